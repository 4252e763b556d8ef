#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Measure the figures of docs/figures.md again, into build/figures.md with commit, date and load: six
# minutes on two idle cores. Fails if a benchmark did, after the last. With names as
# arguments, only those: tools/bench.sh peers. peers installs other programs into build/peers, and
# writes build/benchmarks.md, too.
#
# What changes less has to be named: search_belt, mujoco_blind (needs what peers installs, and half
# an hour), simulators (installs several GB), practice (wants a folder of cases).
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

[ $# -gt 0 ] || set -- peers kernel convergence interval_coverage latency timer
mkdir -p build
exec > >(tee build/figures.md)
printf '# Figures\n\n%s, commit %s, %s processors\n' \
  "$(date +%F)" "$(git describe --always --dirty)" "$(getconf _NPROCESSORS_ONLN)"
for name; do
  printf '\n## %s\n\nload %s\n\n```\n' "$name" "$(cut -d ' ' -f 1-3 /proc/loadavg)"
  SECONDS=0
  case $name in
    peers) with_peers checks/benchmarks/peers.py ;;
    mujoco_blind)
      with_peers -m checks.blind --generator mujoco --cases 200 --seed 2026 --out build/mujoco_blind
      ;;
    arm) with_peers checks/benchmarks/arm.py ;;
    simulators) with_peers -m checks.simulators --out build/simulators ;;
    *) python "checks/benchmarks/$name.py" ;;
  esac || { echo "bench: $name failed." >&2; failed=1; }
  printf '```\n\n%d s\n' "$SECONDS"
done

exit $failed
