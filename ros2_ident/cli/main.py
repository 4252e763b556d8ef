# PYTHON_ARGCOMPLETE_OK
# SPDX-License-Identifier: Apache-2.0
"""The command `ident`: finds the subcommand, loads no other, turns errors into sentences.

Exit codes: 0 success, 1 done but without a usable answer, 2 wrong use or bad input, 3 a defect.
"""

import argparse
import atexit
from collections.abc import Mapping, Sequence
import gc
import importlib
import os
import sys
import textwrap
import time
import traceback

from ros2_ident import package_version
from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.threads import one_thread_for_linear_algebra

EXAMPLES = (
    'examples:\n'
    '  ident check bags/axis_reversals --machine config/emps.yaml\n'
    '  ident identify bags/axis_reversals --machine config/emps.yaml --out results\n'
    '  ident identify --help\n'
    '\n'
)
EXIT_CODES = {0: 'success', 1: 'done, but the answer is not usable as it is'}
# What ends every command in the same way.
_FAILURES = {2: 'wrong use or bad input', 3: 'a defect of ident'}
_CODES = 'An error ends with its code in brackets; docs/errors.md says what each means.\n'


def exit_codes(own: Mapping[int, str]) -> str:
    """Return what a command's help says on exit codes."""
    text = '; '.join(f'{number} {meaning}' for number, meaning in {**own, **_FAILURES}.items())
    return textwrap.fill(f'exit codes: {text}', 79)


def make_parser(words: Sequence[str]) -> argparse.ArgumentParser:
    """Return the parser for a command line; only the subcommand among its words is loaded."""
    from ros2_ident.cli.arguments import add_arguments, COMMANDS

    parser = argparse.ArgumentParser(
        prog='ident',
        description='Identify drive parameters from recorded drive data.',
        epilog=f'{EXAMPLES}{exit_codes(EXIT_CODES)}\n{_CODES}',
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    parser.add_argument('--version', action='store_true', help='print the version and exit')
    parser.set_defaults(refuse=parser.error)
    parsers = parser.add_subparsers(dest='command', metavar='COMMAND', title='commands')
    wanted = next((word for word in words if word in COMMANDS), None)
    for name, command in COMMANDS.items():
        if name != wanted:
            parsers.add_parser(name, help=command['help'])
            continue
        examples = textwrap.indent(command['examples'], '  ')
        more = f'\n{command["more"]}' if 'more' in command else ''
        codes = exit_codes(command['exit codes'])
        own = parsers.add_parser(
            name,
            help=command['help'],
            description=command['description'].rstrip(),
            epilog=f'examples:\n{examples}{more}\n{codes}\n{_CODES}',
            formatter_class=argparse.RawDescriptionHelpFormatter,
            allow_abbrev=False,
        )
        add_arguments(own, command)
        own.set_defaults(refuse=own.error)
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Run `ident` with some words, those of the process where None."""
    begun = time.monotonic()
    one_thread_for_linear_algebra()
    # Most of what a command makes are libraries' classes, which stay: the garbage collector looks
    # at them less often, and not at all at the end, where Python would for up to a second.
    gc.set_threshold(10_000)
    atexit.register(gc.freeze)
    words = list(sys.argv[1:] if argv is None else argv)
    if words[:1] == ['--version']:
        print(f'ident {package_version()}')
        return 0
    parser = make_parser([*words, *os.environ.get('COMP_LINE', '').split()])
    if '_ARGCOMPLETE' in os.environ:
        import argcomplete

        argcomplete.autocomplete(parser)
    try:
        args, more = parser.parse_known_args(words)
        if more:  # said with the usage of the command itself
            args.refuse(f'unrecognized arguments: {" ".join(more)}')
    except SystemExit as exc:
        return int(exc.code or 0)
    args.words, args.begun = words, begun
    if args.command is None:
        parser.print_help(sys.stderr)
        return 2
    try:
        command = importlib.import_module(f'{__package__}.{args.command.replace("-", "_")}')
        return int(command.run(args))
    except IdentError as error:
        print(f'ident {args.command}: {error.message} [{error.code.name}]', file=sys.stderr)
        return error.code.exit_code
    except KeyboardInterrupt:
        print(f'ident {args.command}: interrupted', file=sys.stderr)
        return 1
    except BrokenPipeError:
        # The reader of the output has left.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except Exception as defect:
        traceback.print_exc()
        code = ErrorCode.INTERNAL
        print(
            f'ident {args.command}: a defect of this package ended it ({type(defect).__name__}); '
            f'please report it with the text above [{code.name}]',
            file=sys.stderr,
        )
        return code.exit_code


if __name__ == '__main__':
    sys.exit(main())
