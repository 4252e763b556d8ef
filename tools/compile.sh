#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Run what compiles on the bundled machines, so that the first runs of users need not: simulations,
# and to byte-code what the commands and the node import, for shells that may not write it, too.
set -euo pipefail
cd "${0%/*}/.."
. ./env.sh
unset PYTHONDONTWRITEBYTECODE
out=$(mktemp -d)
trap 'rm -rf "$out"' EXIT
for pair in axis_reversals:emps tripod_mixed:tripod; do
  words=("bags/${pair%:*}" --machine "config/${pair#*:}.yaml" --out "$out" --quiet)
  # To its end: its intervals compile, too. A diagnosis that is cut short has compiled before.
  ident identify "${words[@]}" --population 64 --generations 2 || true
  ident diagnose "${words[@]}" --seconds 1 || true
done
python -c 'import ros2_ident.ros.node' || true
