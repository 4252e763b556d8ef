# SPDX-License-Identifier: Apache-2.0
"""Logs as tables (CSV), read by a column map: what each column is."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
import csv
from dataclasses import dataclass
from decimal import Decimal
from functools import partial
import io
from itertools import islice
import math
from pathlib import Path
import shlex
from typing import Any

import numpy as np

from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.files import read_yaml, unreadable
from ros2_ident.recording.builder import RecordingBuilder
from ros2_ident.recording.limits import listed, printable, require_memory, short, unfit
from ros2_ident.recording.motion import allowed_cutoff, CUTOFF, REST, smooth_motion
from ros2_ident.recording.storage import digest
from ros2_ident.recording.streams import FloatArray, IntArray, LATEST_STAMP, Recording

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
# Rows converted at once: bounds the memory that texts take.
_BLOCK = 1 << 14
_NO_TIME = 'write a number, or leave lines of units below the names out by `skip_below: 1`'
_NO_VALUE = 'leave a cell empty where nothing was measured'
# A step between rows outside of this is a wrong unit of the time, ns.
_FINEST, _COARSEST = 1_000, 2_000_000_000

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
    if not isinstance(time, Mapping) or set(time) != {'column', 'unit'} or unit not in _DIGITS:
        raise refuse(path, f'time is {short(time)}; {_AS}, its unit s, ms, us or ns')
    at, digits = cell('time', time['column']), _DIGITS[unit]
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


def read_table(path: str | Path, columns: str | Path = '') -> list[Recording]:
    """Read a table of samples.

    Args:
        path: A text file with one row per sample.
        columns: The column map; where empty, `NAME.columns.yaml` beside `NAME.csv`.

    Returns:
        One recording per uninterrupted stretch. A row in which every column of a stream is empty
        is no sample of it, so that streams of different rates fit into one table.

    Raises:
        IdentError: NO_DATA, MISSING_STREAM, BAD_VALUES, or INVALID_GOAL for the map; each with the
            remedy.
    """
    path = Path(path)
    if why := unreadable(path):
        text = f'{path}: {why}; give the path of a bag or a CSV file'
        raise ErrorCode.NO_DATA.error(text)
    text = text_of(path)
    where = Path(columns) if columns else path.with_name(path.stem + MAP_SUFFIX)
    if not where.exists():
        names = listed(text[: 1 << 12].split('\n', 1)[0].strip().split(','), 8)
        text = f'is a table and {where} is missing; write this map as in docs/logs.md, or by '
        command = shlex.join(['ident', 'new-machine', '--kind', 'KIND', '--bag', str(path)])
        text += f'`{command}`; the first line is: {names}'
        raise refuse(path, text)
    layout = load_columns(where)
    stamp, values, warnings = _parse(path, text, layout)
    builder = RecordingBuilder(str(path), digest([path, where]))
    for sentence in warnings:
        builder.warn(sentence)
    builder.add_columns(stamp, _summed(str(path), layout, stamp, values))
    return builder.build()


def _bad(path: object, text: str) -> IdentError:
    return ErrorCode.BAD_VALUES.error(f'{path}: {text}')


def text_of(path: Path) -> str:
    """Return a table's text, in any code."""
    # the bytes, the text, a copy to read from, and the values
    needed = 8 * path.stat().st_size
    require_memory(f'{path}: the table takes', needed)
    raw = path.read_bytes()
    try:
        return raw.decode('utf-8-sig')
    except UnicodeDecodeError:
        # scopes on Windows write their names in its code page; numbers look the same in both
        return raw.decode('latin-1')


def _parse(
    path: Path, text: str, layout: ColumnMap
) -> tuple[IntArray, list[FloatArray], list[str]]:
    """Return stamps (T,) ns, each column's scaled values (T,), and what was left out."""
    lines = io.StringIO(text, newline='')
    for _ in range(layout.skip):
        if not lines.readline():
            break
    reader = csv.reader(lines, delimiter=layout.delimiter, skipinitialspace=True)
    try:
        names = [x.strip() for x in next(reader, [])] if layout.header else []
    except csv.Error as exc:
        raise _bad(path, f'the line of names cannot be read ({exc})') from None
    for _ in range(layout.skip_below):
        if next(reader, None) is None:
            break
    cells = [layout.time, *(x.cell for x in layout.columns)]
    time, *where = (_find(path, cell, names) for cell in cells)
    asked = {_find(path, cell, names): value for cell, value in layout.where}
    stamps: list[IntArray] = []
    parts: list[list[FloatArray]] = [[] for _ in layout.columns]
    warnings: list[str] = []

    def nanoseconds(text: str) -> int:
        # a double has not enough digits
        stamp = round(Decimal(text).scaleb(layout.digits))
        if abs(stamp) > LATEST_STAMP:
            raise OverflowError
        return stamp

    rows = _rows_of(path, reader, max(time, *where, *asked) + 1, layout.skip, warnings)
    met = (row for row in rows if all(_equal(row[1][at], x) for at, x in asked.items()))
    while block := list(islice(met, _BLOCK)):
        read = partial(_converted, path, block, layout.decimal)
        stamps.append(np.array(read(time, ': the time', _NO_TIME, nanoseconds), dtype=np.int64))
        for part, column, at in zip(parts, layout.columns, where, strict=True):
            name = f', column {printable(str(column.cell))}:'
            with np.errstate(over='ignore'):
                numbers = read(at, name, _NO_VALUE, lambda x: float(x) if x else math.nan)
                part.append(column.scale * np.array(numbers))
    stamp = np.concatenate(stamps or [np.empty(0, np.int64)])
    if not stamp.size:
        where_ = ' with what `where` asks for' if layout.where else ''
        text = f'{path}: holds no row of values{where_}; record again'
        raise ErrorCode.NO_DATA.error(text)
    _check_steps(path, stamp)
    return stamp, [np.concatenate(part) for part in parts], warnings


def _equal(cell: str, value: str) -> bool:
    """Say whether a cell holds a value, as a text or as a number."""
    try:
        return cell.strip() == value or float(cell) == float(value)
    except ValueError:
        return False


def _find(path: Path, cell: Cell, names: list[str]) -> int:
    if isinstance(cell, int):
        return cell - 1
    if names.count(cell) == 1:
        return names.index(cell)
    if cell in names:
        text = f'two columns are called {short(cell)}; give the number of the column instead'
        raise _bad(path, text)
    text = f'{path}: has no column {short(cell)}, its columns are {listed(names, 30)}'
    remedy = 'correct the column map, its delimiter or its skip'
    raise ErrorCode.MISSING_STREAM.error(f'{text}; {remedy}')


def _rows_of(
    path: Path, reader: Any, width: int, skip: int, warnings: list[str]
) -> Iterator[tuple[int, list[str]]]:
    """Yield rows of one line each, at least `width` cells wide, after the number of the line."""
    narrow, before = '', reader.line_num
    try:
        for row in reader:
            number, before = before + 1, reader.line_num
            if before > number:
                text = 'has a quotation mark that is not closed there; correct the line'
                raise _bad(path, f'line {skip + number} {text}')
            if not any(cell.strip() for cell in row):
                continue
            if narrow:
                text = f'{narrow}, the column map needs {width}; correct the line or the delimiter'
                raise _bad(path, text)
            if len(row) < width:
                last, narrow = skip + number, f'line {skip + number} has {len(row)} cells'
                continue
            yield skip + number, row
    except csv.Error as exc:
        raise _bad(path, f'line {skip + reader.line_num} cannot be read ({exc})') from None
    if narrow:  # a log that was cut off ends in the middle of a line
        warnings.append(f'{path}: its last line {last} breaks off and is left out')


def _converted(
    path: Path,
    rows: list[tuple[int, list[str]]],
    decimal: str,
    at: int,
    where: str,
    remedy: str,
    convert: Callable[[str], Any],
) -> list[Any]:
    """Return the cells of a column as numbers."""
    out = []
    for number, row in rows:
        text = row[at] if decimal == '.' else row[at].replace(',', '.')
        try:
            out.append(convert(text.strip().replace('_', 'x')))  # Python reads 1_000
        except (ArithmeticError, ValueError):
            text = f'line {number}{where} {short(row[at])} is no number; {remedy}'
            raise _bad(path, text) from None
    return out


def _check_steps(path: Path, stamp: IntArray) -> None:
    """Refuse times that the stated unit or too few digits make useless."""
    steps = np.diff(stamp)
    repeated = int((steps == 0).sum())
    if repeated > 0.01 * stamp.size:
        text = f'{repeated} of {stamp.size} rows have the time of the row before'
        raise _bad(path, f'{text}; write it with more digits, or correct its unit')
    forward = steps[steps > 0]
    period = float(np.median(forward)) if forward.size else _FINEST
    if not _FINEST <= period <= _COARSEST:
        raise _bad(path, f'the rows are {period * 1e-9:g} s apart; correct the unit of the time')


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


def _summed(
    path: str, layout: ColumnMap, stamp: IntArray, values: list[FloatArray]
) -> dict[tuple[str, str, str], FloatArray]:
    """Return the values by role, joint and field, of which a map may have several columns."""
    sums: dict[tuple[str, str], FloatArray] = {}
    for column, row in sorted(
        zip(layout.columns, values, strict=True), key=lambda x: x[0].unsigned
    ):
        key = column.joint, column.quantity
        if column.unsigned:
            row = row * _directions(path, column.joint, stamp, sums)
        sums[key] = sums[key] + row if key in sums else row
    found = {}
    for joint, quantity in ((x.joint, x.quantity) for x in layout.columns):
        role, field = QUANTITIES[quantity]
        found[role, joint, field] = sums[joint, quantity]
    return found
