#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# All tests, in two processes side by side, each with half of the time; those of the node mostly
# wait. With arguments only the tests that these choose, in one process.
set -uo pipefail
cd "${0%/*}/.." || exit
[ $# -eq 0 ] || exec python -m pytest "$@"

# The threads of one process' linear algebra would wait for those of the other's.
export OPENBLAS_NUM_THREADS="${OPENBLAS_NUM_THREADS:-1}" OMP_NUM_THREADS="${OMP_NUM_THREADS:-1}"
beside=(test/test_ros_*.py test/test_docs_*.py test/test_gap_*.py)
log=build/tests_beside.log
mkdir -p build
# With job control, or what runs in the background, and its children, would not hear Ctrl-C.
set -m
python -m pytest --durations=20 "${beside[@]}" > "$log" 2>&1 &
other=$!
trap 'kill -INT -- -"$other" 2> /dev/null' INT TERM
python -m pytest --durations=20 test checks/test "${beside[@]/#/--ignore=}"
first=$?
wait "$other"
second=$?
cat "$log"
exit $((first ? first : second))
