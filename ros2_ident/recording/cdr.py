# SPDX-License-Identifier: Apache-2.0
"""Joints' values from serialised messages, many at a time.

Messages of one topic nearly always have the same joints and length, so their numbers lie at the
same bytes: the layout is parsed once, all numbers are picked as strided arrays.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.lib.stride_tricks import as_strided
from numpy.typing import NDArray

from ros2_ident.recording.definition import Fields, path_of, standard, standard_of
from ros2_ident.recording.streams import FIELDS, FloatArray, IntArray, LATEST_STAMP

# Messages of one size are sorted by layout so many times together, then one by one.
_ROUNDS = 32
# Values of a message: the fields of a stream, and the gains that a set-point comes with.
VALUES = (*FIELDS, 'kp', 'kd')
JOINT_STATE = 'sensor_msgs/msg/JointState'


@dataclass(frozen=True)
class Pick:
    """Where values of a field lie in the bytes of a message.

    Attributes:
        field: Number of the field, as in `VALUES`.
        columns: Joints that have one (C,), by their number.
        places: Byte offsets (C,), -1 where there is no value.
        format: In numpy, as `f8`.
        scale: Factor to the unit that is read.
        absent: What stands for no value; NaN for nothing else.
    """

    field: int
    columns: IntArray
    places: IntArray
    format: str
    scale: float = 1.0
    absent: float = np.nan


@dataclass(frozen=True)
class Layout:
    """Where the parts of a message lie in its bytes.

    Attributes:
        names: Joint names (D).
        picks: Values of the fields.
        fixed: Mask (L,) of the bytes that have to be equal for the layout to hold.
        big: Whether numbers are big-endian.
        stamp: Byte offset, format and factor to ns of each part of the stamp; none where the
            message has none.
    """

    names: tuple[str, ...]
    picks: tuple[Pick, ...]
    fixed: NDArray[np.bool_]
    big: bool
    stamp: tuple[tuple[int, str, int], ...]


@dataclass(frozen=True)
class Block:
    """Consecutive messages of one layout.

    Attributes:
        rows: Which of the messages given these are (T,).
        stamp: Header stamps (T,), ns.
        names: The D joints.
        fields: Position, velocity, effort, and the gains where they are read, each (T, D) or
            None.
    """

    rows: IntArray
    stamp: IntArray
    names: tuple[str, ...]
    fields: tuple[FloatArray | None, ...]


# Serialised messages of one size (T, L).
ByteTable = NDArray[np.uint8]
# Finds the parts of a serialised message; ValueError where the bytes are none.
Parse = Callable[[bytes], Layout]


def remembered(parse: Parse) -> Parse:
    """Return what parses a message anew only where the last one of its size was another layout."""
    known: dict[int, tuple[Layout, IntArray, bytes]] = {}

    def parse_once(data: bytes) -> Layout:
        layout, fixed, same = known.get(len(data), (None, None, b''))
        row = np.frombuffer(data, dtype=np.uint8)
        if layout is None or row[fixed].tobytes() != same:
            layout = parse(data)
            fixed = np.flatnonzero(layout.fixed)
            known[len(data)] = layout, fixed, row[fixed].tobytes()
            if len(known) > _ROUNDS:
                del known[next(iter(known))]
        return layout

    return parse_once


def decode(messages: Sequence[bytes] | ByteTable, parse: Parse) -> list[Block]:
    """Decode serialised messages.

    Args:
        messages: T messages of one topic, in order; of one size (L) also as an array (T, L).
        parse: Finds the parts of a message.

    Returns:
        Blocks in the order of the messages: concatenated, their `rows` are 0..T-1.

    Raises:
        ValueError: A message is of another type, or its arrays do not fit its names.
    """
    if not len(messages):
        return []
    layout_of = np.empty(len(messages), dtype=np.int64)
    layouts: list[Layout] = []
    pieces: list[ByteTable] = []
    place = np.empty(len(messages), dtype=np.int64)
    for rows, table in _tables(messages):
        for layout, chosen in _by_layout(table, parse):
            if chosen.size == len(messages):  # nearly always: no copy is made
                return [_block(layout, table, chosen)]
            layout_of[rows[chosen]] = len(layouts)
            place[rows[chosen]] = np.arange(chosen.size)
            layouts.append(layout)
            pieces.append(table[chosen])
    edges = np.flatnonzero(np.diff(layout_of)) + 1
    starts = [0, *edges.tolist()]
    blocks = []
    for begin, end in zip(starts, [*starts[1:], len(messages)], strict=True):
        which = int(layout_of[begin])
        rows = np.arange(begin, end)
        blocks.append(_block(layouts[which], pieces[which][place[begin:end]], rows))
    return blocks


def _tables(messages: Sequence[bytes] | ByteTable) -> Iterator[tuple[IntArray, ByteTable]]:
    """Yield the messages of each size as a table, and which of all these are."""
    if isinstance(messages, np.ndarray):
        yield np.arange(len(messages)), messages
        return
    sizes = np.fromiter(map(len, messages), dtype=np.int64, count=len(messages))
    for size in np.unique(sizes).tolist():
        rows = np.flatnonzero(sizes == size)
        joined = b''.join([messages[i] for i in rows.tolist()])
        yield rows, np.frombuffer(joined, dtype=np.uint8).reshape(rows.size, size)


def _by_layout(table: ByteTable, parse: Parse) -> Iterator[tuple[Layout, IntArray]]:
    """Yield the layouts of messages (T, L), each with the rows of the table that have it."""
    left = np.arange(len(table))
    for _ in range(_ROUNDS):
        if not left.size:
            return
        layout = parse(table[left[0]].tobytes())
        fixed = np.flatnonzero(layout.fixed)
        own = table[:, fixed] if left.size == len(table) else table[np.ix_(left, fixed)]
        same = (own == own[0]).all(axis=1)
        yield layout, left[same]
        left = left[~same]
    # hardly two are alike: comparing each with all others would take for ever
    for row in left.tolist():
        yield parse(table[row].tobytes()), np.array([row])


def _block(layout: Layout, table: ByteTable, rows: IntArray) -> Block:
    """Pick the numbers of messages that share a layout."""
    # Where a message begins four bytes before a multiple of eight its numbers are aligned, and
    # numpy is twice as fast.
    size = table.shape[1]
    room = np.empty((len(table), -(-(size + 4) // 8) * 8), dtype=np.uint8)
    room[:, 4 : 4 + size] = table
    table = room[:, 4 : 4 + size]
    order = '>' if layout.big else '<'
    stamp = np.zeros(rows.size, dtype=np.int64)
    for place, form, factor in layout.stamp:
        part = _column(table, place, order + form)[:, 0]
        if factor == 1 and (part >= 1_000_000_000).any() and len(layout.stamp) > 1:
            raise ValueError('a stamp of more nanoseconds than a second has')
        if form[0] == 'f' and not (np.abs(part) < LATEST_STAMP / factor).all():
            raise ValueError('a stamp that is no time')
        whole = np.round(part * factor) if form[0] == 'f' else part.astype(np.int64) * factor
        stamp += whole.astype(np.int64)
    fields: list[FloatArray | None] = [None] * len(VALUES)
    for pick in layout.picks:
        values = _picked(table, pick, order)
        target = fields[pick.field]
        if target is None and pick.columns.size == len(layout.names):
            fields[pick.field] = values
            continue
        if target is None:
            target = fields[pick.field] = np.full((rows.size, len(layout.names)), np.nan)
        target[:, pick.columns] = values
    gains = any(x is not None for x in fields[len(FIELDS) :])
    return Block(rows, stamp, layout.names, tuple(fields if gains else fields[: len(FIELDS)]))


def _column(table: ByteTable, place: int, form: str, step: int = 0, count: int = 1) -> Any:
    """Return a view of numbers (T, count) in messages (T, L), each some bytes after the other."""
    size = int(form[2:])
    strides = table.strides[0], step, 1
    found = as_strided(table[:, place:], (len(table), count, size), strides, writeable=False)
    return found.view(form)[..., 0]


def _picked(table: ByteTable, pick: Pick, order: str) -> FloatArray:
    """Return a field (T, C) of messages (T, L); NaN where there is none."""
    places, form = pick.places, order + pick.format
    steps = np.diff(places)
    if places.size and (places >= 0).all() and (steps == steps[:1]).all():
        step = int(steps[0]) if steps.size else 0
        strided = _column(table, int(places[0]), form, step, places.size)
        values = np.array(strided, dtype=np.float64)
    else:
        values = np.full((len(table), places.size), np.nan)
        for column, place in enumerate(places.tolist()):
            if place >= 0:
                values[:, column] = _column(table, place, form)[:, 0]
    if not np.isnan(pick.absent):
        values[np.isclose(values, pick.absent, rtol=1e-6, atol=0.0)] = np.nan
    if pick.scale != 1.0:
        values *= pick.scale
    return values


def encode(
    stamp: IntArray, names: Sequence[str], fields: Sequence[FloatArray | None]
) -> list[bytes]:
    """Serialise T messages of the same joints.

    Args:
        stamp: Header stamps (T,), ns.
        names: The D joints.
        fields: Position, velocity, effort, each (T, D) or None for an empty array.

    Returns:
        T messages, little-endian CDR with encapsulation.
    """
    store = standard()
    header, joints, time = (
        store.types[x] for x in ('std_msgs/msg/Header', JOINT_STATE, 'builtin_interfaces/msg/Time')
    )
    rows = [np.zeros(0 if x is None else len(names)) for x in fields]
    one = joints(header(time(0, 0), ''), list(names), *rows)
    message = bytes(store.serialize_cdr(one, JOINT_STATE))
    table = np.tile(np.frombuffer(message, dtype=np.uint8), (stamp.size, 1))
    seconds, nanoseconds = np.divmod(np.asarray(stamp, dtype=np.int64), 1_000_000_000)
    table[:, 4:8] = seconds.astype('<i4').view(np.uint8).reshape(-1, 4)
    table[:, 8:12] = nanoseconds.astype('<u4').view(np.uint8).reshape(-1, 4)
    definition = standard_of(JOINT_STATE)
    assert definition is not None
    found, _ = Fields(definition, [path_of(field) for field in FIELDS]).walk(message)
    for field, values in zip(FIELDS, fields, strict=True):
        if values is not None:
            raw = np.ascontiguousarray(values, dtype='<f8').view(np.uint8).reshape(stamp.size, -1)
            table[:, found[field].at : found[field].at + raw.shape[1]] = raw
    return [row.tobytes() for row in table]
