# SPDX-License-Identifier: Apache-2.0
"""Write a log as a table (CSV) with the column map that reads it back."""

from collections.abc import Iterator, Sequence
from decimal import Decimal
from pathlib import Path

import numpy as np
import yaml

from ros2_ident.files import make_directory, mark, require_ours, write_text
from ros2_ident.files import write_table as write_rows
from ros2_ident.recording.columns import MAP_SUFFIX, QUANTITIES
from ros2_ident.recording.streams import FloatArray, IntArray, Recording, Stream

# ns are nine decimals of a second.
_TO_SECONDS = -9


def write_table(
    path: str | Path, recordings: Sequence[Recording], inputs: Sequence[str | Path] = ()
) -> tuple[Path, Path]:
    """Write recordings of one log as a table; `read_bag` gets the same values back.

    Streams of other rates leave cells empty. The time of the next recording steps back, as it
    does in the log.

    Args:
        path: The `.csv` file.
        recordings: In order.
        inputs: What they were read from, which is not replaced.

    Returns:
        The table and its column map, which lies beside it.

    Raises:
        IdentError: INVALID_GOAL where a file cannot be written, or is not ours to replace.
    """
    table = Path(path)
    where = table.with_name(table.stem + MAP_SUFFIX)
    require_ours([table, where], inputs)
    make_directory(table.parent)
    columns = list(dict.fromkeys(name for r in recordings for name, *_ in _columns(r)))
    joints: dict[str, dict[str, str]] = {}
    for joint, quantity in columns:
        joints.setdefault(joint, {})[quantity] = f'{joint}.{quantity}'
    told = {'time': {'column': 'time', 'unit': 's'}, 'joints': joints}
    head = ['time', *map('.'.join, columns)]
    return (
        write_rows(table, head, (row for r in recordings for row in _rows(r, columns))),
        write_text(where, f'# {mark("columns")}\n{yaml.safe_dump(told, sort_keys=False)}'),
    )


def _rows(recording: Recording, columns: Sequence[tuple[str, str]]) -> Iterator[list[str]]:
    """Yield the rows of a recording: a time, and a cell for each column."""
    own = list(_columns(recording))
    stamps = np.unique(np.concatenate([stamp for _, stamp, _ in own]))
    cells = np.full((stamps.size, len(columns)), np.nan)
    for name, stamp, values in own:
        cells[np.searchsorted(stamps, stamp), columns.index(name)] = values
    for stamp, row in zip(stamps.tolist(), cells.tolist(), strict=True):
        time = Decimal(stamp).scaleb(_TO_SECONDS)
        yield [f'{time:f}', *('' if value != value else repr(value) for value in row)]


def _columns(
    recording: Recording,
) -> Iterator[tuple[tuple[str, str], IntArray, FloatArray]]:
    """Yield joint and quantity, stamps (T,) and values (T,) of all that was measured."""
    for quantity, (role, field) in QUANTITIES.items():
        stream: Stream | None = getattr(recording, role)
        if role == 'effort' and stream is None:
            stream = recording.state  # joint states may bring the effort
        values = None if stream is None else getattr(stream, field)
        if stream is not None and values is not None:
            for joint, column in zip(stream.names, values.T, strict=True):
                if np.isfinite(column).any():
                    yield (joint, quantity), stream.stamp, column
