# SPDX-License-Identifier: Apache-2.0
"""Content of a bag: messages by topic, decoded piece by piece."""

from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ros2_ident.recording import cdr
from ros2_ident.recording.limits import limit, require_memory
from ros2_ident.recording.ros2_control import (
    ARRAY,
    offers,
    parse_trajectory,
    parser,
    ROLES_OF,
    set_points,
    TRAJECTORY,
    Trajectory,
)
from ros2_ident.recording.storage import Budget, Damage, inflate, ZSTD
from ros2_ident.recording.streams import LATEST_STAMP

# Bytes of messages that are decoded at once; fewer would take longer.
_HELD = 1 << 22
# Messages of a topic that is not read, which show what could be read there.
_SHOWN = 10

# What a message of a kind has to be.
WHY = {
    cdr.JOINT_STATE: 'arrays have to be empty or as long as the names',
    ARRAY: 'it has to hold a number for each of the joint names given',
}
OTHERWISE = 'a value for each joint, and times that increase'
# Takes messages of a topic: log times, ns, and serialised bytes.
Sink = Callable[[Sequence[int], Sequence[bytes]], None]


class Messages:
    """The messages of a topic in the order of the file, decoded piece by piece.

    A message as an object takes some hundred bytes; hours of them at 1 kHz would fill the memory.

    Args:
        parse: Finds the values in a message; those of a JointState by default.

    Attributes:
        count: Messages that came.
        lost: Those that are no valid ones of their type.
        blocks: What is decoded, with log times as stamps of those that have none.
        unstamped: Whether there are such.
    """

    def __init__(self, parse: cdr.Parse = cdr.parse_layout) -> None:
        self.count = 0
        self.lost = 0
        self.blocks: deque[cdr.Block] = deque()
        self.unstamped = False
        self._parse = parse
        self._times: list[int] = []
        self._data: list[bytes] = []
        self._held = 0
        self._bytes = 0

    def take(self, times: Sequence[int], data: Sequence[bytes]) -> None:
        """Take messages: log times [ns] and serialised bytes."""
        self.count += len(data)
        self._held += sum(map(len, data))
        self._times += times
        self._data += data
        if self._held > _HELD:
            self.decode()

    def _fresh(self) -> tuple[list[int], list[bytes]]:
        """Return what has come since the last time; what cannot be unpacked is empty."""
        times, data = self._times, self._data
        self._times, self._data, self._held = [], [], 0
        if any(x.startswith(ZSTD) for x in data[:_SHOWN]):  # compressed one by one
            budget = Budget(sum(map(len, data)))
            data = [_unpacked(x, budget) if x.startswith(ZSTD) else x for x in data]
        return times, data

    def decode(self) -> None:
        """Decode what has come since the last time; what is no such message is counted.

        Raises:
            IdentError: BAD_VALUES where the values take more memory than allowed.
        """
        times, data = self._fresh()
        if not data:
            return
        try:
            if max(times) >= LATEST_STAMP or min(times) <= -LATEST_STAMP:
                raise ValueError
            found = cdr.decode(data, self._parse)
        except (ValueError, IndexError):
            whole = [pair for pair in zip(times, data, strict=True) if self._is_whole(*pair)]
            self.lost += len(data) - len(whole)
            times = [x[0] for x in whole]
            found = cdr.decode([x[1] for x in whole], self._parse)
        clock = np.array(times, dtype=np.int64)
        for block in found:
            self._bytes += sum(x.nbytes for x in block.fields if x is not None)
            if not block.stamp.any():
                block, self.unstamped = replace(block, stamp=clock[block.rows]), True
            self.blocks.append(block)
        # the builder needs them twice while it puts them together
        require_memory('the values of one topic take', 3 * self._bytes)

    def _is_whole(self, log_time: int, message: bytes) -> bool:
        """Say whether a message decodes by itself."""
        try:
            (block,) = cdr.decode([message], self._parse)
        except (ValueError, IndexError):
            return False
        names = block.names
        return bool(names) and len(set(names)) == len(names) and abs(log_time) < LATEST_STAMP

    def finish(self) -> None:
        """Bring the last messages, and what is only known with them, into the blocks."""
        self.decode()


class Trajectories(Messages):
    """The trajectories sent on a topic; their blocks are the set-point that follows them."""

    def __init__(self) -> None:
        super().__init__()
        self.sent: list[tuple[int, Trajectory]] = []

    def decode(self) -> None:
        """Decode what has come since the last time."""
        for when, data in zip(*self._fresh(), strict=True):
            try:
                self.sent.append((when, parse_trajectory(data, when)))
            except ValueError:
                self.lost += 1

    def finish(self) -> None:
        """Follow the trajectories in the order in which they came."""
        self.decode()
        self.blocks += set_points([x for _, x in sorted(self.sent, key=lambda pair: pair[0])])
        self.sent = []


def messages_of(kind: str, role: str, names: Sequence[str]) -> Messages:
    """Return what decodes a role's messages of a kind; see `ros2_control.parser`."""
    return Trajectories() if kind == TRAJECTORY else Messages(parser(kind, role, names))


def _unpacked(packed: bytes, budget: Budget) -> bytes:
    raw, sound = inflate('zstd', packed, budget.chunk)
    try:
        budget.take(len(raw))
    except Damage:
        return b''
    return raw if sound else b''


@dataclass
class Content:
    """Content of a bag.

    Attributes:
        wanted: Roles of each topic to read.
        names: What the numbers of arrays are; see `ros2_control.parser`.
        messages: By topic and role, of those wanted that can be read.
        types: Message type of every topic of the bag.
        counts: Messages of every topic of the bag.
        warnings: What could not be read.
    """

    wanted: Mapping[str, tuple[str, ...]]
    names: tuple[str, ...] = ()
    messages: dict[tuple[str, str], Messages] = field(default_factory=dict)
    types: dict[str, str] = field(default_factory=dict)
    counts: dict[str, int] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)
    _first: dict[str, list[bytes]] = field(default_factory=dict)

    def open(self, topic: str, kind: str) -> Sink | None:
        """Note a topic and its type; return where its messages go, None where they are unwanted.

        Raises:
            Damage: There are more topics than any machine has.
        """
        if topic not in self.types:
            if len(self.types) >= 100 * limit('joints'):
                raise Damage('it names more topics than are allowed')
            self.types[topic] = kind
        self.counts.setdefault(topic, 0)
        if kind not in ROLES_OF:
            return None
        roles = [role for role in self.wanted.get(topic, ()) if role in ROLES_OF[kind]]
        if not roles:
            first = self._first.setdefault(topic, [])

            def show(times: Sequence[int], data: Sequence[bytes]) -> None:
                if len(first) < _SHOWN:
                    first.extend(x for x in data[:_SHOWN] if not x.startswith(ZSTD))

            return show
        self.types[topic] = kind
        sinks = []
        for role in roles:
            new = messages_of(kind, role, self.names)
            sinks.append(self.messages.setdefault((topic, role), new).take)

        def fan(times: Sequence[int], data: Sequence[bytes]) -> None:
            for sink in sinks:
                sink(times, data)

        return fan

    def offered(self) -> Iterator[tuple[str, str, tuple[str, ...]]]:
        """Yield topic, type and possible roles of what could be read and is not wanted."""
        for topic, first in sorted(self._first.items()):
            kind = self.types[topic]
            found = {x for data in first for x in offers(kind, data)}
            yield topic, kind, tuple(x for x in ROLES_OF[kind] if x in found)

