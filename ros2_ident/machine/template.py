# SPDX-License-Identifier: Apache-2.0
"""A new machine file: every key with unit and meaning, at an example's value."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import cycle, groupby, islice
import textwrap

from ros2_ident.machine.keys import Key, literal
from ros2_ident.machine.kind import Kind

_WIDTH = 99
_COMMENT = 42


def machine_template(
    kind: Kind, drives: Sequence[str] = (), known: Mapping[str, str] | None = None
) -> str:
    """Return the text of a machine file.

    Args:
        kind: The kind of machine.
        drives: Joint names; those of the example where there are none.
        known: Values of keys by name, as YAML. Beside a file that describes it, a machine needs
            nothing of that section which belongs to single drives or has no default.

    Returns:
        YAML that `load_machine` reads. Optional keys that the example does without stand behind
        a `#`.
    """
    given = {**(known or {})}
    if drives:
        given['drives'] = f'[{", ".join(drives)}]'
    described = {key.section for key in kind.keys if key.file and key.name in given}
    lines = [
        '# SPDX-License-Identifier: Apache-2.0',
        f'# Machine file of a {kind.name}: {kind.title}.',
        '# Every value is an example: put those of your machine in their place. SI units.',
        '# A line behind a # is an alternative, or for what this example has no need of.',
        '# Under drive, controller and parameters, a list holds one entry for each drive.',
        '# `ident check --machine THIS_FILE` says what is missing or implausible, with the line.',
    ]
    for section, keys in groupby(kind.keys, key=lambda key: key.section):
        indent = ''
        if section:
            note = (
                '  # to be found; name: [least, largest, unit]' if section == 'parameters' else ''
            )
            lines += ['', f'{section}:{note}']
            indent = '  '
        for key in keys:
            boxed = section == 'parameters'
            if key.name in given and (not boxed or key.name in kind.described):
                key = replace(key, shown=key.shown or not boxed)
                lines += _lines(key, indent, given[key.name])
                continue
            if key.section in described and key.absent and (key.each or key.default is None):
                key = replace(key, shown=False)
            if drives and key.each and key.constant and isinstance(key.example, tuple):
                # The example machine has another number of drives.
                key = replace(key, example=tuple(islice(cycle(key.example), len(drives))))
            lines += _lines(key, indent, literal(key))
    return '\n'.join(lines) + '\n'


def _lines(key: Key, indent: str, value: str) -> list[str]:
    """Return a key's line, and below it what its comment needs more."""
    parts = [] if key.section == 'parameters' or not key.unit else [key.unit]
    parts.append(key.meaning)
    if key.absent:
        parts.append(key.absent)
    text = f'{parts[0]}; {"; ".join(parts[1:])}' if parts[1:] else parts[0]
    mark = '' if key.shown else '# '
    start = f'{indent}{mark}{key.name}: {value}'
    first, *more = textwrap.wrap(text, _WIDTH - _COMMENT - 2)
    return [f'{start:<{_COMMENT - 1}} # {first}', *(f'{"":<{_COMMENT}}# {rest}' for rest in more)]
