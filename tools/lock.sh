#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Resolve requirements*.in anew and write requirements.lock. Run it with the Python that
# the lock is meant for (3.11); nothing is installed outside a temporary folder.
set -euo pipefail
cd "${0%/*}/.."

scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT
"${PYTHON:-python3.11}" -m venv "$scratch/venv"
"$scratch/venv/bin/python" -m pip install --quiet --dry-run --ignore-installed \
  --report "$scratch/report.json" -r requirements.in -r requirements-wheels.in

# lark-parser is the old name of lark and writes to the same folder; a ROS wheel still asks for it.
"$scratch/venv/bin/python" - "$scratch/report.json" > requirements.lock <<'PYTHON'
import json
import sys

print('# Made by `make lock` from requirements.in and requirements-wheels.in; complete, so it is')
print('# installed with --no-deps.')
with open(sys.argv[1], encoding='utf-8') as file:
    chosen = [entry['metadata'] for entry in json.load(file)['install']]
for name, version in sorted((item['name'].lower(), item['version']) for item in chosen):
    if name != 'lark-parser':
        print(f'{name}=={version}')
PYTHON
echo "requirements.lock: $(grep -c == requirements.lock) packages"
