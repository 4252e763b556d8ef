# SPDX-License-Identifier: Apache-2.0
"""`python -m checks.simulators`: exported machines in the simulators that install from PyPI."""

import argparse
import sys

from checks.simulators.peers import PEERS
from ros2_ident.cli.arguments import names

DESCRIPTION = (
    'Export machines with known values, run them in each simulator, and compare joint torques and '
    'motion with our own. Every simulator gets the newest release in an environment of its own.'
)
EXAMPLES = (
    '  python -m checks.simulators --out build/simulators\n'
    '  python -m checks.simulators --out build/simulators --only mujoco,drake\n'
    '  python -m checks.simulators --out build/cuda --only warp,newton,usd --device cuda:0\n'
    '\n'
    'writes to DIR: simulators.md, figures.json, the exports, and an environment of each\n'
    'simulator, which stays for the next run until it is removed; needs a network\n'
)
EXIT_CODES = {0: 'written'}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    parser.add_argument('--out', required=True, metavar='DIR', help='directory of it all')
    parser.add_argument(
        '--python', default=sys.executable, metavar='FILE',
        help='interpreter that their environments are made of; that of this command by default',
    )  # fmt: skip
    parser.add_argument(
        '--device', default='cpu', metavar='NAME',
        help='where MuJoCo Warp and Newton run, as cuda:0; the processor by default',
    )  # fmt: skip
    parser.add_argument(
        '--only', type=names, default=[*PEERS], metavar='NAME,..', help=f'of {", ".join(PEERS)}'
    )


def run(args: argparse.Namespace) -> int:
    """Run the simulators, write the page."""
    from checks.simulators.run import run as run_all

    print(f'written: {run_all(args.out, args.only, args.python, args.device)}')
    return 0
