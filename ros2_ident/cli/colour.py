# SPDX-License-Identifier: Apache-2.0
"""Red, where standard output is a terminal that shows it and its user wants it."""

import os
import sys


def alarming(text: str) -> str:
    """Return a text in red; as it is where standard output shows no colours."""
    plain = os.environ.get('NO_COLOR') or os.environ.get('TERM', '') in ('', 'dumb', 'unknown')
    return text if plain or not sys.stdout.isatty() else f'\033[1;31m{text}\033[0m'
