# SPDX-License-Identifier: Apache-2.0
"""Robots' own messages: read by their definition and the map of their type, without an option."""

from dataclasses import replace
import importlib
import json
from pathlib import Path
import sqlite3
import sys

from identify_cases import QUICK, ROOT
from mcap.reader import make_reader
from mcap.writer import Writer as McapWriter
from message_makers import Messages
import numpy as np
import pytest

from ros2_ident.cli.main import main
from ros2_ident.errors import IdentError
from ros2_ident.identify.run import identify, read_data
from ros2_ident.models import load_machine
from ros2_ident.recording import check, maps, read_bag, render, Topics, write_bag
from ros2_ident.recording.cdr import encode
from ros2_ident.recording.content import messages_of
from ros2_ident.recording.maps import kinds, map_of, roles_of
from ros2_ident.recording.streams import FIELDS

PENDULUM = ROOT / 'config/double_pendulum.yaml'
MAPS = Path(maps.__file__).with_name('maps')
START = 1_700_000_000_000_000_000
STEP = 2_000_000
SAMPLES = 100
LEGS = [
    f'{leg}_{part}_joint' for leg in ('FR', 'FL', 'RR', 'RL') for part in ('hip', 'thigh', 'calf')
]
SIX = [f'joint_{n}' for n in range(1, 7)]
SEVEN = [*SIX, 'joint_7']
UR = [
    f'{x}_joint'
    for x in ('shoulder_pan', 'shoulder_lift', 'elbow', 'wrist_1', 'wrist_2', 'wrist_3')
]


def truth(joints):
    """Return position, velocity, effort and set-point (T, D), exact in single precision."""
    time = 0.002 * np.arange(SAMPLES)[:, None]
    phase = 5.0 * time + np.arange(joints)
    rows = np.sin(phase), 5.0 * np.cos(phase), 3.0 * np.cos(phase + 0.3), np.sin(phase + 0.1)
    return [x.astype(np.float32).astype(np.float64) for x in rows]


def unitree(maker, package, joints):
    q, dq, tau, goal = truth(joints)
    for k in range(SAMPLES):
        when = START + k * STEP
        state, command = (maker.blank(f'{package}/msg/{x}') for x in ('LowState', 'LowCmd'))
        state.tick = 70_000 + 2 * k
        for j in range(joints):
            motor, goal_ = state.motor_state[j], command.motor_cmd[j]
            motor.q, motor.dq, motor.tau_est = q[k, j], dq[k, j], tau[k, j]
            goal_.q, goal_.dq, goal_.kp, goal_.kd = goal[k, j], 16000.0, 60.0, 5.0
        for motor in command.motor_cmd[joints:]:
            motor.q, motor.dq = 2.146e9, 16000.0
        yield when, '/lowstate', f'{package}/msg/LowState', state
        yield when, '/lowcmd', f'{package}/msg/LowCmd', command


def franka_2(maker):
    q, dq, tau, goal = truth(7)
    kind = 'franka_msgs/msg/FrankaRobotState'
    for k in range(SAMPLES):
        message = maker.blank(kind)
        maker.stamp(message, START + k * STEP)
        message.header.frame_id = 'base'
        for own, place in ((message.measured_joint_state, q), (message.desired_joint_state, goal)):
            own.name = [f'fr3_joint{n}' for n in range(1, 8)]
            own.position, own.velocity, own.effort = place[k], dq[k], tau[k]
        yield START + k * STEP, '/franka_robot_state_broadcaster/robot_state', kind, message


def franka_1(maker):
    q, dq, tau, goal = truth(7)
    kind = 'franka_msgs/msg/FrankaState'
    for k in range(SAMPLES):
        message = maker.blank(kind)
        maker.stamp(message, START + k * STEP)
        message.header.seq, message.header.frame_id = k, 'base'
        message.q, message.dq, message.tau_J, message.q_d = q[k], dq[k], tau[k], goal[k]
        yield START + k * STEP, '/franka_state_controller/franka_states', kind, message


def lbr(maker):
    q, _, tau, goal = truth(7)
    kind = 'lbr_fri_idl/msg/LBRState'
    for k in range(SAMPLES):
        message = maker.blank(kind)
        message.time_stamp_sec, message.time_stamp_nano_sec = divmod(START + k * STEP, 10**9)
        message.measured_joint_position, message.measured_torque = q[k], tau[k]
        message.commanded_joint_position = goal[k]
        yield START + k * STEP, '/lbr/state', kind, message


def odrive(maker):
    q, dq, tau, goal = truth(1)
    for k in range(SAMPLES):
        status = maker.blank('odrive_node/msg/ControllerStatus')
        status.pos_estimate, status.vel_estimate = q[k, 0], dq[k, 0]
        status.torque_estimate = tau[k, 0]
        order = maker.blank('odrive_node/msg/ControlMessage')
        order.input_pos = goal[k, 0]
        yield START + k * STEP, '/controller_status', 'odrive_node/msg/ControllerStatus', status
        yield START + k * STEP, '/control_message', 'odrive_node/msg/ControlMessage', order


def ur(maker):
    q, dq, tau, goal = truth(6)
    kind = 'ur_msgs/msg/RobotStateRTMsg'
    for k in range(SAMPLES):
        message = maker.blank(kind)
        message.time = 321.5 + 0.002 * k
        message.q_actual, message.qd_actual, message.i_actual = q[k], dq[k], tau[k]
        message.q_target = goal[k]
        yield START + k * STEP, '/ur_rt', kind, message


def xarm(maker):
    q = truth(6)[0]
    kind = 'xarm_msgs/msg/RobotMsg'
    for k in range(SAMPLES):
        message = maker.blank(kind)
        maker.stamp(message, START + k * STEP)
        message.angle = q[k].astype(np.float32)
        yield START + k * STEP, '/xarm/robot_states', kind, message


def dynamixel(maker):
    kind = 'dynamixel_workbench_msgs/msg/DynamixelStateList'
    for k in range(SAMPLES):
        message = maker.blank(kind)
        for n, name in enumerate(('pan', 'tilt')):
            motor = maker.blank('dynamixel_workbench_msgs/msg/DynamixelState')
            motor.name, motor.present_position = name, 2048 + 10 * k + n
            message.dynamixel_state.append(motor)
        yield START + k * STEP, '/dynamixel_state', kind, message


def pid(maker):
    q, dq, tau, goal = truth(2)
    kind = 'control_msgs/msg/MultiDOFStateStamped'
    for k in range(SAMPLES):
        message = maker.blank(kind)
        maker.stamp(message, START + k * STEP)
        for j, name in enumerate(('a', 'b')):
            one = maker.blank('control_msgs/msg/SingleDOFState')
            one.name, one.reference, one.output = name, goal[k, j], tau[k, j]
            one.feedback, one.feedback_dot = q[k, j], dq[k, j]
            message.dof_states.append(one)
        yield START + k * STEP, '/pid_controller/controller_state', kind, message


def multi_dof(maker):
    q, dq, _, goal = truth(2)
    for k in range(SAMPLES):
        state = maker.blank('sensor_msgs/msg/JointState')
        maker.stamp(state, START + k * STEP)
        state.name, state.position, state.velocity = ['a', 'b'], q[k], dq[k]
        order = maker.blank('control_msgs/msg/MultiDOFCommand')
        order.dof_names, order.values = ['b', 'a'], goal[k, ::-1].copy()
        yield START + k * STEP, '/joint_states', 'sensor_msgs/msg/JointState', state
        yield START + k * STEP, '/pid/reference', 'control_msgs/msg/MultiDOFCommand', order


def interfaces(maker):
    q, dq, tau, goal = truth(2)
    kind = 'control_msgs/msg/DynamicInterfaceValues'
    for k in range(SAMPLES):
        message = maker.blank(kind)
        maker.stamp(message, START + k * STEP)
        names = [f'{x}/{y}' for y in FIELDS for x in 'ab']
        message.states.interface_names = [*names, 'gpio/vacuum']
        message.states.values = np.concatenate([q[k], dq[k], tau[k], [7.0]])
        message.commands.interface_names = ['a/position', 'b/position']
        message.commands.values = goal[k]
        yield START + k * STEP, '/controller_manager/values', kind, message


def one_joint(maker):
    q, dq, tau, goal = truth(1)
    kind = 'control_msgs/msg/JointControllerState'
    for k in range(SAMPLES):
        message = maker.blank(kind)
        maker.stamp(message, START + k * STEP)
        message.set_point, message.command = goal[k, 0], tau[k, 0]
        message.process_value, message.process_value_dot = q[k, 0], dq[k, 0]
        yield START + k * STEP, '/arm_controller/state', kind, message


TURN = 2.0 * np.pi
# Messages, joints, factor to rad, and whether there are velocity, effort and set-point.
CASES = {
    'unitree_go': (lambda x: unitree(x, 'unitree_go', 12), LEGS, 1.0, 'vec'),
    'unitree_hg': (
        lambda x: unitree(x, 'unitree_hg', 29),
        [f'joint_{n}' for n in range(1, 30)],
        1.0,
        'vec',
    ),
    'franka_ros2': (franka_2, [f'fr3_joint{n}' for n in range(1, 8)], 1.0, 'vec'),
    'lbr': (lbr, SEVEN, 1.0, 'ec'),
    'odrive': (odrive, SIX[:1], TURN, 'vec'),
    'ur': (ur, UR, 1.0, 'vec'),
    'xarm': (xarm, SIX, 1.0, ''),
    'pid_controller': (pid, ['a', 'b'], 1.0, 'vec'),
    'multi_dof_command': (multi_dof, ['a', 'b'], 1.0, 'vc'),
    'interface_values': (interfaces, ['a', 'b'], 1.0, 'vec'),
    'joint_controller_state': (one_joint, SIX[:1], 1.0, 'vec'),
}


def compare(read, joints, factor, holds, command=()):
    q, dq, tau, goal = truth(len(joints))
    assert read.state.names == tuple(joints)
    np.testing.assert_allclose(read.state.position, factor * q, rtol=1e-15)
    if 'v' in holds:
        np.testing.assert_allclose(read.state.velocity, factor * dq, rtol=1e-15)
    if 'e' in holds:
        effort = read.state.effort if read.effort is None else read.effort.effort
        np.testing.assert_array_equal(effort, tau)
    if 'c' in holds:
        found = np.stack([read.command.column('position', x) for x in joints], axis=1)
        np.testing.assert_allclose(found, factor * goal, rtol=1e-15)
        assert set(read.command.names) == set(joints)
    assert (read.command is not None) == ('c' in holds or bool(command))
    for name in command:
        values = read.command.column('position', name)
        np.testing.assert_array_equal(values, goal[:, joints.index(name)])
    for stream in read.streams.values():
        np.testing.assert_allclose(np.diff(stream.stamp), STEP, atol=2)
        assert abs(int(stream.stamp[0]) - START) < 10


@pytest.fixture(scope='module')
def maker():
    return Messages()


@pytest.mark.parametrize('case', CASES)
def test_a_robot_s_messages_need_no_option(maker, tmp_path, case):
    make, joints, factor, holds = CASES[case]
    (read,) = read_bag(maker.write(tmp_path / 'log', make(maker)))
    compare(read, joints, factor, holds)
    assert not any('is not read' in x for x in read.notes)
    assert not any('is NaN' in x for x in render(check([read])))


@pytest.mark.parametrize('case', CASES)
def test_a_bag_without_definitions_is_read_by_that_of_the_map(maker, tmp_path, case):
    make, joints, factor, holds = CASES[case]
    path = maker.write(tmp_path / 'log', make(maker), storage='sqlite3')
    with sqlite3.connect(path / 'log.db3') as base:  # as Humble and before
        base.execute('DROP TABLE IF EXISTS message_definitions')
    base.close()
    (read,) = read_bag(path)
    compare(read, joints, factor, holds)


def test_a_ros_1_bag_is_read_by_its_definitions(tmp_path):
    maker = Messages(version=1)
    (read,) = read_bag(maker.write(tmp_path / 'log.bag', franka_1(maker)))
    compare(read, [f'panda_joint{n}' for n in range(1, 8)], 1.0, 'vec')


def test_counts_are_scaled_by_what_the_map_states(maker, tmp_path):
    (read,) = read_bag(maker.write(tmp_path / 'log', dynamixel(maker)))
    assert read.state.names == ('pan', 'tilt')
    np.testing.assert_allclose(read.state.position[0], np.array([2048, 2049]) * TURN / 4096)
    assert any('counts are taken as those of an XM430' in x for x in read.warnings)


def test_a_counter_keeps_even_time_where_messages_come_late(maker, tmp_path):
    late = np.random.default_rng(1).integers(0, 3_000_000, 2 * SAMPLES)
    slow = 1.0001  # the recorder's clock against the robot's
    messages = [
        (START + round(slow * (when - START)) + int(x), *rest)
        for (when, *rest), x in zip(unitree(maker, 'unitree_go', 12), late, strict=True)
    ]
    (read,) = read_bag(maker.write(tmp_path / 'log', messages))
    steps = np.diff(read.state.stamp)
    assert np.ptp(steps) < 3  # ns
    assert abs(steps.mean() / STEP - slow) < 2e-3
    assert any('its counter is the time, set by' in x for x in read.warnings)


def test_a_counter_is_no_time_while_messages_still_come(maker):
    kind = 'unitree_go/msg/LowState'
    messages = messages_of(map_of(kind), 'state')
    assert messages.clock == 'counter'
    messages.clock = 'none'
    sent = [x for *_, own, x in unitree(maker, 'unitree_go', 12) if own == kind]
    data = [bytes(maker.store.serialize_cdr(x, kind)) for x in sent]
    messages.take(range(START, START + len(data)), data)
    messages.decode()
    (block,) = messages.blocks
    assert messages.unstamped and block.stamp.tolist() == [*range(START, START + len(data))]


def test_gains_that_come_with_a_set_point_are_named(maker, tmp_path):
    messages = [*unitree(maker, 'unitree_hg', 3)]
    messages[-1][-1].motor_cmd[1].kd = 7.0
    (read,) = read_bag(maker.write(tmp_path / 'log', messages))
    assert read.notes[-1] == (
        '/lowcmd comes with gains: kd of joint_1 5, kd of joint_2 5 to 7, kd of joint_3 5, '
        'kp of joint_1 60, kp of joint_2 60, kp of joint_3 60'
    )


def test_a_counter_that_starts_again_is_no_time(maker, tmp_path):
    messages = [*unitree(maker, 'unitree_go', 12)]
    for n, (_, topic, _, message) in enumerate(messages):
        if topic == '/lowstate' and n > SAMPLES:
            message.tick -= 70_000
    (read,) = read_bag(maker.write(tmp_path / 'log', messages))
    assert (np.diff(read.state.stamp) == STEP).all()
    assert any('its counter does not run with the clock' in x for x in read.warnings)


def test_a_set_point_that_is_there_is_not_asked_for(maker, tmp_path):
    messages = [*multi_dof(maker)]
    messages += [(t, f'{x}_2', *rest) for t, x, *rest in messages if x == '/pid/reference']
    lines = render(check(read_bag(maker.write(tmp_path / 'log', messages))))
    (said,) = (x for x in lines if 'there is no command stream' in x)
    assert said.endswith('read the set-point, for which there is a topic')


@pytest.mark.parametrize('order', ['one after the other', 'in turns', 'some', 'sizes'])
def test_messages_of_one_size_in_a_row_are_read_as_any_others(maker, tmp_path, order):
    q, dq, tau, _ = truth(3)
    stamps = START + STEP * np.arange(SAMPLES)
    names = ['a', 'b', 'c']
    first, second = (encode(stamps, names, [sign * q, dq, tau]) for sign in (1.0, -1.0))
    if order == 'sizes':  # a name that is longer for a while
        first[30:60] = encode(stamps[30:60], ['a', 'b', 'longer'], [q[30:60], None, None])
    rows = [(t, n, x) for n, own in enumerate((first, second))
            for t, x in zip(stamps.tolist(), own, strict=True)]  # fmt: skip
    if order != 'one after the other':
        rows.sort(key=lambda x: (x[0] // (7 * STEP if order == 'some' else STEP), x[1]))
    with (tmp_path / 'log.mcap').open('wb') as file:
        writer = McapWriter(file)
        writer.start(profile='ros2')
        text, _ = maker.store.generate_msgdef('sensor_msgs/msg/JointState')
        schema = writer.register_schema('sensor_msgs/msg/JointState', 'ros2msg', text.encode())
        topics = [writer.register_channel(x, 'cdr', schema) for x in ('/one', '/two')]
        for when, number, data in rows:
            writer.add_message(topics[number], when, data, when)
        writer.finish()
    (read,) = read_bag(tmp_path / 'log.mcap', Topics(state='/one', effort='', command='/two'))
    np.testing.assert_array_equal(read.state.position[:, :2], q[:, :2])
    np.testing.assert_array_equal(read.command.position, -q)
    assert (read.state.stamp == stamps).all() and (read.command.stamp == stamps).all()
    if order == 'sizes':
        assert read.state.names == ('a', 'b', 'c', 'longer')
        np.testing.assert_array_equal(read.state.column('position', 'longer')[30:60], q[30:60, 2])


def test_a_definition_in_idl_is_read(tmp_path):
    line = '=' * 80
    text = f"""{line}
IDL: sensor_msgs/msg/JointState
#include "std_msgs/msg/Header.idl"
module sensor_msgs {{
  module msg {{
    @verbatim (language="comment", text="What joints do")
    struct JointState {{
      std_msgs::msg::Header header;
      sequence<string> name;
      sequence<double> position;
      sequence<double> velocity;
      sequence<double> effort;
    }};
  }};
}};
{line}
IDL: std_msgs/msg/Header
#include "builtin_interfaces/msg/Time.idl"
module std_msgs {{
  module msg {{
    struct Header {{
      builtin_interfaces::msg::Time stamp;
      string frame_id;
    }};
  }};
}};
{line}
IDL: builtin_interfaces/msg/Time
module builtin_interfaces {{
  module msg {{
    struct Time {{
      int32 sec;
      uint32 nanosec;
    }};
  }};
}};
"""
    q, dq, _, _ = truth(2)
    with (tmp_path / 'log.mcap').open('wb') as file:
        writer = McapWriter(file)
        writer.start(profile='ros2')
        schema = writer.register_schema('sensor_msgs/msg/JointState', 'ros2idl', text.encode())
        channel = writer.register_channel('/joint_states', 'cdr', schema)
        stamps = START + STEP * np.arange(SAMPLES)
        for when, data in zip(stamps.tolist(), encode(stamps, 'ab', [q, dq, None]), strict=True):
            writer.add_message(channel, when, data, when)
        writer.finish()
    (read,) = read_bag(tmp_path / 'log.mcap')
    compare(read, ['a', 'b'], 1.0, 'v')


def test_names_come_from_the_command_line_or_the_machine(maker, tmp_path):
    path = maker.write(tmp_path / 'log', lbr(maker))
    names = tuple('abcdefg')
    (read,) = read_bag(path, Topics(names=names))
    assert read.state.names == read.command.names == names
    (read,) = read_bag(path, drives=names)
    assert read.state.names == names
    assert any(
        'joints are called a, b, c, d and 3 more in their order' in x for x in read.warnings
    )
    (read,) = read_bag(path, drives=names[:3])  # of another machine
    assert read.state.names == tuple(SEVEN)
    with pytest.raises(IdentError, match='arrays have to be empty or as long as the names'):
        read_bag(path, Topics(names=names[:3]))


def test_check_lists_every_topic(maker, tmp_path):
    messages = [*multi_dof(maker), *one_joint(maker)]
    for k in range(3):
        pose = maker.blank('geometry_msgs/msg/PoseStamped')
        messages.append((START + k, '/pose', 'geometry_msgs/msg/PoseStamped', pose))
        messages.append(
            (START + k, '/said', 'std_msgs/msg/String', maker.blank('std_msgs/msg/String'))
        )
    lines = render(check(read_bag(maker.write(tmp_path / 'log', messages))))
    for said in (
        'command: no /joint_command, /arm_controller/state is taken '
        '(control_msgs/msg/JointControllerState)',
        '/pid/reference (control_msgs/msg/MultiDOFCommand) is not read; to read it: '
        '--command-topic /pid/reference',
        '/pose (geometry_msgs/msg/PoseStamped) is not read, there is no map of its type; it holds '
        'pose.position.x, pose.position.y, pose.position.z, pose.orientation.x and 1 more',
        'not read: /said (std_msgs/msg/String)',
    ):
        assert f'ok    {said}' in lines


@pytest.mark.parametrize('kind', [x for x in kinds() if map_of(x)])
def test_a_topic_of_bytes_that_are_no_message_is_named(maker, tmp_path, kind):
    path = tmp_path / 'log.mcap'
    with path.open('wb') as file:
        writer = McapWriter(file)
        writer.start()
        form = 'cdr' if '/msg/' in kind else 'json'
        number = writer.register_schema(kind, 'ros2msg', b'nothing')
        topic = writer.register_channel('/odd', form, number)
        writer.add_message(topic, START, b'\x00\x01\x00\x00{', START)
        writer.finish()
    with pytest.raises(IdentError, match='holds no message of /joint_states, .* only /odd'):
        read_bag(path)
    with pytest.raises(IdentError, match='no message of /odd is a valid|is an array without'):
        role = roles_of(kind)[0]
        none = dict.fromkeys(('state', 'effort', 'command'), 'none')
        read_bag(path, Topics(**{**none, role: '/odd'}))


def test_every_map_can_be_read_and_states_its_source():
    assert len(kinds()) > 20
    for kind in kinds():
        if (about := map_of(kind)) is None:
            continue
        assert about.kind == kind and roles_of(kind)
        text = (MAPS / f'{kind.replace("/msg/", "-")}.yaml').read_text()
        assert text.split('\n')[1].startswith('source: https://')
        if about.definition is None:  # protobuf and JSON need none
            continue
        for own in about.roles.values():
            for source in own.values():
                assert any(about.definition.has(path) for path in source.paths), (kind, source)


# ---------------------------------------------------------------------- by a map of one's own


def read_by(path, room, text):
    (room / 'map.yaml').write_text(text)
    return read_bag(path, Topics(columns=str(room / 'map.yaml')))


def test_a_column_map_names_fields_of_topics(maker, tmp_path):
    path = maker.write(tmp_path / 'log', unitree(maker, 'unitree_go', 12))
    text = """
time: {column: /lowstate tick, unit: ms}
joints:
  hip, thigh, calf:
    position: '/lowstate motor_state[3:6].q'
    effort: {column: '/lowstate motor_state[3:6].tau_est', scale: -2.0}
    command_position: '/lowcmd motor_cmd[3:6].q'
  other:
    position: /lowstate motor_state[0].q
    effort:
    - /lowstate motor_state[0].tau_est
    - {column: '/lowstate motor_state[1].tau_est', scale: 3}
"""
    (read,) = read_by(path, tmp_path, text)
    q, _, tau, goal = truth(12)
    assert read.state.names == ('hip', 'thigh', 'calf', 'other')
    np.testing.assert_array_equal(read.state.position, q[:, [3, 4, 5, 0]])
    np.testing.assert_array_equal(read.effort.effort[:, :3], -2.0 * tau[:, 3:6])
    np.testing.assert_array_equal(read.effort.effort[:, 3], tau[:, 0] + 3.0 * tau[:, 1])
    np.testing.assert_array_equal(read.command.position, goal[:, 3:6])
    np.testing.assert_allclose(read.state.stamp, START + STEP * np.arange(SAMPLES), atol=2)
    assert any('LowCmd has no stamp, the time of recording is used' in x for x in read.warnings)


def test_a_map_and_the_map_of_the_type_give_the_same(tmp_path):
    maker = Messages(version=1)
    path = maker.write(tmp_path / 'log.bag', franka_1(maker))
    names = ', '.join(f'panda_joint{n}' for n in range(1, 8))
    topic = '/franka_state_controller/franka_states'
    fields = f'position: {topic} q, effort: {topic} tau_J, command_position: {topic} q_d'
    (mapped,) = read_by(path, tmp_path, f'joints: {{"{names}": {{{fields}}}}}')
    (own,) = read_bag(path)
    np.testing.assert_array_equal(mapped.state.position, own.state.position)
    np.testing.assert_array_equal(mapped.effort.effort, own.state.effort)
    np.testing.assert_array_equal(mapped.command.position, own.command.position)
    assert (mapped.state.stamp == own.state.stamp).all()


@pytest.mark.parametrize(
    'text, said',
    [
        ('joints: {a: {position: motor_state}}', 'write a topic and its field, as'),
        ('joints: {a: {position: /x q}}', r'holds no message of /x, only /lowcmd \(unitree_go'),
        (
            'joints: {a: {position: /lowstate q}}',
            r'has no field q, its numbers are imu_state.*; cor',
        ),
        ('joints: {a: {position: "/lowstate motor_state[:].q"}}', 'is 20 numbers for 1 joints'),
        ('joints: {a: {position: "/lowstate motor_state[20].q"}}', 'no message of /lowstate is a'),
        ('joints: {"a, a": {position: "/lowstate motor_state[:2].q"}}', 'names a joint twice'),
        ('time: {column: /x tick}\njoints: {a: {position: /lowstate tick}}', "time names '/x'"),
        ('time: {column: /lowstate t}\njoints: {a: {position: /lowstate tick}}', 'no field t'),
        ('time: 3\njoints: {a: {position: /lowstate tick}}', 'time is 3; write it as in docs'),
    ],
)
def test_a_map_that_does_not_fit_says_what_is_there(maker, tmp_path, text, said):
    path = maker.write(tmp_path / 'log', [*unitree(maker, 'unitree_go', 12)][:20])
    with pytest.raises(IdentError, match=said):
        read_by(path, tmp_path, text)


# ---------------------------------------------------------------------- protobuf and JSON


def foxglove_schema():
    """Return foxglove.JointStates as a set of file descriptors, as foxglove-sdk 0.30 has it."""
    pb2 = pytest.importorskip('google.protobuf.descriptor_pb2', reason='protobuf is not installed')
    time = importlib.import_module('google.protobuf.timestamp_pb2')
    field, own = pb2.FieldDescriptorProto, pb2.FileDescriptorProto()
    own.name, own.package, own.syntax = 'foxglove/JointStates.proto', 'foxglove', 'proto3'
    own.dependency.append('google/protobuf/timestamp.proto')
    joint = own.message_type.add(name='JointState')
    joint.field.add(name='name', number=1, type=field.TYPE_STRING, label=field.LABEL_OPTIONAL)
    for number, name in enumerate(('position', 'velocity', 'acceleration', 'effort'), 2):
        joint.oneof_decl.add(name=f'_{name}')
        joint.field.add(
            name=name, number=number, type=field.TYPE_DOUBLE, label=field.LABEL_OPTIONAL,
            proto3_optional=True, oneof_index=number - 2,
        )  # fmt: skip
    whole = own.message_type.add(name='JointStates')
    for name, number, kind, label in (
        ('timestamp', 1, '.google.protobuf.Timestamp', field.LABEL_OPTIONAL),
        ('joints', 2, '.foxglove.JointState', field.LABEL_REPEATED),
    ):
        whole.field.add(
            name=name, number=number, type=field.TYPE_MESSAGE, label=label, type_name=kind
        )
    found = pb2.FileDescriptorSet()
    found.file.add().CopyFrom(own)  # what it needs comes after it, too
    time.DESCRIPTOR.CopyToProto(found.file.add())
    return found


def write_foxglove(path, form):
    q, dq, tau, goal = truth(2)
    schema, make = b'', None
    if form == 'protobuf':
        files = foxglove_schema()
        schema = files.SerializeToString()
        pool = importlib.import_module('google.protobuf.descriptor_pool').DescriptorPool()
        for file in reversed(files.file):
            pool.Add(file)
        factory = importlib.import_module('google.protobuf.message_factory')
        make = factory.GetMessageClass(pool.FindMessageTypeByName('foxglove.JointStates'))
    with path.open('wb') as file:
        writer = McapWriter(file)
        writer.start()
        encoding = {'protobuf': 'protobuf', 'json': 'jsonschema'}[form]
        number = writer.register_schema('foxglove.JointStates', encoding, schema)
        topics = [writer.register_channel(x, form, number) for x in ('/joint_states', '/goal')]
        for k in range(SAMPLES):
            when = START + k * STEP
            joints = [
                {'name': 'ab'[n], 'position': q[k, n], 'velocity': dq[k, n], 'effort': tau[k, n]}
                for n in (0, 1)
            ]
            goals = [{'name': 'b', 'position': goal[k, 1]}]
            for topic, own in zip(topics, (joints, goals), strict=True):
                if make is not None:
                    message = make(joints=own)
                    message.timestamp.seconds, message.timestamp.nanos = divmod(when, 10**9)
                    data = message.SerializeToString()
                else:
                    stamp = {'sec': when // 10**9, 'nsec': when % 10**9}
                    data = json.dumps({'timestamp': stamp, 'joints': own}).encode()
                writer.add_message(topic, when + 10_000, data, when)
        writer.finish()
    return path


@pytest.mark.parametrize('form', ['protobuf', 'json'])
def test_joint_states_of_foxglove_need_no_map(tmp_path, form):
    path = write_foxglove(tmp_path / 'log.mcap', form)
    (read,) = read_bag(path)
    compare(read, ['a', 'b'], 1.0, 've', command=['b'])
    assert 'command: no /joint_command, /goal is taken (foxglove.JointStates)' in read.notes
    names = 'joints: {"a, b": {position: "/joint_states joints[:].position"}}'
    text = f'time: {{column: /joint_states timestamp}}\n{names}'
    (mapped,) = read_by(path, tmp_path, text)
    np.testing.assert_array_equal(mapped.state.position, read.state.position)
    assert (mapped.state.stamp == read.state.stamp).all()


def test_json_without_values_or_with_an_absurd_time_is_answered(tmp_path):
    path = tmp_path / 'log.mcap'
    for joints, second, said in (
        ([{'name': 'a'}], 1_700_000_000, 'no measured value arrived'),
        ([{'name': 'a', 'position': 1.0}], 10**30, 'no message of /joint_states is a valid'),
        ([{'name': 'a', 'position': 10**400}], 1_700_000_000, 'no message of /joint_states is'),
        ([{'position': {}}], 1_700_000_000, 'no message of /joint_states is a valid'),
    ):
        with path.open('wb') as file:
            writer = McapWriter(file)
            writer.start()
            number = writer.register_schema('foxglove.JointStates', 'jsonschema', b'')
            topic = writer.register_channel('/joint_states', 'json', number)
            stamp = {'sec': second, 'nsec': 0}
            data = json.dumps({'timestamp': stamp, 'joints': joints}).encode()
            writer.add_message(topic, START, data, START)
            writer.finish()
        with pytest.raises(IdentError, match=said):
            read_bag(path)
    text = """time: {column: /joint_states timestamp}
joints: {a: {position: "/joint_states joints[0].nothing"}}"""
    path = write_foxglove(path, 'json')
    with pytest.raises(IdentError, match='no measured value arrived'):
        read_by(path, tmp_path, text)


@pytest.mark.parametrize('form', ['protobuf', 'json'])
def test_a_message_that_is_none_is_left_out(tmp_path, form):
    path = write_foxglove(tmp_path / 'log.mcap', form)
    with (tmp_path / 'other.mcap').open('wb') as file:
        writer = McapWriter(file)
        writer.start()
        with path.open('rb') as source:
            for n, (schema, channel, message) in enumerate(make_reader(source).iter_messages()):
                if not n:
                    number = writer.register_schema(schema.name, schema.encoding, schema.data)
                    topic = writer.register_channel('/joint_states', form, number)
                if channel.topic == '/joint_states':
                    body = b'\xff{' if n == 100 else message.data
                    writer.add_message(topic, message.log_time, body, message.log_time)
        writer.finish()
    (read,) = read_bag(tmp_path / 'other.mcap')
    assert read.state.stamp.size == SAMPLES - 1
    assert any('1 of 100 messages are no valid' in x for x in read.warnings)


# ---------------------------------------------------------------------- identified

DRIVES = {
    **{case: CASES[case][1] for case in ('unitree_go', 'franka_ros2', 'lbr', 'ur')},
    **dict.fromkeys(('pid_controller', 'interface_values', 'protobuf', 'json'), ['a', 'b']),
    'unitree_hg': ['shoulder', 'elbow'],  # in the order of the machine file
    'franka_ros1': [f'panda_joint{n}' for n in range(1, 8)],
}


@pytest.fixture(scope='module')
def pendulum(tmp_path_factory):
    """A double pendulum with noise on its effort, and what is identified from its JointStates."""
    path = tmp_path_factory.mktemp('pendulum') / 'log'
    assert not main(['simulate', str(path), '--machine', str(PENDULUM), '--seconds', '8',
                     '--clean', '--seed', '3'])  # fmt: skip
    (log,) = read_bag(path)
    noise = np.random.default_rng(0).normal(size=log.effort.effort.shape) * 0.02
    values = [
        log.state.position,
        log.state.velocity,
        log.effort.effort + noise,
        log.state.position,
    ]
    assert len({len(x) for x in values}) == 1
    machine = load_machine(PENDULUM)
    log = replace(log, effort=replace(log.effort, effort=values[2]), command=None)
    found = identify(machine, read_data(write_bag(path.with_name('noisy'), log), machine),
                     settings=QUICK)  # fmt: skip
    return machine, values, found


@pytest.mark.parametrize('case', DRIVES)
def test_parameters_are_those_of_joint_states(pendulum, tmp_path, monkeypatch, case):
    machine, values, expected = pendulum
    here = sys.modules[__name__]
    monkeypatch.setattr(here, 'SAMPLES', len(values[0]))
    monkeypatch.setattr(
        here, 'truth', lambda n: [np.pad(x, ((0, 0), (0, max(0, n - 2)))) for x in values]
    )
    if case in ('protobuf', 'json'):
        path = write_foxglove(tmp_path / 'log.mcap', case)
    elif case == 'franka_ros1':
        path = Messages(version=1).write(tmp_path / 'log.bag', franka_1(Messages(version=1)))
    else:
        maker = Messages()
        path = maker.write(tmp_path / 'log', CASES[case][0](maker))
    report = check([*read_bag(path, drives=machine.drives)])
    assert report.level != 'error'
    drives = tuple(DRIVES[case][:2])
    named = replace(machine, drives=drives)
    found = identify(named, read_data(path, named, topics=Topics(command='none')), settings=QUICK)
    for mine, other in zip(found.parameters, expected.parameters, strict=True):
        assert mine.low <= other.value <= mine.high, mine.name
