# SPDX-License-Identifier: Apache-2.0
"""Damaged and crafted logs: what is whole is read and what is lost is said, within bounds."""

import json
import re
import resource
import struct
import time

import numpy as np
import pytest
from reader_cases import (
    alike,
    definitions,
    equal,
    JOINT_STATE,
    kinds,
    MAGIC,
    make_recording,
    mcap_bytes,
    message_record,
    MS,
    outcome,
    record,
    ros_1_file,
    rosbags_bag,
    START,
    TOPICS,
)
import zstandard

from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.recording import align, check, read_bag, RecordingBuilder
from ros2_ident.recording.cdr import encode
from ros2_ident.recording.limits import printable
from ros2_ident.recording.streams import FIELDS


@pytest.fixture(scope='module')
def logs(tmp_path_factory):
    return kinds(tmp_path_factory.mktemp('logs'))


def file_of(tmp_path, data, name='a.mcap'):
    path = tmp_path / name
    path.write_bytes(data)
    return path


def refused(path, text, code=ErrorCode.DAMAGED_BAG):
    with pytest.raises(IdentError, match=text) as caught:
        read_bag(path)
    assert caught.value.code == code
    assert '\n' not in caught.value.message
    return caught.value.message


# ---------------------------------------------------------------------- checksums


@pytest.mark.parametrize('kind', ['mcap', 'mcap_plain', 'mcap_lz4'])
def test_no_flipped_byte_passes_in_silence(logs, tmp_path, kind):
    """Every so many bytes of a small log, each with another bit."""
    log = logs[kind]
    truth = read_bag(log.write(tmp_path, log.data))
    assert truth[0].warnings == ()
    for at in range(0, len(log.data), max(61, len(log.data) // 40)):
        data = bytearray(log.data)
        data[at] ^= 1 << at % 8
        assert outcome(log.write(tmp_path, bytes(data)), truth) != 'silent', at


def test_a_sound_db3_is_read_by_sqlite_without_a_word(tmp_path):
    recording = make_recording()
    bag = rosbags_bag(tmp_path / 'log', recording)
    for path in (bag, bag / 'log.db3'):
        (read,) = read_bag(path)
        assert read.warnings == () and alike(read.state, recording.state)
    # With a name that a URI would read otherwise.
    odd = (bag / 'log.db3').rename(bag / 'a b?c#%41.db3')
    assert read_bag(odd)[0].warnings == ()
    odd.with_name(odd.name + '-wal').write_bytes(b'x')
    assert 'holds messages that were never moved into it' in read_bag(odd)[0].warnings[0]


# ---------------------------------------------------------------------- salvage

COUNT = 120  # messages of three topics, in four blocks of 30


@pytest.fixture(scope='module')
def whole(tmp_path_factory):
    """Return logs of every kind by name."""
    recording, room = make_recording(40), tmp_path_factory.mktemp('whole')
    found = {x: mcap_bytes(recording, x, chunk=30) for x in ('zstd', 'lz4', '')}
    found['no crc'] = mcap_bytes(recording, 'zstd', chunk=30, crc=False)
    found['late'] = mcap_bytes(recording, 'zstd', chunk=30, early=False)
    found['loose'] = mcap_bytes(recording, chunk=0, crc=False)
    for name in (None, 'BZ2', 'LZ4'):
        ros_1_file(room / f'{name}.bag', recording, name, chunk=1 << 12)
        found[f'bag {name}'] = (room / f'{name}.bag').read_bytes()
    bag = rosbags_bag(room / 'log', make_recording(600))
    found['db3'] = (bag / 'log.db3').read_bytes()
    return found


def starts(data, opcode):
    """Return where the records of a kind begin in an MCAP file."""
    found, at = [], len(MAGIC)
    while at + 9 <= len(data):
        kind, size = struct.unpack_from('<BQ', data, at)
        found += [at] if kind == opcode else []
        at += 9 + size
    return found


def put(at, value):
    """Return a damage: bytes in place of those at a place, which a function finds."""

    def change(data):
        place = at(data)
        return data[:place] + value + data[place + len(value) :]

    return change


def cut(at):
    return lambda data: data[: at(data)]


def less(at, count=1):
    return lambda data: data[: at(data)] + data[at(data) + count :]


def chunk(number, by=0):
    return lambda data: starts(data, 6)[number] + by


def after(text, by=0, of=0):
    """Return a function that finds the end of the `of`th occurrence of a text."""
    return lambda data: [x.end() for x in re.finditer(re.escape(text), data)][of] + by


RECOVER = '`mcap recover a.mcap` writes a sound file of the same content'
BROKEN = 'the file breaks off after byte'
# kind, damage, messages saved (None: it is refused), sentence
TABLE = [
    ('zstd', put(chunk(1, 200), b'\xaa'), 90, '1 block inside is damaged, 90 whole.* 30 are lost'),
    ('lz4', put(chunk(1, 200), b'\xaa'), 90, f'1 block inside is damaged, 90 whole.*{RECOVER}'),
    ('', put(chunk(1, 200), b'\xaa'), 90, '1 block inside is damaged'),
    ('no crc', put(chunk(2, 41), b'lz4 '), 90, '1 block inside is damaged'),
    ('zstd', put(chunk(1, 1), b'\xff' * 8), 90, '1 block inside is damaged'),
    ('zstd', put(chunk(1, 45), b'\xff' * 8), 90, '1 block inside is damaged'),
    ('zstd', put(chunk(1, 26), b'\x01'), 90, '1 block inside is damaged'),
    ('zstd', put(chunk(1), b'\x07'), 90, 'the checksum of the file does not fit.* 30 are lost'),
    ('no crc', put(chunk(1), b'\x55'), 90, 'bytes make no sense.* 30 are lost'),
    ('zstd', less(chunk(1, 200)), 90, '1 block inside is damaged'),
    ('no crc', less(chunk(1, 200), 60), 90, '1 block inside is damaged'),
    ('', less(chunk(0, 200), 3), 90, '1 block inside is damaged'),
    ('late', put(chunk(0, 200), b'\xaa'), 90, '1 block inside is damaged'),
    ('late', put(chunk(3, 200), b'\xaa'), 90, '1 block inside is damaged'),
    ('zstd', cut(chunk(2)), 60, BROKEN),
    ('zstd', cut(chunk(2, 5)), 60, BROKEN),
    ('', cut(chunk(2, 1500)), 72, BROKEN),
    ('zstd', cut(lambda data: starts(data, 15)[0]), COUNT, BROKEN),
    ('zstd', cut(lambda data: len(data) - 1), COUNT, ''),
    ('loose', less(lambda data: starts(data, 5)[20] + 60), COUNT - 1, '1 bytes make no sense'),
    ('loose', put(lambda data: starts(data, 5)[60], b'\x55'), COUNT - 1, ' 1 are lost'),
    ('loose', cut(lambda data: starts(data, 5)[100] + 30), 100, BROKEN),
    ('zstd', put(lambda data: starts(data, 15)[0] + 9, b'abcd'), COUNT, 'checksum of the file'),
    ('zstd', put(after(b'/effort', -1, -1), b'x'), COUNT, 'the checksum of its summary does not'),
    ('no crc', put(lambda data: starts(data, 11)[0] + 57, b'\x2b'), COUNT, 'messages are missing'),
    ('zstd', put(lambda data: 1, b'X'), None, 'no MCAP file: its first bytes are others'),
    ('bag None', put(after(b'compression=', 0, 1), b'X'), None, '`rosbag reindex a.bag`'),
    ('bag BZ2', put(after(b'BZh9', 9, 1), b'XXX'), 89, '1 block inside is damaged.* 31 are lost'),
    ('bag LZ4', put(after(b'size=', 90, 1), bytes(80)), 89, '1 block inside is damaged'),
    ('bag None', cut(lambda data: len(data) // 2), None, '`rosbag reindex a.bag`'),
    ('bag BZ2', put(after(b'index_pos='), bytes(8)), None, 'not indexed.*`rosbag reindex a.bag`'),
    ('bag None', put(lambda data: 2, b'x'), None, 'magic is invalid'),
    ('db3', cut(lambda data: len(data) // 2), None, '`sqlite3 a.db3 .recover`'),
    ('db3', put(lambda data: 4096 * 9, bytes(4096)), None, '`sqlite3 a.db3 .recover`'),
    ('db3', put(lambda data: 2, b'x'), None, 'not a database'),
]


@pytest.mark.parametrize('row', range(len(TABLE)))
def test_what_of_a_damaged_log_is_saved_and_said(whole, tmp_path, row):
    kind, change, saved, sentence = TABLE[row]
    suffix = {'bag': '.bag', 'db3': '.db3'}.get(kind[:3], '.mcap')
    path = file_of(tmp_path, change(whole[kind]), f'a{suffix}')
    if saved is None:
        refused(path, sentence)
        return
    (read, *_) = read_bag(path)
    assert sum(x.stamp.size for x in read.streams.values()) == saved
    assert re.search(sentence, ' '.join(read.warnings)), read.warnings
    truth = make_recording(40)
    for role, stream in read.streams.items():
        rows = np.searchsorted(truth.streams[role].stamp, stream.stamp)
        for field in FIELDS:
            if (values := stream.values(field)) is not None:
                np.testing.assert_array_equal(values, truth.streams[role].values(field)[rows])


def test_of_a_sound_log_nothing_is_lost(whole, tmp_path):
    for kind, data in whole.items():
        suffix = {'bag': '.bag', 'db3': '.db3'}.get(kind[:3], '.mcap')
        (read,) = read_bag(file_of(tmp_path, data, f'a{suffix}'))
        assert read.warnings == (), kind
        assert equal([read], [make_recording(600 if kind == 'db3' else 40)])


def test_files_of_a_bag_follow_each_other_as_its_metadata_say(tmp_path):
    builder, early = RecordingBuilder('x'), make_recording(seed=1)
    for role, stream in make_recording().streams.items():
        later = stream.stamp + 1000 * MS
        builder.add_block(role, later, stream.names, *map(stream.values, FIELDS))
    (moved,) = builder.build()
    for name, recording in (('log_0.mcap', moved), ('log_1.mcap', early)):
        (tmp_path / name).write_bytes(mcap_bytes(recording, crc=False))
    topics = [{'topic_metadata': {'name': t}, 'message_count': 240} for t in TOPICS]
    notes = {'topics_with_message_count': topics}
    notes['relative_file_paths'] = ['log_0.mcap', 'log_1.mcap']
    (tmp_path / 'metadata.yaml').write_text(json.dumps({'rosbag2_bagfile_information': notes}))
    one, two = read_bag(tmp_path)
    assert alike(one.state, moved.state) and alike(two.state, early.state)
    assert one.warnings == ()


def test_a_compressed_file_that_is_cut_is_read_as_far_as_it_goes(tmp_path):
    whole = mcap_bytes(make_recording(), chunk=30)
    frames = [whole[:20_000], whole[20_000:]]
    packed = b''.join(map(zstandard.ZstdCompressor().compress, frames))
    path = file_of(tmp_path, packed, 'a.mcap.zstd')
    assert read_bag(path)[0].warnings == ()
    path.write_bytes(packed[:-3])
    (said,) = read_bag(path)[0].warnings
    assert 'the file breaks off' in said
    path.write_bytes(packed[:-300] + bytes(300))
    assert 'it cannot be unpacked to its end' in read_bag(path)[0].warnings[0]


# ---------------------------------------------------------------------- bombs


def small_memory(path, text, code=ErrorCode.DAMAGED_BAG):
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    begin = time.process_time()
    refused(path, text, code)
    assert time.process_time() - begin < 5.0
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 400_000  # KiB


@pytest.mark.parametrize('claimed', [None, 1000])
def test_a_block_that_unpacks_to_more_than_the_bound_is_refused(tmp_path, claimed):
    packed = zstandard.ZstdCompressor().compress(bytes(129 << 20))
    head = struct.pack('<QQQI', 0, 0, claimed or 129 << 20, 0) + struct.pack('<I', 4) + b'zstd'
    chunk = record(6, head + struct.pack('<Q', len(packed)) + packed)
    path = file_of(tmp_path, MAGIC + record(1, bytes(8)) + definitions() + chunk)
    text = 'claims to unpack to 129 MiB, more than the 128 MiB allowed .ROS2_IDENT_MAX_CHUNK'
    small_memory(path, '1 block inside is damaged' if claimed else text)


def test_a_file_that_would_fill_the_disk_is_refused(tmp_path):
    packed = zstandard.ZstdCompressor().compress(bytes(257 << 20))
    path = file_of(tmp_path, packed, 'a.mcap.zstd')
    text = 'unpacks from .* KiB to more than 256 MiB, the most .* raise ROS2_IDENT_MAX_UNPACKED'
    small_memory(path, text)


def loose_log(tmp_path, body, kind=JOINT_STATE):
    """Write a log of records without a block."""
    head = MAGIC + record(1, bytes(8)) + definitions(kind)
    return file_of(tmp_path, head + body + record(15, bytes(4)))


def joint_log(tmp_path, names, count=3):
    stamp = START + np.arange(count) * MS
    data = encode(stamp, names, [np.zeros((count, len(names))), None, None])
    body = b''.join(message_record(0, int(t), x) for t, x in zip(stamp, data, strict=True))
    return loose_log(tmp_path, body)


def test_names_are_bounded_in_number_and_length(tmp_path, monkeypatch):
    bad = ErrorCode.BAD_VALUES
    raised = {'ROS2_IDENT_MAX_JOINTS': '1001', 'ROS2_IDENT_MAX_NAME': '257'}
    for variable, value in raised.items():
        monkeypatch.setenv(variable, value)
    path = joint_log(tmp_path, [f'j{k}' for k in range(1_001)])
    (tmp_path / 'long').mkdir()
    long = joint_log(tmp_path / 'long', ['x' * 257])
    assert read_bag(path)[0].state.stamp.size == read_bag(long)[0].state.stamp.size == 3
    for variable in raised:
        monkeypatch.delenv(variable)
    begin = time.process_time()
    refused(path, 'names 1001 joints, more than the 1000 allowed.*ROS2_IDENT_MAX_JOINTS', bad)
    assert time.process_time() - begin < 2.0
    refused(long, 'name of 257 bytes, more than the 256', bad)


@pytest.mark.parametrize('name', ['\x1b[2J\x1b]0;owned\x07', 'x\ndrives: [y]', '', ' '])
def test_a_name_that_cannot_be_shown_is_refused(tmp_path, name):
    path = joint_log(tmp_path, [name, 'b'], 50)
    said = refused(path, 'state names a joint .*; (re)?name the joint', ErrorCode.BAD_VALUES)
    assert said.isprintable()


def test_control_sequences_never_reach_the_terminal(tmp_path):
    kind = '\x1b[31mstd_msgs/msg/String'
    path = loose_log(tmp_path, message_record(0, START, b'x'), kind)
    assert refused(path, 'is of type', ErrorCode.MISSING_STREAM).isprintable()
    assert printable('a\u202eb' + 'c' * 300, 10) == r'a\u202ebc…'


# ---------------------------------------------------------------------- clocks


def moved(recording, begin, end, by):
    """Return a recording in which some samples' stamps are off by some ns."""
    builder = RecordingBuilder('log')
    for role, x in recording.streams.items():
        stamp = x.stamp.copy()
        stamp[begin:end] += by
        builder.add_block(role, stamp, x.names, x.position, x.velocity, x.effort)
    return builder.build()


def test_a_clock_that_is_set_splits_the_recording():
    """It laid a grid over the gap: 80 GiB."""
    recording = make_recording(2000)
    parts = moved(recording, 900, None, 3_000_000 * 10**9)
    assert [x.state.stamp.size for x in parts] == [900, 1100]
    assert 'nothing came for up to 3e+06 s' in parts[0].warnings[0]
    for part in parts:
        assert align(part, recording.state.names, 1e-3).cycles == part.state.stamp.size
    assert any(x.code == 'segments' for x in check(parts).findings)


@pytest.mark.parametrize('by', [1 << 52, -(1 << 52), 1 << 32, -(1 << 32)])
def test_one_wrong_stamp_costs_one_message(by):
    recording = make_recording(2000)
    (read,) = moved(recording, 900, 901, by)
    assert read.state.stamp.size == 1999
    assert 'state: messages with stamps up to' in read.warnings[0]
    assert read.warnings[0].endswith('are left out: 1, the first is number 901')


def test_log_times_and_nanoseconds_beyond_their_range_are_left_out(tmp_path):
    good = encode(START + np.arange(9) * MS, ['a'], [np.zeros((9, 1)), None, None])
    bad = good[0][:8] + struct.pack('<I', 4_000_000_000) + good[0][12:]
    body = message_record(0, (1 << 64) - 1, good[0]) + message_record(0, START, bad)
    body += b''.join(message_record(0, START + k, x) for k, x in enumerate(good))
    path = loose_log(tmp_path, body)
    (read,) = read_bag(path)
    assert read.state.stamp.size == 9
    assert '2 of 11 messages are no valid JointState' in read.warnings[0]
