#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# All tests, in two processes that take file after file, the longest first.
# Arguments choose: `-m "not slow"`, `-k search`. Where one is a path, one process runs that alone.
# In CI the seconds of every test go to build/durations.txt.
set -euo pipefail
cd "${0%/*}/.."
for word in "$@"; do [ ! -e "${word%%::*}" ] || exec python -m pytest "$@"; done

# Without byte-code every process compiles all tests anew, 5 s of each; git ignores it.
unset PYTHONDONTWRITEBYTECODE
# The threads of one process' linear algebra would wait for those of the other's.
export OPENBLAS_NUM_THREADS="${OPENBLAS_NUM_THREADS:-1}" OMP_NUM_THREADS="${OMP_NUM_THREADS:-1}"
both=(-n 2 --dist loadfile --no-loadscope-reorder)
[ "${CI:-}" = true ] || exec python -m pytest "${both[@]}" --durations=20 "$@"
mkdir -p build
python -m pytest "${both[@]}" --durations=0 "$@" | tee build/tests.log
grep -E '^[0-9.]+s (setup|call|teardown) ' build/tests.log | sort -rn > build/durations.txt
