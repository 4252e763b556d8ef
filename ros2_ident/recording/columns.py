# SPDX-License-Identifier: Apache-2.0
"""Column maps: what the columns of a table, or the fields of a bag's topics, are."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
import math
from pathlib import Path
import re
from typing import Any

import numpy as np

from ros2_ident.errors import ErrorCode
from ros2_ident.files import read_yaml
from ros2_ident.recording.definition import path_of
from ros2_ident.recording.limits import printable, short, unfit
from ros2_ident.recording.maps import DIGITS
from ros2_ident.recording.motion import allowed_cutoff, CUTOFF, REST, smooth_motion
from ros2_ident.recording.streams import FloatArray, IntArray

MAP_SUFFIX = '.columns.yaml'
# Error of a map that makes no sense.
refuse = ErrorCode.INVALID_GOAL.at
# Quantity of a joint in the map: role and field of the stream it becomes.
QUANTITIES = {
    'position': ('state', 'position'),
    'velocity': ('state', 'velocity'),
    'effort': ('effort', 'effort'),
    'command_position': ('command', 'position'),
    'command_velocity': ('command', 'velocity'),
}
# A map is short; so is a row.
_LARGEST_MAP, _MOST_COLUMNS, _MOST_LINES = 1 << 20, 1 << 16, 1 << 31

Cell = str | int

TIME_UNITS = {'µs': 'us', 'millis': 'ms', 'micros': 'us'}
for _marks, _plain in (('', 's'), ('m milli', 'ms'), ('u micro', 'us'), ('n nano', 'ns')):
    for _mark in _marks.split(' '):
        _spelled = (f'{_mark}{x}' for x in ('sec', 'secs', 'second', 'seconds'))
        TIME_UNITS |= dict.fromkeys((_plain, *_spelled), _plain)
_DEGREE, _TURN = math.pi / 180.0, 2.0 * math.pi
# Factors to m or rad, and a second; to N, N m, A or percent. NaN where only the owner knows it.
_COUNTED = 'inc incs increments count counts cnt cts qc tick ticks puls pulse pulses lsb steps'
_RAW = dict.fromkeys((*_COUNTED.split(), 'raw', 'digits'), math.nan)
PERMIL = ('permil', '‰', '0.1%', '0.1 %')
OPEN = _RAW | dict.fromkeys(('%', 'percent', *PERMIL), math.nan)
LENGTHS = {'m': 1.0, 'mm': 1e-3, 'cm': 1e-2, 'km': 1e3, 'um': 1e-6, 'µm': 1e-6}
LENGTHS |= dict.fromkeys(('inch', 'inches'), 0.0254)
for _word, _size in (('meter', 1.0), ('metre', 1.0), ('millimeter', 1e-3), ('millimetre', 1e-3)):
    LENGTHS |= dict.fromkeys((_word, f'{_word}s'), _size)
MOTION = OPEN | LENGTHS | {'mrad': 1e-3}
MOTION |= dict.fromkeys(('rad', 'rads', 'radian', 'radians'), 1.0)
MOTION |= dict.fromkeys(('deg', 'degs', 'degree', 'degrees', '°'), _DEGREE)
MOTION |= dict.fromkeys(('rev', 'turn', 'turns', 'rotations', 'revolutions'), _TURN)
# Of velocities alone, as they stand.
_PER = dict.fromkeys(('/min', '_per_min', '_per_minute'), 60.0)
_PER |= dict.fromkeys(('/h', '_h', 'h', 'ph', '_per_h', '_per_hour'), 3600.0)
_LENGTH_SPEEDS = {f'{x}{per}': y / time for x, y in LENGTHS.items() for per, time in _PER.items()}
_LENGTH_SPEEDS |= {'mps': 1.0, 'kph': 1.0 / 3.6}
_MINUTES = 'rpm', '1/min', 'u/min', 'r/min', 'tr/min', 'rev/min', 'min^-1', 'min-1'
SPEEDS = dict.fromkeys(_MINUTES, _TURN / 60.0) | dict.fromkeys(('hz', 'rps'), _TURN)
SPEEDS |= {'dps': _DEGREE, 'radps': 1.0} | _LENGTH_SPEEDS
SPEEDS |= {f'{x}{per}': MOTION[x] / _PER[per] for x in ('rad', 'deg', 'rev') for per in _PER}
_TORQUES = dict.fromkeys(('nm', 'n m', 'n.m', 'n*m', 'n·m', 'newton_meters'), 1.0)
# Of efforts by what they come to, as the `effort_unit` of a machine file says it.
EFFORTS: Mapping[str, Mapping[str, float]] = {
    'N m': _TORQUES | {'mnm': 1e-3, 'ncm': 1e-2, 'knm': 1e3},
    'N': {'n': 1.0, 'kn': 1e3, 'newtons': 1.0},
    'A': {'a': 1.0, 'arms': 1.0, 'a rms': 1.0, 'a_rms': 1.0, 'ma': 1e-3, 'milliamps': 1e-3},
    'percent': {'%': 1.0, 'percent': 1.0} | dict.fromkeys(PERMIL, 0.1),
}
EFFORT = _RAW | {unit: x for units in EFFORTS.values() for unit, x in units.items()}


def units_of(quantity: str) -> Mapping[str, float]:
    """Return the factors of the units that a quantity may have, as `plain_unit` returns them."""
    if quantity == 'effort':
        return EFFORT
    return MOTION | SPEEDS if quantity.endswith('velocity') else MOTION


def factor_of(quantity: str, unit: str) -> float | None:
    """Return the factor of a unit; NaN where only its owner knows it, None for no such unit."""
    plain = plain_unit(unit)
    rate = plain != unit.strip().lower()
    return None if rate and not quantity.endswith('velocity') else units_of(quantity).get(plain)


def si_unit(quantity: str, unit: str) -> str:
    """Return what a unit of a quantity comes to: m, rad, N m, N, A or percent; else empty.

    Args:
        unit: As `plain_unit` returns it.
    """
    if quantity == 'effort':
        return next((kind for kind, units in EFFORTS.items() if unit in units), '')
    turns = (MOTION | SPEEDS).keys() - OPEN.keys()
    return 'm' if unit in LENGTHS.keys() | _LENGTH_SPEEDS else 'rad' if unit in turns else ''


def plain_unit(unit: str) -> str:
    """Return a unit in lower case, without what is per second."""
    return re.sub(r'(/s(ec)?|_?per_?s(ec(ond)?)?|_s(ec)?| s-1| s\^-1)$', '', unit.strip().lower())


@dataclass(frozen=True)
class Column:
    """One quantity of one joint, or a part of it: columns of one quantity are added."""

    joint: str
    quantity: str  # a key of `QUANTITIES`
    cell: Cell  # name of the column, or its number from 1
    scale: float = 1.0  # from the column to m, m/s or the unit of the effort; of its unit, too
    unsigned: bool = False  # whether it is an effort's size, with the sign of the velocity
    unit: str = ''  # what it comes to, as `si_unit` has it, where the map states that
    entry: int = 0  # which number of the cell it is, where a path names several
    of: int = 1  # how many they are


_AS = 'write it as in docs/logs.md'
# What a map may state beside time and joints: the usual, whether a value fits, what to write else.
_OPTIONS: Mapping[str, tuple[Any, Callable[[Any], bool]]] = {
    'where': ({}, lambda x: isinstance(x, Mapping) and all(map(np.isscalar, x.values()))),
    'delimiter': (',', lambda x: isinstance(x, str) and len(x) == 1 and x not in '\r\n\0"'),
    'decimal': ('.', ('.', ',').__contains__),
    'skip': (0, lambda x: type(x) is int and x in range(_MOST_LINES)),
    'skip_below': (0, lambda x: type(x) is int and x in range(_MOST_LINES)),
    'header': (True, lambda x: isinstance(x, bool)),
}
OPTIONS = ('time', 'joints', *_OPTIONS)


@dataclass(frozen=True)
class ColumnMap:
    """Meaning of a table's columns."""

    time: Cell  # name or number of the time's column
    digits: int  # decimal digits from the time's unit to ns
    columns: tuple[Column, ...]  # the quantities of the joints
    delimiter: str  # between cells
    decimal: str  # the decimal mark
    skip: int  # lines before the line of names
    header: bool  # whether there is a line of names
    skip_below: int  # lines between the names and the values
    where: tuple[tuple[Cell, str], ...]  # cells, and what stands there in the rows that count
    rate: float = 0.0  # rows per second where there is no time, Hz


def load_columns(path: str | Path, arrays: bool = False) -> ColumnMap:
    """Read a column map (docs/logs.md).

    Args:
        arrays: Whether it is of arrays: columns by name, of several `NAME[0]` or a slice.

    Raises:
        IdentError: INVALID_GOAL where the file cannot be read or makes no sense.
    """
    data = _read_map(path, ('time', 'joints', 'where') if arrays else OPTIONS)
    given = {key: data.get(key, usual) for key, (usual, _) in _OPTIONS.items()}
    for key, value in given.items():
        if not _OPTIONS[key][1](value) or (key == 'decimal' and value == given['delimiter']):
            raise refuse(path, f'{key} is {short(value)}; {_AS}')
    cell = partial(_cell, path, given['header'], arrays)
    time, where = data.get('time'), given.pop('where')
    rate = time.get('rate') if isinstance(time, Mapping) and len(time) == 1 else None
    if isinstance(rate, (int, float)) and 0 < rate < 1e6:
        time = {'column': '', 'unit': 's'}
    unit = str(time.get('unit')) if isinstance(time, Mapping) else ''
    if not isinstance(time, Mapping) or set(time) != {'column', 'unit'} or unit not in DIGITS:
        raise refuse(path, f'time is {short(time)}; {_AS}, its unit s, ms, us or ns')
    at = '' if rate else cell('time', time['column'])
    columns = _joints(path, data, cell, several=arrays)
    rows = tuple((cell('where', x), str(y).strip()) for x, y in where.items())
    return ColumnMap(at, DIGITS[unit], columns, where=rows, rate=float(rate or 0), **given)


def _read_map(path: str | Path, known: tuple[str, ...]) -> Mapping[str, Any]:
    """Return what a map states, which has joints."""
    try:
        data = read_yaml(path, _LARGEST_MAP)
    except ValueError as error:
        raise refuse(path, f'{printable(str(error))}; give the path of a column map') from None
    if not isinstance(data, Mapping) or not isinstance(data.get('joints'), Mapping):
        raise refuse(path, 'needs `time` and `joints`; docs/logs.md has an example')
    _known(path, 'the map', data, known)
    return data


def _joints(
    path: object, data: Mapping[str, Any], cell: Callable[[str, Any], Cell], several: bool = False
) -> tuple[Column, ...]:
    """Return the quantities of a map's joints; where `several`, `a, b` are two of one path."""
    columns: list[Column] = []
    named: list[str] = []
    for key, quantities in data['joints'].items():
        names = [x.strip() for x in key.split(',')] if several and isinstance(key, str) else [key]
        for joint in names:
            if why := unfit(joint):
                raise refuse(path, f'names a joint {short(joint)}, {why}')
        named += map(str, names)
        if not isinstance(quantities, Mapping) or not quantities:
            raise refuse(path, f'{key} has no column; write as `position: NAME`')
        _known(path, str(key), quantities, tuple(QUANTITIES))
        for quantity, entry in quantities.items():
            for part in entry if isinstance(entry, list) and entry else [entry]:
                about = _column(path, str(key), quantity, part, cell)
                columns += [Column(str(x), *about, n, len(names)) for n, x in enumerate(names)]
    if len(set(named)) < len(named):
        raise refuse(path, 'names a joint twice; give each joint its own name')
    if not columns:
        raise refuse(path, 'joints is empty; name at least one joint and its columns')
    return tuple(columns)


@dataclass(frozen=True)
class TopicMap:
    """Meaning of the fields of one topic."""

    columns: tuple[Column, ...]  # quantities of joints, their cells paths of fields
    time: str | None = None  # its path; None for a header's stamp or, without one, the arrival
    digits: int = 0  # decimal digits from the unit of a time that is a number to ns


def load_topics(path: str | Path) -> dict[str, TopicMap]:
    """Return the meaning of each topic that a column map (docs/logs.md) of a bag names.

    Raises:
        IdentError: INVALID_GOAL where the file cannot be read or makes no sense.
    """
    data = _read_map(path, ('time', 'joints'))
    found: dict[str, list[Column]] = {}
    for column in _joints(path, data, partial(_field, path), several=True):
        topic, _, field = str(column.cell).partition(' ')
        found.setdefault(topic, []).append(replace(column, cell=field))
    times: dict[str, tuple[str, int]] = {}
    given = data.get('time') or []
    for time in given if isinstance(given, list) else [given]:
        unit = time.get('unit', 'ns') if isinstance(time, Mapping) else ''
        if unit not in DIGITS or set(time) - {'unit'} != {'column'}:
            raise refuse(path, f'time is {short(time)}; {_AS}, its unit s, ms, us or ns')
        topic, _, field = str(_field(path, 'time', time['column'])).partition(' ')
        times[topic] = field, DIGITS[unit]
    for topic in times.keys() - found.keys():
        raise refuse(path, f'time names {short(topic)}, of which no joint has a field')
    return {x: TopicMap(tuple(own), *times.get(x, ())) for x, own in found.items()}


def _field(path: object, what: str, cell: Any) -> Cell:
    """Return a topic and the path of fields of its messages, a space between."""
    topic, _, field = cell.partition(' ') if isinstance(cell, str) else ('', '', '')
    try:
        path_of(field.strip())
    except ValueError:
        form = 'write a topic and its field, as `/lowstate motor_state[3].q`'
        raise refuse(path, f'{what} names {short(cell)}; {form}') from None
    return f'/{topic.lstrip("/")} {field.strip()}'


def _known(path: object, what: str, given: Iterable[object], known: tuple[str, ...]) -> None:
    for key in given:
        if key not in known:
            raise refuse(path, f'{what} has {short(key)}; choose from {", ".join(known)}')


def _column(
    path: object, joint: str, quantity: str, entry: Any, cell: Callable[[str, Any], Cell]
) -> tuple[str, Cell, float, bool, str]:
    """Return quantity, cell, scale, whether unsigned, and unit of (a part of) a quantity."""
    what, scale, unit = f'{printable(joint)}.{quantity}', math.nan, ''
    given = entry if isinstance(entry, Mapping) else {'column': entry}
    _known(path, what, given, ('column', 'scale', 'unit', *['sign'] * (quantity == 'effort')))
    with suppress(TypeError, ValueError, OverflowError):
        scale = float(given.get('scale', 1.0))
    if not math.isfinite(scale) or not scale or given.get('sign', 'velocity') != 'velocity':
        raise refuse(path, f'{what} is {short(entry)}; {_AS}')
    if 'unit' in given:
        factor = factor_of(quantity, str(given['unit']))
        if factor is None or math.isnan(factor):
            known = [name for name, x in units_of(quantity).items() if not math.isnan(x)]
            text = 'which is no unit of it, or none of a known size'
            able = f'choose from {", ".join(known)}, or state its `scale`'
            raise refuse(path, f'{what} is in {short(given["unit"])}, {text}; {able}')
        # a scale beside it turns the sign, or makes another quantity of it
        unit = si_unit(quantity, plain_unit(str(given['unit']))) if abs(scale) == 1.0 else ''
        scale *= factor
    return quantity, cell(what, given.get('column')), scale, 'sign' in given, unit


def _cell(path: object, header: bool, arrays: bool, what: str, cell: Any) -> Cell:
    """Return the name or number of a column, or the name of an array."""
    if not arrays and type(cell) is int and 1 <= cell <= _MOST_COLUMNS:
        return cell
    if header and isinstance(cell, str) and (cell.strip() if arrays else cell):
        return cell.strip()
    kind = f'the {"name or the " * header}number (from 1) of a column'
    kind = 'the name of an array' if arrays else kind
    raise refuse(path, f'{what} names the column {short(cell)}; write {kind}')


def _directions(
    path: str, joint: str, stamp: IntArray, measured: Mapping[tuple[str, str], FloatArray]
) -> FloatArray:
    """Return the sign of a joint's velocity (T,), which it keeps while it rests."""
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


def stated_units(path: str, columns: Sequence[Column]) -> dict[tuple[str, str], str]:
    """Return the units that a map states by joint and quantity, as `si_unit` has them.

    Raises:
        IdentError: INVALID_GOAL where the columns of a sum have different ones.
    """
    found: dict[tuple[str, str], str] = {}
    for x in columns:
        if x.unit and found.setdefault((x.joint, x.quantity), x.unit) != x.unit:
            of, units = f'{printable(x.joint)}.{x.quantity}', found[x.joint, x.quantity]
            text = f'{of} adds columns in {units} and {x.unit}; give each a `scale` to one unit'
            raise refuse(path, text)
    return found


def summed(
    path: str, columns: Sequence[Column], stamp: IntArray, values: Sequence[FloatArray]
) -> dict[tuple[str, str, str], FloatArray]:
    """Return scaled values by role, joint and field, of which a map may have several columns."""
    sums: dict[tuple[str, str], FloatArray] = {}
    for column, row in sorted(zip(columns, values, strict=True), key=lambda x: x[0].unsigned):
        key = column.joint, column.quantity
        with np.errstate(over='ignore'):
            row = column.scale * row
        if column.unsigned:
            row *= _directions(path, column.joint, stamp, sums)
        sums[key] = sums[key] + row if key in sums else row
    found = {}
    for x in columns:
        role, field = QUANTITIES[x.quantity]
        found[role, x.joint, field] = sums[x.joint, x.quantity]
    return found
