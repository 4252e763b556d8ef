# SPDX-License-Identifier: Apache-2.0
"""A program of this folder: arguments, and errors as sentences, as `ident` has them."""

import argparse
from collections.abc import Sequence
import sys
from types import ModuleType

from ros2_ident.cli.main import exit_codes
from ros2_ident.errors import IdentError
from ros2_ident.threads import one_thread_for_linear_algebra


def start(name: str, command: ModuleType, argv: Sequence[str] | None = None) -> int:
    """Run a program.

    Args:
        name: Behind `python -m`.
        command: DESCRIPTION, EXAMPLES, EXIT_CODES, add_arguments(parser) and run(args).
        argv: The words after its name; those of the process where None.
    """
    one_thread_for_linear_algebra()
    words = list(sys.argv[1:] if argv is None else argv)
    parser = argparse.ArgumentParser(
        prog=f'python -m {name}',
        description=command.DESCRIPTION,
        epilog=f'examples:\n{command.EXAMPLES}\n{exit_codes(command.EXIT_CODES)}',
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    command.add_arguments(parser)
    args = parser.parse_args(words)
    args.command = ['python', '-m', name, *words]
    try:
        return int(command.run(args))
    except IdentError as error:
        print(f'{name}: {error.message} [{error.code.name}]', file=sys.stderr)
        return error.code.exit_code
    except KeyboardInterrupt:
        print(f'{name}: interrupted', file=sys.stderr)
        return 1
