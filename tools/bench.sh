#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Run every benchmarks/bench_*.py, in order of name.
set -euo pipefail
cd "${0%/*}/.."
shopt -s nullglob

scripts=(benchmarks/bench_*.py)
[ ${#scripts[@]} -gt 0 ] || { echo 'bench: there is no benchmarks/bench_*.py.' >&2; exit 1; }
for script in "${scripts[@]}"; do
  printf '\n== %s\n' "$script"
  python "$script"
done
