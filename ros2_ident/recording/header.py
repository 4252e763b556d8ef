# SPDX-License-Identifier: Apache-2.0
"""A first column map for a table, from the names in its header."""

from collections.abc import Sequence
import csv
from itertools import islice
from pathlib import Path
import re

import yaml

from ros2_ident.recording.columns import MAP_SUFFIX, QUANTITIES, refuse
from ros2_ident.recording.shown import listed

# Lines that are looked at.
_HEAD = 200
_WORDS = {
    'position': 'pos position angle theta q encoder',
    'velocity': 'vel velocity speed omega dq qd',
    'effort': 'effort torque tau current i iq force',
    'command': 'cmd command ref reference set setpoint desired des target',
    '': 'act actual meas measured value averaged avg',
}
# What a word of a column's name stands for; other words name its joint.
_MEANT = {word: what for what, words in _WORDS.items() for word in words.split()}
_TIMES = {'time', 't', 'stamp', 'timestamp', 'clock'}
_TIME_UNITS = ('s', 'ms', 'us', 'ns')
_TO_SI = {'deg': 0.017453292519943295, 'rpm': 0.10471975511965977, 'mm': 1e-3, 'ma': 1e-3}
# What an effort in another unit than N m or N asks of the machine file.
_ASKED = {'%': 'percent and rated_torque', **dict.fromkeys(('a', 'ma'), 'A and torque_constant')}
_UNITS = {*_TIME_UNITS, 'm', 'rad', 'n', 'nm', *_ASKED, *_TO_SI}


def drafted_columns(path: str | Path) -> str:
    """Return a column map, as YAML, by what the names in a table's header stand for.

    Args:
        path: The table.

    Raises:
        IdentError: INVALID_GOAL where there is no line of names above the numbers, no time among
            them, or nothing of a joint.
    """
    with Path(path).open(encoding='utf-8-sig', errors='replace', newline='') as file:
        lines = list(islice(file, _HEAD))
    delimiter = max(',;\t', key=lambda x: sum(line.count(x) for line in lines))
    decimal = ',' if delimiter != ',' and re.search(r'\d,\d', ''.join(lines[-3:])) else '.'
    rows = [[x.strip() for x in row] for row in csv.reader(lines, delimiter=delimiter)]
    first = next((n for n, row in enumerate(rows) if _numeric(row, decimal)), 0)
    wide = [n for n in range(first) if len(rows[n]) == len(rows[first])]
    where = f'write {Path(path).stem}{MAP_SUFFIX}, as in docs/logs.md'
    if not wide:
        raise refuse(path, f'has no line of names above its numbers; {where}')
    # Of two lines the lower one holds units.
    names, units = rows[wide[max(-2, -len(wide))]], rows[wide[-1]] if wide[1:] else []
    time, joints, unread, notes = None, dict[str, dict[str, object]](), [], ''
    for n, (name, below) in enumerate(zip(names, units or [''] * len(names), strict=True), 1):
        stem, unit = _parted(name)
        unit = (below.strip('[]() ') or unit).lower().removesuffix('/s')
        parts = [re.findall(r'[A-Z]?[a-z]+|[A-Z]+|\d+', x) for x in re.split(r'[\W_]+', stem)]
        words = [word.lower() for part in parts for word in part]
        meant = {_MEANT[x] for x in words if x in _MEANT}
        quantity = next((x for x in ('velocity', 'effort', 'position') if x in meant), '')
        if 'command' in meant:
            quantity = f'command_{quantity or "position"}'
        # A joint is spelled as in the header, for descriptions that know it by that name.
        spelled = [''.join(x for x in part if x.lower() not in _MEANT) for part in parts]
        joint = '_'.join(filter(None, spelled))
        own = joints.setdefault(f'joint_{joint}' if joint.isdigit() else joint or 'joint_1', {})
        # A time without a name is known by its unit.
        timed = _TIMES & set(words) or (not words and unit in _TIME_UNITS)
        if quantity == 'effort' and unit in _ASKED:
            notes = f'# The machine file needs, for the effort, effort_unit: {_ASKED[unit]}.\n'
        if time is None and timed:
            time = {'column': name or n, 'unit': unit if unit in _TIME_UNITS else 's'}
        elif quantity not in QUANTITIES or quantity in own:
            unread.append(name)
        elif unit in _TO_SI:
            own[quantity] = {'column': name, 'scale': _TO_SI[unit]}
        else:
            own[quantity] = name
    joints = {joint: own for joint, own in joints.items() if own}
    if time is None or not joints:
        what = 'time' if time is None else 'position, velocity or effort'
        raise refuse(path, f'no column is named as a {what}: {listed(names)}; {where}')
    told = {'time': time, 'joints': joints, 'delimiter': delimiter, 'decimal': decimal}
    told |= {'skip': wide[max(-2, -len(wide))], 'skip_below': 1 if units else 0}
    notes += f'# Not read: {listed(unread, 30)}\n' if unread else ''
    return (
        f'# From the names in {Path(path).name}: look whether columns and units are right.\n'
        f'{notes}{yaml.safe_dump(told, sort_keys=False)}'
    )


def _parted(name: str) -> tuple[str, str]:
    """Return a column's name without the unit in brackets or behind the last _, and that unit."""
    for pattern in (r'(.*)[\[(](.*)[\])]', r'(.*)_([A-Za-z]+)'):
        found = re.fullmatch(pattern, name)
        if found and found[2].lower().removesuffix('/s') in _UNITS:
            return found[1], found[2]
    return name, ''


def _numeric(row: Sequence[str], decimal: str) -> bool:
    """Say whether all cells of a row that hold something hold numbers."""
    try:
        return len([float(x.replace(decimal, '.')) for x in row if x]) > 1
    except ValueError:
        return False
