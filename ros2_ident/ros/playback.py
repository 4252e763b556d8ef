# SPDX-License-Identifier: Apache-2.0
"""The messages of a bag and the pace they come at; knows nothing of rclpy."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
import time

from rosbags.highlevel import AnyReader
from rosbags.typesys import get_typestore, Stores

from ros2_ident.errors import ErrorCode, IdentError

TYPE = 'sensor_msgs/msg/JointState'

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


def play(
    messages: Iterable[Message],
    publish: Callable[[Message], None],
    *,
    rate: float = 1.0,
    stopped: Callable[[], bool] = lambda: False,
    between: Callable[[int], None] = lambda log_time: None,
) -> bool:
    """Hand out messages at the recorded pace; return whether the end was reached.

    Args:
        messages: In the order of log time.
        publish: Takes a message when it is due.
        rate: Times faster than recorded.
        stopped: Whether to end now.
        between: Called with the log time now, ns, between the messages; has to be quick.
    """
    first, start = None, time.monotonic_ns()
    for message in messages:
        if first is None:
            first, start = message.log_time, time.monotonic_ns()
        due = start + round((message.log_time - first) / rate)
        while not stopped() and (now := time.monotonic_ns()) < due:
            between(first + round((now - start) * rate))
            time.sleep(min((due - now) * 1e-9, _NAP))
        if stopped():
            return False
        publish(message)
    return True
