# SPDX-License-Identifier: Apache-2.0
"""What is heard is what a bag would hold."""

import math

import numpy as np
import pytest
from reader_cases import equal
from ros_helpers import ended, MACHINE, new_domain, program, RELIABLE, short_bag, Station

pytest.importorskip('ros2_ident_msgs', reason='run `make test`, or source env.sh first')

from builtin_interfaces.msg import Duration  # noqa: E402
from rclpy.node import Node  # noqa: E402
from rclpy.parameter import Parameter  # noqa: E402
from rclpy.qos import QoSProfile, ReliabilityPolicy  # noqa: E402
from sensor_msgs.msg import JointState  # noqa: E402
from std_msgs.msg import Float64MultiArray  # noqa: E402

from ros2_ident.errors import IdentError  # noqa: E402
from ros2_ident.identify.data import gather  # noqa: E402
from ros2_ident.models import load_machine  # noqa: E402
from ros2_ident.recording import read_bag  # noqa: E402
from ros2_ident.ros.capture import Capture  # noqa: E402

pytestmark = pytest.mark.ros


class Ear(Station):
    """A bare node with a Capture."""

    def __init__(self, domain: int, **options) -> None:
        self.now = 0.0

        def make(context):
            node = Node(
                'ear',
                context=context,
                parameter_overrides=[Parameter(x, value=y) for x, y in RELIABLE.items()],
            )
            self.capture = Capture(node, **{'limit': 100_000, 'clock': lambda: self.now} | options)
            return node

        super().__init__(make, domain)

    def received(self) -> int:
        return sum(
            len(inbox.data) + inbox.meter.received + inbox.meter.malformed + inbox.meter.dropped
            for inbox in self.capture._inbox.values()
        )


class Mouth:
    """Publishes into an Ear, from the same process."""

    def __init__(self, ear: Ear) -> None:
        self.ear = ear
        self.sent = 0
        self.publishers = {
            topic: ear.node.create_publisher(JointState, topic, 1000)
            for topic in ('joint_states', 'effort', 'joint_command')
        }
        ear.until(
            lambda: all(p.get_subscription_count() for p in self.publishers.values()), 'a match'
        )

    def say(self, stamp: float, names, topic: str = 'joint_states', **fields) -> None:
        message = JointState(name=list(names), **fields)
        ns = round(stamp * 1e9)
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(ns, 1_000_000_000)
        self.publish(message, topic)

    def publish(self, message, topic: str = 'joint_states') -> None:
        self.publishers[topic].publish(message)
        self.sent += 1
        self.ear.until(lambda: self.ear.received() >= self.sent, 'the message')


@pytest.fixture
def ear():
    made = []

    def make(**options) -> Ear:
        made.append(Ear(new_domain(), **options))
        return made[-1]

    yield make
    for one in made:
        one.close()


def test_a_replayed_bag_gives_the_same_data_set_as_the_bag_read_directly(tmp_path) -> None:
    bag, count = short_bag(tmp_path)
    domain = new_domain()
    ear = Ear(domain)
    try:
        with program(
            'replay', str(bag), '--rate', '2', '--wait-for-subscribers', '60', domain=domain
        ) as replay:
            assert ended(replay)[0] == 0
        direct = read_bag(bag)
        ear.until(lambda: ear.received() == count, f'{count} messages')
        heard = ear.capture.snapshot().build()
    finally:
        ear.close()
    assert len(heard) == 1 and equal(heard, direct)
    machine = load_machine(MACHINE)
    one, two = (gather(x, machine).datasets[0] for x in (heard, direct))
    for name in ('command_position', 'command_velocity', 'position', 'velocity', 'effort'):
        assert np.array_equal(getattr(one, name), getattr(two, name), equal_nan=True)
    assert (one.start, one.cycle, one.names) == (two.start, two.cycle, two.names)
    assert (one.streams, one.warnings) == (two.streams, two.warnings)


def test_missing_samples_are_counted(ear) -> None:
    mouth = Mouth(listening := ear())
    for k in range(100):
        if k not in (40, 41, 70):
            mouth.say(1.0 + 0.01 * k, ['a'], position=[float(k)])
    listening.capture.flush()
    meter = listening.capture.meters['state']
    assert (meter.received, meter.missing) == (97, 3)
    assert meter.missing_fraction == pytest.approx(0.03)
    assert meter.rate == pytest.approx(100.0)


def test_a_full_buffer_counts_and_says_so(ear) -> None:
    mouth = Mouth(listening := ear(limit=5))
    for k in range(8):
        mouth.say(1.0 + 0.01 * k, ['a'], position=[float(k)])
    (recording,) = listening.capture.snapshot().build()
    assert len(recording.state.stamp) == 5
    assert listening.capture.meters['state'].dropped == 3
    assert any('raise buffer_messages' in x for x in recording.warnings)


@pytest.mark.parametrize('keep', [False, True])
def test_a_new_stream_replaces_the_ended_one_unless_it_is_kept(ear, keep: bool) -> None:
    mouth = Mouth(listening := ear(keep_streams=keep))
    capture = listening.capture
    assert capture.empty and capture.idle == math.inf
    for k in range(40):
        mouth.say(1.0 + 0.01 * k, ['a'], position=[float(k)])
    listening.now = 3.0
    assert capture.idle == 3.0 and not capture.ended
    capture.end()
    assert capture.ended and len(capture.snapshot().build()) == 1
    mouth.sent = mouth.sent if keep else 0
    mouth.say(1.0, ['a'], position=[0.0])
    listening.until(lambda: not capture.ended, 'the new stream')
    mouth.sent = listening.received()
    for k in range(1, 40):
        mouth.say(1.0 + 0.01 * k, ['a'], position=[float(-k)])
    found = capture.snapshot().build()
    assert len(found) == (2 if keep else 1)
    assert found[-1].state.position[-1] == -39.0
    capture.clear()
    assert capture.empty
    with pytest.raises(IdentError):
        capture.snapshot().build()


def test_incompatible_qos_is_named(ear) -> None:
    listening = ear()
    listening.node.create_publisher(
        JointState, '/effort', QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
    )
    listening.until(
        lambda: '/effort has a publisher of incompatible QoS' in listening.capture.silence(),
        'the sentence',
    )


# ---------------------------------------------------------------------- other types, pauses


@pytest.fixture
def speaker(ear):
    """Return a function that makes an Ear and, in a context of its own, a publisher for it."""
    made = []

    def make(kind, **options):
        domain = new_domain()
        made.append(Ear(domain, **options))
        made.append(Station(lambda context: Node('speaker', context=context), domain))
        one, other = made[-2:]
        publisher = other.node.create_publisher(kind, 'joint_command', 10)
        one.until(lambda: one.node.get_publishers_info_by_topic('/joint_command'), 'it')
        one.request(lambda: one.executor.create_task(one.capture.adapt), 'the executor')
        return one, publisher

    yield make
    for one in made[::-1]:
        one.close()


def test_an_array_is_heard_by_the_names_given(speaker) -> None:
    one, publisher = speaker(Float64MultiArray, names=('a', 'b/velocity'))
    one.until(publisher.get_subscription_count, 'a match')
    for k in range(3):
        publisher.publish(Float64MultiArray(data=[1.0 + k, 2.0]))
        one.until(lambda k=k: one.received() > k, 'the message')
    (recording,) = one.capture.snapshot().build()
    assert recording.command.names == ('a', 'b')
    np.testing.assert_array_equal(recording.command.column('position', 'a'), [1.0, 2.0, 3.0])
    np.testing.assert_array_equal(recording.command.column('velocity', 'b'), [2.0] * 3)
    assert any('has no stamp, the time of publishing' in x for x in recording.warnings)


def test_what_cannot_be_heard_says_what_to_do(speaker) -> None:
    one, _ = speaker(Float64MultiArray)
    assert 'set joint_names to the joints in its order' in one.capture.silence()
    one.capture._adapt('state', '/joint_states', 'no_such_msgs/msg/Thing')
    assert 'no_such_msgs is not installed (Ubuntu: apt install ros-jazzy-no-such-msgs)' in (
        one.capture.silence()
    )


def test_trajectories_are_the_set_point_that_follows_them(speaker) -> None:
    message = pytest.importorskip('trajectory_msgs.msg', reason='no trajectory_msgs here')
    one, publisher = speaker(message.JointTrajectory)
    one.until(publisher.get_subscription_count, 'a match')
    points = [
        message.JointTrajectoryPoint(
            positions=[float(k)], time_from_start=Duration(nanosec=100_000_000 * k)
        )
        for k in range(2)
    ]
    publisher.publish(message.JointTrajectory(joint_names=['a'], points=points))
    one.until(lambda: one.received() > 0, 'the trajectory')
    (recording,) = one.capture.snapshot().build()
    assert recording.command.stamp.size == 101
    np.testing.assert_allclose(recording.command.position[::50, 0], [0.0, 0.5, 1.0], atol=1e-9)


@pytest.mark.parametrize(('next_stamp', 'kept'), [(100.021, 22), (105.0, 1), (3.0, 1)])
def test_a_pause_of_a_bag_does_not_cut_a_stream(ear, next_stamp, kept) -> None:
    one = ear()
    mouth = Mouth(one)
    for k in range(21):
        mouth.say(100.0 + 1e-3 * k, ['a'], position=[0.0])
    one.capture.end()
    one.now += 5.0
    mouth.sent = -1  # how many there will be is what is asked
    mouth.say(next_stamp, ['a'], position=[0.0])
    one.until(lambda: not one.capture.ended, 'the stream to go on')
    one.capture.flush()
    assert one.capture.meters['state'].received == kept
