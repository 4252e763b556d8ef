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

from ros2_ident.recording.definition import path_of, standard, standard_of, walker
from ros2_ident.recording.streams import FIELDS, FloatArray, IntArray, LATEST_STAMP

# Messages of one size are sorted by layout so many times together, then one by one.
_ROUNDS = 32
# Values of a message: the fields of a stream, and the gains that a set-point comes with.
VALUES = (*FIELDS, 'kp', 'kd')
JOINT_STATE = 'sensor_msgs/msg/JointState'


@dataclass(frozen=True)
class Pick:
    """Where values of a field lie in the bytes of a message."""

    field: int  # number of the field, as in `VALUES`
    columns: IntArray  # joints that have one (C,), by their number
    places: IntArray  # byte offsets (C,), -1 where there is no value
    format: str  # in numpy, as `f8`
    scale: float = 1.0  # factor to the unit that is read
    absent: float = np.nan  # what stands for no value; NaN for nothing else


@dataclass(frozen=True)
class Layout:
    """Where the parts of a message lie in its bytes."""

    names: tuple[str, ...]  # of the D joints
    picks: tuple[Pick, ...]
    fixed: NDArray[np.bool_]  # (L,) bytes that have to be equal for the layout to hold
    big: bool  # whether numbers are big-endian
    stamp: tuple[tuple[int, str, int], ...]  # byte offset, format and factor to ns of each part


@dataclass(frozen=True)
class Block:
    """Consecutive messages of one layout."""

    rows: IntArray  # which of the messages given these are (T,)
    stamp: IntArray  # header stamps (T,), ns
    names: tuple[str, ...]  # the D joints
    fields: tuple[FloatArray | None, ...]  # (T, D) each: `FIELDS`, or `VALUES` with gains


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
    layout_of, place = np.empty((2, len(messages)), dtype=np.int64)
    layouts: list[tuple[Layout, ByteTable]] = []
    for rows, table in _tables(messages):
        for layout, chosen in _by_layout(table, parse):
            if chosen.size == len(messages):  # nearly always: no copy is made
                return [_block(layout, table, chosen)]
            layout_of[rows[chosen]] = len(layouts)
            place[rows[chosen]] = np.arange(chosen.size)
            layouts.append((layout, table[chosen]))
    blocks = []
    for rows in np.split(np.arange(len(messages)), np.flatnonzero(np.diff(layout_of)) + 1):
        layout, table = layouts[layout_of[rows[0]]]
        blocks.append(_block(layout, table[place[rows]], rows))
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
        values, target = _picked(table, pick, order), fields[pick.field]
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
    shape, strides = (len(table), count, int(form[2:])), (table.strides[0], step, 1)
    return as_strided(table[:, place:], shape, strides, writeable=False).view(form)[..., 0]


def _picked(table: ByteTable, pick: Pick, order: str) -> FloatArray:
    """Return a field (T, C) of messages (T, L); NaN where there is none."""
    places, form = pick.places, order + pick.format
    steps = np.diff(places)
    if places.size and (places >= 0).all() and (steps == steps[:1]).all():
        step = int(steps[0]) if steps.size else 0
        values = np.array(_column(table, int(places[0]), form, step, places.size), np.float64)
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
    """Return T JointState messages of D joints, little-endian CDR with encapsulation.

    Args:
        stamp: Header stamps (T,), ns.
        fields: Position, velocity, effort, each (T, D) or None for an empty array.
    """
    store = standard()
    time = store.types['builtin_interfaces/msg/Time'](0, 0)
    header = store.types['std_msgs/msg/Header'](time, '')
    rows = [np.zeros(0 if x is None else len(names)) for x in fields]
    one = store.types[JOINT_STATE](header, list(names), *rows)
    message = bytes(store.serialize_cdr(one, JOINT_STATE))
    table = np.tile(np.frombuffer(message, dtype=np.uint8), (stamp.size, 1))
    time_of = np.stack(np.divmod(np.asarray(stamp, dtype=np.int64), 1_000_000_000), axis=1)
    table[:, 4:12] = time_of.astype('<u4').view(np.uint8)
    definition = standard_of(JOINT_STATE)
    assert definition is not None
    found, _ = walker(definition, [path_of(field) for field in FIELDS])(message)
    for field, values in zip(FIELDS, fields, strict=True):
        if values is not None:
            raw = np.ascontiguousarray(values, dtype='<f8').view(np.uint8).reshape(stamp.size, -1)
            begin = found[field].places.start
            table[:, begin : begin + raw.shape[1]] = raw
    return [row.tobytes() for row in table]
