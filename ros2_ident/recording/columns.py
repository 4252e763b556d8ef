# SPDX-License-Identifier: Apache-2.0
"""Column maps: what each column of a table is, read or drafted from the names in its header."""

from collections.abc import Callable, Iterable, Mapping, Sequence
import csv
from dataclasses import dataclass
from itertools import islice
import math
from pathlib import Path
import re
from typing import Any

import yaml

from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.files import read_yaml
from ros2_ident.recording.shown import listed, printable

SUFFIXES = ('.csv', '.tsv', '.txt')
MAP_SUFFIX = '.columns.yaml'
# Quantity of a joint in the map: role and field of the stream it becomes.
QUANTITIES = {
    'position': ('state', 'position'),
    'velocity': ('state', 'velocity'),
    'effort': ('effort', 'effort'),
    'command_position': ('command', 'position'),
    'command_velocity': ('command', 'velocity'),
}
# Decimal digits from a unit of time to ns.
_DIGITS = {'s': 9, 'ms': 6, 'us': 3, 'ns': 0}
# A map is short; so is a row.
_LARGEST_MAP, _MOST_COLUMNS = 1 << 20, 1 << 16
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

Cell = str | int


@dataclass(frozen=True)
class Column:
    """One quantity of one joint, or a part of it: columns of one quantity are added.

    Attributes:
        joint: Joint name.
        quantity: A key of `QUANTITIES`.
        cell: Name of the column, or its number from 1.
        scale: Factor from the column to m, m/s or the unit of the effort.
        unsigned: Whether it is an effort's size, with the sign of the velocity.
    """

    joint: str
    quantity: str
    cell: Cell
    scale: float = 1.0
    unsigned: bool = False


def _is_count(value: object) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and value >= 0


def _is_choice(value: object) -> bool:
    return isinstance(value, Mapping) and not any(
        isinstance(x, list | dict) for x in value.values()
    )


def _is_mark(value: object) -> bool:
    return isinstance(value, str) and len(value) == 1 and value not in '\r\n\0"'


# What a map may state beside time and joints: the usual, whether a value fits, what to write else.
_OPTIONS: Mapping[str, tuple[Any, Callable[[Any], bool], str]] = {
    'where': ({}, _is_choice, 'write {COLUMN: VALUE} of rows that count'),
    'delimiter': (',', _is_mark, 'write one character, as ";" or "\\t"'),
    'decimal': ('.', ('.', ',').__contains__, 'write "." or ",", and another one as delimiter'),
    'skip': (0, _is_count, 'write the number of lines before the names'),
    'skip_below': (0, _is_count, 'write the number of lines below the names'),
    'header': (True, lambda x: isinstance(x, bool), 'write true or false'),
}
OPTIONS = ('time', 'joints', *_OPTIONS)


@dataclass(frozen=True)
class ColumnMap:
    """Meaning of a table's columns.

    Attributes:
        time: Name or number of the time's column.
        digits: Decimal digits from the time's unit to ns.
        columns: The quantities of the joints.
        delimiter: Between cells.
        decimal: The decimal mark.
        skip: Lines before the line of names.
        header: Whether there is a line of names.
        skip_below: Lines between the names and the values.
        where: Cells, and what stands there in the rows that count.
    """

    time: Cell
    digits: int
    columns: tuple[Column, ...]
    delimiter: str
    decimal: str
    skip: int
    header: bool
    skip_below: int
    where: tuple[tuple[Cell, str], ...]


def load_columns(path: str | Path) -> ColumnMap:
    """Read a column map.

    Args:
        path: A YAML file as in docs/logs.md.

    Returns:
        The map.

    Raises:
        IdentError: INVALID_GOAL where the file cannot be read or makes no sense.
    """
    try:
        data = read_yaml(path, _LARGEST_MAP)
    except ValueError as error:
        raise refuse(path, f'{printable(str(error))}; give the path of a column map') from None
    if not isinstance(data, Mapping) or not isinstance(data.get('joints'), Mapping):
        raise refuse(path, 'needs `time` and `joints`; docs/logs.md has an example')
    _known(path, 'the map', data, OPTIONS)
    given = {key: data.get(key, usual) for key, (usual, *_) in _OPTIONS.items()}
    for key, value in given.items():
        _, fits, remedy = _OPTIONS[key]
        if not fits(value) or (key == 'decimal' and value == given['delimiter']):
            raise refuse(path, f'{key} is {short(value)}; {remedy}')
    header, where = given['header'], given.pop('where')
    time, digits = _time(path, data.get('time'), header)
    columns = []
    for joint, quantities in data['joints'].items():
        if not isinstance(quantities, Mapping) or not quantities:
            raise refuse(
                path, f'{printable(str(joint))} has no column; write as `position: NAME`'
            )
        _known(path, printable(str(joint)), quantities, tuple(QUANTITIES))
        for quantity, entry in quantities.items():
            what = f'{printable(str(joint))}.{quantity}'
            for part in entry if isinstance(entry, list) and entry else [entry]:
                cell, scale, sign = _entry(path, what, part, header)
                columns.append(Column(str(joint), str(quantity), cell, scale, sign))
    if len({str(x) for x in data['joints']}) < len(data['joints']):
        raise refuse(path, 'names a joint twice; give each joint its own name')
    if not columns:
        raise refuse(path, 'joints is empty; name at least one joint and its columns')
    rows = tuple((_cell(path, 'where', x, header), str(y).strip()) for x, y in where.items())
    return ColumnMap(time, digits, tuple(columns), where=rows, **given)


def refuse(path: object, text: str) -> IdentError:
    """Return the error of a map that makes no sense."""
    return IdentError(ErrorCode.INVALID_GOAL, f'{path}: {text}')


def _known(path: object, what: str, given: Iterable[object], known: tuple[str, ...]) -> None:
    for key in given:
        if key not in known:
            raise refuse(path, f'{what} has {short(key)}; choose from {", ".join(known)}')


def _time(path: object, entry: object, header: bool) -> tuple[Cell, int]:
    unit = entry.get('unit') if isinstance(entry, Mapping) else None
    known = isinstance(unit, str) and unit in _DIGITS
    if not isinstance(entry, Mapping) or set(entry) != {'column', 'unit'} or not known:
        raise refuse(
            path,
            f'time is {short(entry)}; write {{column: NAME, unit: s}}, the unit s, ms, us or ns',
        )
    return _cell(path, 'time', entry['column'], header), _DIGITS[str(unit)]


def _entry(path: object, what: str, entry: Any, header: bool) -> tuple[Cell, float, bool]:
    if not isinstance(entry, Mapping):
        return _cell(path, what, entry, header), 1.0, False
    signed = ('sign',) if what.endswith('.effort') else ()
    _known(path, what, entry, ('column', 'scale', *signed))
    if entry.get('sign', 'velocity') != 'velocity':
        raise refuse(path, f'{what}.sign is {short(entry["sign"])}; write velocity')
    try:
        scale = float(entry.get('scale', 1.0))
    except (TypeError, ValueError, OverflowError):
        scale = math.nan
    if not math.isfinite(scale) or scale == 0.0:
        raise refuse(
            path, f'{what}.scale is {short(entry["scale"])}; write a number other than 0'
        )
    return _cell(path, what, entry.get('column'), header), scale, 'sign' in entry


def short(value: object) -> str:
    """Return a value as it may be shown in a sentence."""
    try:
        return printable(repr(value), 60)
    except (ValueError, RecursionError):  # a number of thousands of digits, nested without end
        return 'a value that cannot be shown'


def _cell(path: object, what: str, cell: Any, header: bool) -> Cell:
    number = isinstance(cell, int) and not isinstance(cell, bool) and 1 <= cell <= _MOST_COLUMNS
    if number or (header and isinstance(cell, str) and cell):
        return cell if number else str(cell).strip()
    kind = 'the name or the number (from 1)' if header else 'the number (from 1)'
    raise refuse(path, f'{what} names the column {short(cell)}; write {kind} of a column')


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
