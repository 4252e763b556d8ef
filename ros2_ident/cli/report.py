# SPDX-License-Identifier: Apache-2.0
"""`ident report`: one page on a result directory."""

import argparse
from pathlib import Path

DESCRIPTION = (
    'Write a page on what a result directory holds: what is wrong with the simulation, how sure '
    'that is, how far the gap closes, what to do now, and the details. Of several directories, '
    'write one page that compares them. A page is one HTML file; it opens without a network and '
    'prints.'
)
EXAMPLES = (
    '  ident report results\n'
    '  ident report results --page axis_7.html\n'
    '  ident report before after --page before_and_after.html\n'
    '\n'
    '`ident identify` and `ident diagnose` write the page by themselves; this writes it again,\n'
    'for an older directory or after both have written to one.\n'
)
EXIT_CODES = {0: 'the page is written'}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    parser.add_argument(
        'directory',
        metavar='DIR',
        nargs='+',
        help='what `ident identify`, `ident diagnose` or `ident fleet` wrote; the others are '
        'compared with the first',
    )
    parser.add_argument(
        '--page',
        metavar='FILE',
        type=Path,
        help='file to write; by default report.html in DIR, of several comparison.html in the '
        'first',
    )


def run(args: argparse.Namespace) -> int:
    """Write the page."""
    from ros2_ident.report.page import write_comparison, write_report

    if len(args.directory) == 1:
        page = write_report(args.directory[0], args.page)
    else:
        page = write_comparison(args.directory, args.page)
    print(f'written: {page}')
    return 0
