#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# The benchmarks that need nothing but the package, with their default arguments: each takes less
# than two minutes on two cores. Fails if one of them did, after the last.
#
# Not among them: benchmarks/coverage.py (five minutes and more), benchmarks/practice.py (wants a
# folder of cases), benchmarks/report.py (wants result directories and Chromium),
# benchmarks/kernel.py (wants gcc and AVX-512).
set -uo pipefail
cd "${0%/*}/.." || exit
failed=0

for name in search_mutation search_belt convergence latency cluster; do
  printf '\n== benchmarks/%s.py\n' "$name"
  SECONDS=0
  python "benchmarks/$name.py" || { echo "bench: $name failed." >&2; failed=1; }
  printf '(%d s)\n' "$SECONDS"
done

exit $failed
