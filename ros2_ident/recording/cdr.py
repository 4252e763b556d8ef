# SPDX-License-Identifier: Apache-2.0
"""Joints' values from raw CDR, many messages at a time.

Messages of one topic nearly always have the same joints and length, so their numbers lie at the
same bytes: the layout is parsed once, all numbers are picked with two array operations.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache
import struct

import numpy as np
from numpy.typing import NDArray
from rosbags.typesys import get_typestore, Stores
from rosbags.typesys.store import Typestore

from ros2_ident.errors import ErrorCode
from ros2_ident.recording.limits import limit, variable_of
from ros2_ident.recording.streams import FloatArray, IntArray

# Messages of one size are sorted by layout so many times together, then one by one.
_ROUNDS = 32
# CDR may be filled up to its alignment; more at the end is no JointState.
_PADDING = 8
JOINT_STATE = 'sensor_msgs/msg/JointState'
_HEADER = 4  # bytes of encapsulation before the first byte that alignment counts from


@dataclass(frozen=True)
class Layout:
    """Where the parts of a message lie in its bytes.

    Attributes:
        names: Joint names.
        places: Byte offsets (D,) of position, velocity and effort, -1 for a joint that has no
            value; None where a whole field is empty.
        fixed: Mask (L,) of the bytes that have to be equal for the layout to hold.
        big: Whether numbers are big-endian.
        stamp: Byte offset of the stamp; None where the message has none.
    """

    names: tuple[str, ...]
    places: tuple[IntArray | None, IntArray | None, IntArray | None]
    fixed: NDArray[np.bool_]
    big: bool
    stamp: int | None = _HEADER


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
    fields: tuple[FloatArray | None, FloatArray | None, FloatArray | None]


class Cursor:
    """Walks over one serialised message and notes which of its bytes make its layout.

    Args:
        data: The message with its four bytes of encapsulation.

    Attributes:
        at: Place of the next byte.
        big: Whether numbers are big-endian.
        fixed: Mask (L,) of the bytes that lengths and names are made of.

    Raises:
        ValueError: The bytes are no message, here and in every step.
        IdentError: BAD_VALUES where joints are more, or their names longer, than is allowed.
    """

    def __init__(self, data: bytes) -> None:
        if len(data) < _HEADER or data[0] != 0 or data[1] not in (0, 1):
            raise ValueError('no CDR message')
        self.big = data[1] == 0
        self.fixed = np.zeros(len(data), dtype=np.bool_)
        self.fixed[:2] = True
        self.at = _HEADER
        self._data = data
        self._unpack = struct.Struct(f'{">" if self.big else "<"}I').unpack_from

    def skip(self, size: int, align: int) -> int:
        """Pass over a value of some bytes; return its place."""
        begin = self.at + -(self.at - _HEADER) % align
        if begin + size > len(self._data):
            raise ValueError('message ends early')
        self.at = begin + size
        return begin

    def count(self) -> int:
        """Return a length."""
        begin = self.skip(4, 4)
        self.fixed[begin : self.at] = True
        return int(self._unpack(self._data, begin)[0])

    def text(self, *, free: bool = False) -> str:
        """Return a string; a free one may differ from message to message."""
        size = self.count()
        if self.at + size > len(self._data):
            raise ValueError('message ends early')
        if not free and size > limit('name') + 1:
            text = f'a joint has a name of {size - 1} bytes, more than the {limit("name")} allowed'
            remedy = f'shorten it, or raise {variable_of("name")}'
            raise ErrorCode.BAD_VALUES.error(f'{text}; {remedy}')
        begin = self.skip(size, 1)
        self.fixed[begin : self.at] = not free
        return '' if free else self._data[begin : self.at].rstrip(b'\0').decode()

    def header(self) -> int:
        """Pass over a header; return the place of its stamp."""
        begin = self.skip(8, 4)
        self.text(free=True)
        return begin

    def names(self) -> tuple[str, ...]:
        """Return a sequence of names."""
        number = self.count()
        if number > len(self._data):
            raise ValueError('more names than bytes')
        if number > limit('joints'):
            text = f'a message names {number} joints, more than the {limit("joints")} allowed'
            remedy = f'record the drives only, or raise {variable_of("joints")}'
            raise ErrorCode.BAD_VALUES.error(f'{text}; {remedy}')
        return tuple(self.text() for _ in range(number))

    def doubles(self) -> IntArray | None:
        """Return the places of a sequence of doubles; None where it is empty."""
        number = self.count()
        if not number:
            return None
        begin = self.skip(8 * number, 8)
        return begin + 8 * np.arange(number)

    def end(self) -> None:
        """Refuse what goes on after its end."""
        if len(self._data) - self.at > _PADDING:
            raise ValueError('message goes on after its end')


Parse = Callable[[bytes], Layout]


def parse_layout(data: bytes) -> Layout:
    """Find the parts of one serialised JointState.

    Args:
        data: The message with its four bytes of encapsulation.

    Raises:
        ValueError: The bytes are no JointState.
        IdentError: As `Cursor`.
    """
    cursor = Cursor(data)
    cursor.header()
    names = cursor.names()
    position, velocity, effort = cursor.doubles(), cursor.doubles(), cursor.doubles()
    cursor.end()
    return Layout(names, (position, velocity, effort), cursor.fixed, cursor.big)


def decode(messages: Sequence[bytes], parse: Parse = parse_layout) -> list[Block]:
    """Decode serialised messages.

    Args:
        messages: T messages of one topic, in order.
        parse: Finds the parts of a message; those of a JointState by default.

    Returns:
        Blocks in the order of the messages: concatenated, their `rows` are 0..T-1.

    Raises:
        ValueError: A message is of another type, or its arrays do not fit its names.
    """
    if not messages:
        return []
    sizes = np.fromiter((len(m) for m in messages), dtype=np.int64, count=len(messages))
    layout_of = np.empty(len(messages), dtype=np.int64)
    layouts: list[Layout] = []
    pieces: list[NDArray[np.uint8]] = []
    place = np.empty(len(messages), dtype=np.int64)
    for size in np.unique(sizes).tolist():
        rows = np.flatnonzero(sizes == size)
        joined = b''.join([messages[i] for i in rows.tolist()])
        table = np.frombuffer(joined, dtype=np.uint8).reshape(rows.size, size)
        for layout, chosen in _by_layout(messages, rows, table, parse):
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
        same = (table[left][:, layout.fixed] == table[left[0], layout.fixed]).all(axis=1)
        yield layout, left[same]
        left = left[~same]
    # hardly two are alike: comparing each with all others would take for ever
    for row in left.tolist():
        yield parse(messages[int(rows[row])]), np.array([row])


def _block(layout: Layout, table: NDArray[np.uint8], rows: IntArray) -> Block:
    """Pick the numbers of messages that share a layout."""
    order = '>' if layout.big else '<'
    stamp = np.zeros(rows.size, dtype=np.int64)
    if layout.stamp is not None:
        half = layout.stamp + 4
        seconds = table[:, half - 4 : half].copy().view(f'{order}i4')[:, 0].astype(np.int64)
        nanoseconds = table[:, half : half + 4].copy().view(f'{order}u4')[:, 0].astype(np.int64)
        if (nanoseconds >= 1_000_000_000).any():
            raise ValueError('a stamp of more nanoseconds than a second has')
        stamp = seconds * 1_000_000_000 + nanoseconds
    fields: list[FloatArray | None] = []
    for places in layout.places:
        if places is not None and places.size != len(layout.names):
            raise ValueError(f'{len(layout.names)} names but an array of {places.size} values')
        fields.append(None if places is None else _picked(table, places, order))
    return Block(rows, stamp, layout.names, (fields[0], fields[1], fields[2]))


def _picked(table: NDArray[np.uint8], places: IntArray, order: str) -> FloatArray:
    """Return the doubles (T, D) at places (D,) of messages (T, L); NaN where there is none."""
    begin = int(places[0])
    if begin >= 0 and (np.diff(places) == 8).all():
        raw = table[:, begin : begin + 8 * places.size].copy()
        return raw.view(f'{order}f8').astype(np.float64)
    raw = table[:, (places[:, None] + np.arange(8)).ravel()]
    values = np.ascontiguousarray(raw).view(f'{order}f8').astype(np.float64)
    values[:, places < 0] = np.nan
    return values


@cache
def typestore() -> Typestore:
    """Return the messages of ROS 2 Jazzy itself."""
    return get_typestore(Stores.ROS2_JAZZY)


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
    store = typestore()
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
    for places, values in zip(parse_layout(message).places, fields, strict=True):
        if places is not None:
            raw = np.ascontiguousarray(values, dtype='<f8').view(np.uint8).reshape(stamp.size, -1)
            table[:, places[0] : places[0] + raw.shape[1]] = raw
    return [row.tobytes() for row in table]
