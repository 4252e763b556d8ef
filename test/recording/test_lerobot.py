# SPDX-License-Identifier: Apache-2.0
"""LeRobot folders: the same streams as from the bag, and units that are told or asked for."""

from functools import cache
import json

from identify_cases import AXIS_FILE, ROOT
import numpy as np
import pytest

from ros2_ident.cli.main import main
from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.recording import read_bag, Topics

pyarrow = pytest.importorskip('pyarrow', reason='pyarrow is not installed; `make setup` brings it')
from pyarrow import parquet  # noqa: E402

RATE = 30
BAG = ROOT / 'bags/axis_reversals'
# 1024 counts are a quarter of a turn.
CALIBRATION = {'shoulder_pan': {'id': 1, 'range_min': 1500, 'range_max': 1500 + 1024}}
SPAN = 2.0 * np.pi * 1024 / 4095
FACTOR = {'rad': 1.0, 'deg': 180.0 / np.pi, 'percent': 200.0 / SPAN}


@cache
def samples():
    """Return position, effort and set-point of a bundled bag as a loop at 30 Hz sees them."""
    (log,) = read_bag(BAG)
    frames = np.arange(int(log.duration * RATE))
    time = log.state.stamp[0] + frames * (1e9 / RATE)
    values = (log.state.position, log.effort.effort, log.command.position)
    return [
        np.interp(time, x.stamp, y[:, 0])[:, None]
        for x, y in zip((log.state, log.effort, log.command), values, strict=True)
    ]


def write(folder, version, features, episodes=1, names=('shoulder_pan.pos',)):
    """Write a folder as LeRobot does; `features` are arrays (T, D)."""
    data = folder / 'data/chunk-000'
    data.mkdir(parents=True)
    (folder / 'meta').mkdir()
    size = len(next(iter(features.values())))
    episode = np.arange(size) * episodes // size
    frame = np.concatenate([np.arange(np.sum(episode == k)) for k in range(episodes)])
    columns = {k: pyarrow.array(list(v.astype(np.float32))) for k, v in features.items()}
    columns |= {'timestamp': (frame / RATE).astype(np.float32), 'frame_index': frame}
    columns |= {'episode_index': episode, 'index': np.arange(size), 'task_index': 0 * frame}
    table = pyarrow.table(columns)
    if version == 'v3.0':
        parquet.write_table(table, data / 'file-000.parquet')
        (folder / 'meta/episodes/chunk-000').mkdir(parents=True)
    for k in range(episodes if version == 'v2.1' else 0):
        parquet.write_table(table.filter(episode == k), data / f'episode_{k:06d}.parquet')
    about = {'dtype': 'float32', 'shape': [len(names)], 'names': list(names)}
    info = {'codebase_version': version, 'fps': RATE, 'features': dict.fromkeys(features, about)}
    (folder / 'meta/info.json').write_text(json.dumps(info))
    return folder


@pytest.mark.parametrize(('version', 'unit'), [('v2.1', 'rad'), *(('v3.0', x) for x in FACTOR)])
def test_a_folder_is_read_as_its_bag_is(tmp_path, version, unit, capsys):
    position, effort, command = samples()
    scaled = {'observation.state': position * FACTOR[unit], 'action': command * FACTOR[unit]}
    folder = write(tmp_path / 'log', version, {**scaled, 'observation.effort': effort}, 2)
    where = tmp_path / 'so101.json'
    where.write_text(json.dumps(CALIBRATION))
    topics = Topics(position_unit=unit, columns=str(where))
    one, two = read_bag(folder, topics)
    half = len(position) // 2
    for read, rows in ((one, slice(0, half)), (two, slice(half, None))):
        assert read.state.names == read.effort.names == read.command.names == ('shoulder_pan',)
        np.testing.assert_allclose(read.state.position, position[rows], atol=1e-8, rtol=1e-6)
        np.testing.assert_allclose(read.command.position, command[rows], atol=1e-8, rtol=1e-6)
        np.testing.assert_allclose(read.effort.effort, effort[rows], atol=1e-8, rtol=1e-6)
        np.testing.assert_allclose(np.diff(read.state.stamp), 1e9 / RATE, atol=1)
        assert 'number of the frame over 30 Hz: jitter' in read.warnings[0]
    assert two.source.endswith('log/episode_000001')
    file = tmp_path / 'machine.yaml'
    file.write_text(AXIS_FILE.read_text().replace('emps_axis', 'shoulder_pan'))
    words = ['check', str(folder), '--position-unit', unit, '--columns', str(where)]
    main([*words, '--machine', str(file), '--command-topic', 'none'])
    assert 'jitter cannot be seen' in capsys.readouterr().out


ENDS = {'a': (-1.0, 1.0), 'b': (-1.9, 1.7)}
WAVE = np.sin(np.linspace(0.0, 20.0, 200))


@pytest.mark.parametrize(
    ('reach', 'ends', 'unit'),
    [
        ((0.9, 1.5), ENDS, 'rad'),
        ((0.2, 0.1), ENDS, 'rad'),
        ((55.0, 95.0), ENDS, 'deg or percent'),
        ((55.0, 105.0), ENDS, 'deg'),
        ((99.0, 70.0), ENDS, 'percent'),
        ((300.0, 1.0), ENDS, ''),
        ((20.0, 150.0), {}, 'deg'),
        ((0.9, 1.5), {}, 'rad or deg or percent'),
    ],
)
def test_the_unit_is_told_by_the_ends_of_the_joints_or_asked_for(tmp_path, reach, ends, unit):
    values = WAVE[:, None] * np.array([*reach, 50.0]) + [0.0, 0.0, 50.0]
    names = ('a.pos', 'b.pos', 'gripper.pos')
    folder = write(tmp_path / 'log', 'v3.0', {'observation.state': values}, names=names)
    words = {'rad': 'radians', 'deg': 'degrees', 'percent': '-100 to 100 of the travel'}
    if unit not in words:
        able = ' or '.join(words[x] for x in unit.split(' or ')) if unit else 'none of them'
        with pytest.raises(IdentError, match=f'may be {able}; give --position-unit') as caught:
            read_bag(folder, travel=ends)
        assert caught.value.code == ErrorCode.WRONG_UNITS
        return
    (read,) = read_bag(folder, travel={**ends, 'gripper': (-0.2, 1.8)})
    assert f'positions are taken as {words[unit]}' in read.warnings[1]
    low, high = ends.get('b', (-1.0, 1.0))
    scale = {'rad': 1.0, 'deg': np.pi / 180.0, 'percent': (high - low) / 200.0}[unit]
    middle = 0.5 * (low + high) if unit == 'percent' else 0.0
    expected = middle + scale * values[:, 1]
    np.testing.assert_allclose(read.state.column('position', 'b'), expected, atol=1e-5)
    # LeRobot's drivers give a gripper as 0 to 100, whatever the others are in.
    open_ = values[:, 2] if unit == 'rad' else -0.2 + 0.02 * values[:, 2]
    np.testing.assert_allclose(read.state.column('position', 'gripper'), open_, atol=1e-5)


@pytest.mark.parametrize('counts', [4096, 1024])
def test_degrees_are_told_by_their_steps(tmp_path, counts):
    middle = np.array([0.5 * (800 + 3001), 0.5 * (900 + 3000)])
    raw = np.rint(middle + 0.1 * counts * WAVE[:, None] * [1.0, 0.3])
    degrees = (raw - middle) * 360.0 / (counts - 1)
    names = ('a.pos', 'b.pos')
    folder = write(tmp_path / 'log', 'v3.0', {'observation.state': degrees}, names=names)
    (read,) = read_bag(folder, travel=ENDS)
    np.testing.assert_allclose(read.state.position, np.deg2rad(degrees), atol=1e-6)
    assert f'taken as degrees, their steps are those of {counts} counts a turn' in read.warnings[1]


def test_percent_of_two_calibrated_arms_is_told_by_its_steps(tmp_path):
    low, high, names = np.array([800, 900]), np.array([3001, 3100]), ('left_a', 'right_a')
    raw = np.rint(0.5 * (low + high) + 400.0 * WAVE[:, None] * [1.0, 0.3])
    percent = (raw - low) / (high - low) * 200.0 - 100.0
    motors = [
        {'range_min': a, 'range_max': b} for a, b in zip(low.tolist(), high.tolist(), strict=True)
    ]
    motors[1]['drive_mode'] = 1
    percent[:, 1] *= -1.0
    where = tmp_path / 'both.json'
    where.write_text(json.dumps(dict(zip(names, motors, strict=True))))
    titles = [f'{x}.pos' for x in names]
    folder = write(tmp_path / 'log', 'v3.0', {'observation.state': percent}, names=titles)
    (read,) = read_bag(folder, Topics(columns=str(where)))
    expected = (raw - 0.5 * (low + high)) * 2.0 * np.pi / 4095
    np.testing.assert_allclose(read.state.position, expected, atol=1e-6)
    assert 'taken as -100 to 100 of the travel, their steps are those of 4096' in read.warnings[1]


def test_percent_of_the_same_reach_are_not_taken_for_degrees(tmp_path):
    percent = np.rint(1024 + 700 * WAVE[:, None]) / 2048 * 200.0 - 100.0
    folder = write(tmp_path / 'log', 'v3.0', {'observation.state': percent}, names=('a.pos',))
    with pytest.raises(IdentError, match='degrees or -100 to 100 of the travel; give --position'):
        read_bag(folder, travel={'a': (-1.5, 1.5)})


def test_grippers_of_two_arms_are_never_taken_as_angles(tmp_path):
    names = ('left_elbow.pos', 'left_gripper.pos', 'right_elbow.pos', 'right_gripper.pos')
    values = 40.0 * WAVE[:, None] + np.array([0.0, 50.0, 0.0, 50.0])
    folder = write(tmp_path / 'log', 'v3.0', {'observation.state': values}, names=names)
    topics = Topics(position_unit='deg')
    (read,) = read_bag(folder, topics)
    assert read.state.names == ('left_elbow', 'right_elbow')
    said = 'left_gripper, right_gripper: left out, 0 to 100 of a travel that nothing states'
    assert said in read.warnings[1]
    (read,) = read_bag(folder, topics, {'left_gripper': (0.0, 2.0)})
    opened = read.state.column('position', 'left_gripper')
    np.testing.assert_allclose(opened, 0.02 * values[:, 1], atol=1e-6)
    np.testing.assert_allclose(read.state.column('position', 'left_elbow'),
                               np.deg2rad(values[:, 0]), atol=1e-6)  # fmt: skip


def test_names_that_end_in_q_are_radians_and_a_base_is_left_out(tmp_path):
    names = ('kLeftHipPitch.q', 'kLeftKnee.q', 'x.vel', 'theta.vel')
    values = WAVE[:, None] * np.array([0.4, 0.8, 0.2, 30.0])
    features = {'observation.state': values, 'action': values[:, :2]}
    folder = write(tmp_path / 'log', 'v3.0', features, names=names)
    info = json.loads((folder / 'meta/info.json').read_text())
    info['features']['action'] = {**info['features']['action'], 'names': names[:2]}
    (folder / 'meta/info.json').write_text(json.dumps(info))
    (read,) = read_bag(folder)
    assert read.state.names == ('kLeftHipPitch', 'kLeftKnee')
    np.testing.assert_allclose(read.state.position, values[:, :2], atol=1e-6)
    assert read.state.velocity is None
    assert any('x, theta: left out, a velocity without a position' in x for x in read.warnings)
    assert read.notes == ('the action is what was asked for, before the driver limits it',)


@pytest.mark.parametrize(('robot', 'turned'), [('so101_follower', True), ('koch_follower', False)])
def test_a_calibration_states_direction_and_counts(tmp_path, robot, turned):
    percent = 80.0 * WAVE[:, None] * [1.0, 1.0]
    folder = write(
        tmp_path / 'log', 'v3.0', {'observation.state': percent}, names=('a.pos', 'b.pos')
    )
    info = json.loads((folder / 'meta/info.json').read_text())
    (folder / 'meta/info.json').write_text(json.dumps({**info, 'robot_type': robot}))
    where = tmp_path / 'calibration.json'
    where.write_text(
        json.dumps(
            {
                'a': {'drive_mode': 1, 'range_min': 1000, 'range_max': 3000},
                'b': {'drive_mode': 0, 'range_min': 100, 'range_max': 900},
            }
        )
    )
    (read,) = read_bag(folder, Topics(position_unit='percent', columns=str(where)))
    half = np.pi * np.array([2000 / 4095, 800 / 1023])
    sign = np.array([-1.0 if turned else 1.0, 1.0])
    np.testing.assert_allclose(read.state.position, sign * half * percent / 100.0, atol=1e-6)


@pytest.mark.parametrize('grouped', [dict, list])
def test_names_may_stand_in_groups_and_say_what_they_are(tmp_path, grouped):
    names = ('a.pos', 'a.vel', 'b', 'a.current')
    features = {'observation.state': np.stack([WAVE, 2.0 * WAVE, 3.0 * WAVE, 4.0 * WAVE], axis=1)}
    folder = write(tmp_path / 'log', 'v2.1', features, names=names)
    info = json.loads((folder / 'meta/info.json').read_text())
    info['features']['observation.state']['names'] = (
        {'motors': list(names)} if grouped is dict else [list(names[:3]), list(names[3:])]
    )
    info['features']['observation.image'] = {'dtype': 'video', 'shape': [3, 4, 4], 'names': None}
    (folder / 'meta/info.json').write_text(json.dumps(info))
    (read,) = read_bag(folder, Topics(position_unit='rad'))
    assert read.state.names == ('a', 'b') and read.effort.names == ('a',)
    np.testing.assert_allclose(read.state.column('velocity', 'a'), 2.0 * WAVE, atol=1e-6)
    np.testing.assert_allclose(read.state.column('position', 'b'), 3.0 * WAVE, atol=1e-6)
    np.testing.assert_allclose(read.effort.column('effort', 'a'), 4.0 * WAVE, atol=1e-6)


@pytest.mark.parametrize(
    ('file', 'content', 'said'),
    [
        ('meta/info.json', b'{"fps": 30', 'is no description of a LeRobot folder'),
        ('meta/info.json', b'{"codebase_version": "v9", "fps": 1, "features": {}}', 'v2.1 and v3'),
        ('meta/info.json', b'{"codebase_version": "v3.0", "fps": 1, "features": {}}', 'no joints'),
        ('meta/info.json', b'{"codebase_version": "v3.0", "fps": 1%0999d}' % 0, 'too large'),
        ('so101.json', b'{"a": {"range_max": 1%0999d, "range_min": 0}}' % 0, 'no calibration'),
        ('data/chunk-000/file-000.parquet', b'PAR1', 'cannot be read'),
        ('data/chunk-000/file-000.parquet', None, 'holds no data'),
        (
            'meta/info.json',
            b'{"codebase_version": "v3.0", "fps": 1, "features": '
            b'{"observation.state": {"names": ["a", "b"]}}}',
            'names 2 numbers of .*, its rows have 1',
        ),
        ('so101.json', b'{"a": 1}', 'is no calibration of LeRobot'),
        ('so101.json', b'{}', '-100 to 100 is the travel of shoulder_pan, which nothing states'),
    ],
)
def test_what_cannot_be_read_is_said_with_the_remedy(tmp_path, file, content, said):
    folder = write(tmp_path / 'log', 'v3.0', {'observation.state': 50.0 * WAVE[:, None]})
    (folder / file).unlink(missing_ok=True)
    if content is not None:
        (folder / file).write_bytes(content)
    where = folder / 'so101.json'
    with pytest.raises(IdentError, match=said) as caught:
        read_bag(folder, Topics(position_unit='percent', columns=str(where) * where.exists()))
    assert caught.value.code != ErrorCode.INTERNAL and caught.value.message.isprintable()
