# SPDX-License-Identifier: Apache-2.0
"""Logs as tables (CSV), read by a column map that says what each column is."""

from collections.abc import Iterator, Mapping
import csv
from decimal import Decimal
import io
from itertools import compress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.recording.builder import RecordingBuilder
from ros2_ident.recording.columns import (
    Cell,
    Column,
    ColumnMap,
    load_columns,
    MAP_SUFFIX,
    QUANTITIES,
    refuse,
    short,
)
from ros2_ident.recording.limits import Limits, too_large
from ros2_ident.recording.motion import CUTOFF
from ros2_ident.recording.shown import listed, printable
from ros2_ident.recording.smooth import allowed_cutoff, smooth_motion
from ros2_ident.recording.storage import digest
from ros2_ident.recording.streams import FIELDS, FloatArray, IntArray, Recording

# Rows converted at once: bounds the memory that texts take.
_BLOCK = 1 << 14
# A step between rows outside of this is a wrong unit of the time, ns.
_FINEST, _COARSEST = 1_000, 2_000_000_000
# A joint that is slower than this share of its top speed rests.
_REST = 0.01


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
        raise refuse(
            path,
            f'is a table and {where} is missing; write this map as in docs/logs.md, or have '
            f'`ident new-machine --kind KIND --bag {path}` write it; the first line is: {names}',
        )
    layout = load_columns(where)
    stamp, values, warnings = _parse(path, text, layout)
    builder = RecordingBuilder(str(path), digest([path, where]), limits)
    for sentence in warnings:
        builder.warn(sentence)
    _feed(builder, layout, stamp, values)
    return builder.build()


def _bad(path: object, text: str) -> IdentError:
    return IdentError(ErrorCode.BAD_VALUES, f'{path}: {text}')


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
    for _ in range(layout.skip_below):
        next(reader, None)
    cells = [layout.time, *(x.cell for x in layout.columns)]
    where = [_find(path, cell, names) for cell in cells]
    asked = {_find(path, cell, names): value for cell, value in layout.where}
    width = max(*where, *asked) + 1
    stamps: list[NDArray[np.int64]] = []
    parts: list[list[FloatArray]] = [[] for _ in layout.columns]
    warnings: list[str] = []
    for rows, numbers in _blocks(path, reader, width, layout.skip, warnings):
        if asked:
            met = [all(_equal(row[at], x) for at, x in asked.items()) for row in rows]
            rows, numbers = list(compress(rows, met)), list(compress(numbers, met))
        table = list(zip(*rows, strict=False)) or [()] * width
        stamps.append(_stamps(path, table[where[0]], numbers, layout))
        for part, column, at in zip(parts, layout.columns, where[1:], strict=True):
            part.append(_floats(path, table[at], numbers, column, layout.decimal))
    stamp = np.concatenate(stamps or [np.empty(0, np.int64)])
    if not stamp.size:
        where_ = ' with what `where` asks for' if layout.where else ''
        raise IdentError(
            ErrorCode.NO_DATA, f'{path}: holds no row of values{where_}; record again'
        )
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
        raise _bad(
            path, f'two columns are called {short(cell)}; give the number of the column instead'
        )
    raise IdentError(
        ErrorCode.MISSING_STREAM,
        f'{path}: has no column {short(cell)}, its columns are {listed(names, 30)}; correct '
        'the column map, its delimiter or its skip',
    )


def _blocks(
    path: Path, reader: Any, width: int, skip: int, warnings: list[str]
) -> Iterator[tuple[list[list[str]], list[int]]]:
    """Yield rows of one line each, `width` cells wide, with the numbers of their lines."""
    rows: list[list[str]] = []
    numbers: list[int] = []
    narrow, before = '', reader.line_num
    while True:
        try:
            row = next(reader, None)
        except csv.Error as exc:
            raise _bad(path, f'line {skip + reader.line_num} cannot be read ({exc})') from None
        if row is None:
            break
        if reader.line_num > before + 1:
            text = 'has a quotation mark that is not closed there; correct the line'
            raise _bad(path, f'line {skip + before + 1} {text}')
        before = reader.line_num
        if not any(cell.strip() for cell in row):
            continue
        if narrow:
            raise _bad(path, f'{narrow}, the column map needs {width}; correct the line or the '
                       'delimiter')  # fmt: skip
        if len(row) < width:
            narrow, cut = f'line {skip + before} has {len(row)} cells', skip + before
            continue
        rows.append(row[:width])
        numbers.append(skip + before)
        if len(rows) == _BLOCK:
            yield rows, numbers
            rows, numbers = [], []
    if rows:
        yield rows, numbers
    if narrow:  # a log that was cut off ends in the middle of a line
        warnings.append(f'{path}: its last line {cut} breaks off and is left out')


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
                f'line {numbers[k]}: the time {short(cell)} is no number; write it as a '
                'number in the unit that the column map states, or leave lines of units below the '
                'names out by `skip_below: 1`',
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
                    f'{where}: {short(cell)} is no number; leave a '
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
    moves = np.abs(rate) > _REST * np.fmax.reduce(np.abs(rate))
    last = np.maximum.accumulate(np.where(moves, np.arange(rate.size), -1))
    return np.sign(rate[np.where(last < 0, np.argmax(moves), last)])


def _feed(
    builder: RecordingBuilder, layout: ColumnMap, stamp: IntArray, values: list[FloatArray]
) -> None:
    """Hand the columns over, stream by stream."""
    sums: dict[tuple[str, str], FloatArray] = {}
    for column, row in sorted(
        zip(layout.columns, values, strict=True), key=lambda x: x[0].unsigned
    ):
        key = column.joint, column.quantity
        if column.unsigned:
            row = row * _directions(builder.source, column.joint, stamp, sums)
        sums[key] = sums[key] + row if key in sums else row
    for role in dict.fromkeys(QUANTITIES[x.quantity][0] for x in layout.columns):
        joints = list(
            dict.fromkeys(x.joint for x in layout.columns if QUANTITIES[x.quantity][0] == role)
        )
        fields: dict[str, FloatArray] = {}
        for (joint, quantity), row in sums.items():
            own, field = QUANTITIES[quantity]
            if own == role:
                block = fields.setdefault(field, np.full((stamp.size, len(joints)), np.nan))
                block[:, joints.index(joint)] = row
        there = np.zeros(stamp.size, dtype=np.bool_)
        for block in fields.values():
            there |= ~np.isnan(block).all(axis=1)
        blocks = [None if x not in fields else fields[x][there] for x in FIELDS]
        builder.add_block(role, stamp[there], joints, *blocks)
