# SPDX-License-Identifier: Apache-2.0
"""Robots' own messages: read by their definition and the map of their type, without an option."""

from dataclasses import replace
import json
from pathlib import Path
import sqlite3

from identify_cases import AXIS_FILE
from message_makers import foxglove_log, Messages, write_mcap
import numpy as np
import pytest

from ros2_ident.errors import IdentError
from ros2_ident.identify.run import read_data
from ros2_ident.models import load_machine
from ros2_ident.recording import check, maps, read_bag, render, scan, Topics
from ros2_ident.recording.cdr import encode
from ros2_ident.recording.content import messages_of
from ros2_ident.recording.maps import JOINT_STATE, kinds, map_of, roles_of
from ros2_ident.recording.streams import FIELDS

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


TURN = 2.0 * np.pi
FRANKA = [f'fr3_joint{n}' for n in range(1, 8)]


def unitree(package):
    """Return what a robot of Unitree sends; 2.146e9 rad and 16000 rad/s are no set-point."""
    state = {'motor_state[].q': 'q', 'motor_state[].dq': 'dq', 'motor_state[].tau_est': 'tau'}
    state['tick'] = lambda k, _: 70_000 + 2 * k
    none = {'motor_cmd[].q': 2.146e9, 'motor_cmd[].dq': 16000.0}
    gains = {'motor_cmd[].kp': 60.0, 'motor_cmd[].kd': 5.0}
    command = 'motor_cmd[].q', 'goal'
    return [
        ('/lowstate', f'{package}/msg/LowState', state.items()),
        ('/lowcmd', f'{package}/msg/LowCmd', [*none.items(), *gains.items(), command]),
    ]


def one(topic, kind, **fields):
    """Return a topic, its type, and fields by their paths with `__` for the points."""
    return topic, kind, [(path.replace('__', '.'), value) for path, value in fields.items()]


# Joints, factor to rad, whether there are velocity, effort and set-point; and of each topic the
# type and its fields: a row of `truth` by its name, what a function makes, or what stands there.
CASES = {
    'unitree_go': (LEGS, 1.0, 'vec', unitree('unitree_go')),
    'unitree_hg': ([f'joint_{n}' for n in range(1, 30)], 1.0, 'vec', unitree('unitree_hg')),
    'franka_ros2': (FRANKA, 1.0, 'vec', [one(
        '/franka_robot_state_broadcaster/robot_state', 'franka_msgs/msg/FrankaRobotState',
        header__frame_id=lambda *_: 'base',
        measured_joint_state__name=FRANKA, measured_joint_state__position='q',
        measured_joint_state__velocity='dq', measured_joint_state__effort='tau',
        desired_joint_state__name=FRANKA, desired_joint_state__position='goal',
        desired_joint_state__velocity='dq', desired_joint_state__effort='tau',
    )]),
    'franka_ros1': ([f'panda_joint{n}' for n in range(1, 8)], 1.0, 'vec', [one(
        '/franka_state_controller/franka_states', 'franka_msgs/msg/FrankaState',
        header__frame_id=lambda *_: 'base', q='q', dq='dq', tau_J='tau', q_d='goal',
    )]),
    'lbr': (SEVEN, 1.0, 'ec', [one(
        '/lbr/state', 'lbr_fri_idl/msg/LBRState', measured_torque='tau',
        time_stamp_sec=lambda k, _: (START + k * STEP) // 10**9,
        time_stamp_nano_sec=lambda k, _: (START + k * STEP) % 10**9,
        measured_joint_position='q', commanded_joint_position='goal',
    )]),
    'odrive': (SIX[:1], TURN, 'vec', [
        one('/controller_status', 'odrive_node/msg/ControllerStatus',
            pos_estimate='q', vel_estimate='dq', torque_estimate='tau'),
        one('/control_message', 'odrive_node/msg/ControlMessage', input_pos='goal'),
    ]),
    'ur': (UR, 1.0, 'vec', [one(
        '/ur_rt', 'ur_msgs/msg/RobotStateRTMsg', time=lambda k, _: 321.5 + 0.002 * k,
        q_actual='q', qd_actual='dq', i_actual='tau', q_target='goal',
    )]),
    'xarm': (SIX, 1.0, '', [one('/xarm/robot_states', 'xarm_msgs/msg/RobotMsg', angle='q')]),
    'pid_controller': (['a', 'b'], 1.0, 'vec', [(
        '/pid_controller/controller_state', 'control_msgs/msg/MultiDOFStateStamped',
        [(f'dof_states[].{path}', value) for path, value in (
            ('name', ['a', 'b']), ('reference', 'goal'), ('output', 'tau'), ('feedback', 'q'),
            ('feedback_dot', 'dq'))],
    )]),
    'multi_dof_command': (['a', 'b'], 1.0, 'vc', [
        one('/joint_states', 'sensor_msgs/msg/JointState', name=['a', 'b'], position='q',
            velocity='dq'),
        one('/pid/reference', 'control_msgs/msg/MultiDOFCommand', dof_names=['b', 'a'],
            values=lambda _, x: x['goal'][::-1]),
    ]),
    'interface_values': (['a', 'b'], 1.0, 'vec', [one(
        '/controller_manager/values', 'control_msgs/msg/DynamicInterfaceValues',
        states__interface_names=[*(f'{x}/{y}' for y in FIELDS for x in 'ab'), 'gpio/vacuum'],
        states__values=lambda _, x: [*x['q'], *x['dq'], *x['tau'], 7.0],
        commands__interface_names=['a/position', 'b/position'], commands__values='goal',
    )]),
    'joint_controller_state': (SIX[:1], 1.0, 'vec', [one(
        '/arm_controller/state', 'control_msgs/msg/JointControllerState', set_point='goal',
        command='tau', process_value='q', process_value_dot='dq',
    )]),
}  # fmt: skip
# Those of ROS 1 are no case of ROS 2.
ROS_2 = [case for case in CASES if case != 'franka_ros1']


def sent(maker, case, joints=0):
    """Yield (time, topic, type, message) of a case; of so many joints where it is given."""
    rows = dict(zip(('q', 'dq', 'tau', 'goal'), truth(joints or len(CASES[case][0])), strict=True))
    for k in range(SAMPLES):
        when, now = START + k * STEP, {name: x[k] for name, x in rows.items()}
        for topic, kind, fields in CASES[case][-1]:
            known = [(x, now.get(y, y) if isinstance(y, str) else y) for x, y in fields]
            own = [(x, y(k, now) if callable(y) else y) for x, y in known]
            header = any(name == 'header' for name, _ in maker.store.fielddefs[kind][1])
            yield when, topic, kind, maker.made(kind, own, when if header else None)


def dynamixel(maker):
    kind = 'dynamixel_workbench_msgs/msg/DynamixelStateList'
    for k in range(SAMPLES):
        place = [2048 + 10 * k, 2049 + 10 * k]
        fields = ('name', ['pan', 'tilt']), ('present_position', place)
        message = maker.made(kind, [(f'dynamixel_state[].{x}', y) for x, y in fields])
        yield START + k * STEP, '/dynamixel_state', kind, message


def keyed(maker):
    """Yield those of an interfaces_state_broadcaster: names once, after the first values."""
    q, dq, tau, _ = truth(2)
    keys = [*(f'{x}/{y}' for y in FIELDS for x in 'ab'), 'gpio/vacuum']
    names = maker.made('control_msgs/msg/Keys', [('keys', keys)], START)
    for k in range(SAMPLES):
        values = [*q[k], *dq[k], *tau[k], 7.0]
        when = START + k * STEP
        message = maker.made('control_msgs/msg/Float64Values', [('values', values)], when)
        yield when, '/broadcaster/values', 'control_msgs/msg/Float64Values', message
        if not k:
            yield when, '/broadcaster/names', 'control_msgs/msg/Keys', names


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


@pytest.mark.parametrize('case', ROS_2)
def test_a_robot_s_messages_need_no_option(maker, tmp_path, case):
    joints, factor, holds, _ = CASES[case]
    (read,) = read_bag(maker.write(tmp_path / 'log', sent(maker, case)))
    compare(read, joints, factor, holds)
    assert not any('is not read' in x for x in read.notes)
    assert not any('is NaN' in x for x in render(check([read])))


@pytest.mark.parametrize('case', ROS_2)
def test_a_bag_without_definitions_is_read_by_that_of_the_map(maker, tmp_path, monkeypatch, case):
    # Some of it is decoded before the file ends, as of long logs.
    monkeypatch.setattr('ros2_ident.recording.content._HELD', 9000)
    joints, factor, holds, _ = CASES[case]
    path = maker.write(tmp_path / 'log', sent(maker, case), storage='sqlite3')
    with sqlite3.connect(path / 'log.db3') as base:  # as Humble and before
        base.execute('DROP TABLE IF EXISTS message_definitions')
    base.close()
    (read,) = read_bag(path)
    compare(read, joints, factor, holds)


def test_a_ros_1_bag_is_read_by_its_definitions_and_by_a_map_of_one_s_own(tmp_path):
    maker = Messages(version=1)
    path = maker.write(tmp_path / 'log.bag', sent(maker, 'franka_ros1'))
    (own,) = read_bag(path)
    compare(own, *CASES['franka_ros1'][:3])
    topic = '/franka_state_controller/franka_states'
    fields = f'position: {topic} q, effort: {topic} tau_J, command_position: {topic} q_d'
    (mapped,) = read_by(
        path, tmp_path, f'joints: {{"{", ".join(own.state.names)}": {{{fields}}}}}'
    )
    np.testing.assert_array_equal(mapped.state.position, own.state.position)
    np.testing.assert_array_equal(mapped.effort.effort, own.state.effort)
    np.testing.assert_array_equal(mapped.command.position, own.command.position)
    assert (mapped.state.stamp == own.state.stamp).all()


@pytest.mark.parametrize('storage', ['mcap', 'sqlite3'])
def test_numbers_are_called_as_the_topic_beside_them_says(maker, tmp_path, storage):
    path = maker.write(tmp_path / 'log', keyed(maker), storage=storage)
    for topics in (Topics(), Topics('/broadcaster/values', 'none', 'none')):
        (read,) = read_bag(path, topics)
        compare(read, ['a', 'b'], 1.0, 've')
        assert read.warnings == () and not any('not read' in x for x in read.notes)
    (read,) = read_bag(path, Topics(names=tuple(f'x{n}/velocity' for n in range(7))))
    assert read.state.names == tuple(f'x{n}' for n in range(7)) and read.state.position is None
    alone = [x for x in keyed(maker) if x[1] == '/broadcaster/values']
    path = maker.write(tmp_path / 'alone', alone, storage=storage)
    with pytest.raises(IdentError, match='/broadcaster/values is an array without names; name'):
        read_bag(path, Topics('/broadcaster/values', 'none', 'none'))


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
        for (when, *rest), x in zip(sent(maker, 'unitree_go'), late, strict=True)
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
    states = [x for *_, own, x in sent(maker, 'unitree_go') if own == kind]
    data = [maker.bytes_of(kind, x) for x in states]
    messages.take(range(START, START + len(data)), data)
    messages.decode()
    (block,) = messages.blocks
    assert messages.unstamped and block.stamp.tolist() == [*range(START, START + len(data))]


def test_gains_that_come_with_a_set_point_are_named(maker, tmp_path):
    messages = [*sent(maker, 'unitree_hg', 3)]
    messages[-1][-1].motor_cmd[1].kd = 7.0
    (read,) = read_bag(maker.write(tmp_path / 'log', messages))
    assert read.notes[-1] == (
        '/lowcmd comes with gains: kd of joint_1 5, kd of joint_2 5 to 7, kd of joint_3 5, '
        'kp of joint_1 60, kp of joint_2 60, kp of joint_3 60'
    )


def test_a_counter_that_starts_again_is_no_time(maker, tmp_path):
    messages = [*sent(maker, 'unitree_go')]
    for n, (_, topic, _, message) in enumerate(messages):
        if topic == '/lowstate' and n > SAMPLES:
            message.tick -= 70_000
    (read,) = read_bag(maker.write(tmp_path / 'log', messages))
    assert (np.diff(read.state.stamp) == STEP).all()
    assert any('its counter does not run with the clock' in x for x in read.warnings)


def test_two_set_points_are_not_guessed_between_and_none_is_asked_for(maker, tmp_path):
    messages = [*sent(maker, 'multi_dof_command')]
    messages += [(t, f'{x}_2', *rest) for t, x, *rest in messages if x == '/pid/reference']
    (read,) = read_bag(maker.write(tmp_path / 'log', messages))
    assert read.command is None
    assert any('name one of them by --command-topic' in x for x in read.notes)
    (said,) = (x for x in render(check([read])) if 'there is no command stream' in x)
    assert said.endswith('read the set-point, for which there is a topic')


def test_looking_for_topics_ends_where_all_have_shown_what_they_hold(tmp_path, monkeypatch):
    chunks = []
    unpack = scan.inflate
    monkeypatch.setattr(scan, 'inflate', lambda *x: chunks.append(0) or unpack(*x))
    q, dq, tau, _ = truth(3)
    stamps = START + STEP * np.arange(SAMPLES)
    data = encode(stamps, ['a', 'b', 'c'], [q, dq, tau])
    text, _ = Messages().store.generate_msgdef(JOINT_STATE)

    def read(late):
        path = tmp_path / f'{late}.mcap'
        rows = [('/arm/joint_states', *x) for x in zip(stamps.tolist(), data, strict=True)]
        rows.insert(late, ('/spare/joint_states', START, data[0]))
        write_mcap(path, JOINT_STATE, 'ros2msg', text.encode(), rows, chunk_size=4 * len(data[0]))
        chunks.clear()
        with pytest.raises(IdentError) as refused:
            read_bag(path)
        return len(chunks), refused.value.message

    (early, told), (late, same) = read(1), read(SAMPLES)
    assert '/arm/joint_states' in told and '/spare/joint_states' in told
    assert same.replace(f'{SAMPLES}.mcap', '1.mcap') == told
    assert early < 5 < SAMPLES // 6 < late


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
    text, _ = maker.store.generate_msgdef(JOINT_STATE)
    path = write_mcap(tmp_path / 'log.mcap', JOINT_STATE, 'ros2msg', text.encode(),
                      [(('/one', '/two')[n], t, x) for t, n, x in rows])  # fmt: skip
    (read,) = read_bag(path, Topics(state='/one', effort='', command='/two'))
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
    stamps = START + STEP * np.arange(SAMPLES)
    pairs = zip(stamps.tolist(), encode(stamps, 'ab', [q, dq, None]), strict=True)
    rows = [('/joint_states', *pair) for pair in pairs]
    (read,) = read_bag(
        write_mcap(tmp_path / 'log.mcap', JOINT_STATE, 'ros2idl', text.encode(), rows)
    )
    compare(read, ['a', 'b'], 1.0, 'v')


def test_names_come_from_the_command_line_or_the_machine(maker, tmp_path):
    path = maker.write(tmp_path / 'log', sent(maker, 'lbr'))
    names = tuple('abcdefg')
    (read,) = read_bag(path, Topics(names=names))
    assert read.state.names == read.command.names == names
    (read,) = read_bag(path, drives=names)
    assert read.state.names == names
    # They are found: it is only too short.
    with pytest.raises(IdentError, match='record a motion of several seconds'):
        read_data(path, replace(load_machine(AXIS_FILE), drives=names))
    assert any(
        'joints are called a, b, c, d and 3 more in their order' in x for x in read.warnings
    )
    (read,) = read_bag(path, drives=names[:3])  # of another machine
    assert read.state.names == tuple(SEVEN)
    many = maker.write(tmp_path / 'many', sent(maker, 'unitree_hg'))  # motors that are not there
    (read,) = read_bag(many, drives=('shoulder', 'elbow'))
    assert read.state.names == read.command.names == ('shoulder', 'elbow')
    with pytest.raises(IdentError, match='arrays have to be empty or as long as the names'):
        read_bag(path, Topics(names=names[:3]))


def test_check_lists_every_topic(maker, tmp_path):
    messages = [*sent(maker, 'multi_dof_command'), *sent(maker, 'joint_controller_state')]
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


@pytest.mark.parametrize('kind', [x for x in kinds() if map_of(x) and roles_of(x)])
def test_a_topic_of_bytes_that_are_no_message_is_named(maker, tmp_path, kind):
    form = 'cdr' if '/msg/' in kind else 'json'
    rows = [('/odd', START, b'\x00\x01\x00\x00{')]
    path = write_mcap(tmp_path / 'log.mcap', kind, 'ros2msg', b'nothing', rows, form)
    with pytest.raises(
        IdentError, match='holds no message of /joint_states, .* only /odd .* by --columns'
    ):
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
        assert about.kind == kind and (roles_of(kind) or about.names_of)
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
    path = maker.write(tmp_path / 'log', sent(maker, 'unitree_go'))
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
    path = maker.write(tmp_path / 'log', [*sent(maker, 'unitree_go')][:20])
    with pytest.raises(IdentError, match=said):
        read_by(path, tmp_path, text)


# ---------------------------------------------------------------------- protobuf and JSON


def write_foxglove(path, form, broken=None):
    q, dq, tau, goal = truth(2)
    rows = []
    for k in range(SAMPLES):
        when = START + k * STEP
        joints = [
            {'name': 'ab'[n], 'position': q[k, n], 'velocity': dq[k, n], 'effort': tau[k, n]}
            for n in (0, 1)
        ]
        rows.append(('/joint_states', when, joints))
        rows.append(('/goal', when, [{'name': 'b', 'position': goal[k, 1]}]))
    return foxglove_log(path, form, rows, broken)


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


@pytest.mark.parametrize('fields', ['position effort', 'position velocity effort'])
def test_joint_states_of_ros_in_json_are_those_of_their_bytes(tmp_path, fields):
    # as recorders in Python write them; what was not measured is an empty list
    q, dq, tau, _ = truth(2)
    rows = []
    for k in range(SAMPLES):
        when = START + k * STEP
        stamp = {'sec': when // 10**9, 'nanosec': when % 10**9}
        tables = {'position': q, 'velocity': dq, 'effort': tau}
        told = {x: y[k].tolist() if x in fields and k % 9 else [] for x, y in tables.items()}
        told['position'] = q[k].tolist()
        data = {'header': {'stamp': stamp, 'frame_id': ''}, 'name': ['a', 'b'], **told}
        rows.append(('/joint_states', when, json.dumps(data).encode()))
    path = tmp_path / 'log.mcap'
    write_mcap(path, 'sensor_msgs/msg/JointState', 'jsonschema', b'{}', rows, 'json')
    (read,) = read_bag(path)
    assert not read.warnings
    there = np.arange(SAMPLES) % 9 > 0
    np.testing.assert_array_equal(read.state.position, q)
    np.testing.assert_array_equal(read.state.effort[there], tau[there])
    assert np.isnan(read.state.effort[~there]).all()
    assert (read.state.velocity is None) == ('velocity' not in fields)


def test_json_without_values_or_with_an_absurd_time_is_answered(tmp_path):
    path = tmp_path / 'log.mcap'
    for joints, second, said in (
        ([{'name': 'a'}], 1_700_000_000, 'no measured value arrived'),
        ([{'name': 'a', 'position': 1.0}], 10**30, 'no message of /joint_states is a valid'),
        ([{'name': 'a', 'position': 10**400}], 1_700_000_000, 'no message of /joint_states is'),
        ([{'position': {}}], 1_700_000_000, 'no message of /joint_states is a valid'),
    ):
        stamp = {'sec': second, 'nsec': 0}
        data = json.dumps({'timestamp': stamp, 'joints': joints}).encode()
        rows = [('/joint_states', START, data)]
        write_mcap(path, 'foxglove.JointStates', 'jsonschema', b'', rows, 'json')
        with pytest.raises(IdentError, match=said):
            read_bag(path)
    text = """time: {column: /joint_states timestamp}
joints: {a: {position: "/joint_states joints[0].nothing"}}"""
    path = write_foxglove(path, 'json')
    with pytest.raises(IdentError, match='no measured value arrived'):
        read_by(path, tmp_path, text)


@pytest.mark.parametrize('form', ['protobuf', 'json'])
def test_a_message_that_is_none_is_left_out(tmp_path, form):
    (read,) = read_bag(write_foxglove(tmp_path / 'log.mcap', form, ('/joint_states', 50)))
    assert read.state.stamp.size == SAMPLES - 1
    assert any('1 of 100 messages are no valid' in x for x in read.warnings)
