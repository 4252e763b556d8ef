# SPDX-License-Identifier: Apache-2.0
"""`ident report`: one page on a result directory."""

import argparse


def run(args: argparse.Namespace) -> int:
    """Write the page."""
    from ros2_ident.report.page import write_comparison, write_report

    if len(args.directory) == 1:
        page = write_report(args.directory[0], args.page)
    else:
        page = write_comparison(args.directory, args.page)
    print(f'written: {page}')
    return 0
