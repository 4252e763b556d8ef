#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# All linters, each to its end; fails if one of them did.
set -uo pipefail
cd "${0%/*}/.." || exit
failed=0

python -m ruff check . || failed=1
python -m mypy || failed=1

# Every source file says what licence it is under.
unmarked=$(git ls-files -co --exclude-standard '*.py' '*.sh' 'Makefile' '*/CMakeLists.txt' |
  xargs grep -L 'SPDX-License-Identifier: Apache-2.0')
if [ -n "$unmarked" ]; then
  printf 'no SPDX-License-Identifier:\n%s\n' "$unmarked"
  failed=1
fi

exit $failed
