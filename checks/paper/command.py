# SPDX-License-Identifier: Apache-2.0
"""`python -m checks.paper`: the paper's experiments again, and the page on them."""

import argparse

from ros2_ident.cli.arguments import count

DESCRIPTION = (
    'Rerun the experiments of Ludwig and Gerstmayr (2011) and write a page with our figures '
    "beside the paper's."
)
EXAMPLES = (
    '  python -m checks.paper --out docs\n'
    '  python -m checks.paper --out /tmp/quick --seeds 20\n'
    '\n'
    'writes to DIR: paper.md, and its pictures in paper/\n'
)
EXIT_CODES = {0: 'written'}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    parser.add_argument(
        '--out', default='build', metavar='DIR', help='directory for the page; build by default'
    )
    parser.add_argument(
        '--seeds',
        type=count,
        default=100,
        metavar='N',
        help='repetitions behind every success rate; 100 by default',
    )
    parser.add_argument('--quiet', action='store_true', help='show no progress')


def run(args: argparse.Namespace) -> int:
    """Run the experiments."""
    from checks.paper.run import run as run_paper
    from ros2_ident.cli.progress import Meter
    from ros2_ident.files import make_directory

    with Meter(quiet=args.quiet) as meter:
        page = run_paper(make_directory(args.out), meter, seeds=args.seeds)
    print(f'written: {page}')
    return 0
