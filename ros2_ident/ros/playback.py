# SPDX-License-Identifier: Apache-2.0
"""The messages of a bag and the pace they come at; knows nothing of rclpy."""

from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass
import itertools
from pathlib import Path
import time

from rosbags.highlevel import AnyReader
from rosbags.typesys import get_typestore, Stores

from ros2_ident.errors import ErrorCode, IdentError

TYPE = 'sensor_msgs/msg/JointState'

# Messages read ahead, and how many of them in one go: reading must not make the next one late.
_AHEAD = 5000
_PIECE = 20
# A gap this long [ns] is used to read ahead.
_GAP = 300_000
# The longest sleep [s]: a signal is noticed after it.
_NAP = 0.05


@dataclass(frozen=True)
class Message:
    """One serialised message."""

    topic: str
    log_time: int
    data: bytes


class Bag:
    """The JointState topics of a bag, read as they are needed.

    Args:
        path: A bag directory or a single file.
        topics: Topics to take; all of the type where None.

    Attributes:
        topics: Topics and how many messages each has.
        skipped: Topics of other types.
        start: First log time, ns.
        duration: From the first to the last log time of the bag, s.

    Raises:
        IdentError: NO_DATA, MISSING_STREAM or DAMAGED_BAG.
    """

    def __init__(self, path: str | Path, topics: list[str] | None = None) -> None:
        path = Path(path).expanduser()
        if not path.exists():
            raise IdentError(
                ErrorCode.NO_DATA, f'{path}: does not exist; give a bag directory or an .mcap file'
            )
        try:
            self._reader = AnyReader([path], default_typestore=get_typestore(Stores.ROS2_JAZZY))
            self._reader.open()
        except Exception as exc:  # rosbags lets errors of its decoders through
            reason = ' '.join(str(exc).split()).rstrip('.') or type(exc).__name__
            raise IdentError(
                ErrorCode.DAMAGED_BAG,
                f'{path}: cannot be played ({reason}); try `mcap recover` or `ros2 bag reindex`',
            ) from None
        fitting = [x for x in self._reader.connections if x.msgtype == TYPE]
        self.skipped = sorted({x.topic for x in self._reader.connections if x.msgtype != TYPE})
        there = sorted({x.topic for x in fitting})
        if topics is not None:
            absent = [topic for topic in topics if topic not in there]
            if absent:
                raise IdentError(
                    ErrorCode.MISSING_STREAM,
                    f'{path}: has no JointState topic {", ".join(absent)}; '
                    f'it has {", ".join(there) or "none"}',
                )
            fitting = [x for x in fitting if x.topic in topics]
        self._connections = fitting
        self.topics: dict[str, int] = {}
        for connection in fitting:
            self.topics[connection.topic] = (
                self.topics.get(connection.topic, 0) + connection.msgcount
            )
        if not sum(self.topics.values()):
            raise IdentError(
                ErrorCode.NO_DATA,
                f'{path}: holds no message of type {TYPE}; '
                f'its other topics are {", ".join(self.skipped) or "none"}',
            )
        self.start = int(self._reader.start_time)
        self.duration = 1e-9 * (int(self._reader.end_time) - self.start)

    @property
    def count(self) -> int:
        """Messages that will be played."""
        return sum(self.topics.values())

    def messages(self) -> Iterator[Message]:
        """Yield the messages in the order of log time, in the CDR of ROS 2."""
        reader = self._reader
        for connection, log_time, data in reader.messages(connections=self._connections):
            raw = bytes(data)
            if not reader.is2:
                raw = bytes(reader.typestore.ros1_to_cdr(raw, TYPE))
            yield Message(connection.topic, int(log_time), raw)

    def close(self) -> None:
        """Close the files."""
        self._reader.close()


class Player:
    """Hands out messages at the recorded pace.

    Args:
        messages: In the order of log time.
        publish: Takes a message when it is due.
        rate: Times faster than recorded.
        stopped: Whether to end now.
        on_round: Called with the log time now, ns, between the messages; has to be quick.
    """

    def __init__(
        self,
        messages: Iterator[Message],
        publish: Callable[[Message], None],
        *,
        rate: float = 1.0,
        stopped: Callable[[], bool] = lambda: False,
        on_round: Callable[[int], None] = lambda log_time: None,
    ) -> None:
        self._messages = messages
        self._ahead: deque[Message] = deque()
        self._publish = publish
        self._rate = rate
        self._stopped = stopped
        self._on_round = on_round
        self.count = 0

    def play(self) -> bool:
        """Play to the end; return whether it was reached."""
        self._read(_AHEAD)
        if not self._ahead:
            return True
        first = self._ahead[0].log_time
        start = time.monotonic_ns()
        while self._ahead:
            if self._stopped():
                return False
            now = time.monotonic_ns()
            due = start + round((self._ahead[0].log_time - first) / self._rate)
            if due > now:
                self._on_round(first + round((now - start) * self._rate))
                if due - now > _GAP and len(self._ahead) < _AHEAD:
                    self._read(_PIECE)
                left = (due - time.monotonic_ns()) * 1e-9
                if left > 0.0:
                    time.sleep(min(left, _NAP))
                continue
            self._publish(self._ahead.popleft())
            self.count += 1
            if not self._ahead:
                self._read(_PIECE)
        return True

    def _read(self, count: int) -> None:
        self._ahead.extend(itertools.islice(self._messages, count))
