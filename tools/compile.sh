#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Run each command on each bundled machine for a second, so that what they need is compiled.
set -euo pipefail
cd "${0%/*}/.."
. ./env.sh
out=$(mktemp -d)
trap 'rm -rf "$out"' EXIT
for command in identify diagnose; do
  for pair in axis_reversals:emps tripod_mixed:tripod; do
    ident "$command" "bags/${pair%:*}" --machine "config/${pair#*:}.yaml" --out "$out" \
      --seconds 1 --no-report --quiet || true
  done
done
