# SPDX-License-Identifier: Apache-2.0
"""Topics of the node: three into one RecordingBuilder, as a bag would be; how they arrive.

A topic is first subscribed as JointState. Where another type is published that holds the same, as
those of ros2_control, the subscription is made anew for that type.

Messages are taken as bytes and decoded some hundred at a time, with the decoder that reads bags:
a callback then costs a few microseconds, whatever the number of joints, and holds the interpreter
for as long. All methods belong to the executor's thread; `snapshot` hands a copy to another one.
"""

from collections.abc import Callable, Sequence
from importlib import import_module
import math
import time
from typing import Any

import numpy as np
from numpy.typing import NDArray
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
from ros2_ident.recording import cdr, LIVE, Recording, RecordingBuilder
from ros2_ident.recording.content import (
    messages_of,
    set_points,
    Trajectories,
    Trajectory,
    why,
)
from ros2_ident.recording.maps import JOINT_STATE, kinds, map_of, nameless, parser, roles_of
from ros2_ident.recording.write import Spool

TOPICS = {'state': 'joint_states', 'effort': 'effort', 'command': 'joint_command'}

# Best effort matches every publisher; a shallow queue loses messages while the search runs.
QOS = QoSProfile(
    depth=1000, history=HistoryPolicy.KEEP_LAST, reliability=ReliabilityPolicy.BEST_EFFORT
)
_BATCH = 128


class _Inbox:
    """Messages of one role that are not decoded yet, and trajectories, which never are."""

    def __init__(self) -> None:
        self.kind = JOINT_STATE
        self.problem = ''  # why what is published cannot be subscribed
        self.trajectories: list[Trajectory] = []
        self.clear()

    def clear(self) -> None:
        self.trajectories.clear()
        self.data: list[bytes] = []
        self.sent: list[int] = []
        self.meter = StreamMeter()

    @property
    def heard(self) -> bool:
        return bool(self.data or self.meter.received)


class Capture:
    """Subscriptions that fill a buffer.

    Args:
        keep_streams: Whether a new stream is added to the ended one instead of replacing it.
        names: What the numbers of a Float64MultiArray are: joints, or `joint/velocity`.
        spool: Where what arrives is written as well.
        clock: Seconds that never step back.

    Attributes:
        ended: Whether the stream has ended and the next message begins a new one.
    """

    def __init__(
        self,
        node: Node,
        *,
        limit: int,
        keep_streams: bool = False,
        names: Sequence[str] = (),
        spool: Spool | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.limit = limit
        self.on_latency: Callable[[int], None] | None = None  # for measurements, ns
        self.keep_streams = keep_streams
        self.names = tuple(names)
        self.spool = spool
        self._spool_problem = ''
        self._node = node
        self._clock = clock
        self._builder = RecordingBuilder(LIVE)
        self._inbox = {role: _Inbox() for role in TOPICS}
        self._arrived: float | None = None
        self.ended = False
        self._subscriptions = {role: self._subscribe(role, JointState) for role in TOPICS}

    def adapt(self) -> None:
        """Subscribe silent topics by the type that is published there, where it can be read."""
        for role, inbox in self._inbox.items():
            if inbox.heard:
                continue
            topic = self._subscriptions[role].topic_name
            sent = {x.topic_type for x in self._node.get_publishers_info_by_topic(topic)}
            kind = next((x for x in kinds() if x in sent and role in roles_of(x)), inbox.kind)
            if kind != inbox.kind:
                self._adapt(role, topic, kind)

    def _adapt(self, role: str, topic: str, kind: str) -> None:
        inbox = self._inbox[role]
        package, _, name = kind.partition('/msg/')
        if nameless(kind, role) and not self.names:
            inbox.problem = (
                f'{topic} is an array without names, set joint_names to the joints in its order'
            )
            return
        try:
            message = getattr(import_module(f'{package}.msg'), name)
        except (ModuleNotFoundError, AttributeError):
            inbox.problem = (
                f'{topic} is of type {kind}, and {package} is not installed (Ubuntu: apt install '
                f'ros-jazzy-{package.replace("_", "-")})'
            )
            return
        inbox.kind, inbox.problem = kind, ''
        self._node.destroy_subscription(self._subscriptions[role])
        self._subscriptions[role] = self._subscribe(role, message)
        self._node.get_logger().info(f'{topic} is read as {kind}')

    def _subscribe(self, role: str, kind: Any) -> Subscription:
        inbox = self._inbox[role]
        clock = self._node.get_clock()

        def take(data: bytes, info: dict[str, int]) -> None:
            if self.ended:
                self._begin_again(role, data)
            elif self._arrived is None and self.spool is not None:
                self.spool.clear()  # it holds what a node before this one has heard
            now = time.time_ns()
            sent = info['source_timestamp'] or now
            inbox.data.append(data)
            # what has no stamp has come at the time that the others are stamped by
            inbox.sent.append(clock.now().nanoseconds if clock.ros_time_is_active else sent)
            if self.on_latency is not None:
                self.on_latency(now - sent)
            self._arrived = self._clock()
            if len(inbox.data) >= _BATCH:
                self._decode(role)

        def hear(data: bytes, info: dict[str, int]) -> None:
            take(data, info)
            _take_waiting(subscription, take)

        subscription = self._node.create_subscription(
            kind,
            TOPICS[role],
            hear,
            QOS,
            raw=True,
            qos_overriding_options=QoSOverridingOptions.with_default_policies(),
        )
        return subscription

    # ------------------------------------------------------------------ what came

    @property
    def topics(self) -> dict[str, str]:
        """Resolved topic names by role."""
        return {role: sub.topic_name for role, sub in self._subscriptions.items()}

    @property
    def meters(self) -> 'dict[str, StreamMeter]':
        """How each stream arrived, as far as it is decoded."""
        return {role: inbox.meter for role, inbox in self._inbox.items()}

    @property
    def received(self) -> int:
        """Messages of all streams, as far as they are decoded."""
        return sum(meter.received for meter in self.meters.values())

    @property
    def empty(self) -> bool:
        """Whether nothing has arrived since the last `clear`."""
        return self._arrived is None

    @property
    def idle(self) -> float:
        """Seconds since the last message; infinite before the first."""
        return float('inf') if self._arrived is None else self._clock() - self._arrived

    def close(self) -> None:
        """Bring what has come to the spool, and end it."""
        self.flush()
        if self.spool is not None:
            self.spool.close()
            self.spool = None

    def end(self) -> None:
        """Take the stream as ended."""
        self.flush()
        self.ended = True

    def clear(self) -> None:
        """Forget everything received."""
        self._builder.clear()
        for inbox in self._inbox.values():
            inbox.clear()
        if self.spool is not None:
            self.spool.clear()
        self._arrived = None
        self.ended = False

    def restore(self, recordings: Sequence[Recording]) -> None:
        """Hold what was heard before a restart, as a stream that has ended."""
        for recording in recordings:
            for role, stream in recording.streams.items():
                self._builder.add_block(role, stream.stamp, stream.names, **stream.fields)
                self._inbox[role].meter.add(stream.stamp)
        self._arrived = self._clock()
        self.ended = True

    def _goes_on(self, role: str, data: bytes) -> bool:
        """Whether a message continues the stream after a pause.

        Its stamp is then hardly later than the last one, however long the silence was.
        """
        inbox = self._inbox[role]
        about = map_of(inbox.kind)
        if inbox.meter.last is None or about is None or about.clock != 'stamp':
            return False
        try:
            (block,) = cdr.decode([data], parser(about, role, self.names))
        except (ValueError, IndexError, IdentError):
            return False
        return 0 < int(block.stamp[0]) - inbox.meter.last < 0.5e9 * self.idle

    def _begin_again(self, role: str, data: bytes) -> None:
        if self.keep_streams:
            self.ended = False
        elif self._goes_on(role, data):
            self.ended = False
            self._node.get_logger().info('the stream goes on where it paused; it is one')
        else:
            self.clear()
            self._node.get_logger().info(
                'a new stream begins; the data of the one before is replaced (see keep_streams)'
            )

    def snapshot(self) -> RecordingBuilder:
        """Return a copy of all that was received; another thread may build it."""
        self.flush()
        builder = self._builder.copied()
        for role, inbox in self._inbox.items():
            for block in set_points(inbox.trajectories):
                builder.add_block(role, block.stamp, block.names, *block.fields)
        return builder

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
        inbox.data, inbox.sent = [], []
        room = self.limit - inbox.meter.received
        if len(data) > room:
            if not inbox.meter.dropped:
                self._warn(
                    role,
                    f'the buffer holds {self.limit} messages and takes no more; '
                    'call ~/clear_data or raise buffer_messages',
                )
            inbox.meter.dropped += len(data) - room
            data, sent = data[:room], sent[:room]
        self._write(role, data, sent)
        messages = messages_of(map_of(inbox.kind), role, self.names)
        if messages.clock == 'counter':  # set by all log times together, which are still to come
            messages.clock = 'none'
        reason = why(inbox.kind, role)
        try:
            messages.take(sent, data)
            messages.decode()
            for block in messages.blocks:
                self._add(role, block)
        except IdentError as error:
            messages.lost, reason = len(data), error.message
        if messages.unstamped:
            said = 'header stamps are 0, the time of publishing is used; stamp the messages'
            if messages.clock == 'none':
                said = f'{inbox.kind} has no stamp, the time of publishing is used'
            self._builder.warn(f'{self.topics[role]}: {said}')
        if isinstance(messages, Trajectories):
            inbox.trajectories += [x for _, x in messages.sent]
            inbox.meter.received += len(messages.sent)
        if messages.lost and not inbox.meter.malformed:
            what = f'messages are left out because they are no proper {inbox.kind} ({reason})'
            self._warn(role, f'{what}; repair the publisher')
        inbox.meter.malformed += messages.lost

    def _write(self, role: str, data: list[bytes], sent: list[int]) -> None:
        """Write messages to the spool, unless another role's subscription of the topic does."""
        topics = list(self.topics.values())
        if self.spool is None or topics.index(self.topics[role]) != list(TOPICS).index(role):
            return
        self.spool.add(self.topics[role], self._inbox[role].kind, sent, data)
        if self.spool.problem != self._spool_problem:
            self._spool_problem = self.spool.problem
            if self._spool_problem:
                self._node.get_logger().warning(self._spool_problem)

    def _add(self, role: str, block: cdr.Block) -> None:
        meter = self._inbox[role].meter
        before = meter.backward
        self._builder.add_block(role, block.stamp, block.names, *block.fields)
        meter.add(block.stamp)
        if meter.backward > before:
            self._node.get_logger().info(
                f'{self.topics[role]}: stamps stepped back, a new segment begins'
            )

    def _warn(self, role: str, text: str) -> None:
        self._builder.warn(f'{self.topics[role]}: {text}')
        self._node.get_logger().warning(f'{self.topics[role]}: {text}')

    # ------------------------------------------------------------------ silence

    def silence(self) -> str:
        """Return why nothing may have arrived, topic by topic."""
        parts = [
            self._inbox[role].problem or self._silence(self._inbox[role].kind, subscription)
            for role, subscription in self._subscriptions.items()
        ]
        return f'no data yet: {"; ".join(parts)}'

    def _silence(self, kind: str, subscription: Subscription) -> str:
        topic = subscription.topic_name
        publishers: list[Any] = self._node.get_publishers_info_by_topic(topic)
        if not publishers:
            return f'{topic} has 0 publishers'
        wrong = sorted({x.topic_type for x in publishers if x.topic_type != kind})
        if wrong:
            return f'{topic} has a publisher of the wrong type {", ".join(wrong)}, expected {kind}'
        for publisher in publishers:
            fits, reason = qos_check_compatible(publisher.qos_profile, subscription.qos_profile)
            if fits == QoSCompatibility.ERROR:
                return (
                    f'{topic} has a publisher of incompatible QoS '
                    f'({reason.strip().rstrip(";.")}), '
                    f'see qos_overrides.{topic}.subscription'
                )
        return f'{topic} has {len(publishers)} publishers and none has sent'


def _take_waiting(
    subscription: Subscription, take: Callable[[bytes, dict[str, int]], None]
) -> None:
    """Take what waits in the queue, too: a round of the executor costs many times a message."""
    handle = subscription.handle
    with handle:
        for _ in range(_BATCH):  # then the other topics have their turn
            found = handle.take_message(subscription.msg_type, True)
            if found is None:
                return
            take(*found)


# Fewer intervals than this say nothing about the period.
_ENOUGH = 20


class StreamMeter:
    """Counts one stream. Numbers come from the header stamps, never from the time of arrival."""

    def __init__(self) -> None:
        self.received = 0
        self.missing = 0
        self.backward = 0
        self.malformed = 0
        self.dropped = 0
        self.last: int | None = None
        self._period = math.nan

    @property
    def rate(self) -> float:
        """Samples per second, Hz; NaN while unknown."""
        return 1e9 / self._period

    @property
    def missing_fraction(self) -> float:
        """Samples missing over those expected; NaN while unknown."""
        if math.isnan(self._period):
            return math.nan
        return self.missing / max(1, self.missing + self.received)

    def add(self, stamps: NDArray[np.int64]) -> None:
        """Count the stamps (T,) [ns] of messages in the order of arrival."""
        self.received += len(stamps)
        if self.last is not None:
            stamps = np.concatenate(([self.last], stamps))
        if not len(stamps):
            return
        self.last = int(stamps[-1])
        steps = np.diff(stamps)
        self.backward += int((steps < 0).sum())
        # joints that publish one by one share a stamp
        forward = steps[steps > 0]
        if len(forward) >= _ENOUGH or (math.isnan(self._period) and len(forward)):
            self._period = float(np.median(forward))
        if len(forward):
            self.missing += int(np.maximum(np.rint(forward / self._period) - 1, 0).sum())
