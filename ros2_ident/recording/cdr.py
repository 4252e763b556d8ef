# SPDX-License-Identifier: Apache-2.0
"""Joints' values from serialised messages, many at a time.

Messages of one topic nearly always have the same joints and length, so their numbers lie at the
same bytes: the layout is parsed once, all numbers are picked as strided arrays.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ros2_ident.recording.definition import Fields, path_of, standard, standard_of
from ros2_ident.recording.streams import FIELDS, FloatArray, IntArray, LATEST_STAMP

# Messages of one size are sorted by layout so many times together, then one by one.
_ROUNDS = 32
JOINT_STATE = 'sensor_msgs/msg/JointState'


@dataclass(frozen=True)
class Pick:
    """Where values of a field lie in the bytes of a message.

    Attributes:
        field: Number of the field, as in `FIELDS`.
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
        fields: Position, velocity, effort, each (T, D) or None.
    """

    rows: IntArray
    stamp: IntArray
    names: tuple[str, ...]
    fields: tuple[FloatArray | None, ...]


# Finds the parts of a serialised message; ValueError where the bytes are none.
Parse = Callable[[bytes], Layout]


def decode(messages: Sequence[bytes], parse: Parse) -> list[Block]:
    """Decode serialised messages.

    Args:
        messages: T messages of one topic, in order.
        parse: Finds the parts of a message.

    Returns:
        Blocks in the order of the messages: concatenated, their `rows` are 0..T-1.

    Raises:
        ValueError: A message is of another type, or its arrays do not fit its names.
    """
    if not messages:
        return []
    sizes = np.fromiter(map(len, messages), dtype=np.int64, count=len(messages))
    layout_of = np.empty(len(messages), dtype=np.int64)
    layouts: list[Layout] = []
    pieces: list[NDArray[np.uint8]] = []
    place = np.empty(len(messages), dtype=np.int64)
    for size in np.unique(sizes).tolist():
        rows = np.flatnonzero(sizes == size)
        joined = b''.join([messages[i] for i in rows.tolist()])
        table = np.frombuffer(joined, dtype=np.uint8).reshape(rows.size, size)
        for layout, chosen in _by_layout(messages, rows, table, parse):
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


def _by_layout(
    messages: Sequence[bytes], rows: IntArray, table: NDArray[np.uint8], parse: Parse
) -> Iterator[tuple[Layout, IntArray]]:
    """Yield the layouts of messages of one size, each with the rows of the table that have it."""
    left = np.arange(rows.size)
    for _ in range(_ROUNDS):
        if not left.size:
            return
        layout = parse(messages[int(rows[left[0]])])
        fixed = np.flatnonzero(layout.fixed)
        own = table[:, fixed] if left.size == rows.size else table[np.ix_(left, fixed)]
        same = (own == own[0]).all(axis=1)
        yield layout, left[same]
        left = left[~same]
    # hardly two are alike: comparing each with all others would take for ever
    for row in left.tolist():
        yield parse(messages[int(rows[row])]), np.array([row])


def _block(layout: Layout, table: NDArray[np.uint8], rows: IntArray) -> Block:
    """Pick the numbers of messages that share a layout."""
    order = '>' if layout.big else '<'
    stamp = np.zeros(rows.size, dtype=np.int64)
    for place, form, factor in layout.stamp:
        part = _column(table, place, order + form)
        if factor == 1 and (part >= 1_000_000_000).any() and len(layout.stamp) > 1:
            raise ValueError('a stamp of more nanoseconds than a second has')
        if form[0] == 'f' and not (np.abs(part) < LATEST_STAMP / factor).all():
            raise ValueError('a stamp that is no time')
        whole = np.round(part * factor) if form[0] == 'f' else part.astype(np.int64) * factor
        stamp += whole.astype(np.int64)
    fields: list[FloatArray | None] = [None] * len(FIELDS)
    for pick in layout.picks:
        values = _picked(table, pick, order)
        target = fields[pick.field]
        if target is None and pick.columns.size == len(layout.names):
            fields[pick.field] = values
            continue
        if target is None:
            target = fields[pick.field] = np.full((rows.size, len(layout.names)), np.nan)
        target[:, pick.columns] = values
    return Block(rows, stamp, layout.names, tuple(fields))


def _column(table: NDArray[np.uint8], place: int, form: str) -> NDArray[Any]:
    """Return the numbers (T,) at a byte of messages (T, L), which need not be aligned."""
    return np.ndarray((len(table),), form, table.data, place, (table.strides[0],))


def _picked(table: NDArray[np.uint8], pick: Pick, order: str) -> FloatArray:
    """Return a field (T, C) of messages (T, L); NaN where there is none."""
    places, form = pick.places, order + pick.format
    steps = np.diff(places)
    if places.size and (places >= 0).all() and (steps == steps[:1]).all():
        step = int(steps[0]) if steps.size else 0
        strides = table.strides[0], step
        shape = len(table), places.size
        values = np.ndarray(shape, form, table.data, int(places[0]), strides).astype(np.float64)
    else:
        values = np.full((len(table), places.size), np.nan)
        for column, place in enumerate(places.tolist()):
            if place >= 0:
                values[:, column] = _column(table, place, form)
    if not np.isnan(pick.absent):
        values[np.isclose(values, pick.absent, rtol=1e-6, atol=0.0)] = np.nan
    return values if pick.scale == 1.0 else values * pick.scale


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
