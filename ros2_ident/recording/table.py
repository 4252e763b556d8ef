# SPDX-License-Identifier: Apache-2.0
"""Logs of columns, read by a column map: tables (CSV), and arrays with names.

Of arrays: NumPy, MATLAB, HDF5, Parquet, JSON lines; or a folder with a file for each quantity.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, ExitStack, suppress
import csv
from dataclasses import replace
from decimal import Decimal
from functools import partial
from importlib import import_module
import io
from itertools import islice
import json
import math
from pathlib import Path
import re
import shlex
from typing import Any
from zipfile import is_zipfile

import numpy as np
from numpy.typing import NDArray

from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.files import unreadable
from ros2_ident.recording import columns as maps
from ros2_ident.recording.builder import RecordingBuilder
from ros2_ident.recording.columns import Cell, ColumnMap, MAP_SUFFIX, refuse
from ros2_ident.recording.limits import listed, printable, require_memory, short
from ros2_ident.recording.matlab import arrays_of, linked_in
from ros2_ident.recording.names import meanings
from ros2_ident.recording.storage import counted, damaged, digest, SUFFIXES
from ros2_ident.recording.storage import NAME as BAG_NAME
from ros2_ident.recording.streams import FloatArray, IntArray, LATEST_STAMP, Recording

TABLES = ('.csv', '.tsv', '.txt', '.dat', '.log')
_bad = ErrorCode.BAD_VALUES.at
# Rows converted at once: bounds the memory that texts take.
_BLOCK = 1 << 14
# A step between rows outside of this is a wrong unit of the time, ns.
_FINEST, _COARSEST = 1_000, 2_000_000_000
_NO_TIME = 'write a number, or leave lines of units below the names out by `skip_below: 1`'
_NUMBERS = ('numbers',)  # of a line that holds such
_NO_VALUE = 'leave a cell empty where nothing was measured'
# Number of a line and its cells; makes a value of a cell.
_Row = tuple[int, list[str]]
_Convert = Callable[[str], Any]


def arrays_in(path: Path) -> list[Path]:
    """Return the files of arrays in a folder that is no bag, by their names; none of a file.

    Tables without names are such, and those that share a log's quantities.
    """
    files = [x for x in path.iterdir() if x.is_file()] if path.is_dir() else []
    if any(x.suffix in SUFFIXES or x.name == BAG_NAME for x in files):
        return []
    arrays = sorted(x for x in files if x.suffix.lower() in _PARTS or _line(x, 0) is _NUMBERS)
    return arrays or sorted(_shared(files))


def _line(path: Path, number: int) -> Sequence[str]:
    """Return the words of a table's first or second line, or that these are numbers; or none."""
    if path.suffix.lower() not in TABLES:
        return ()
    with path.open(encoding='utf-8-sig', errors='replace') as stream:
        line = [stream.readline(1 << 20) for _ in range(number + 1)][-1]
    if all(map(is_number, _in_blanks(line).split() or [''])):
        return _NUMBERS
    mark = max(',;\t', key=line.count)
    return [x.strip(' "\r\n') for x in (line.split(mark) if mark in line else line.split())]


def _shared(files: Sequence[Path]) -> dict[Path, list[str]]:
    """Return the tables that share a log, each with the names of its columns.

    A file is named before its columns where these name no quantity. What is in two of them is
    logged twice, so that they are several logs: none is returned.
    """
    found, places = dict[Path, list[str]](), list[str]()
    for path in files:
        names = _line(path, 0)
        if names is _NUMBERS or _line(path, 1) is not _NUMBERS:
            continue
        before = {x.name: f'{path.stem}.' * (x.quantity != 'time') for x in meanings(names)}
        for called in ([*names], [f'{before[x]}{x}' for x in names]):
            if read := [x for x in meanings(called) if x.quantity not in ('', 'time')]:
                found[path] = called
                places += [f'{x.joint}.{x.quantity}' for x in read]
                break
    return found if len(found) > 1 and len({*places}) == len(places) else {}


def _in_blanks(text: str) -> str:
    """Return a table's text with blanks between its numbers, and points in them."""
    marks = str.maketrans(',;\t', '.  ' if re.search('[;\t]', text[: 1 << 20]) else '   ')
    return text.translate(marks)


def map_beside(path: Path) -> Path:
    """Return where the column map of a log lies that none is named for."""
    path = path.resolve() if path.name in ('', '..') else path
    return path.parent / f'{path.stem}{MAP_SUFFIX}'


def of_columns(path: Path) -> bool:
    """Return whether a column map says what a log is: a table, or arrays."""
    if path.is_dir():
        return bool(arrays_in(path))
    return path.suffix.lower() in (*TABLES, *ARRAYS)


def read_columns(path: Path, columns: str | Path = '') -> list[Recording]:
    """Read a table, a text file with one row per sample, or arrays of samples: a file or folder.

    Args:
        columns: The column map; where empty, `NAME.columns.yaml` beside the file.

    Returns:
        One recording per uninterrupted stretch, and per group that a `*` in the map of arrays
        stands for. A row of a table in which every column of a stream is empty is no sample of
        it, so that streams of different rates fit into one.

    Raises:
        IdentError: NO_DATA, MISSING_STREAM, BAD_VALUES, DAMAGED_BAG, or INVALID_GOAL for the map
            and for a library that is not there; each with the remedy.
    """
    arrays = path.is_dir() or path.suffix.lower() in ARRAYS
    if why := unreadable(path):
        kind = 'a log' if arrays else 'a bag or a CSV file'
        raise ErrorCode.NO_DATA.error(f'{path}: {why}; give the path of {kind}')
    where = Path(columns) if columns else map_beside(path)
    return _read_arrays(path, where) if arrays else _read_table(path, where)


def _read_table(path: Path, where: Path) -> list[Recording]:
    text = text_of(path)
    if not where.exists():
        names = listed(text[: 1 << 12].split('\n', 1)[0].strip().split(','), 8)
        text = f'is a table and {where} is missing; write this map as in docs/logs.md, or by '
        text += (
            f'`{_draft(path)}`, or give that of another log, --columns FILE; the first line is: '
        )
        text += names
        raise refuse(path, text)
    layout = maps.load_columns(where)
    return _recorded(path, where, '', layout, *_parse(path, text, layout))


def _draft(path: Path) -> str:
    """Return the command that writes a log's column map by its names."""
    return shlex.join(['ident', 'new-machine', '--kind', 'KIND', '--bag', str(path)])


def _recorded(
    path: Path, where: Path, key: str, layout: ColumnMap, stamp: IntArray,
    values: Sequence[FloatArray], warnings: Sequence[str],
) -> list[Recording]:  # fmt: skip
    """Return recordings of columns (T,) with their stamps (T,), ns, of a group of arrays."""
    if not stamp.size:
        text = ' with what `where` asks for' * bool(layout.where)
        raise ErrorCode.NO_DATA.error(f'{path}: holds no row of values{text}; record again')
    steps = np.diff(stamp)
    repeated, forward = int((steps == 0).sum()), steps[steps > 0]
    period = float(np.median(forward)) if forward.size else _FINEST
    if repeated > 0.01 * stamp.size:
        text = f'{repeated} of {stamp.size} rows have the time of the row before; '
        raise _bad(path, f'{text}write more digits, correct its unit, or state the `rate` of rows')
    if not _FINEST <= period <= _COARSEST:
        text = f'the rows are {period * 1e-9:g} s apart; correct the unit of the time in '
        raise _bad(path, f'{text}{where.name}: s, ms, us or ns')
    source = f'{path}/{key}' if key else str(path)
    builder = RecordingBuilder(
        source, digest([*(arrays_in(path) or [path]), where]), warnings=warnings
    )
    units = maps.stated_units(str(where), layout.columns)
    builder.add_columns(stamp, maps.summed(str(path), layout.columns, stamp, values), units)
    return builder.build()


def _nanoseconds(time: str | int, digits: int) -> int:
    """Return a time in ns, of decimals to the last digit; a double has not enough."""
    stamp = time * 10**digits if isinstance(time, int) else round(Decimal(time).scaleb(digits))
    if abs(stamp) > LATEST_STAMP:
        raise OverflowError
    return stamp


def text_of(path: Path) -> str:
    """Return a table's text, in any code."""
    # the bytes, the text, a copy to read from, and the values
    require_memory(f'{path}: the table takes', 8 * path.stat().st_size)
    raw = path.read_bytes()
    try:
        return _apart(raw.decode('utf-8-sig'))
    except UnicodeDecodeError:
        # scopes on Windows write their names in its code page; numbers look the same in both
        return _apart(raw.decode('latin-1'))


def _apart(text: str) -> str:
    """Return a table with several numbers of one cell, as `[0.1 2.3]`, in cells of their own.

    Their names have a number, as those of an array's columns. It is judged by the last line but
    one, as the last may break off, below a line of names that are as many.
    """
    last = ['', *filter(str.strip, text.rstrip().rsplit('\n', 4))][-2:][0]
    for mark in ',;\t':
        with suppress(csv.Error, StopIteration):
            sizes = [len(_several(x)) or 1 for x in next(csv.reader([last], delimiter=mark))]
            apart = 1 < len(sizes) < sum(sizes)
            rows = [*csv.reader(io.StringIO(text, newline=''), delimiter=mark)] if apart else []
            words = (n for n, row in enumerate(rows) if not any(map(_several, row)))
            names = next(n for n in words if len(rows[n]) == len(sizes))
            each = [[y for x in row for y in _several(x) or [x]] for row in rows]
            several = zip(rows[names], sizes, strict=True)
            each[names] = [f'{x}[{k}]' if n > 1 else x for x, n in several for k in range(n)]
            out = io.StringIO()
            csv.writer(out, delimiter=mark).writerows(each)
            return out.getvalue()
    return text


def is_number(text: str, decimal: str = '.') -> bool:
    """Return whether a cell holds a number."""
    try:
        float(text.replace(decimal, '.'))
    except ValueError:
        return False
    return True


def _several(cell: str) -> list[str]:
    """Return the numbers of a cell; none of what is no number."""
    parts = re.split(r'[\s,]+' if cell.strip()[:1] in ('[', '(') else ' +', cell.strip(' []()'))
    return parts if all(map(is_number, parts)) else []


def _parse(
    path: Path, text: str, layout: ColumnMap
) -> tuple[IntArray, list[FloatArray], list[str]]:
    """Return stamps (T,) ns, each column's values (T,), and what was left out."""
    lines = islice(io.StringIO(text, newline=''), layout.skip, None)
    reader = csv.reader(lines, delimiter=layout.delimiter, skipinitialspace=True)
    try:
        names = [x.strip() for x in next(reader, [])] if layout.header else []
    except csv.Error as exc:
        raise _bad(path, f'the line of names cannot be read ({exc})') from None
    for _ in range(layout.skip_below):
        if next(reader, None) is None:
            break
    where = [_find(path, x.cell, names) for x in layout.columns]
    time = None if layout.rate else _find(path, layout.time, names)
    asked = {_find(path, cell, names): value for cell, value in layout.where}
    stamps = [np.empty(0, dtype=np.int64)]
    parts = [[np.empty(0)] for _ in layout.columns]
    warnings: list[str] = []
    nanoseconds = partial(_nanoseconds, digits=layout.digits)
    width = max([*where, *asked, time or 0]) + 1
    rows = enumerate(_rows_of(path, reader, width, layout.skip, warnings))
    met = (x for x in rows if all(_equal(x[1][1][at], y) for at, y in asked.items()))
    while several := list(islice(met, _BLOCK)):
        block = [row for _, row in several]
        read = partial(_converted, path, block, layout.decimal)
        if time is None:
            own = [round(n * 1e9 / layout.rate) for n, _ in several]
        else:
            own = read(time, ': the time', _NO_TIME, nanoseconds)
        stamps.append(np.array(own, dtype=np.int64))
        for part, column, at in zip(parts, layout.columns, where, strict=True):
            name = f', column {printable(str(column.cell))}:'
            numbers = read(at, name, _NO_VALUE, lambda x: float(x) if x else math.nan)
            part.append(np.array(numbers))
    return np.concatenate(stamps), [np.concatenate(part) for part in parts], warnings


def _equal(cell: str, value: str) -> bool:
    with suppress(ValueError):  # as a text or as a number
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
    raise _missing(path, 'column', cell, names, ', its delimiter or its skip')


def _missing(path: Path, kind: str, name: str, names: Sequence[str], more: str = '') -> Exception:
    text = f'{path}: has no {kind} {short(name)}, its {kind}s are {listed(names, 30)}'
    return ErrorCode.MISSING_STREAM.error(f'{text}; correct the column map{more}')


def _rows_of(
    path: Path, reader: Any, width: int, skip: int, warnings: list[str]
) -> Iterator[_Row]:
    """Yield rows of one line each, at least `width` cells wide."""
    narrow, last, before = '', 0, skip + reader.line_num
    try:
        for row in reader:
            number, before = before + 1, skip + reader.line_num
            if before > number:
                text = 'has a quotation mark that is not closed there; correct the line'
                raise _bad(path, f'line {number} {text}')
            if not any(cell.strip() for cell in row):
                continue
            if narrow:
                text = f'{narrow}, the column map needs {width}; correct the line or the delimiter'
                raise _bad(path, text)
            if len(row) >= width:
                yield number, row
            else:
                last, narrow = number, f'line {number} has {len(row)} cells'
    except csv.Error as exc:
        raise _bad(path, f'line {skip + reader.line_num} cannot be read ({exc})') from None
    if narrow:  # a log that was cut off ends in the middle of a line
        warnings.append(f'{path}: its last line {last} breaks off and is left out')


def _converted(
    path: Path, rows: list[_Row], decimal: str, at: int, where: str, remedy: str, convert: _Convert
) -> list[Any]:
    out = []
    for number, row in rows:
        text = row[at] if decimal == '.' else row[at].replace(',', '.')
        try:
            out.append(convert(text.strip().replace('_', 'x')))  # Python reads 1_000
        except (ArithmeticError, ValueError):
            text = f'line {number}{where} {short(row[at])} is no number; {remedy}'
            raise _bad(path, text) from None
    return out


# Names of the arrays of a file, what returns one, and what was left out of it.
_Opened = tuple[Sequence[str], Callable[[str], NDArray[Any]], Sequence[str]]
# A name, and of several columns the number of one, or some as a slice.
_CELL = re.compile(r'(.*?)(?:\[(-?\d+)\]|\[(-?\d*):(-?\d*)\])?', re.DOTALL)
_MOST_NAMES = 100_000


def array_sizes(path: Path) -> dict[str, tuple[int, int]]:
    """Return rows and columns of a file's arrays by their names; 0 of what is no table of numbers.

    Raises:
        IdentError: DAMAGED_BAG for a file that cannot be read, INVALID_GOAL without its library.
    """
    found = {}
    with _careful(path), _opened(path) as (names, get, _):
        for name in names:
            array = get(name)
            table = array.ndim in (1, 2) and array.dtype.kind in 'biufM'
            plain = array.ndim < 2 or array.shape[0] == 1
            shape = (array.size, 1) if plain else array.shape
            found[name] = (shape[0], shape[1]) if table else (0, 0)
    return found


def _read_arrays(path: Path, where: Path) -> list[Recording]:
    found = []
    with ExitStack() as stack:
        with _careful(path):
            names, get, warnings = stack.enter_context(_opened(path))
        if not where.exists():
            text = f'needs the column map {where}; write it as in docs/logs.md, or by '
            raise refuse(path, f'{text}`{_draft(path)}`; it holds {listed(names, 20)}')
        layout = maps.load_columns(where, arrays=True)
        for key in _keys(path, layout, names):
            cells = [str(x.cell).replace('*', key) for x in layout.columns]
            own = [replace(x, cell=y) for x, y in zip(layout.columns, cells, strict=True)]
            one = replace(layout, columns=tuple(own), time=str(layout.time).replace('*', key))
            found += _recorded(path, where, key, one, *_rows(path, one, names, get), warnings)
    return found


def _keys(path: Path, layout: ColumnMap, names: Sequence[str]) -> list[str]:
    """Return what a `*` in the names stands for, in their order; '' where there is none."""
    starred = [x for x in (str(x.cell) for x in layout.columns) if x.count('*') == 1]
    if not starred:
        return ['']
    name, _ = _parts(starred[0])
    pattern = re.compile(re.escape(name).replace(r'\*', '([^/]+)'))
    if not (found := [x[1] for x in map(pattern.fullmatch, names) if x]):
        raise _missing(path, 'array', name, names)
    return sorted(found, key=counted)


def _parts(cell: str) -> tuple[str, int | slice | None]:
    """Return a cell's name, and which of its columns it means."""
    found = _CELL.fullmatch(cell)
    assert found is not None
    name, one, low, high = found.groups()
    if low is not None:
        return name, slice(*(int(x) if x else None for x in (low, high)))
    return name, None if one is None else int(one)


def _rows(
    path: Path, layout: ColumnMap, names: Sequence[str], get: Callable[[str], NDArray[Any]]
) -> tuple[IntArray, list[FloatArray]]:
    """Return stamps (T,) ns and each column's values (T,)."""
    held: dict[str, NDArray[Any]] = {}

    def column(cell: object, entry: int = 0, of: int = 1) -> NDArray[Any]:
        name, index = _parts(str(cell))
        if name not in held:
            if name not in names:
                raise _missing(path, 'array', name, names)
            with _careful(path):
                found = get(name)
            if found.dtype.kind == 'M':
                found = found.astype('M8[ns]').astype(np.int64)
            if found.dtype.kind not in 'biuf' or found.ndim > 2:
                text = f'{short(name)} holds {found.dtype.name} of {found.ndim} axes'
                raise _bad(path, f'{text}; name an array of numbers, a row for each time')
            plain = found.ndim < 2 or found.shape[0] == 1
            held[name] = found.reshape(-1, 1) if plain else found
        table = held[name]
        try:
            chosen = table if index is None else table[:, index]
        except IndexError:
            text = f'{short(name)} has {table.shape[1]} columns; correct {cell}'
            raise _bad(path, text) from None
        chosen = chosen.reshape(len(table), -1)
        if chosen.shape[1] != of:
            text = f'{printable(str(cell))} is {chosen.shape[1]} columns for {of} joints; write as'
            raise _bad(path, f'{text} NAME[0], or NAME[0:{of}] for {of} joints')
        return chosen[:, entry]

    values = [column(x.cell, x.entry, x.of) for x in layout.columns]
    if layout.time:
        times = column(layout.time)
        exact = map(repr, times.tolist()) if times.dtype.kind == 'f' else times.tolist()
        try:
            stamp = np.array([_nanoseconds(x, layout.digits) for x in exact], dtype=np.int64)
        except (ArithmeticError, ValueError):
            raise _bad(path, 'a time is no number, or too large; correct it or its unit') from None
    else:
        stamp = np.round(np.arange(len(values[0])) * (1e9 / layout.rate)).astype(np.int64)
    there = np.ones(stamp.size, dtype=np.bool_)
    for cell, wanted in layout.where:
        number = math.nan  # what is no number stands nowhere
        with suppress(ValueError):
            number = float({'True': 1, 'False': 0}.get(wanted, wanted))
        there &= column(cell) == number
    for x, row in zip(layout.columns, values, strict=True):
        if row.size != stamp.size:
            text = f'{printable(str(x.cell))} has {row.size} rows, the time {stamp.size}'
            raise _bad(path, f'{text}; write arrays of one length, or a map for each')
    return stamp[there], [row[there].astype(np.float64) for row in values]


def _library(name: str, path: Path) -> Any:
    """Return a library that only some logs need."""
    try:
        return import_module(name)
    except ModuleNotFoundError:
        text = f'{path}: needs {name.partition(".")[0]}; `pip install "ros2-ident[tables]"`'
        raise ErrorCode.INVALID_GOAL.error(text) from None


@contextmanager
def _careful(path: Path) -> Iterator[None]:
    """Turn what a library raises at a damaged file into the refusal of the file."""
    try:
        yield
    except IdentError:
        raise
    except Exception as exc:  # libraries let whatever damaged bytes cause through
        said = printable(' '.join(str(exc).split()) or type(exc).__name__, 120)
        raise damaged(path, f'cannot be read ({said}); write or copy it again') from None


def _opened(path: Path) -> AbstractContextManager[_Opened]:
    return _folder(path) if path.is_dir() else _OPEN.get(path.suffix.lower(), _plain)(path)


@contextmanager
def _folder(path: Path) -> Iterator[_Opened]:
    """Give the arrays of all files; what a file holds alone has the file's name."""
    found: dict[str, Callable[[], NDArray[Any]]] = {}
    time: NDArray[Any] | None = None
    with ExitStack() as stack:
        files = arrays_in(path)
        for file, called in _shared(files).items():
            values = np.loadtxt(io.StringIO(_in_blanks(text_of(file))), skiprows=1, ndmin=2)
            for meant, column in zip(meanings(called), values.T, strict=True):
                if meant.quantity != 'time' or time is None:
                    found[meant.name] = partial(np.asarray, column)
                elif not np.array_equal(time, column):
                    text = f'{short(meant.name)} of {printable(file.name)} is another time than '
                    raise _bad(path, f'{text}that of the other tables; write one table')
                if meant.quantity == 'time':
                    time = column
        for file in () if found else files:
            names, get, _ = stack.enter_context(_opened(file))
            for name in names:
                found[file.stem if len(names) == 1 else f'{file.stem}.{name}'] = partial(get, name)
        yield [*found], lambda name: found[name](), ()


@contextmanager
def _plain(path: Path) -> Iterator[_Opened]:
    values = np.loadtxt(io.StringIO(_in_blanks(text_of(path))), ndmin=2)
    yield [path.stem], lambda name: values, ()


@contextmanager
def _single(path: Path) -> Iterator[_Opened]:
    require_memory(f'{path}: its values take', 3 * path.stat().st_size)
    values = np.load(path, allow_pickle=False)
    fields = values.dtype.names
    yield [*(fields or (path.stem,))], lambda name: values[name] if fields else values, ()


@contextmanager
def _numpy(path: Path) -> Iterator[_Opened]:
    if not is_zipfile(path):
        raise ValueError('it is no archive of arrays, as numpy.savez writes it')
    with np.load(path, allow_pickle=False) as file:
        sizes = {x.filename: x.file_size for x in file.zip.infolist()}

        def get(name: str) -> NDArray[Any]:
            require_memory(f'{path}: {name} takes', 3 * sizes.get(f'{name}.npy', 0))
            return np.asarray(file[name])

        yield file.files, get, ()


@contextmanager
def _matlab(path: Path) -> Iterator[_Opened]:
    with path.open('rb') as stream:
        newer = stream.read(19) == b'MATLAB 7.3 MAT-file'
    if newer:
        with _hdf5(path, matlab=True) as (names, get, _):
            yield names, lambda name: get(name).T, ()
        return
    require_memory(f'{path}: its values take', 4 * path.stat().st_size)
    found = dict(arrays_of(path.read_bytes()))
    yield [*found], found.__getitem__, ()


@contextmanager
def _hdf5(path: Path, matlab: bool = False) -> Iterator[_Opened]:
    h5py = _library('h5py', path)
    found: dict[str, Any] = {}

    def visit(name: str, node: Any) -> int | None:
        # a dataset that lies in other files is none of this one
        if isinstance(node, h5py.Dataset) and not (node.external or node.is_virtual):
            found[name] = node
        return 1 if len(found) > _MOST_NAMES else None

    def get(name: str) -> NDArray[Any]:
        size = found[name].size * max(found[name].dtype.itemsize, 8)
        require_memory(f'{path}: {name} takes', 3 * size)
        return np.asarray(found[name][()])

    with h5py.File(path, 'r') as file:
        if matlab:
            found |= islice(linked_in(file), _MOST_NAMES)
        else:
            file.visititems(visit)
        yield [*found], get, ()


@contextmanager
def _parquet(path: Path) -> Iterator[_Opened]:
    with _library('pyarrow.parquet', path).ParquetFile(path) as file:
        yield file.schema_arrow.names, lambda name: parquet_columns(path, [name])[name], ()


def parquet_columns(path: Path, names: Sequence[str]) -> dict[str, NDArray[Any]]:
    """Return columns of a Parquet file, (T,) or, of lists, (T, C).

    Raises:
        IdentError: DAMAGED_BAG, or BAD_VALUES for lists of unlike lengths; INVALID_GOAL without
            pyarrow.
    """
    parquet, found = _library('pyarrow.parquet', path), {}
    with _careful(path), parquet.ParquetFile(path) as file:
        require_memory(f'{path}: its values take', 24 * file.metadata.num_rows * len(names))
        table = file.read(list(names))
        for name in names:
            rows = table[name].combine_chunks()
            lists = hasattr(rows, 'flatten') and 'list' in str(rows.type)
            flat = (rows.flatten() if lists else rows).to_numpy(zero_copy_only=False)
            width = flat.size // max(1, len(rows)) if lists else 1
            sizes = set(rows.value_lengths().to_pylist()) if lists else ()
            if len(sizes) > 1:
                raise ValueError(f'{name} holds lists of unlike lengths')
            found[name] = flat.reshape(len(rows), width) if lists else flat
    return found


@contextmanager
def _json_lines(path: Path) -> Iterator[_Opened]:
    require_memory(f'{path}: its values take', 20 * path.stat().st_size)
    rows: list[Any] = []
    warnings = []
    lines = path.read_text(encoding='utf-8', errors='replace').splitlines()
    for number, line in enumerate(lines, 1):
        try:
            row = json.loads(line) if line.strip() else None
        except (ValueError, RecursionError):
            if number < len(lines):
                raise _bad(path, f'line {number} is no JSON; correct the line') from None
            # a log that was cut off ends in the middle of a line
            warnings.append(f'{path}: its last line {number} breaks off and is left out')
            row = None
        if isinstance(row, Mapping):
            rows.append(row)
    names = dict.fromkeys(name for row in rows[:_SHOWN] for name, _ in _leaves(row))

    def get(name: str) -> NDArray[Any]:
        values = [dict(_leaves(row)).get(name) if '.' in name else row.get(name) for row in rows]
        width = next((len(x) for x in values if isinstance(x, list)), 0)
        none = [np.nan] * width if width else np.nan
        return np.array([none if x is None else x for x in values])

    yield [*names], get, warnings


def _leaves(row: Mapping[str, Any], before: str = '', deep: int = 0) -> Iterator[tuple[str, Any]]:
    for name, value in row.items():
        if isinstance(value, Mapping) and deep < 8:
            yield from _leaves(value, f'{before}{name}.', deep + 1)
        else:
            yield before + name, value


# Lines in which names are looked for.
_SHOWN = 100
_OPEN = {'.npz': _numpy, '.mat': _matlab, '.hdf5': _hdf5, '.h5': _hdf5, '.parquet': _parquet}
_OPEN |= {'.jsonl': _json_lines, '.npy': _single}
ARRAYS = tuple(_OPEN)
# Files of which a folder may hold one for each quantity.
_PARTS = ('.npy', '.npz', '.mat')
