#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# All linters, each to its end; fails if one of them did.
set -uo pipefail
cd "${0%/*}/.." || exit
failed=0
mkdir -p build

python -m ruff check . || failed=1
python -m ruff format --check --quiet . || { echo 'not formatted; run: ruff format .'; failed=1; }
python -m mypy || failed=1
python tools/callers.py || failed=1
lint-imports --no-cache > build/imports.log 2>&1 || { cat build/imports.log; failed=1; }

# English: proselint, and terms of the field, a pattern and what to write in its place on each line.
proselint check README.md CHANGELOG.rst docs/*.md || failed=1
if git grep -nIEi -f <(cut -f1 tools/terms.txt) -- \
  README.md CHANGELOG.rst 'docs/*.md' 'ros2_ident/*.py' 'msg_defs/*'; then
  echo 'these terms are replaced as tools/terms.txt has it'
  failed=1
fi

# Every source file says what licence it is under.
unmarked=$(git ls-files -co --exclude-standard '*.py' '*.sh' 'Makefile' '*/CMakeLists.txt' |
  xargs grep -L 'SPDX-License-Identifier: Apache-2.0')
if [ -n "$unmarked" ]; then
  printf 'no SPDX-License-Identifier:\n%s\n' "$unmarked"
  failed=1
fi

exit $failed
