# SPDX-License-Identifier: Apache-2.0
"""A machine file that asks for the robot's description, and the node that hears it."""

from pathlib import Path

import pytest

pytest.importorskip('pinocchio', reason='pinocchio is not installed')

from ros_helpers import new_domain, Station  # noqa: E402
from test_models_serial import described, URDF  # noqa: E402

from ros2_ident.errors import ErrorCode, IdentError  # noqa: E402
from ros2_ident.models import load_machine  # noqa: E402
from ros2_ident.models.serial.arm import arm_of  # noqa: E402


@pytest.fixture
def asking(tmp_path: Path) -> Path:
    described(tmp_path)
    path = tmp_path / 'arm.yaml'
    path.write_text(path.read_text().replace('arm.urdf', '/robot_description'))
    return path


def test_what_was_heard_takes_the_place_of_a_file(asking: Path) -> None:
    machine = load_machine(asking)
    with pytest.raises(IdentError) as caught:
        arm_of(machine)
    assert caught.value.code is ErrorCode.MISSING_STREAM
    assert 'robot_state_publisher' in caught.value.message
    heard = machine.described(URDF)
    assert len(arm_of(heard).bodies) == 4
    assert heard.digest != machine.digest
    # A machine with a file of its own does not care.
    assert heard.described('<robot/>') is heard


@pytest.mark.ros
def test_the_node_hears_it_and_goals_use_it(asking: Path) -> None:
    from rclpy.node import Node
    from ros2_ident_msgs.action import Diagnose, Identify
    from std_msgs.msg import String

    from ros2_ident.ros import parameters
    from ros2_ident.ros.goals import diagnose_request_of, request_of
    from ros2_ident.ros.node import Identifier
    from ros2_ident.ros.outlet import LATCHED

    log = str(asking)  # whatever is there: it is not read
    domain = new_domain()
    early = Station(lambda context: Node('state_publisher', context=context), domain)
    early.node.create_publisher(String, 'robot_description', LATCHED).publish(String(data=URDF))
    late = Station(lambda context: Identifier(context=context), domain)
    try:
        late.until(lambda: late.node.description, 'the description')
        now = parameters.snapshot(late.node)
        bag = {'data_source': Identify.Goal.DATA_SOURCE_BAG, 'machine_file': str(asking)}
        for ask, goal in (
            (request_of, Identify.Goal(bag_path=log, **bag)),
            (diagnose_request_of, Diagnose.Goal(fit_bag_path=log, **bag)),
        ):
            request = ask(goal, now, description=late.node.description)
            assert request.machine.text('description') == URDF
            with pytest.raises(IdentError) as caught:
                ask(goal, now)
            assert caught.value.code is ErrorCode.MISSING_STREAM
    finally:
        late.close()
        early.close()
