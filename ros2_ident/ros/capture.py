# SPDX-License-Identifier: Apache-2.0
"""What the node hears: three topics into one RecordingBuilder, as a bag would be read.

Messages are taken as bytes and decoded some hundred at a time, with the decoder that reads bags:
a callback then costs a few microseconds, whatever the number of joints, and holds the interpreter
for as long. All methods belong to the executor's thread; `snapshot` hands a copy to another one.
"""

from collections.abc import Callable
import copy
import time
from typing import Any

import numpy as np
from rclpy.node import Node
from rclpy.qos import (
    HistoryPolicy,
    qos_check_compatible,
    QoSCompatibility,
    QoSProfile,
    ReliabilityPolicy,
)
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.subscription import Subscription
from sensor_msgs.msg import JointState

from ros2_ident.errors import IdentError
from ros2_ident.recording import cdr, RecordingBuilder
from ros2_ident.ros.meter import StreamMeter

TOPICS = {'state': 'joint_states', 'effort': 'effort', 'command': 'joint_command'}
TYPE = 'sensor_msgs/msg/JointState'

# Best effort matches every publisher; a shallow queue loses messages while the search runs.
QOS = QoSProfile(
    depth=1000, history=HistoryPolicy.KEEP_LAST, reliability=ReliabilityPolicy.BEST_EFFORT
)
_BATCH = 128


class _Inbox:
    """Messages of one role that are not decoded yet."""

    def __init__(self) -> None:
        self.data: list[bytes] = []
        self.sent: list[int] = []
        self.latency: list[int] = []
        self.meter = StreamMeter()


class Capture:
    """Subscriptions that fill a buffer.

    Args:
        node: Whose topics.
        limit: Messages kept of each stream.
        keep_streams: Whether a new stream is added to the ended one instead of replacing it.
        clock: Seconds that never step back.
    """

    def __init__(
        self,
        node: Node,
        *,
        limit: int,
        keep_streams: bool = False,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.limit = limit
        self.on_latency: Callable[[int], None] | None = None  # for measurements, ns
        self.keep_streams = keep_streams
        self._node = node
        self._clock = clock
        self._builder = RecordingBuilder('live')
        self._inbox = {role: _Inbox() for role in TOPICS}
        self._arrived: float | None = None
        self._ended = False
        self._subscriptions = {role: self._subscribe(role, name) for role, name in TOPICS.items()}

    def _subscribe(self, role: str, topic: str) -> Subscription:
        inbox = self._inbox[role]

        def take(data: bytes, info: dict[str, int]) -> None:
            if self._ended:
                self._begin_again()
            now = time.time_ns()
            sent = info['source_timestamp'] or now
            inbox.data.append(data)
            inbox.sent.append(sent)
            inbox.latency.append(now - sent)
            if self.on_latency is not None:
                self.on_latency(now - sent)
            self._arrived = self._clock()
            if len(inbox.data) >= _BATCH:
                self._decode(role)

        return self._node.create_subscription(
            JointState,
            topic,
            take,
            QOS,
            raw=True,
            qos_overriding_options=QoSOverridingOptions.with_default_policies(),
        )

    # ------------------------------------------------------------------ what came

    @property
    def topics(self) -> dict[str, str]:
        """Resolved topic names by role."""
        return {role: sub.topic_name for role, sub in self._subscriptions.items()}

    @property
    def meters(self) -> dict[str, StreamMeter]:
        """How each stream arrived, as far as it is decoded."""
        return {role: inbox.meter for role, inbox in self._inbox.items()}

    @property
    def empty(self) -> bool:
        """Whether nothing has arrived since the last `clear`."""
        return self._arrived is None

    @property
    def ended(self) -> bool:
        """Whether the stream has ended and the next message begins a new one."""
        return self._ended

    @property
    def idle(self) -> float:
        """Seconds since the last message; infinite before the first."""
        return float('inf') if self._arrived is None else self._clock() - self._arrived

    def end(self) -> None:
        """Take the stream as ended."""
        self.flush()
        self._ended = True

    def clear(self) -> None:
        """Forget everything received."""
        self._builder.clear()
        for inbox in self._inbox.values():
            inbox.data.clear()
            inbox.sent.clear()
            inbox.latency.clear()
            inbox.meter = StreamMeter()
        self._arrived = None
        self._ended = False

    def _begin_again(self) -> None:
        if self.keep_streams:
            self._ended = False
        else:
            self.clear()
            self._node.get_logger().info(
                'a new stream begins; the data of the one before is replaced (see keep_streams)'
            )

    def snapshot(self) -> RecordingBuilder:
        """Return a copy of all that was received; another thread may build it."""
        self.flush()
        return copy.deepcopy(self._builder)

    # ------------------------------------------------------------------ decoding

    def flush(self) -> None:
        """Decode what is waiting."""
        for role in self._inbox:
            self._decode(role)

    def _decode(self, role: str) -> None:
        inbox = self._inbox[role]
        if not inbox.data:
            return
        data, sent = inbox.data, inbox.sent
        inbox.meter.add_latency(inbox.latency)
        inbox.data, inbox.sent, inbox.latency = [], [], []
        room = self.limit - self._builder.counts[role]
        if len(data) > room:
            self._say_full(role, inbox.meter)
            inbox.meter.dropped += len(data) - room
            data, sent = data[:room], sent[:room]
        try:
            self._feed(role, data, sent)
        except (ValueError, IndexError, IdentError):
            # one of them is no proper JointState: take the others one by one
            for one, at in zip(data, sent, strict=True):
                try:
                    self._feed(role, [one], [at])
                except (ValueError, IndexError, IdentError) as error:
                    self._say_malformed(role, inbox.meter, error)

    def _feed(self, role: str, data: list[bytes], sent: list[int]) -> None:
        meter = self._inbox[role].meter
        for block in cdr.decode(data):
            stamp = block.stamp
            if not stamp.any():
                stamp = np.array([sent[i] for i in block.rows.tolist()], dtype=np.int64)
                self._builder.warn(
                    f'{self.topics[role]}: header stamps are 0, the time of publishing is used; '
                    'stamp the messages'
                )
            before = meter.backward
            self._builder.add_block(role, stamp, block.names, *block.fields)
            meter.add(stamp)
            if meter.backward > before:
                self._node.get_logger().info(
                    f'{self.topics[role]}: stamps stepped back, a new segment begins'
                )

    def _say_full(self, role: str, meter: StreamMeter) -> None:
        if meter.dropped:
            return
        text = (
            f'{self.topics[role]}: the buffer holds {self.limit} messages and takes no more; '
            'call ~/clear_data or raise buffer_messages'
        )
        self._builder.warn(text)
        self._node.get_logger().warning(text)

    def _say_malformed(self, role: str, meter: StreamMeter, error: Exception) -> None:
        meter.malformed += 1
        if meter.malformed == 1:
            text = (
                f'{self.topics[role]}: messages are left out because they are no proper {TYPE} '
                f'({error}); repair the publisher'
            )
            self._builder.warn(text)
            self._node.get_logger().warning(text)

    # ------------------------------------------------------------------ silence

    def silence(self) -> str:
        """Return why nothing may have arrived, topic by topic."""
        parts = [self._silence(sub) for sub in self._subscriptions.values()]
        return f'no data yet: {"; ".join(parts)}'

    def _silence(self, subscription: Subscription) -> str:
        topic = subscription.topic_name
        publishers: list[Any] = self._node.get_publishers_info_by_topic(topic)
        if not publishers:
            return f'{topic} has 0 publishers'
        wrong = sorted({x.topic_type for x in publishers if x.topic_type != TYPE})
        if wrong:
            return f'{topic} has a publisher of the wrong type {", ".join(wrong)}, expected {TYPE}'
        for publisher in publishers:
            fits, reason = qos_check_compatible(publisher.qos_profile, subscription.qos_profile)
            if fits == QoSCompatibility.ERROR:
                return (
                    f'{topic} has a publisher of incompatible QoS '
                    f'({reason.strip().rstrip(";.")}), '
                    f'see qos_overrides.{topic}.subscription'
                )
        return f'{topic} has {len(publishers)} publishers and none has sent'
