#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Build the documentation site; a warning is an error.
set -euo pipefail
cd "${0%/*}/.."

# Its makers advertise another program on standard error.
export NO_MKDOCS_2_WARNING=1
python -m mkdocs build --quiet --strict "$@"
echo 'docs: build/docs/index.html'
