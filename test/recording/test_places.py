# SPDX-License-Identifier: Apache-2.0
"""Logs at odd places, beside a metadata.yaml that is another's, and times that no bag can hold."""

import errno
import os
from pathlib import Path
import shutil

import numpy as np
import pytest
from reader_cases import make_recording, MS, START
import yaml

from ros2_ident.cli.main import main
from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.recording import read_bag, read_bags, RecordingBuilder, write_bag

ROOT = Path(__file__).parents[2]
UNFIT = 'metadata.yaml does not fit the files; `ros2 bag reindex'


@pytest.fixture(scope='module')
def bag(tmp_path_factory):
    return write_bag(tmp_path_factory.mktemp('places') / 'log', make_recording())


def refused(path, text, code=ErrorCode.NO_DATA):
    with pytest.raises(IdentError, match=text) as caught:
        read_bag(path)
    assert caught.value.code == code
    assert len(caught.value.message) < 600


@pytest.mark.parametrize('name', ['x' * 300, 'x/' * 3000 + 'x.mcap', 'x' * 300 + '.csv'])
def test_a_path_that_the_system_refuses(name, capsys):
    """It was a traceback, and asked to be reported."""
    refused(f'/tmp/{name}', 'cannot be read .File name too long.; give the path of a log')
    assert main(['check', f'/tmp/{name}']) == 2
    assert '[NO_DATA]' in capsys.readouterr().err


@pytest.mark.parametrize('step', ['open', 'iterdir', 'read_bytes'])
def test_what_may_not_be_read(bag, tmp_path, monkeypatch, step):
    shutil.copytree(bag, tmp_path / 'log')
    path = tmp_path / 'log'
    if step == 'read_bytes':
        path = tmp_path / 'log.csv'
        path.write_text('time,q\n0,0\n')

    def closed(*_, **__):
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))

    monkeypatch.setattr(Path, step, closed)
    refused(path, 'cannot be read .Permission denied.; give the path of a log that this user may')


def test_links_that_lead_nowhere(bag, tmp_path):
    loop = tmp_path / 'loop'
    loop.symlink_to(loop)
    refused(loop, 'does not exist')
    inner = tmp_path / 'inner'
    inner.mkdir()
    (inner / 'a.mcap').symlink_to('a.mcap')
    refused(inner, 'holds no .mcap')
    around = tmp_path / 'around'
    shutil.copytree(bag, around)
    (around / 'again').symlink_to(around)
    assert read_bag(around)[0].warnings == ()


# ---------------------------------------------------------------------- metadata.yaml


def with_metadata(bag, folder, change):
    shutil.copytree(bag, folder)
    file = folder / 'metadata.yaml'
    content = yaml.safe_load(file.read_text())
    change(content['rosbag2_bagfile_information'])
    file.write_text(yaml.safe_dump(content))
    return folder


def counts(by):
    def change(info):
        for entry in info['topics_with_message_count']:
            entry['message_count'] += by

    return change


def renamed(info):
    for entry in info['topics_with_message_count']:
        entry['topic_metadata']['name'] += '_2'


@pytest.mark.parametrize(
    'change',
    [
        counts(7),
        counts(-7),
        counts(-1000),
        renamed,
        lambda info: info.update(relative_file_paths=['log.mcap', 'log.mcap']),
        lambda info: info.update(relative_file_paths=['log_0.mcap']),
        lambda info: info.update(relative_file_paths=['../../etc/passwd']),
    ],
)
def test_a_whole_log_beside_the_metadata_of_another(bag, tmp_path, change):
    """The file states its own counts, under checksums; one that was named twice was read twice."""
    (read,) = read_bag(with_metadata(bag, tmp_path / 'log', change))
    assert read.streams == read_bag(bag)[0].streams
    (said,) = read.warnings
    assert UNFIT in said


def test_a_file_that_metadata_does_not_name_is_not_read_and_that_is_said(bag, tmp_path):
    folder = with_metadata(bag, tmp_path / 'log', lambda info: None)
    shutil.copy(folder / 'log.mcap', folder / 'log_1.mcap')
    (read,) = read_bag(folder)
    assert read.state == read_bag(bag)[0].state
    assert UNFIT in read.warnings[0]


def test_messages_that_only_metadata_knows_of_are_lost(bag, tmp_path):
    """A file that was cut does not state how many there were."""
    folder = with_metadata(bag, tmp_path / 'log', counts(7))
    data = (folder / 'log.mcap').read_bytes()
    (folder / 'log.mcap').write_bytes(data[:-1200])
    (read,) = read_bag(folder)
    assert '360 whole messages were read, 21 are lost' in read.warnings[0]
    assert UNFIT not in ' '.join(read.warnings)


# ---------------------------------------------------------------------- the same log twice


def test_one_log_does_not_count_twice(bag, tmp_path):
    """Its intervals would be too narrow by the square root of two."""
    other = write_bag(tmp_path / 'other', make_recording(seed=1))
    assert len(read_bags([bag, other])) == 2
    copy = shutil.copytree(bag, tmp_path / 'copy')
    for paths in ([bag, bag], [bag, other, copy], [str(bag), f'{bag}/../{bag.name}']):
        with pytest.raises(IdentError, match='would count twice; name it once') as caught:
            read_bags(paths)
        assert caught.value.code == ErrorCode.INVALID_GOAL


# ---------------------------------------------------------------------- times


def shifted(by, size=200):
    recording = make_recording(size)
    builder = RecordingBuilder('log')
    for role, x in recording.streams.items():
        builder.add_block(role, x.stamp - START + by, x.names, x.position, x.velocity, x.effort)
    return recording, builder.build()


@pytest.mark.parametrize(
    ('begin', 'rest'),
    [(-1_500 * MS, 500 * MS), (-50 * MS, 950 * MS), (3_900_000_000 * 10**9 + 7, 7)],
)
def test_times_before_1970_and_after_2038_are_counted_from_0(tmp_path, begin, rest):
    """A scope counts from its trigger on, LabVIEW from 1904: no bag could be written of either."""
    recording, (read,) = shifted(begin)
    for role, stream in read.streams.items():
        np.testing.assert_array_equal(stream.stamp - rest, recording.streams[role].stamp - START)
        np.testing.assert_array_equal(stream.values('position'), recording.streams[role].position)
    (said,) = read.warnings
    assert f'the stamps begin at {begin * 1e-9:.6g} s, which no ROS time can be' in said
    (again,) = read_bag(write_bag(tmp_path / 'bag', read))
    assert again.streams == read.streams


@pytest.mark.parametrize('begin', [0, START, (1 << 31) * 10**9 - 200 * MS])
def test_times_that_a_bag_can_hold_stay(begin):
    _, (read,) = shifted(begin)
    assert read.warnings == ()
    assert read.begin == begin


def test_of_two_stretches_only_the_one_that_needs_it_is_moved():
    recording = make_recording(100)
    builder = RecordingBuilder('log')
    for by in (-5 * 10**9, 10**12):
        for role, x in recording.streams.items():
            stamp = x.stamp - START + by
            builder.add_block(role, stamp, x.names, x.position, x.velocity, x.effort)
    first, second = builder.build()
    assert (first.begin, second.begin) == (0, 10**12)
