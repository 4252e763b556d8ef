# SPDX-License-Identifier: Apache-2.0
"""Pages of the documentation that are made from tables in the code.

`python tools/reference_pages.py` writes them; a test compares them.
"""

import argparse
from collections.abc import Container, Iterable, Iterator
import math
from pathlib import Path
import re

from ros2_ident.cli.arguments import COMMANDS
from ros2_ident.cli.main import make_parser
from ros2_ident.machine.keys import Key
from ros2_ident.models.registry import OWN_KINDS

_MADE = 'Made by `python tools/reference_pages.py`; a test compares it with the code.'


def machine_file() -> str:
    """Return docs/machine_file.md: every key of a machine file."""
    kinds = OWN_KINDS
    users: dict[tuple[str, ...], list[str]] = {}
    for kind in kinds.values():
        for cells in _rows(kind.keys):
            users.setdefault(cells, []).append(kind.name)
    lines = [
        '# The machine file',
        '',
        _MADE,
        '',
        '`ident new-machine --kind KIND` writes one with all keys; how to fill it in:',
        '[own_machine.md](own_machine.md). SI units throughout. A value outside the plausible',
        'range gives a warning. An unknown key is an error.',
        '',
        'A key `drive.x` or `controller.x` holds for all drives, or is a list with a value for',
        'each. Keys of `parameters` are identified; their value is an interval with its unit, as',
        '`[1.0e+4, 3.0e+5, N/m]`, or one for each drive; absent, they are 0, of the kind `mujoco`',
        "the description's. A starred key is a constant that can be identified, too: write its",
        'interval below `parameters`. The second of two units is that of a drive whose effort is',
        "a force, or of an arm's sliding joint.",
        '',
        '## Keys of several kinds',
        '',
        *_table('key', 'meaning', 'if absent', 'plausible', 'kinds'),
    ]
    for cells, names in users.items():
        if len(names) > 1:
            everywhere = len(names) == len(kinds)
            lines.append(_line(*cells, 'all' if everywhere else ', '.join(names)))
    for kind in kinds.values():
        lines += ['', f'## `machine: {kind.name}`', '']
        lines += [f'{kind.title[0].upper()}{kind.title[1:]}.', '']
        lines += _table('key', 'meaning', 'if absent', 'plausible')
        lines += [_line(*cells) for cells, names in users.items() if names == [kind.name]]
    return '\n'.join(lines) + '\n'


def _line(*cells: str) -> str:
    return f'| {" | ".join(cells)} |'


def _table(*heads: str) -> list[str]:
    return [_line(*heads), _line(*['---'] * len(heads))]


def _rows(keys: Iterable[Key]) -> Iterator[tuple[str, ...]]:
    """Yield the cells of each key; a constant that can be identified has one row and a star."""
    sought = {key.name for key in keys if key.section == 'parameters'}
    constants = {key.name for key in keys if key.constant}
    for key in keys:
        if key.section == 'parameters' and key.name in constants:
            continue
        units = [unit for unit in dict.fromkeys((key.unit, key.force_unit)) if unit.strip('1')]
        bounds = f'[{key.low:g}, {key.high:g}]' if math.isfinite(key.high) else ''
        absent = key.absent.replace(' by default', '') or 'required'
        star = ' *' if key.constant and key.name in sought else ''
        yield (
            f'`{".".join(key.path)}`{star}',
            key.meaning,
            '' if key.section == 'parameters' else absent,
            f'{bounds} {" or ".join(units)}'.strip(),
        )


def command_line() -> str:
    """Return docs/cli.md: every command with its arguments, examples and exit codes."""
    parsers = {name: _parser(name) for name in COMMANDS}
    users: dict[tuple[str, str], list[str]] = {}
    for name, parser in parsers.items():
        for action in _options(parser):
            if action.option_strings:
                needed = ' (required)' if action.required else ''
                users.setdefault(_row(action), []).append(f'{name}{needed}')
    shared = {row: names for row, names in users.items() if len(names) > 1}
    lines = [
        '# The command `ident`',
        '',
        _MADE,
        '',
        '`ident COMMAND --help` has the same, with more examples. A word in capitals stands for',
        'a value; an option marked * can be given several times. Output: [files.md](files.md).',
        '',
        *_table('command', 'does'),
        *(
            f'| [`ident {name}`](#ident-{name}) | {command["help"]} |'
            for name, command in COMMANDS.items()
        ),
        '',
        'Exit codes: 0 done; 1 done in part, or with a result that needs attention, listed with',
        'each command; 2 wrong use or bad input; 3 a defect of ident.',
        '',
        '## Shared options',
        '',
        *_table('option', 'meaning', 'of'),
        *(_line(*row, ', '.join(names)) for row, names in shared.items()),
    ]
    for name, parser in parsers.items():
        lines += ['', *_command(name, parser, shared)]
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
        'In zsh the same after `autoload -U bashcompinit && bashcompinit`.',
    ]
    return '\n'.join(lines) + '\n'


def _parser(name: str) -> argparse.ArgumentParser:
    parsers = next(
        action
        for action in make_parser([name])._actions
        if isinstance(action, argparse._SubParsersAction)
    )
    return parsers.choices[name]


def _options(parser: argparse.ArgumentParser) -> Iterator[argparse.Action]:
    return (x for x in parser._actions if not isinstance(x, argparse._HelpAction))


def _command(
    name: str, parser: argparse.ArgumentParser, shared: Container[tuple[str, str]]
) -> Iterator[str]:
    """Yield the section on one command."""
    examples, _, rest = (parser.epilog or '').partition('\n\n')
    yield from (f'## `ident {name}`', '', parser.description or '', '')
    yield from _table('argument', 'meaning')
    for action in _options(parser):
        row = _row(action)
        if row not in shared or not action.option_strings:
            yield _line(row[0], f'{row[1]}; required' if _needed(action) else row[1])
    yield from ('', '```sh')  # cli/test_main.py checks them in the help
    lines = [line.removeprefix('  ') for line in examples.splitlines()[1:]]
    starts = [number for number, line in enumerate(lines) if not line.startswith(' ')]
    yield from lines[: [*starts, *[len(lines)] * 2][2]]  # two of them; the help has all
    yield '```'
    for paragraph in rest.partition('An error ends')[0].strip().split('\n\n'):
        for part in re.split(r'\n(?=exit codes:)', paragraph):
            text = ' '.join(part.split()).rstrip('.')
            # what 0, 2 and 3 mean is the same everywhere
            text = re.sub(r'^exit codes: 0 .*?; (1 .*)?2 wrong.*', r'\1', text).rstrip('; ')
            # files have a page of their own
            if text and not text.startswith('writes to'):
                one = f'Exit code 1: {text[2:]}' if text[0] == '1' else text[0].upper() + text[1:]
                yield from ('', f'{one}.')


def _argument(action: argparse.Action) -> str:
    word = action.metavar or '/'.join(map(str, action.choices or ())) or action.dest.upper()
    if not action.option_strings:
        return f'`[{word}]`' if action.nargs == '?' else f'`{word}`'
    value = '' if action.nargs == 0 else f' {word}'
    several = ' *' if isinstance(action, argparse._AppendAction) else ''
    return f'`{action.option_strings[-1]}{value}`{several}'


def _row(action: argparse.Action) -> tuple[str, str]:
    text = (action.help or '').replace('%(default)s', f'`{action.default}`')
    return _argument(action), text.replace('%%', '%').replace('|', '\\|')


def _needed(action: argparse.Action) -> bool:
    return action.required and bool(action.option_strings)


def generated(root: Path) -> dict[Path, str]:
    """Return the pages, below the root of the source tree."""
    return {
        root / 'docs/cli.md': command_line(),
        root / 'docs/machine_file.md': machine_file(),
    }


if __name__ == '__main__':
    for path, text in generated(Path(__file__).resolve().parents[1]).items():
        path.write_text(text, encoding='utf-8')
        print(path)
