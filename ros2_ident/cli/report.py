# SPDX-License-Identifier: Apache-2.0
"""`ident report`: one page on a result directory."""

import argparse
from pathlib import Path
import sys

from ros2_ident.errors import IdentError

DESCRIPTION = (
    'Write one page on what a result directory holds: the answer in sentences, measured and '
    'simulated effort, parameters, search, gap, provenance. The page is one HTML file; it opens '
    'without a network and prints.'
)
EXAMPLES = (
    '  ident report results\n'
    '  ident report results --page axis_7.html\n'
    '\n'
    '`ident identify` and `ident diagnose` write the page by themselves; this writes it again,\n'
    'for an older directory or after both have written to one.\n'
)
EXIT_CODES = {0: 'the page is written'}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    parser.add_argument(
        'directory', metavar='DIR', help='what `ident identify` or `ident diagnose` wrote'
    )
    parser.add_argument(
        '--page', metavar='FILE', type=Path, help='file to write; report.html in DIR by default'
    )


def run(args: argparse.Namespace) -> int:
    """Write the page."""
    from ros2_ident.report.page import write_report

    print(f'written: {write_report(args.directory, args.page)}')
    return 0


def print_page(directory: Path, *, wanted: bool) -> None:
    """Write the page at the end of a run and say where; a run is not lost where that fails.

    Args:
        directory: Where the run has written its files.
        wanted: False only takes away the page on an earlier run.
    """
    from ros2_ident.report.files import PAGE

    (directory / PAGE).unlink(missing_ok=True)
    if not wanted:
        return
    from ros2_ident.report.page import write_report

    try:
        print(f'page: {write_report(directory)}')
    except IdentError as error:
        print(f'no page is written: {error.message}', file=sys.stderr)
