# SPDX-License-Identifier: Apache-2.0
"""Logs as tables (CSV), read by a column map that says what each column is."""

from collections.abc import Iterable, Iterator, Mapping
import csv
from dataclasses import dataclass
from decimal import Decimal
import io
from itertools import islice
import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
import yaml

from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.recording.builder import RecordingBuilder
from ros2_ident.recording.limits import Limits, too_large
from ros2_ident.recording.shown import listed, printable
from ros2_ident.recording.storage import digest
from ros2_ident.recording.streams import FIELDS, FloatArray, IntArray, Recording

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
_OPTIONS = ('time', 'joints', 'delimiter', 'decimal', 'skip', 'header')
# Rows converted at once: bounds the memory that texts take.
_BLOCK = 1 << 14
# A step between rows outside of this is a wrong unit of the time, ns.
_FINEST, _COARSEST = 1_000, 2_000_000_000

# A map is short; so is a row.
_LARGEST_MAP, _MOST_COLUMNS = 1 << 20, 1 << 16
_NO_DELIMITER = '\r\n\0"'

Cell = str | int


@dataclass(frozen=True)
class Column:
    """One quantity of one joint.

    Attributes:
        joint: Joint name.
        quantity: A key of `QUANTITIES`.
        cell: Name of the column, or its number from 1.
        scale: Factor from the column to m, m/s or the unit of the effort.
    """

    joint: str
    quantity: str
    cell: Cell
    scale: float = 1.0


@dataclass(frozen=True)
class ColumnMap:
    """What a table's columns are.

    Attributes:
        time: Name or number of the time's column.
        digits: Decimal digits from the time's unit to ns.
        columns: The quantities of the joints.
        delimiter: Between cells.
        decimal: The decimal mark.
        skip: Lines before the line of names.
        header: Whether there is a line of names.
    """

    time: Cell
    digits: int
    columns: tuple[Column, ...]
    delimiter: str = ','
    decimal: str = '.'
    skip: int = 0
    header: bool = True


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
        if Path(path).exists() and not Path(path).is_file():
            raise _refuse(path, 'cannot be read (no file); give the path of a column map')
        if Path(path).stat().st_size > _LARGEST_MAP:
            raise _refuse(path, f'is larger than {_LARGEST_MAP} bytes; give a column map')
        data = yaml.safe_load(Path(path).read_text(encoding='utf-8'))
    except OSError as exc:
        raise _refuse(
            path, f'cannot be read ({exc.strerror}); give the path of a column map'
        ) from None
    except (yaml.YAMLError, ValueError, OverflowError, TypeError) as exc:
        raise _refuse(path, f'is no YAML: {printable(" ".join(str(exc).split()))}') from None
    except RecursionError:
        raise _refuse(path, 'is no YAML: it is nested without end') from None
    if not isinstance(data, Mapping) or not isinstance(data.get('joints'), Mapping):
        raise _refuse(path, 'needs `time` and `joints`; docs/logs.md has an example')
    _known(path, 'the map', data, _OPTIONS)
    header, skip = data.get('header', True), data.get('skip', 0)
    delimiter, decimal = data.get('delimiter', ','), data.get('decimal', '.')
    if not isinstance(header, bool):
        raise _refuse(path, f'header is {_short(header)}; write true or false')
    if not isinstance(skip, int) or isinstance(skip, bool) or skip < 0:
        raise _refuse(path, f'skip is {_short(skip)}; write the number of lines before the names')
    if not isinstance(delimiter, str) or len(delimiter) != 1 or delimiter in _NO_DELIMITER:
        raise _refuse(
            path, f'delimiter is {_short(delimiter)}; write one character, as ";" or "\\t"'
        )
    if decimal not in ('.', ',') or decimal == delimiter:
        raise _refuse(
            path, f'decimal is {_short(decimal)}; write "." or ",", and another one as delimiter'
        )
    time, digits = _time(path, data.get('time'), header)
    columns = []
    for joint, quantities in data['joints'].items():
        if not isinstance(quantities, Mapping) or not quantities:
            raise _refuse(
                path, f'{printable(str(joint))} has no column; write as `position: NAME`'
            )
        _known(path, printable(str(joint)), quantities, tuple(QUANTITIES))
        for quantity, entry in quantities.items():
            cell, scale = _entry(path, f'{printable(str(joint))}.{quantity}', entry, header)
            columns.append(Column(str(joint), str(quantity), cell, scale))
    if len({str(x) for x in data['joints']}) < len(data['joints']):
        raise _refuse(path, 'names a joint twice; give each joint its own name')
    if not columns:
        raise _refuse(path, 'joints is empty; name at least one joint and its columns')
    return ColumnMap(time, digits, tuple(columns), delimiter, decimal, skip, header)


def read_table(
    path: str | Path, columns: str | Path = '', limits: Limits | None = None
) -> list[Recording]:
    """Read a table of samples.

    Args:
        path: A text file with one row per sample.
        columns: The column map; where empty, `NAME.columns.yaml` beside `NAME.csv`.
        limits: How much of the machine it may take; the default where None.

    Returns:
        One recording per uninterrupted stretch. A row in which every column of a stream is empty
        is no sample of it, so that streams of different rates fit into one table.

    Raises:
        IdentError: NO_DATA, MISSING_STREAM, BAD_VALUES, or INVALID_GOAL for the map; each with the
            remedy.
    """
    path = Path(path)
    if not path.is_file():
        raise IdentError(
            ErrorCode.NO_DATA, f'{path}: does not exist; give the path of a bag or a CSV file'
        )
    text = _text(path, limits or Limits())
    where = Path(columns) if columns else path.with_name(path.stem + MAP_SUFFIX)
    if not where.is_file():
        names = listed(text[: 1 << 12].split('\n', 1)[0].strip().split(','), 8)
        raise _refuse(
            path,
            f'is a table and {where} is missing; write this column map as in docs/logs.md, or '
            f'name one by --columns; the first line is: {names}',
        )
    layout = load_columns(where)
    stamp, values, warnings = _parse(path, text, layout)
    builder = RecordingBuilder(str(path), digest([path, where]), limits)
    for sentence in warnings:
        builder.warn(sentence)
    _feed(builder, layout, stamp, values)
    return builder.build()


def _refuse(path: object, text: str) -> IdentError:
    return IdentError(ErrorCode.INVALID_GOAL, f'{path}: {text}')


def _bad(path: object, text: str) -> IdentError:
    return IdentError(ErrorCode.BAD_VALUES, f'{path}: {text}')


def _known(path: object, what: str, given: Iterable[object], known: tuple[str, ...]) -> None:
    for key in given:
        if key not in known:
            raise _refuse(path, f'{what} has {_short(key)}; choose from {", ".join(known)}')


def _time(path: object, entry: object, header: bool) -> tuple[Cell, int]:
    unit = entry.get('unit') if isinstance(entry, Mapping) else None
    known = isinstance(unit, str) and unit in _DIGITS
    if not isinstance(entry, Mapping) or set(entry) != {'column', 'unit'} or not known:
        raise _refuse(
            path,
            f'time is {_short(entry)}; write {{column: NAME, unit: s}}, the unit s, ms, us or ns',
        )
    return _cell(path, 'time', entry['column'], header), _DIGITS[str(unit)]


def _entry(path: object, what: str, entry: Any, header: bool) -> tuple[Cell, float]:
    if not isinstance(entry, Mapping):
        return _cell(path, what, entry, header), 1.0
    _known(path, what, entry, ('column', 'scale'))
    try:
        scale = float(entry.get('scale', 1.0))
    except (TypeError, ValueError, OverflowError):
        scale = math.nan
    if not math.isfinite(scale) or scale == 0.0:
        raise _refuse(
            path, f'{what}.scale is {_short(entry["scale"])}; write a number other than 0'
        )
    return _cell(path, what, entry.get('column'), header), scale


def _short(value: object) -> str:
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
    raise _refuse(path, f'{what} names the column {_short(cell)}; write {kind} of a column')


def _text(path: Path, limits: Limits) -> str:
    # the bytes, the text, a copy to read from, and the values
    needed = 8 * path.stat().st_size
    if needed > limits.memory:
        raise too_large(f'{path}: the table takes', needed, limits.memory, 'memory')
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
    cells = [layout.time, *(x.cell for x in layout.columns)]
    where = [_find(path, cell, names) for cell in cells]
    width = max(where) + 1
    stamps: list[NDArray[np.int64]] = []
    parts: list[list[FloatArray]] = [[] for _ in layout.columns]
    warnings: list[str] = []
    for rows, numbers in _blocks(path, reader, width, layout.skip, warnings):
        table = list(zip(*rows, strict=False))
        stamps.append(_stamps(path, table[where[0]], numbers, layout))
        for part, column, at in zip(parts, layout.columns, where[1:], strict=True):
            part.append(_floats(path, table[at], numbers, column, layout.decimal))
    if not stamps:
        raise IdentError(ErrorCode.NO_DATA, f'{path}: holds no row of values; record again')
    stamp = np.concatenate(stamps)
    _check_steps(path, stamp)
    return stamp, [np.concatenate(part) for part in parts], warnings


def _find(path: Path, cell: Cell, names: list[str]) -> int:
    if isinstance(cell, int):
        return cell - 1
    if names.count(cell) == 1:
        return names.index(cell)
    if cell in names:
        raise _bad(
            path, f'two columns are called {_short(cell)}; give the number of the column instead'
        )
    raise IdentError(
        ErrorCode.MISSING_STREAM,
        f'{path}: has no column {_short(cell)}, its columns are {listed(names, 30)}; correct '
        'the column map, its delimiter or its skip',
    )


def _blocks(
    path: Path, reader: Any, width: int, skip: int, warnings: list[str]
) -> Iterator[tuple[list[list[str]], list[int]]]:
    """Yield rows, each at least `width` cells wide, with the numbers of their lines."""
    short: tuple[int, int] | None = None
    while True:
        rows, numbers = [], []
        for row in islice(_rows(path, reader, skip), _BLOCK):
            if not any(cell.strip() for cell in row):
                continue
            if short is not None:
                raise _bad(
                    path,
                    f'line {short[0]} has {short[1]} cells, the column map needs {width}; correct '
                    'the line or the delimiter',
                )
            if len(row) < width:
                short = skip + reader.line_num, len(row)
                continue
            rows.append(row[:width])
            numbers.append(skip + reader.line_num)
        if rows:
            yield rows, numbers
        elif short is None or not reader.line_num:
            return
        else:
            # a log that was cut off ends in the middle of a line
            warnings.append(f'{path}: its last line {short[0]} breaks off and is left out')
            return


def _rows(path: Path, reader: Any, skip: int) -> Iterator[list[str]]:
    """Yield the rows, each of one line."""
    before = reader.line_num
    while True:
        try:
            row = next(reader, None)
        except csv.Error as exc:
            raise _bad(path, f'line {skip + reader.line_num} cannot be read ({exc})') from None
        if row is None:
            return
        if reader.line_num > before + 1:
            raise _bad(
                path,
                f'line {skip + before + 1} has a quotation mark that is not closed there; '
                'correct the line',
            )
        before = reader.line_num
        yield row


def _stamps(
    path: Path, cells: tuple[str, ...], numbers: list[int], layout: ColumnMap
) -> NDArray[np.int64]:
    """Return stamps, ns: decimal arithmetic, since a double has not enough digits for ns."""
    stamps = np.empty(len(cells), dtype=np.int64)
    for k, cell in enumerate(cells):
        text = cell if layout.decimal == '.' else cell.replace(',', '.')
        try:
            if '_' in text:
                raise ValueError
            stamps[k] = int(Decimal(text).scaleb(layout.digits).to_integral_value())
        except (ArithmeticError, ValueError):
            raise _bad(
                path,
                f'line {numbers[k]}: the time {_short(cell)} is no number; write it as a '
                'number in the unit that the column map states',
            ) from None
    return stamps


def _floats(
    path: Path, cells: tuple[str, ...], numbers: list[int], column: Column, decimal: str
) -> FloatArray:
    """Return values (T,), NaN where a cell is empty."""
    if decimal == ',':
        cells = tuple(x.replace(',', '.') for x in cells)
    try:
        if any('_' in x for x in cells):
            raise ValueError
        values = np.array([float(x) for x in cells])
    except ValueError:
        values = np.full(len(cells), np.nan)
        for k, cell in enumerate(cells):
            if not cell.strip():
                continue
            try:
                values[k] = float(cell.replace('_', 'x'))
            except ValueError:
                where = f'line {numbers[k]}, column {printable(str(column.cell))}'
                raise _bad(
                    path,
                    f'{where}: {_short(cell)} is no number; leave a '
                    'cell empty where nothing was measured',
                ) from None
    with np.errstate(over='ignore'):
        scaled: FloatArray = values if column.scale == 1.0 else values * column.scale
    return scaled


def _check_steps(path: Path, stamp: IntArray) -> None:
    """Refuse times that the stated unit or too few digits make useless."""
    steps = np.diff(stamp)
    repeated = int((steps == 0).sum())
    if repeated > 0.01 * stamp.size:
        raise _bad(
            path,
            f'{repeated} of {stamp.size} rows have the time of the row before; write the time '
            'with more digits, or correct its unit in the column map',
        )
    forward = steps[steps > 0]
    period = float(np.median(forward)) if forward.size else _FINEST
    if not _FINEST <= period <= _COARSEST:
        raise _bad(
            path,
            f'the rows are {period * 1e-9:g} s apart; correct the unit of the time in the column '
            'map',
        )


def _feed(
    builder: RecordingBuilder, layout: ColumnMap, stamp: IntArray, values: list[FloatArray]
) -> None:
    """Hand the columns over, stream by stream."""
    for role in dict.fromkeys(QUANTITIES[x.quantity][0] for x in layout.columns):
        joints = list(
            dict.fromkeys(x.joint for x in layout.columns if QUANTITIES[x.quantity][0] == role)
        )
        fields: dict[str, FloatArray] = {}
        for column, row in zip(layout.columns, values, strict=True):
            own, field = QUANTITIES[column.quantity]
            if own == role:
                block = fields.setdefault(field, np.full((stamp.size, len(joints)), np.nan))
                block[:, joints.index(column.joint)] = row
        there = np.zeros(stamp.size, dtype=np.bool_)
        for block in fields.values():
            there |= ~np.isnan(block).all(axis=1)
        blocks = [None if x not in fields else fields[x][there] for x in FIELDS]
        builder.add_block(role, stamp[there], joints, *blocks)
