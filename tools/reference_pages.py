# SPDX-License-Identifier: Apache-2.0
"""Pages of the documentation that are made from tables in the code.

`python tools/reference_pages.py` writes them; a test compares them.
"""

import argparse
from collections.abc import Iterator
import math
from pathlib import Path
import re

from ros2_ident.cli.main import COMMANDS, make_parser
from ros2_ident.errors import ErrorCode
from ros2_ident.machine.keys import Key, literal
from ros2_ident.models.registry import own_kinds

_MADE = 'Made by `python tools/reference_pages.py`; a test compares it with the code.'


def machine_file() -> str:
    """Return docs/machine_file.md: every key of a machine file."""
    lines = [
        '# The machine file',
        '',
        _MADE,
        '',
        '`ident new-machine --kind KIND` writes one with all keys; how to fill it in:',
        '[own_machine.md](own_machine.md). SI units throughout. What lies outside the plausible',
        'range is warned of, not refused. A key that is not in the table is refused.',
    ]
    for kind in own_kinds().values():
        lines += [
            '',
            f'## `machine: {kind.name}`',
            '',
            f'{kind.title[0].upper()}{kind.title[1:]}.',
            '',
            '| key | unit | meaning | without it | plausible |',
            '| --- | --- | --- | --- | --- |',
        ]
        lines += [_row(key) for key in kind.keys]
    return '\n'.join(lines) + '\n'


def _row(key: Key) -> str:
    units = [unit for unit in dict.fromkeys((key.unit, key.force_unit)) if unit]
    without = key.absent or ('not searched: zero' if key.section == 'parameters' else 'refused')
    span = f'{key.low:g} to {key.high:g}' if math.isfinite(key.high) else ''
    return (
        f'| `{".".join(key.path)}` | {" or ".join(units)} | {key.meaning}; '
        f'as `{literal(key)}` | {without} | {span} |'
    )


def errors() -> str:
    """Return docs/errors.md: the catalogue of errors."""
    lines = [
        '# Errors',
        '',
        _MADE,
        '',
        'Every error is one sentence that says what was found, where, and what to do, and a code.',
        '`ident` prints the code behind the sentence, in brackets, and ends with this exit code;',
        'the node puts number and sentence into `error_code` and `error_message` of its messages.',
        'In Python it is an `IdentError` with `code` and `message`. Numbers are never reused.',
        '',
        '| number | code | meaning | remedy | exit code |',
        '| --- | --- | --- | --- | --- |',
    ]
    lines += [
        f'| {code.value} | `{code.name}` | {code.meaning} | {code.remedy} | {code.exit_code} |'
        for code in ErrorCode
    ]
    lines += [
        '',
        '`CANCELLED`, `DIVERGED` and `NOT_IDENTIFIABLE` come with a result: what was found until',
        'then is printed and written. `ident check` ends with 1 where it finds errors, whatever',
        'they are; they are all in its report.',
    ]
    return '\n'.join(lines) + '\n'


def command_line() -> str:
    """Return docs/cli.md: every command with its arguments, examples and exit codes."""
    lines = [
        '# The command `ident`',
        '',
        _MADE,
        '',
        'The same is in `ident COMMAND --help`. A word in capitals stands for a value; an option',
        'marked * can be given several times.',
        '',
        '| command | does |',
        '| --- | --- |',
        *(
            f'| [`ident {name}`](#ident-{name}) | {line} |'
            for name, (_, line) in COMMANDS.items()
        ),
    ]
    for name in COMMANDS:
        lines += ['', *_command(name)]
    lines += [
        '',
        '## Completion by tab',
        '',
        'In bash, once a shell after `. ./env.sh`, or for good in `~/.bashrc`:',
        '',
        '```bash',
        'eval "$(register-python-argcomplete ident)"',
        '```',
        '',
        'In zsh the same after `autoload -U bashcompinit && bashcompinit`. Commands, options,',
        'bags, machine files, drives, parameters and effects are completed; drives and parameters',
        'after `--machine FILE` only, since they stand in the file.',
    ]
    return '\n'.join(lines) + '\n'


def _command(name: str) -> Iterator[str]:
    """Yield the section on one command."""
    parsers = next(
        action
        for action in make_parser([name])._actions
        if isinstance(action, argparse._SubParsersAction)
    )
    parser = parsers.choices[name]
    examples, _, rest = (parser.epilog or '').partition('\n\n')
    yield from (f'## `ident {name}`', '', parser.description or '', '')
    yield from ('| argument | meaning |', '| --- | --- |')
    for action in parser._actions:
        if not isinstance(action, argparse._HelpAction):
            yield f'| {_argument(action)} | {_meaning(action)} |'
    yield from ('', '<!-- not run: examples -->', '```bash')
    yield from (line.removeprefix('  ') for line in examples.splitlines()[1:])
    yield '```'
    for paragraph in rest.partition('An error ends')[0].strip().split('\n\n'):
        for part in re.split(r'\n(?=exit codes:)', paragraph):
            text = ' '.join(part.split())
            yield from ('', f'{text[0].upper()}{text[1:]}.')


def _argument(action: argparse.Action) -> str:
    word = action.metavar or '/'.join(map(str, action.choices or ())) or action.dest.upper()
    if not action.option_strings:
        return f'`[{word}]`' if action.nargs == '?' else f'`{word}`'
    value = '' if action.nargs == 0 else f' {word}'
    several = ' *' if isinstance(action, argparse._AppendAction) else ''
    return f'`{action.option_strings[-1]}{value}`{several}'


def _meaning(action: argparse.Action) -> str:
    text = (action.help or '').replace('%%', '%').replace('|', '\\|')
    return f'{text}; required' if action.required and action.option_strings else text


def messages(root: Path) -> str:
    """Return docs/messages.md: messages and actions as they are defined.

    Args:
        root: The root of the source tree, whose msg_defs/ is read.
    """
    lines = [
        '# Messages and actions',
        '',
        _MADE,
        '',
        'The definitions of the package `ros2_ident_msgs`, from `msg_defs/`. Which topic, service',
        'or action has which, [node.md](node.md#topics-services-and-the-action) says. In',
        'an action, goal, result and feedback stand between the lines `---`.',
    ]
    for folder in ('action', 'msg'):
        for path in sorted((root / 'msg_defs' / folder).iterdir()):
            text = path.read_text(encoding='utf-8').strip()
            head, _, body = text.partition('\n\n')
            about = ' '.join(line.lstrip('# ') for line in head.splitlines())
            lines += ['', f'## `{folder}/{path.stem}`', '', about, '', '```text', body, '```']
    return '\n'.join(lines) + '\n'


def generated(root: Path) -> dict[Path, str]:
    """Return the pages, below the root of the source tree."""
    return {
        root / 'docs/cli.md': command_line(),
        root / 'docs/errors.md': errors(),
        root / 'docs/machine_file.md': machine_file(),
        root / 'docs/messages.md': messages(root),
    }


if __name__ == '__main__':
    for path, text in generated(Path(__file__).resolve().parents[1]).items():
        path.write_text(text, encoding='utf-8')
        print(path)
