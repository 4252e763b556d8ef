#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# The kept runs of the blind check against their seals, then a short run of both checks. Fails if
# one of them did, after the last.
set -uo pipefail
cd "${0%/*}/.." || exit
failed=0

for seals in docs/blind/*/seals.json docs/blind/*/*/seals.json; do
  folder=${seals%/seals.json}
  printf '\n== %s\n' "$folder"
  python -m checks.blind --verify "$folder" || failed=1
done
mkdir -p build/checks
printf '\n== eight new cases\n'
python -m checks.blind --cases 8 --seed 1 --out build/checks/blind || failed=1
printf "\n== the paper's experiments\n"
python -m checks.paper --seeds 5 --out build/checks || failed=1

exit $failed
