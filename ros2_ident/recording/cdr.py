# SPDX-License-Identifier: Apache-2.0
"""sensor_msgs/JointState from raw CDR, many messages at a time.

Messages of one topic nearly always have the same joints and the same length, so their numbers lie
at the same bytes: the layout is parsed once and the numbers of all messages are picked with two
array operations.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
import struct

import numpy as np
from numpy.typing import NDArray

from ros2_ident.recording.limits import Limits, variable_of
from ros2_ident.recording.streams import FloatArray, IntArray

# Messages of one size are sorted by layout so many times together, then one by one.
_ROUNDS = 32
# CDR may be filled up to its alignment; more at the end is no JointState.
_PADDING = 8
_HEADER = 4  # bytes of encapsulation before the first byte that alignment counts from


class TooManyNamesError(ValueError):
    """A message names more joints, or longer ones, than are allowed."""


@dataclass(frozen=True)
class Layout:
    """Where the parts of a JointState lie in its bytes.

    Attributes:
        names: Joint names.
        spans: Byte ranges of position, velocity and effort; None where empty.
        fixed: Mask (L,) of the bytes that have to be equal for the layout to hold.
        big: Whether numbers are big-endian.
    """

    names: tuple[str, ...]
    spans: tuple[tuple[int, int] | None, tuple[int, int] | None, tuple[int, int] | None]
    fixed: NDArray[np.bool_]
    big: bool


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

    def taken(self, rows: IntArray) -> 'Block':
        """Return the messages at some places of this block, numbered from 0."""
        position, velocity, effort = (None if x is None else x[rows] for x in self.fields)
        return Block(
            np.arange(rows.size), self.stamp[rows], self.names, (position, velocity, effort)
        )


def parse_layout(data: bytes, limits: Limits | None = None) -> Layout:
    """Find the parts of one serialised JointState.

    Args:
        data: The message with its four bytes of encapsulation.
        limits: How many names, and of what length.

    Returns:
        The layout.

    Raises:
        ValueError: The bytes are no JointState; TooManyNamesError where they exceed the limits.
    """
    limits = limits or Limits()
    if len(data) < _HEADER + 28 or data[0] != 0 or data[1] not in (0, 1):
        raise ValueError('no CDR message')
    big = data[1] == 0
    fixed = np.zeros(len(data), dtype=np.bool_)
    fixed[:2] = True
    order = '>' if big else '<'
    unpack = struct.Struct(f'{order}I').unpack_from

    def count(at: int) -> tuple[int, int]:
        """Return the number in the next aligned 4 bytes and the place after it."""
        at += -(at - _HEADER) % 4
        if at + 4 > len(data):
            raise ValueError('message ends early')
        fixed[at : at + 4] = True
        return unpack(data, at)[0], at + 4

    size, at = count(12)
    at += size
    number, at = count(at)
    if number > len(data):
        raise ValueError('more names than bytes')
    if number > limits.joints:
        raise TooManyNamesError(
            f'a message names {number} joints, more than the {limits.joints} allowed; record the '
            f'drives only, or raise {variable_of("joints")}'
        )
    names = []
    for _ in range(number):
        size, at = count(at)
        if at + size > len(data):
            raise ValueError('message ends early')
        if size > limits.name + 1:
            raise TooManyNamesError(
                f'a joint has a name of {size - 1} bytes, more than the {limits.name} allowed; '
                f'shorten it, or raise {variable_of("name")}'
            )
        fixed[at : at + size] = True
        names.append(data[at : at + size].rstrip(b'\0').decode())
        at += size
    spans: list[tuple[int, int] | None] = []
    for _ in range(3):
        number, at = count(at)
        if not number:
            spans.append(None)
            continue
        at += -(at - _HEADER) % 8
        if at + 8 * number > len(data):
            raise ValueError('message ends early')
        spans.append((at, at + 8 * number))
        at += 8 * number
    if len(data) - at > _PADDING:
        raise ValueError('message goes on after its end')
    return Layout(tuple(names), (spans[0], spans[1], spans[2]), fixed, big)


def decode(messages: Sequence[bytes], limits: Limits | None = None) -> list[Block]:
    """Decode serialised JointState messages.

    Args:
        messages: T messages of one topic, in order.
        limits: How many names each may have, and of what length.

    Returns:
        Blocks in the order of the messages: concatenated, their `rows` are 0..T-1.

    Raises:
        ValueError: A message is no JointState, or its arrays do not fit its names.
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
        for layout, chosen in _by_layout(messages, rows, table, limits):
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
    messages: Sequence[bytes],
    rows: IntArray,
    table: NDArray[np.uint8],
    limits: Limits | None,
) -> Iterator[tuple[Layout, IntArray]]:
    """Yield the layouts of messages of one size, each with the rows of the table that have it."""
    left = np.arange(rows.size)
    for _ in range(_ROUNDS):
        if not left.size:
            return
        layout = parse_layout(messages[int(rows[left[0]])], limits)
        same = (table[left][:, layout.fixed] == table[left[0], layout.fixed]).all(axis=1)
        yield layout, left[same]
        left = left[~same]
    # hardly two are alike: comparing each with all others would take for ever
    groups: dict[object, tuple[Layout, list[int]]] = {}
    for row in left.tolist():
        layout = parse_layout(messages[int(rows[row])], limits)
        key = layout.names, layout.spans, layout.big
        groups.setdefault(key, (layout, []))[1].append(row)
    for layout, chosen in groups.values():
        yield layout, np.array(chosen, dtype=np.int64)


def _block(layout: Layout, table: NDArray[np.uint8], rows: IntArray) -> Block:
    """Pick the numbers of messages that share a layout."""
    order = '>' if layout.big else '<'
    seconds = table[:, 4:8].copy().view(f'{order}i4')[:, 0].astype(np.int64)
    nanoseconds = table[:, 8:12].copy().view(f'{order}u4')[:, 0].astype(np.int64)
    fields: list[FloatArray | None] = []
    for span in layout.spans:
        if span is None:
            fields.append(None)
            continue
        values = table[:, span[0] : span[1]].copy().view(f'{order}f8').astype(np.float64)
        if values.shape[1] != len(layout.names):
            raise ValueError(f'{len(layout.names)} names but an array of {values.shape[1]} values')
        fields.append(values)
    if (nanoseconds >= 1_000_000_000).any():
        raise ValueError('a stamp of more nanoseconds than a second has')
    stamp = seconds * 1_000_000_000 + nanoseconds
    return Block(rows, stamp, layout.names, (fields[0], fields[1], fields[2]))


def encode(
    stamp: IntArray,
    names: Sequence[str],
    fields: Sequence[FloatArray | None],
    frame_id: str = '',
) -> list[bytes]:
    """Serialise T messages of the same joints.

    Args:
        stamp: Header stamps (T,), ns.
        names: The D joints.
        fields: Position, velocity, effort, each (T, D) or None for an empty array.
        frame_id: The header's frame.

    Returns:
        T messages, little-endian CDR with encapsulation.
    """
    head = bytearray(b'\x00\x01\x00\x00' + bytes(8))

    def text(value: str) -> None:
        head.extend(bytes(-(len(head) - _HEADER) % 4))
        raw = value.encode() + b'\0'
        head.extend(struct.pack('<I', len(raw)) + raw)

    text(frame_id)
    head.extend(bytes(-(len(head) - _HEADER) % 4))
    head.extend(struct.pack('<I', len(names)))
    for name in names:
        text(name)
    head.extend(bytes(-(len(head) - _HEADER) % 4))
    spans = []
    for values in fields:
        head.extend(struct.pack('<I', 0 if values is None else len(names)))
        if values is not None and len(names):
            head.extend(bytes(-(len(head) - _HEADER) % 8))
            spans.append((len(head), values))
            head.extend(bytes(8 * len(names)))
    table = np.tile(np.frombuffer(bytes(head), dtype=np.uint8), (stamp.size, 1))
    seconds, nanoseconds = np.divmod(np.asarray(stamp, dtype=np.int64), 1_000_000_000)
    table[:, 4:8] = seconds.astype('<i4').view(np.uint8).reshape(-1, 4)
    table[:, 8:12] = nanoseconds.astype('<u4').view(np.uint8).reshape(-1, 4)
    for begin, values in spans:
        raw = np.ascontiguousarray(values, dtype='<f8').view(np.uint8).reshape(stamp.size, -1)
        table[:, begin : begin + raw.shape[1]] = raw
    return [row.tobytes() for row in table]
