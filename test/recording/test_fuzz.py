# SPDX-License-Identifier: Apache-2.0
"""Fuzzing: whatever the bytes are, a log is read, salvaged or refused in one sentence.

`checks/benchmarks/fuzz_readers.py` does the same for hours; what it found is in `corpus/readers`.
"""

from pathlib import Path
import random
import time

from hypothesis import given, HealthCheck, settings
from hypothesis import strategies as st
import numpy as np
import pytest
from reader_cases import COLUMNS, damage, kinds, outcome, START

from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.recording import check, read_bag, RecordingBuilder
from ros2_ident.recording.cdr import decode, JOINT_STATE
from ros2_ident.recording.maps import map_of, parser

CORPUS = Path(__file__).parent / 'corpus' / 'readers'
QUIET = settings(
    max_examples=100,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)


@pytest.fixture(scope='module')
def logs(tmp_path_factory):
    return kinds(tmp_path_factory.mktemp('logs'))


def answered(path):
    """Read and judge; return the refusal, or None."""
    try:
        found = read_bag(path)
    except IdentError as error:
        assert error.code != ErrorCode.INTERNAL
        assert error.message.isprintable(), repr(error.message)
        return error.message
    assert all(x.sentence.isprintable() for x in check(found).findings)
    return None


@pytest.mark.parametrize('path', sorted(CORPUS.iterdir()), ids=lambda x: x.name)
def test_the_corpus_is_answered_at_once(path, tmp_path):
    copy = tmp_path / path.name
    copy.write_bytes(path.read_bytes())
    if path.suffix == '.csv':
        (tmp_path / f'{path.stem}.columns.yaml').write_text(COLUMNS)
    begin = time.process_time()
    answered(copy)
    assert time.process_time() - begin < 10.0


def fuzz(log, room):
    truth = read_bag(log.write(room, log.data))

    @settings(QUIET, max_examples=15)
    @given(st.integers(0, 1 << 32), st.integers(1, 5))
    def run(seed, times):
        outcome(log.write(room, damage(log.data, random.Random(seed), times)), truth)

    run()


def test_damaged_logs_are_answered(logs, tmp_path):
    for name, log in logs.items():
        (tmp_path / name).mkdir()
        fuzz(log, tmp_path / name)


@QUIET
@given(st.binary(max_size=400), st.sampled_from(['mcap', 'db3', 'bag', 'mcap.zstd', 'csv']))
def test_any_bytes_are_answered(tmp_path, data, suffix):
    (tmp_path / 'log.columns.yaml').write_text(COLUMNS)
    heads = {'mcap': b'\x89MCAP0\r\n', 'db3': b'SQLite format 3\0', 'bag': b'#ROSBAG V2.0\n'}
    path = tmp_path / f'log.{suffix}'
    for head in (b'', heads.get(suffix, b'time,q1,q2,tau1,tau2,ref1,ref2\n')):
        path.write_bytes(head + data)
        answered(path)


@QUIET
@given(st.lists(st.binary(max_size=120), max_size=4))
def test_any_message_is_decoded_or_refused(data):
    messages = [b'\x00\x01\x00\x00' + x for x in data]
    try:
        blocks = decode(messages, parser(map_of(JOINT_STATE), 'state'))
    except ValueError:
        return
    assert sum(x.rows.size for x in blocks) == len(messages)


NUMBERS = st.one_of(
    st.floats(allow_nan=True, allow_infinity=True).map(repr),
    st.integers(-(1 << 70), 1 << 70).map(str),
    st.sampled_from(
        ['', ' ', 'nan', '-inf', '1e400', '1e999999999', '1e-999999999', '0x1', '1_0']
    ),
    st.text(max_size=6),
)


@QUIET
@given(
    st.lists(st.lists(NUMBERS, max_size=9), max_size=12),
    st.sampled_from(['utf-8', 'utf-16', 'latin-1', 'utf-8-sig']),
    st.sampled_from(['\n', '\r\n', '\r']),
    st.booleans(),
)
def test_any_table_is_answered(tmp_path, rows, encoding, end, regular):
    names = 'time,q1,q2,tau1,tau2,ref1,ref2'
    lines = [names, *(','.join(row) for row in rows)]
    if regular:  # odd rows among many even ones
        lines[1:1] = [f'{k * 1e-3:.3f},{k % 5},1,2,3,4,5' for k in range(40)]
    path = tmp_path / 'log.csv'
    path.write_bytes(end.join(lines).encode(encoding, 'replace'))
    (tmp_path / 'log.columns.yaml').write_text(COLUMNS)
    answered(path)


STAMPS = st.lists(
    st.one_of(
        st.integers(-(1 << 63), (1 << 63) - 1),
        st.integers(0, 100).map(lambda k: START + k * 1_000_000),
    ),
    min_size=1,
    max_size=40,
)


@QUIET
@given(STAMPS, STAMPS)
def test_any_stamps_make_recordings_or_a_sentence(state, command):
    builder = RecordingBuilder('log')
    try:
        for role, stamp in (('state', state), ('command', command)):
            values = np.arange(len(stamp), dtype=float)[:, None]
            builder.add_block(role, np.array(stamp, dtype=np.int64), ['a'], values)
        found = builder.build()
    except IdentError as error:
        assert error.message.isprintable()
        return
    for part in found:
        assert all((np.diff(x.stamp) > 0).all() for x in part.streams.values())
    check(found)
