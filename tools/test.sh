#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Tests in three processes side by side; those of the node mostly wait.
# Arguments choose: `-m "not slow"`, `-k search`. Where one is a path, one process runs that alone.
# In CI the seconds of every test go to build/durations.txt.
set -uo pipefail
cd "${0%/*}/.." || exit
for word in "$@"; do [ ! -e "${word%%::*}" ] || exec python -m pytest "$@"; done

# The threads of one process' linear algebra would wait for those of the other's.
export OPENBLAS_NUM_THREADS="${OPENBLAS_NUM_THREADS:-1}" OMP_NUM_THREADS="${OMP_NUM_THREADS:-1}"
beside=(test/ros 'test/docs test/gap test/search test/report checks/test')
durations=20
[ "${CI:-}" != true ] || durations=0
mkdir -p build
rm -f build/tests*.log
# With job control, or what runs in the background, and its children, would not hear Ctrl-C.
set -m
others=() ignored=()
for part in "${!beside[@]}"; do
  read -ra rooms <<< "${beside[part]}"
  ignored+=("${rooms[@]/#/--ignore=}")
  python -m pytest --durations=$durations "$@" "${rooms[@]}" > "build/tests_$part.log" 2>&1 &
  others+=($!)
done
trap 'for other in "${others[@]}"; do kill -INT -- -"$other" 2> /dev/null; done' INT TERM
python -m pytest --durations=$durations "$@" test "${ignored[@]}" 2>&1 | tee build/tests.log
codes=("${PIPESTATUS[0]}")
for part in "${!others[@]}"; do
  wait "${others[part]}"
  codes+=($?)
  cat "build/tests_$part.log"
done
[ "$durations" -ne 0 ] ||
  grep -hE '^[0-9.]+s (setup|call|teardown) ' build/tests*.log | sort -rn > build/durations.txt
# What was chosen may lie in one part only; the others have then found nothing: 5.
found=5
for code in "${codes[@]}"; do
  [ "$code" -eq 5 ] || { [ "$found" -ne 5 ] && [ "$found" -ne 0 ]; } || found=$code
done
exit "$found"
