# SPDX-License-Identifier: Apache-2.0
"""`ident new-machine`: a commented machine file to start from."""

import argparse

from ros2_ident.cli.arguments import names
from ros2_ident.models.registry import KINDS, machine_from_mapping

DESCRIPTION = (
    'Write a machine file: every key with its unit, its meaning and the value of an example '
    "machine. Put your machine's values in their place, then ask `ident check`."
)
EXAMPLES = (
    '  ident new-machine --kind linear_axis --drives x_axis --out my_axis.yaml\n'
    '  ident new-machine --kind tripod --drives left,right,rear --out my_tripod.yaml\n'
    '  ident check --machine my_axis.yaml\n'
)
EXIT_CODES = {0: 'written'}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    parser.add_argument(
        '--kind',
        choices=tuple(KINDS),
        required=True,
        help='kind of machine',
    )
    parser.add_argument(
        '--drives', type=names, default=(), metavar='A,B', help='joint names in your bags'
    )
    parser.add_argument('--out', metavar='FILE', help='file to write; standard output without it')


def run(args: argparse.Namespace) -> int:
    """Write the file."""
    from pathlib import Path

    import yaml

    from ros2_ident.errors import ErrorCode, IdentError
    from ros2_ident.files import write_text
    from ros2_ident.machine.template import machine_template

    text = machine_template(KINDS[args.kind], args.drives)
    machine_from_mapping(yaml.safe_load(text), '--drives')
    if args.out is None:
        print(text, end='')
        return 0
    path = Path(args.out)
    if path.exists():
        raise IdentError(
            ErrorCode.INVALID_GOAL, f'{path}: exists already; remove it or give another name'
        )
    write_text(path, text)
    print(f'written: {path}; change its values, then: ident check --machine {path}')
    return 0
