# SPDX-License-Identifier: Apache-2.0
"""Live messages in a file: found again after an end of any kind."""

import os
import subprocess
import sys

import numpy as np
import pytest
from reader_cases import make_recording

from ros2_ident.errors import IdentError
from ros2_ident.recording import read_bag
from ros2_ident.recording.cdr import encode, JOINT_STATE
from ros2_ident.recording.streams import FIELDS
from ros2_ident.recording.write import Spool

TOPICS = {'state': '/joint_states', 'effort': '/effort', 'command': '/joint_command'}


def spooled(spool, recording, rows=slice(None)):
    for role, stream in recording.streams.items():
        data = encode(stream.stamp, stream.names, [stream.values(x) for x in FIELDS])
        spool.add(TOPICS[role], JOINT_STATE, stream.stamp[rows].tolist(), data[rows])


def same(one, two, rows=slice(None)):
    for role, stream in one.streams.items():
        other = two.streams[role]
        np.testing.assert_array_equal(other.stamp, stream.stamp[rows])
        for field in FIELDS:
            if (values := stream.values(field)) is not None:
                np.testing.assert_array_equal(other.values(field), values[rows])


@pytest.fixture
def path(tmp_path):
    return tmp_path / 'spool/live.mcap'


def test_it_is_continued_after_an_end_and_forgotten_when_cleared(path):
    recording = make_recording()
    spool = Spool(path, 1 << 20)
    spooled(spool, recording, slice(0, 70))
    spool.close()
    spool = Spool(path, 1 << 20)
    assert not spool.empty
    spooled(spool, recording, slice(70, None))
    spool.close()
    (read,) = read_bag(path)
    same(recording, read)
    spool = Spool(path, 1 << 20)
    spool.clear()
    assert spool.empty
    spooled(spool, recording, slice(0, 5))
    spool.close()
    (read,) = read_bag(path)
    same(recording, read, slice(0, 5))


def test_a_killed_process_leaves_all_that_it_had_written(path):
    code = (
        'import os, sys; sys.path.insert(0, sys.argv[2])\n'
        'from pathlib import Path\n'
        'from reader_cases import make_recording\n'
        'from recording.test_spool import spooled, Spool\n'
        'spooled(Spool(Path(sys.argv[1]), 1 << 20), make_recording())\n'
        'os.kill(os.getpid(), 9)\n'
    )
    here = os.path.dirname(os.path.dirname(__file__))
    subprocess.run([sys.executable, '-c', code, str(path), here], check=False)
    (read,) = read_bag(path)
    same(make_recording(), read)
    Spool(path, 1 << 20).close()  # nobody holds it


def test_one_process_writes_it(path):
    spool = Spool(path, 1 << 20)
    with pytest.raises(IdentError, match='another process writes it'):
        Spool(path, 1 << 20)
    spool.close()


def test_it_takes_no_more_than_its_limit_and_says_so(path):
    recording = make_recording()
    spool = Spool(path, 20_000)
    for k in range(0, 120, 10):
        spooled(spool, recording, slice(k, k + 10))
    assert 'takes no more' in spool.problem and 'raise spool_size' in spool.problem
    assert path.stat().st_size <= 20_000
    (read,) = read_bag(path)
    assert 10 < read.state.stamp.size < 120
    spool.clear()
    assert spool.problem == ''
