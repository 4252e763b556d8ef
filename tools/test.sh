#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Tests in two processes side by side, each with half of the time; those of the node mostly wait.
# Arguments choose: `-m "not slow"`, `-k search`. Where one is a path, one process runs that alone.
# In CI the seconds of every test go to build/durations.txt.
set -uo pipefail
cd "${0%/*}/.." || exit
for word in "$@"; do [ ! -e "${word%%::*}" ] || exec python -m pytest "$@"; done

# The threads of one process' linear algebra would wait for those of the other's.
export OPENBLAS_NUM_THREADS="${OPENBLAS_NUM_THREADS:-1}" OMP_NUM_THREADS="${OMP_NUM_THREADS:-1}"
beside=(test/ros test/docs test/gap test/search test/report test/excite test/fleet)
durations=20
[ "${CI:-}" != true ] || durations=0
mkdir -p build
# With job control, or what runs in the background, and its children, would not hear Ctrl-C.
set -m
python -m pytest --durations=$durations "$@" "${beside[@]}" > build/tests_beside.log 2>&1 &
other=$!
trap 'kill -INT -- -"$other" 2> /dev/null' INT TERM
python -m pytest --durations=$durations "$@" test checks/test "${beside[@]/#/--ignore=}" 2>&1 |
  tee build/tests.log
first=${PIPESTATUS[0]}
wait "$other"
second=$?
cat build/tests_beside.log
[ "$durations" -ne 0 ] ||
  grep -hE '^[0-9.]+s (setup|call|teardown) ' build/tests{,_beside}.log | sort -rn > build/durations.txt
# Where what was chosen lies in one half only, the other has found nothing: 5.
[ "$first" -ne 5 ] || first=$second
[ "$second" -ne 5 ] || second=$first
exit $((first ? first : second))
