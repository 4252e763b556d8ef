#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Make the API pages from the docstrings.
set -euo pipefail
cd "${0%/*}/.."

python -m pdoc --docformat google --output-directory build/docs ros2_ident
echo 'docs: build/docs/index.html'
