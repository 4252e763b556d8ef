# SPDX-License-Identifier: Apache-2.0
"""A machine file that asks for the robot's description, and the node that hears it."""

from collections.abc import Iterator
from pathlib import Path
import time
from typing import Any

import numpy as np
import pytest

pytest.importorskip('pinocchio', reason='pinocchio is not installed')

from models.test_serial import described, URDF  # noqa: E402
from ros_helpers import Here, new_domain, Station  # noqa: E402

from ros2_ident.errors import ErrorCode, IdentError  # noqa: E402
from ros2_ident.models import load_machine  # noqa: E402


@pytest.fixture
def asking(tmp_path: Path) -> Path:
    described(tmp_path)
    path = tmp_path / 'arm.yaml'
    path.write_text(path.read_text().replace('arm.urdf', '/robot_description'))
    return path


@pytest.mark.ros
def test_the_node_hears_it_and_goals_use_it(asking: Path) -> None:
    from rclpy.node import Node
    from ros2_ident_msgs.action import Diagnose, Identify
    from std_msgs.msg import String

    from ros2_ident.ros import parameters
    from ros2_ident.ros.goals import wanted_of
    from ros2_ident.ros.outlet import LATCHED

    log = str(asking)  # whatever is there: it is not read
    domain = new_domain()
    early = Station(lambda context: Node('state_publisher', context=context), domain)
    early.node.create_publisher(String, 'robot_description', LATCHED).publish(String(data=URDF))
    late = Here(domain, asking.parent)
    try:
        late.until(lambda: late.node.description, 'the description')
        now = parameters.snapshot(late.node)
        bag = {'data_source': Identify.Goal.DATA_SOURCE_BAG, 'machine_file': str(asking)}
        for goal in (Identify.Goal(bag_path=log, **bag), Diagnose.Goal(bag_path=log, **bag)):
            wanted = wanted_of(goal, now, heard=late.node.description, states=late.node.states)
            assert wanted.machine.text('description') == wanted.description == URDF
            with pytest.raises(IdentError) as caught:
                wanted_of(goal, now)
            assert caught.value.code is ErrorCode.MISSING_STREAM
    finally:
        late.close()
        early.close()


PENDULUM = """<robot name="pendulum"><link name="wall"/>
  <link name="rod"><inertial><origin xyz="0 0 -0.3"/><mass value="2"/>
    <inertia ixx="0.01" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.001"/></inertial></link>
  <joint name="swing" type="revolute"><parent link="wall"/><child link="rod"/><axis xyz="0 1 0"/>
    <limit lower="-3" upper="3" effort="20" velocity="9"/></joint></robot>"""


def swings() -> Iterator[Any]:
    """Yield what a pendulum of 0.8 kg m and 0.25 kg m^2 reports at 250 Hz, beside a gripper."""
    from sensor_msgs.msg import JointState

    clock = 0.004 * np.arange(1000)
    angle, speed, acceleration = (
        sum(a * w**n * np.sin(w * clock + n * np.pi / 2) for a, w in ((0.8, 3.0), (0.3, 7.1)))
        for n in range(3)
    )
    torque = 0.25 * acceleration + 9.81 * 0.8 * np.sin(angle)
    torque += 0.4 * np.tanh(speed / 0.02) + 0.3 * speed
    torque += np.random.default_rng(1).normal(0.0, 0.01, clock.size)
    for t, q, v, f in zip(clock, angle, speed, torque, strict=True):
        message = JointState(name=['grip', 'swing'], position=[0.0, q])
        message.velocity, message.effort = [0.0, v], [0.0, f]
        message.header.stamp.sec = 1
        message.header.stamp.nanosec = round(t * 1e9) % 10**9
        message.header.stamp.sec += int(t)
        yield message


@pytest.mark.ros
def test_a_robot_that_is_only_heard_is_identified_without_a_machine_file(tmp_path: Path) -> None:
    from rclpy.node import Node
    from ros2_ident_msgs.action import Identify
    from sensor_msgs.msg import JointState
    from std_msgs.msg import String

    from ros2_ident.ros.outlet import LATCHED

    domain = new_domain()
    robot = Station(lambda context: Node('robot', context=context), domain)
    robot.node.create_publisher(String, 'robot_description', LATCHED).publish(
        String(data=PENDULUM)
    )
    states = robot.node.create_publisher(JointState, 'joint_states', 1000)
    node = Here(domain, tmp_path, end_of_stream=0.5, initial_population=64, generations=2)
    try:
        node.until(lambda: node.node.description, 'the description')
        robot.until(lambda: states.get_subscription_count(), 'the subscription')
        with pytest.raises(IdentError, match='ident new-machine') as caught:
            node.node.identifying.begin(Identify.Goal(data_source=1, bag_path=str(tmp_path)))
        assert caught.value.code is ErrorCode.INVALID_GOAL
        for message in swings():
            states.publish(message)
            time.sleep(0.0005)
        node.until(lambda: node.node.last or node.node.board.state >= 4, 'the result')
        found = node.node.last.result
        values = {parameter.name: parameter.value for parameter in found.parameters}
        assert values['swing.coulomb_torque'] == pytest.approx(0.4, abs=0.02)
        assert values['swing.viscous_torque'] == pytest.approx(0.3, abs=0.02)
        assert max(abs(v) for n, v in values.items() if 'link_moment' in n) == pytest.approx(
            0.8, abs=0.01
        )
        (folder,) = tmp_path.glob('2*')
        again = load_machine(folder / 'machine.yaml')
        assert again.drives == ('swing',)
        assert again.text('description') == PENDULUM and again.number('cycle') == 0.004
        node.node.description = PENDULUM[:300]
        with pytest.raises(IdentError, match='is no XML') as caught:
            node.node.identifying.begin(Identify.Goal())
        assert caught.value.code is ErrorCode.BAD_MACHINE_FILE
        node.node.description = None
        with pytest.raises(IdentError, match='no robot_description was heard'):
            node.node.identifying.begin(Identify.Goal())
    finally:
        node.close()
        robot.close()
