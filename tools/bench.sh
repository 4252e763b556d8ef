#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# The benchmarks with their default arguments. The first compares with other programs, which it
# installs into build/peers, writes build/benchmarks.md, and takes about five minutes on two idle
# cores; the others need nothing but the package, less than two minutes each. Fails if one of them
# did, after the last. With names as arguments, only those: tools/bench.sh peers.
#
# mujoco_blind is not among them: it needs what the first installs, and takes half an hour.
#
# Nor are interval_coverage (five minutes and more), practice (wants a folder of cases), report (wants result
# directories and Chromium) and kernel (wants gcc and AVX-512).
set -uo pipefail
cd "${0%/*}/.." || exit
failed=0

with_peers() {
  tools/peers.sh || {
    echo 'bench: Exudyn, MuJoCo and pycma could not be installed; check the network.' >&2
    return 1
  }
  PYTHONPATH="build/peers${PYTHONPATH:+:$PYTHONPATH}" python "$@"
}

[ $# -gt 0 ] || set -- peers search_mutation search_belt convergence latency timer cluster
for name; do
  printf '\n== checks/benchmarks/%s.py\n' "$name"
  SECONDS=0
  case $name in
    peers) with_peers checks/benchmarks/peers.py ;;
    mujoco_blind) with_peers checks/benchmarks/mujoco_blind.py ;;
    *) python "checks/benchmarks/$name.py" ;;
  esac || { echo "bench: $name failed." >&2; failed=1; }
  printf '(%d s)\n' "$SECONDS"
done

exit $failed
