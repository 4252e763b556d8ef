# SPDX-License-Identifier: Apache-2.0
"""What the readers of the file formats fill: messages by topic, decoded piece by piece."""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.recording import cdr
from ros2_ident.recording.damage import Damage
from ros2_ident.recording.inflate import Budget, unpack_zstd, ZSTD
from ros2_ident.recording.limits import Limits, too_large
from ros2_ident.recording.streams import IntArray, LATEST_STAMP

JOINT_STATE = 'sensor_msgs/msg/JointState'
# Messages that are decoded at once; fewer would take longer.
_PIECE = 1 << 14
# Bytes of messages after which they are decoded, however few they are.
_HELD = 1 << 24

Decoded = tuple[IntArray, cdr.Block]


class Messages:
    """The messages of a topic in the order of log time, decoded piece by piece.

    A message as an object takes some hundred bytes; hours of them at 1 kHz would fill the memory.

    Attributes:
        count: Messages that came.
        lost: Those that are no valid JointState.
        blocks: What is decoded: log times, ns, and values.
        convert: Makes CDR bytes of a message; None where it is CDR.
    """

    def __init__(self, limits: Limits) -> None:
        self.count = 0
        self.lost = 0
        self.blocks: deque[Decoded] = deque()
        self.convert: Callable[[bytes], bytes] | None = None
        self._limits = limits
        self._fresh: list[tuple[int, bytes]] = []
        self._held = 0
        self._bytes = 0
        self._since = 0

    def append(self, log_time: int, data: bytes) -> None:
        """Take a message: log time [ns] and serialised bytes."""
        self.count += 1
        self._held += len(data)
        self._fresh.append((log_time, data))
        if len(self._fresh) >= _PIECE or self._held > _HELD:
            self.decode()

    def decode(self) -> None:
        """Decode what has come since the last time; what is no JointState is counted.

        Raises:
            IdentError: BAD_VALUES where the values take more memory than allowed.
        """
        fresh, self._fresh, self._held = self._fresh, [], 0
        if not fresh:
            return
        times = [x[0] for x in fresh]
        data = self._plain([x[1] for x in fresh])
        try:
            if max(times) >= LATEST_STAMP or min(times) <= -LATEST_STAMP:
                raise ValueError
            found = cdr.decode(data, self._limits)
        except cdr.TooManyNamesError as exc:
            raise IdentError(ErrorCode.BAD_VALUES, str(exc)) from None
        except (ValueError, IndexError):
            data, times = whole_messages(data, times, self._limits)
            self.lost += len(fresh) - len(data)
            found = cdr.decode(data, self._limits)
        clock = np.array(times, dtype=np.int64)
        for block in found:
            self._bytes += sum(x.nbytes for x in block.fields if x is not None)
            self.blocks.append((clock[block.rows], block))
        # the builder needs them twice while it puts them together
        if 3 * self._bytes > self._limits.memory:
            raise too_large(
                'the values of one topic take', 3 * self._bytes, self._limits.memory, 'memory'
            )

    def sort(self) -> None:
        """Bring what came since the last call into the order of log time, as it was recorded."""
        self.decode()
        new = [self.blocks.pop() for _ in range(len(self.blocks) - self._since)][::-1]
        clock = np.concatenate([x for x, _ in new]) if new else np.empty(0, dtype=np.int64)
        if (np.diff(clock) < 0).any():
            new = _sorted(new, np.argsort(clock, kind='stable'))
        self.blocks.extend(new)
        self._since = len(self.blocks)

    def __len__(self) -> int:
        return self.count

    def _plain(self, data: list[bytes]) -> list[bytes]:
        """Unpack messages that were compressed one by one; what cannot be becomes empty."""
        if any(x.startswith(ZSTD) for x in data):
            budget = Budget(sum(map(len, data)), self._limits)
            data = [_unpacked(x, budget) if x.startswith(ZSTD) else x for x in data]
        if self.convert is not None:
            data = [_converted(x, self.convert) for x in data]
        return data


def _unpacked(packed: bytes, budget: Budget) -> bytes:
    out = bytearray()
    try:
        for piece, whole in unpack_zstd(lambda: iter([packed])):
            budget.take(len(piece))
            out += piece
            if not whole or len(out) > budget.limits.chunk:
                return b''
    except Damage:
        return b''
    return bytes(out)


def _converted(data: bytes, convert: Callable[[bytes], bytes]) -> bytes:
    try:
        return convert(data)
    except Exception:  # generated code lets whatever damaged bytes cause through
        return b''


def _sorted(blocks: list[Decoded], order: IntArray) -> list[Decoded]:
    """Return blocks cut and put together anew in another order of their messages (T,)."""
    sizes = [clock.size for clock, _ in blocks]
    owner = np.repeat(np.arange(len(blocks)), sizes)[order]
    row = np.concatenate([np.arange(n) for n in sizes])[order]
    cuts = [0, *(np.flatnonzero(np.diff(owner)) + 1).tolist(), owner.size]
    out = []
    for begin, end in zip(cuts, cuts[1:], strict=False):
        clock, block = blocks[int(owner[begin])]
        out.append((clock[row[begin:end]], block.taken(row[begin:end])))
    return out


def whole_messages(
    data: list[bytes], log_times: list[int], limits: Limits
) -> tuple[list[bytes], list[int]]:
    """Return the messages that decode, one by one, and their log times.

    Args:
        data: CDR bytes.
        log_times: ns.
        limits: How many names each may have, and of what length.
    """
    kept: list[bytes] = []
    times: list[int] = []
    for message, log_time in zip(data, log_times, strict=True):
        try:
            (block,) = cdr.decode([message], limits)
        except (ValueError, IndexError):
            continue
        names = block.names
        if names and len(set(names)) == len(names) and abs(log_time) < LATEST_STAMP:
            kept.append(message)
            times.append(log_time)
    return kept, times


@dataclass
class Content:
    """What a bag holds.

    Attributes:
        wanted: Topics to read.
        limits: How much of it.
        messages: By topic, of those wanted that hold JointState.
        types: Message type of every topic of the bag.
        counts: Messages of every topic of the bag.
        warnings: What could not be read.
    """

    wanted: frozenset[str]
    limits: Limits = field(default_factory=Limits)
    messages: dict[str, Messages] = field(default_factory=dict)
    types: dict[str, str] = field(default_factory=dict)
    counts: dict[str, int] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)

    def open(self, topic: str, kind: str) -> Messages | None:
        """Note a topic and its type; return where its messages go, None where they are unwanted.

        Raises:
            Damage: There are more topics than any machine has.
        """
        if topic not in self.types:
            if len(self.types) >= 100 * self.limits.joints:
                raise Damage('it names more topics than are allowed')
            self.types[topic] = kind
        self.counts.setdefault(topic, 0)
        if topic not in self.wanted or kind != JOINT_STATE:
            return None
        self.types[topic] = kind
        return self.messages.setdefault(topic, Messages(self.limits))

    def sort(self) -> None:
        """Bring all messages since the last call into the order of log time."""
        for messages in self.messages.values():
            messages.sort()
