# SPDX-License-Identifier: Apache-2.0
"""Column maps: what the columns of a table, or the fields of a bag's topics, are."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
import math
from pathlib import Path
from typing import Any

import numpy as np

from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.files import read_yaml
from ros2_ident.recording.limits import printable, short, unfit
from ros2_ident.recording.maps import DIGITS
from ros2_ident.recording.motion import allowed_cutoff, CUTOFF, REST, smooth_motion
from ros2_ident.recording.streams import FloatArray, IntArray

MAP_SUFFIX = '.columns.yaml'
# Quantity of a joint in the map: role and field of the stream it becomes.
QUANTITIES = {
    'position': ('state', 'position'),
    'velocity': ('state', 'velocity'),
    'effort': ('effort', 'effort'),
    'command_position': ('command', 'position'),
    'command_velocity': ('command', 'velocity'),
}
# A map is short; so is a row.
_LARGEST_MAP, _MOST_COLUMNS = 1 << 20, 1 << 16
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


_AS = 'write it as in docs/logs.md'
# What a map may state beside time and joints: the usual, whether a value fits, what to write else.
_OPTIONS: Mapping[str, tuple[Any, Callable[[Any], bool]]] = {
    'where': ({}, lambda x: isinstance(x, Mapping) and all(map(np.isscalar, x.values()))),
    'delimiter': (',', lambda x: isinstance(x, str) and len(x) == 1 and x not in '\r\n\0"'),
    'decimal': ('.', ('.', ',').__contains__),
    'skip': (0, lambda x: type(x) is int and x >= 0),
    'skip_below': (0, lambda x: type(x) is int and x >= 0),
    'header': (True, lambda x: isinstance(x, bool)),
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
    given = {key: data.get(key, usual) for key, (usual, _) in _OPTIONS.items()}
    for key, value in given.items():
        if not _OPTIONS[key][1](value) or (key == 'decimal' and value == given['delimiter']):
            raise refuse(path, f'{key} is {short(value)}; {_AS}')
    cell = partial(_cell, path, given['header'])
    time, where = data.get('time'), given.pop('where')
    unit = str(time.get('unit')) if isinstance(time, Mapping) else ''
    if not isinstance(time, Mapping) or set(time) != {'column', 'unit'} or unit not in DIGITS:
        raise refuse(path, f'time is {short(time)}; {_AS}, its unit s, ms, us or ns')
    at, digits = cell('time', time['column']), DIGITS[unit]
    columns = []
    for joint, quantities in data['joints'].items():
        if why := unfit(joint):
            raise refuse(path, f'names a joint {short(joint)}, {why}')
        name = str(joint)
        if not isinstance(quantities, Mapping) or not quantities:
            raise refuse(path, f'{name} has no column; write as `position: NAME`')
        _known(path, name, quantities, tuple(QUANTITIES))
        for quantity, entry in quantities.items():
            for part in entry if isinstance(entry, list) and entry else [entry]:
                columns.append(_column(path, str(joint), quantity, part, cell))
    if len({str(x) for x in data['joints']}) < len(data['joints']):
        raise refuse(path, 'names a joint twice; give each joint its own name')
    if not columns:
        raise refuse(path, 'joints is empty; name at least one joint and its columns')
    rows = tuple((cell('where', x), str(y).strip()) for x, y in where.items())
    return ColumnMap(at, digits, tuple(columns), where=rows, **given)


def refuse(path: object, text: str) -> IdentError:
    """Return the error of a map that makes no sense."""
    return ErrorCode.INVALID_GOAL.error(f'{path}: {text}')


def _known(path: object, what: str, given: Iterable[object], known: tuple[str, ...]) -> None:
    for key in given:
        if key not in known:
            raise refuse(path, f'{what} has {short(key)}; choose from {", ".join(known)}')


def _column(
    path: object, joint: str, quantity: str, entry: Any, cell: Callable[[str, Any], Cell]
) -> Column:
    """Return what a map has as (a part of) a quantity of a joint: a cell, or more about it."""
    what, scale = f'{printable(joint)}.{quantity}', math.nan
    given = entry if isinstance(entry, Mapping) else {'column': entry}
    _known(path, what, given, ('column', 'scale', *['sign'] * (quantity == 'effort')))
    with suppress(TypeError, ValueError, OverflowError):
        scale = float(given.get('scale', 1.0))
    if not math.isfinite(scale) or not scale or given.get('sign', 'velocity') != 'velocity':
        raise refuse(path, f'{what} is {short(entry)}; {_AS}')
    return Column(joint, quantity, cell(what, given.get('column')), scale, 'sign' in given)


def _cell(path: object, header: bool, what: str, cell: Any) -> Cell:
    number = type(cell) is int and 1 <= cell <= _MOST_COLUMNS
    if number or (header and isinstance(cell, str) and cell):
        return cell if number else str(cell).strip()
    kind = 'the name or the number (from 1)' if header else 'the number (from 1)'
    raise refuse(path, f'{what} names the column {short(cell)}; write {kind} of a column')


def _directions(
    path: str, joint: str, stamp: IntArray, measured: Mapping[tuple[str, str], FloatArray]
) -> FloatArray:
    """Return the sign of a joint's velocity (T,), which it keeps while it rests.

    Raises:
        IdentError: INVALID_GOAL where the map has neither a velocity nor a position of it.
    """
    rate, place = (measured.get((joint, x)) for x in ('velocity', 'position'))
    if rate is None:
        if place is None:
            text = f'{joint}.effort takes the sign of its velocity; name a column of its velocity'
            raise refuse(path, f'{text} or position')
        cycle = float(np.median(np.diff(stamp))) * 1e-9
        rate = smooth_motion(place, cycle, allowed_cutoff(place, cycle, CUTOFF))[1][0]
    moves = np.abs(rate) > REST * np.fmax.reduce(np.abs(rate))
    last = np.maximum.accumulate(np.where(moves, np.arange(rate.size), -1))
    return np.sign(rate[np.where(last < 0, np.argmax(moves), last)])


def summed(
    path: str, columns: Sequence[Column], stamp: IntArray, values: Sequence[FloatArray]
) -> dict[tuple[str, str, str], FloatArray]:
    """Return the values by role, joint and field, of which a map may have several columns."""
    sums: dict[tuple[str, str], FloatArray] = {}
    for column, row in sorted(zip(columns, values, strict=True), key=lambda x: x[0].unsigned):
        key = column.joint, column.quantity
        if column.unsigned:
            row = row * _directions(path, column.joint, stamp, sums)
        sums[key] = sums[key] + row if key in sums else row
    found = {}
    for joint, quantity in ((x.joint, x.quantity) for x in columns):
        role, field = QUANTITIES[quantity]
        found[role, joint, field] = sums[joint, quantity]
    return found
