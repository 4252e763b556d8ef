# SPDX-License-Identifier: Apache-2.0
"""Logs of ros2_control: what its controllers publish, and what they are told."""

from dataclasses import replace

import numpy as np
import pytest
from reader_cases import make_recording
from ros2_control_bags import ARRAY, as_ros2_control_records, Maker

from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.recording import check, read_bag, render, Topics
from ros2_ident.recording.cdr import JOINT_STATE
from ros2_ident.recording.content import parse_trajectory, set_points
from ros2_ident.recording.maps import TRAJECTORY

MS = 1_000_000
START = 1_700_000_000_000_000_000
CONTROLLER = '/joint_trajectory_controller/controller_state'


def same(one, two, *fields):
    """Compare fields of the two drives, whatever else there is."""
    for field in fields:
        for name in ('drive_1', 'drive_2'):
            np.testing.assert_array_equal(one.column(field, name), two.column(field, name))


@pytest.mark.parametrize('storage', ['mcap', 'sqlite3'])
@pytest.mark.parametrize('efforts', ['state', 'dynamic', 'output'])
def test_a_bag_of_ros2_control_needs_no_options(tmp_path, storage, efforts):
    recording = make_recording()
    maker = Maker()
    messages = as_ros2_control_records(maker, recording, efforts=efforts)
    (read,) = read_bag(maker.write(tmp_path / 'log', messages, storage))
    np.testing.assert_array_equal(read.command.stamp, recording.command.stamp)
    same(read.state, recording.state, 'position', 'velocity')
    same(read.command, recording.command, 'position')
    source = read.state if efforts == 'state' else read.effort
    same(source, recording.effort, 'effort')
    assert read.warnings == ()
    said = '\n'.join(read.notes)
    assert f'command: no /joint_command, {CONTROLLER} is taken' in said
    chosen = {'dynamic': '/dynamic_joint_states', 'output': CONTROLLER}.get(efforts)
    assert (f'effort: no /effort, {chosen} is taken' in said) == (chosen is not None)


def test_noetic_s_controller_state_is_read_too(tmp_path):
    recording = make_recording()
    maker = Maker(old=True)
    messages = as_ros2_control_records(maker, recording, dynamic=False)
    (read,) = read_bag(maker.write(tmp_path / 'log', messages))
    same(read.command, recording.command, 'position')
    with pytest.raises(IdentError, match='no measured value arrived'):
        read_bag(tmp_path / 'log', Topics('', CONTROLLER, ''))


def namespaced(recording, maker, prefixes):
    """Return state and set-point of arms in namespaces, their joints with a prefix."""
    found = []
    for space, prefix in prefixes.items():
        for role, topic in (('state', 'joint_states'), ('command', 'joint_command')):
            stream = recording.streams[role]
            names = [f'{prefix}{x}' for x in stream.names]
            rate = (
                stream.velocity
                if stream.velocity is not None
                else np.zeros((len(stream.stamp), 0))
            )
            for when, *values in zip(stream.stamp.tolist(), stream.position, rate, strict=True):
                message = maker.joint_state(when, names, *values)
                found.append((when, f'/{space}/{topic}', JOINT_STATE, message))
    return sorted(found, key=lambda x: x[0])


def test_of_two_arms_the_one_of_the_machine_is_read(tmp_path):
    recording, maker = make_recording(), Maker()
    path = maker.write(
        tmp_path / 'two', namespaced(recording, maker, {'left': 'l_', 'right': 'r_'})
    )
    said = 'state: /left/joint_states, /right/joint_states hold one; name one of them by --state-'
    for drives in ((), ('other',)):
        with pytest.raises(IdentError, match=said) as caught:
            read_bag(path, drives=drives)
        assert caught.value.code == ErrorCode.MISSING_STREAM
    (read,) = read_bag(path, drives=('r_drive_1', 'r_drive_2', 'l_drive_1'))
    assert set(read.state.names) == set(read.command.names)
    assert {x[:2] for x in read.state.names} == {'r_'}
    np.testing.assert_array_equal(read.state.position, recording.state.position)
    assert 'command: no /joint_command, /right/joint_command is taken' in '\n'.join(read.notes)
    (read,) = read_bag(path, Topics('/left/joint_states', 'none', 'none'))
    assert {x[:2] for x in read.state.names} == {'l_'}


def test_a_default_topic_in_a_namespace_needs_no_option(tmp_path):
    recording, maker = make_recording(), Maker()
    path = maker.write(tmp_path / 'one', namespaced(recording, maker, {'cell/arm': ''}))
    (read,) = read_bag(path)
    same(read.state, recording.state, 'position', 'velocity')
    same(read.command, recording.command, 'position')
    with pytest.raises(IdentError, match='holds no message of /nowhere, only /cell/arm/joint_com'):
        read_bag(path, Topics(state='/nowhere'))


def forward(maker, recording, fields=('position',)):
    """Return a recording's messages with the set-point as an array of numbers."""
    messages = as_ros2_control_records(maker, recording, dynamic=False)
    kept = [x for x in messages if x[1] == '/joint_states']
    command = recording.command
    for k, stamp in enumerate(command.stamp.tolist()):
        values = np.concatenate([command.values(x)[k] for x in fields])
        array = maker.made(ARRAY, [('layout.dim[].label', ['joints']), ('data', values)])
        kept.append((stamp, '/forward_position_controller/commands', ARRAY, array))
    return kept


def test_an_array_is_read_by_the_names_given(tmp_path):
    recording = make_recording()
    recording = replace(
        recording,
        command=replace(recording.command, velocity=recording.command.position * 3.0),
    )
    maker = Maker()
    path = maker.write(tmp_path / 'log', forward(maker, recording, ('position', 'velocity')))
    topic = '/forward_position_controller/commands'
    (unread,) = read_bag(path)
    assert unread.command is None
    assert (
        f'ok    {topic} (std_msgs/msg/Float64MultiArray) is not read; to read it: '
        f'--command-topic {topic} --joint-names A,B (the joints in its order)'
    ) in render(check([unread]))
    names = ('drive_1', 'drive_2', 'drive_1/velocity', 'drive_2/velocity')
    (read,) = read_bag(path, Topics(command=topic, names=names))
    same(read.command, recording.command, 'position', 'velocity')
    np.testing.assert_array_equal(read.command.stamp, recording.command.stamp)
    assert any('Float64MultiArray has no stamp' in x for x in read.warnings)
    for names, code, said in (
        ((), ErrorCode.INVALID_GOAL, 'is an array without names; name the joints'),
        (('drive_1',), ErrorCode.BAD_VALUES, 'a number for each of the joint names given'),
    ):
        with pytest.raises(IdentError, match=said) as caught:
            read_bag(path, Topics(command=topic, names=names))
        assert caught.value.code == code


# ---------------------------------------------------------------------- trajectories


def parsed(maker, stamp, names, points, arrival=START):
    data = maker.bytes_of(TRAJECTORY, maker.trajectory(stamp, names, points))
    return parse_trajectory(data, arrival)


def quintic(time, length, begin, end):
    """Return the path of least jerk between two rests, and its velocity."""
    s = np.clip(time / length, 0.0, 1.0)
    path = begin + (end - begin) * (10 * s**3 - 15 * s**4 + 6 * s**5)
    return path, (end - begin) / length * (30 * s**2 - 60 * s**3 + 30 * s**4)


def test_a_trajectory_is_followed_as_its_controller_does():
    maker = Maker()
    zero = [0.0, 0.0]
    points = [(0, [0.0, 1.0], zero, zero), (10**9, [2.0, -1.0], zero, zero)]
    (block,) = set_points([parsed(maker, START, 'ab', points)])
    assert block.names == ('a', 'b')
    time = (block.stamp - START) * 1e-9
    assert time[0] == 0.0 and time[-1] == 1.0 and len(time) == 1001
    for column, (begin, end) in enumerate(((0.0, 2.0), (1.0, -1.0))):
        path, speed = quintic(time, 1.0, begin, end)
        np.testing.assert_allclose(block.fields[0][:, column], path, atol=1e-12)
        np.testing.assert_allclose(block.fields[1][:-1, column], speed[:-1], atol=1e-11)


def test_a_later_trajectory_takes_over_from_the_set_point():
    maker = Maker()
    first = parsed(maker, START, 'a', [(0, [0.0]), (10**9, [1.0])])
    # stamp 0: it begins when it arrives
    second = parsed(maker, 0, 'a', [(5 * 10**8, [0.0])], arrival=START + 5 * 10**8)
    (block,) = set_points([first, second])
    time = (block.stamp - START) * 1e-9
    expected = np.interp(time, [0.0, 0.5, 1.0], [0.0, 0.5, 0.0])
    np.testing.assert_allclose(block.fields[0][:, 0], expected, atol=1.1e-3)
    assert time[-1] == 1.0


def test_absurd_trajectories_take_no_memory():
    points = [(0, [0.0] * 6), ((2**31 - 1) * 10**9, [1.0] * 6)]
    with pytest.raises(IdentError, match='of memory, more than'):
        set_points([parsed(Maker(), START, 'abcdef', points)])


def test_trajectories_in_a_bag_are_the_command(tmp_path):
    recording = make_recording()
    maker = Maker()
    records = as_ros2_control_records(maker, recording, dynamic=False)
    messages = [x for x in records if x[1] == '/joint_states']
    names = ['drive_1', 'drive_2']
    points = [(0, [0.0, 0.0], [0.0, 0.0]), (10**8, [0.1, 0.2], [0.0, 0.0])]
    sent = maker.trajectory(0, names, points)
    topic = '/joint_trajectory_controller/joint_trajectory'
    messages.append((START + 5 * MS, topic, TRAJECTORY, sent))
    (read,) = read_bag(maker.write(tmp_path / 'log', messages))
    assert read.command.names == ('drive_1', 'drive_2')
    assert read.command.stamp[0] == START + 5 * MS and read.command.stamp.size == 101
    np.testing.assert_allclose(read.command.position[-1], [0.1, 0.2])
    assert any(f'command: no /joint_command, {topic} is taken' in x for x in read.notes)


@pytest.mark.parametrize(
    'points',
    [
        [],
        [(0, [])],
        [(0, [0.0, 1.0])],
        [(10**8, [0.0]), (0, [1.0])],
        [(0, [np.nan])],
        [(0, [0.0], [0.0, 1.0])],
    ],
)
def test_what_no_controller_can_follow_is_refused(points):
    with pytest.raises(ValueError):
        parsed(Maker(), START, 'a', points)
