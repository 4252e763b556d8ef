# SPDX-License-Identifier: Apache-2.0
"""The pace of a replay, and what it plays."""

import os
from pathlib import Path
import subprocess
import sys
import time

import pytest
from ros_helpers import BAG, ended, new_domain, program, QUEUE, short_bag, Station

from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.recording import read_bag
from ros2_ident.ros.replay import opened, paced

STEP = 2_000_000  # ns
ROOT = Path(__file__).parents[2]


def messages(count: int):
    return iter(('/x', 10**18 + k * STEP, bytes([k % 256])) for k in range(count))


def test_messages_come_in_order_and_at_their_times() -> None:
    came = []
    for _, _, data in paced(messages(200)):
        came.append((time.monotonic_ns(), data[0]))
    assert [x for _, x in came] == list(range(200))
    late = sorted((at - came[0][0]) - k * STEP for k, (at, _) in enumerate(came))
    assert late[0] > -STEP, 'never early'
    assert late[len(late) // 2] < STEP, 'half of them within a period, on a busy machine too'


@pytest.mark.parametrize(
    ('path', 'topics', 'code'),
    [
        ('/nowhere', [], ErrorCode.NO_DATA),
        ('/dev/zero', [], ErrorCode.NO_DATA),
        (__file__, [], ErrorCode.DAMAGED_BAG),
        (BAG, ['/x'], ErrorCode.MISSING_STREAM),
    ],
)
def test_what_cannot_be_played(path: Path | str, topics, code: ErrorCode) -> None:
    with pytest.raises(IdentError) as caught:
        opened(path, topics)
    assert caught.value.code == code


@pytest.mark.ros
def test_clock_remaps_and_a_paused_start(tmp_path) -> None:
    from rclpy.node import Node
    from rosgraph_msgs.msg import Clock
    from sensor_msgs.msg import JointState

    domain = new_domain()
    bag, _ = short_bag(tmp_path)
    count = len(read_bag(bag)[0].state.stamp)
    clocks, states = [], []

    def make(context):
        node = Node('watch', context=context)
        node.create_subscription(Clock, '/clock', clocks.append, 1000)
        node.create_subscription(JointState, '/arm/states', states.append, QUEUE)
        return node

    station = Station(make, domain)
    try:
        with program(
            'replay',
            str(bag),
            '--rate',
            '4',
            '--clock',
            '100',
            '--topics',
            '/joint_states',
            '--wait-for-subscribers',
            '60',
            '--ros-args',
            '-r',
            '/joint_states:=/arm/states',
            domain=domain,
        ) as replay:
            code, text = ended(replay)
        assert code == 0, text
        station.until(lambda: len(states) == count, 'the messages')
    finally:
        station.close()
    seconds = [x.clock.sec + 1e-9 * x.clock.nanosec for x in clocks]
    assert seconds == sorted(seconds)
    assert 50 <= len(clocks) <= 110, 'a hundred a second of wall time'
    first = states[0].header.stamp
    assert abs(seconds[0] - first.sec - 1e-9 * first.nanosec) < 0.1


@pytest.mark.ros
def test_what_the_demo_watches_with_ends_in_a_sentence_where_no_result_comes() -> None:
    words = [sys.executable, ROOT / 'tools/watch.py', '--seconds', '0.3']
    env = os.environ | {'ROS_DOMAIN_ID': str(new_domain())}
    done = subprocess.run(words, env=env, capture_output=True, text=True, timeout=300)
    assert (done.returncode, done.stderr) == (2, 'watch: no result of /identifier came\n')
