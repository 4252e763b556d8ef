# SPDX-License-Identifier: Apache-2.0
"""Logs at odd places, beside a metadata.yaml that is another's, and times that no bag can hold."""

import shutil

import numpy as np
import pytest
from reader_cases import equal, make_recording, MS, START
import yaml

from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.recording import read_bag, read_bags, RecordingBuilder, write_bag

UNFIT = 'metadata.yaml does not fit the files; `ros2 bag reindex'


@pytest.fixture(scope='module')
def bag(tmp_path_factory):
    return write_bag(tmp_path_factory.mktemp('places') / 'log', make_recording())


def test_what_cannot_be_read_is_refused_with_the_systems_reason(bag, tmp_path, monkeypatch):
    """A name that was too long was a traceback, and asked to be reported."""
    loop = tmp_path / 'loop'
    loop.symlink_to(loop)
    long = 'cannot be read .File name too long.; give the path of a log'
    rows = [(f'/tmp/{"x" * 300}', long), (f'/tmp/{"x/" * 3000}x.csv', long)]
    for path, said in [*rows, (loop, 'does not exist')]:
        with pytest.raises(IdentError, match=said) as caught:
            read_bag(path)
        assert caught.value.code == ErrorCode.NO_DATA and len(caught.value.message) < 600
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


@pytest.mark.parametrize(
    'change',
    [
        lambda info: info.update(relative_file_paths=['log.mcap', 'log.mcap']),
        lambda info: info.update(relative_file_paths=['log_0.mcap']),
        lambda info: info.update(relative_file_paths=['../../etc/passwd']),
    ],
)
def test_a_whole_log_beside_the_metadata_of_another(bag, tmp_path, change):
    """A file that was named twice was read twice."""
    (read,) = read_bag(with_metadata(bag, tmp_path / 'log', change))
    assert equal([read], read_bag(bag))
    (said,) = read.warnings
    assert UNFIT in said


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
@pytest.mark.parametrize(
    ('begin', 'rest'),
    [(-1_500 * MS, 500 * MS), (-50 * MS, 950 * MS), (39 * 10**17 + 7, 7), (START, START)],
)
def test_times_before_1970_and_after_2038_are_counted_from_0(tmp_path, begin, rest):
    """A scope counts from its trigger on, LabVIEW from 1904: no bag could be written of either."""
    recording = make_recording(200)
    builder = RecordingBuilder('log')
    for role, x in recording.streams.items():
        stamp = x.stamp - START + begin
        builder.add_block(role, stamp, x.names, x.position, x.velocity, x.effort)
    (read,) = builder.build()
    for role, stream in read.streams.items():
        np.testing.assert_array_equal(stream.stamp - rest, recording.streams[role].stamp - START)
    said = f'the stamps begin at {begin * 1e-9:.6g} s, which no ROS time can be'
    assert [said in x for x in read.warnings] == ([] if begin == rest else [True])
    (again,) = read_bag(write_bag(tmp_path / 'bag', read))
    assert equal([again], [read])
