# SPDX-License-Identifier: Apache-2.0
"""Logs as tables (CSV), read by a column map: what each column is."""

from collections.abc import Callable, Iterator
from contextlib import suppress
import csv
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
from ros2_ident.files import unreadable
from ros2_ident.recording.builder import RecordingBuilder
from ros2_ident.recording.columns import (
    Cell,
    ColumnMap,
    load_columns,
    MAP_SUFFIX,
    refuse,
    require_steps,
    summed,
)
from ros2_ident.recording.limits import listed, printable, require_memory, short
from ros2_ident.recording.storage import digest
from ros2_ident.recording.streams import FloatArray, IntArray, LATEST_STAMP, Recording

SUFFIXES = ('.csv', '.tsv', '.txt')
# Rows converted at once: bounds the memory that texts take.
_BLOCK = 1 << 14
_NO_TIME = 'write a number, or leave lines of units below the names out by `skip_below: 1`'
_NO_VALUE = 'leave a cell empty where nothing was measured'


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
    builder.add_columns(stamp, summed(str(path), layout.columns, stamp, values))
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
    require_steps(path, stamp)
    return stamp, [np.concatenate(part) for part in parts], warnings


def _equal(cell: str, value: str) -> bool:
    """Say whether a cell holds a value, as a text or as a number."""
    with suppress(ValueError):
        return cell.strip() == value or float(cell) == float(value)
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
