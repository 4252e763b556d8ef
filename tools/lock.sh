#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Resolve requirements*.in anew and write requirements.lock, with the hash of every file that a
# package has of its version. Nothing is installed outside a temporary folder.
set -euo pipefail
cd "${0%/*}/.."

scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT
"${PYTHON:-python3}" -m venv "$scratch/venv"
"$scratch/venv/bin/python" -m pip install --quiet uv

# lark-parser is the old name of lark and writes to the same folder; a ROS wheel still asks for it.
"$scratch/venv/bin/uv" pip compile --quiet --upgrade --generate-hashes --no-annotate --no-header \
  --python-version 3.11 --python-platform x86_64-manylinux_2_34 --no-emit-package lark-parser \
  --output-file "$scratch/lock" requirements.in requirements-wheels.in
{
  echo '# Made by `make lock` from requirements.in and requirements-wheels.in; complete, so it is'
  echo '# installed with --no-deps.'
  cat "$scratch/lock"
} > requirements.lock
echo "requirements.lock: $(grep -c == requirements.lock) packages"
