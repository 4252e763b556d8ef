# SPDX-License-Identifier: Apache-2.0
"""Bags: written and read back, damaged, empty, of the wrong kind."""

import hashlib
from pathlib import Path

from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
import numpy as np
import pytest
from reader_cases import alike, equal, make_recording, ros_1_file
from rosbags.rosbag2 import CompressionFormat, CompressionMode, Reader, StoragePlugin, Writer
from rosbags.typesys import get_typestore, Stores

from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.recording import read_bag, Topics, write_bag
from ros2_ident.recording.cdr import decode, encode
from ros2_ident.recording.maps import map_of, parser
from ros2_ident.recording.streams import FIELDS

MS = 1_000_000
START = 1_700_000_000_000_000_000
STORE = get_typestore(Stores.ROS2_JAZZY)
JOINT_STATE = 'sensor_msgs/msg/JointState'


@pytest.fixture(scope='module')
def recording():
    return make_recording(2000)


@pytest.fixture(scope='module')
def bag(recording, tmp_path_factory):
    # chunks of MCAP hold a megabyte: several of them make damage interesting
    return write_bag(tmp_path_factory.mktemp('bags') / 'log', recording)


def message(names=('a',), position=(), velocity=(), effort=(), stamp=START, frame=''):
    types = STORE.types
    header = types['std_msgs/msg/Header'](
        stamp=types['builtin_interfaces/msg/Time'](sec=stamp // 10**9, nanosec=stamp % 10**9),
        frame_id=frame,
    )
    arrays = [np.array(x, dtype=np.float64) for x in (position, velocity, effort)]
    return types[JOINT_STATE](header, list(names), *arrays)


def write_messages(path, messages, start=START):
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connection = writer.add_connection('/joint_states', JOINT_STATE, typestore=STORE)
        for k, data in enumerate(messages):
            if not isinstance(data, bytes):
                data = bytes(STORE.serialize_cdr(data, JOINT_STATE))
            writer.write(connection, start + k * MS, data)
    return path


def test_what_is_written_is_read(recording, bag):
    (read,) = read_bag(bag)
    assert equal([read], [recording])
    assert read.source == str(bag)
    assert read.warnings == ()
    file = bag / 'log.mcap'
    expected = hashlib.sha256(file.read_bytes()).hexdigest()
    assert read.sha256 == read_bag(file)[0].sha256 == expected


def test_the_same_streams_give_the_same_bytes(recording, bag, tmp_path):
    again = write_bag(tmp_path / 'log', recording)
    for name in ('log.mcap', 'metadata.yaml'):
        assert (again / name).read_bytes() == (bag / name).read_bytes()


def test_other_tools_read_it(recording, bag):
    with Reader(bag) as reader:
        counts = {x.topic: x.msgcount for x in reader.connections}
        assert 'builtin_interfaces/Time stamp' in reader.connections[0].msgdef.data
        data = next(data for c, _, data in reader.messages() if c.topic == '/joint_states')
    assert counts == {'/joint_states': 2000, '/effort': 2000, '/joint_command': 2000}
    first = STORE.deserialize_cdr(data, JOINT_STATE)
    assert first.name == list(recording.state.names)
    np.testing.assert_array_equal(first.velocity, recording.state.velocity[0])
    assert first.effort.size == 0
    with (bag / 'log.mcap').open('rb') as file:
        indexed = make_reader(file, validate_crcs=True)
        messages = list(indexed.iter_messages(topics=['/effort']))
        assert indexed.get_summary().statistics.message_count == 6000
    assert [m.log_time for _, _, m in messages] == recording.effort.stamp.tolist()
    (block,) = decode([m.data for _, _, m in messages], parser(map_of(JOINT_STATE), 'state'))
    np.testing.assert_array_equal(block.fields[2], recording.effort.effort)


def test_streams_under_other_names(recording, tmp_path):
    path = write_bag(tmp_path / 'log', {'robot/js': recording.state, '/tau': recording.effort})
    (read,) = read_bag(path, Topics(state='/robot/js', effort='tau', command=''))
    assert alike(read.state, recording.state)
    assert read.command is None


def test_nothing_is_overwritten_unasked(recording, bag, tmp_path):
    with pytest.raises(IdentError, match='exists already; remove it or give another directory'):
        write_bag(bag, recording)
    (tmp_path / 'precious.txt').write_text('x')
    for place in (tmp_path, bag):
        with pytest.raises(IdentError, match='is no draft that ident wrote and will not be repl'):
            write_bag(place, recording, mark='draft')
    path = write_bag(tmp_path / 'log', recording, mark='draft')
    write_bag(path, {'/joint_states': recording.state}, mark='draft')
    assert read_bag(path)[0].effort is None
    with pytest.raises(IdentError, match='there is no stream to write'):
        write_bag(tmp_path / 'none', {})


@pytest.mark.parametrize('storage', [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
@pytest.mark.parametrize('mode', [CompressionMode.FILE, CompressionMode.MESSAGE])
def test_compressed_bags_with_and_without_metadata(tmp_path, storage, mode):
    writer = Writer(tmp_path / 'log', version=9, storage_plugin=storage)
    writer.set_compression(mode, CompressionFormat.ZSTD)
    stamp = START + np.arange(50) * MS
    values = np.arange(100.0).reshape(50, 2)
    with writer:
        connection = writer.add_connection('/joint_states', JOINT_STATE, typestore=STORE)
        for k, data in enumerate(encode(stamp, ('a', 'b'), [values, None, None])):
            writer.write(connection, START + k * MS, data)
    (file,) = (x for x in (tmp_path / 'log').iterdir() if x.name != 'metadata.yaml')
    for path in (tmp_path / 'log', file):
        np.testing.assert_array_equal(read_bag(path)[0].state.position, values)
    (tmp_path / 'log' / 'metadata.yaml').unlink()
    np.testing.assert_array_equal(read_bag(tmp_path / 'log')[0].state.position, values)


def test_without_metadata(bag, recording, tmp_path):
    (tmp_path / 'log.mcap').write_bytes((bag / 'log.mcap').read_bytes())
    (read,) = read_bag(tmp_path)
    assert alike(read.state, recording.state)
    assert 'metadata.yaml is missing; `ros2 bag reindex' in read.warnings[0]
    (tmp_path / 'metadata.yaml').write_text('nonsense: [')
    (read,) = read_bag(tmp_path)
    assert alike(read.state, recording.state)
    assert 'metadata.yaml does not fit the files' in read.warnings[0]


def test_a_split_ros_1_bag_gives_the_same_streams(tmp_path):
    recording = make_recording(300)
    middle = int(recording.state.stamp[150])
    for number, (begin, end) in enumerate([(0, middle), (middle, 1 << 62)]):
        ros_1_file(tmp_path / f'log_{number}.bag', recording.between(begin, end))
    (read,) = read_bag(tmp_path)
    assert equal([read], [recording])
    assert read.warnings == ()


def test_messages_without_stamps_get_the_time_of_recording(tmp_path):
    path = write_messages(tmp_path / 'log', [message(position=[1.0], stamp=0)] * 5)
    (read,) = read_bag(path)
    np.testing.assert_array_equal(read.state.stamp, START + np.arange(5) * MS)
    assert 'all header stamps are 0' in read.warnings[0]


def test_invalid_messages_are_left_out_and_counted(tmp_path):
    good = [message(position=[float(k)], stamp=START + k * MS) for k in range(10)]
    good[3] = message(names=('a', 'b'), position=[1.0], stamp=START + 3 * MS)
    good[5] = b'\x00\x01\x00\x00rubbish'
    (read,) = read_bag(write_messages(tmp_path / 'log', good))
    assert read.state.stamp.size == 8
    assert read.warnings == (
        '/joint_states: 2 of 10 messages are no valid JointState and are left out',
    )
    with pytest.raises(IdentError, match='no message of /joint_states is a valid') as caught:
        read_bag(write_messages(tmp_path / 'bad', [good[3]] * 3))
    assert caught.value.code == ErrorCode.BAD_VALUES


def fails(path, code, text, topics=None):
    with pytest.raises(IdentError, match=text) as caught:
        read_bag(path, topics)
    assert caught.value.code.name == code
    assert '\n' not in caught.value.message


def test_errors_name_the_remedy(bag, tmp_path):
    (tmp_path / 'zero.mcap').write_bytes(b'')
    for name in ('text.npz', 'text.xyz'):
        (tmp_path / name).write_text('a,b')
    (tmp_path / 'nothing').mkdir()
    lost = 'holds no message of /js, only'
    for path, code, text, *topics in (
        (tmp_path / 'none', 'NO_DATA', 'does not exist; give the path of a bag'),
        (tmp_path / 'nothing', 'NO_DATA', 'holds no .mcap, .db3 or .bag file'),
        (bag, 'MISSING_STREAM', lost + r' /effort \(sensor_msgs/msg/Joi.*'
         'name the topics of .* or `none` for one that was not', Topics('/js', '', '')),
        (bag, 'MISSING_STREAM', lost, Topics(effort='js')),
        (bag, 'MISSING_STREAM', lost, Topics(command='js')),
        (bag, 'INVALID_GOAL', 'no topic is given', Topics('', '', '')),
        (bag, 'INVALID_GOAL', '/a is given as state and as effort', Topics('/a', 'a', '')),
        (tmp_path / 'zero.mcap', 'DAMAGED_BAG', r'is empty \(0 bytes\)'),
        (tmp_path / 'text.npz', 'DAMAGED_BAG', 'it is no archive of arrays, as numpy.savez'),
        (tmp_path / 'text.xyz', 'INVALID_GOAL', 'is not a format read here; give a bag, .mcap'),
    ):  # fmt: skip
        fails(path, code, text, *topics)
    (read,) = read_bag(bag, Topics(command='none', effort='/js', so_far=True))
    assert (read.command, read.effort) == (None, None)


def test_bags_without_what_is_needed(tmp_path):
    empty = write_messages(tmp_path / 'empty', [])
    fails(empty, 'NO_DATA', 'the bag holds no message; record again')
    with Writer(tmp_path / 'other', version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        kind = 'std_msgs/msg/String'
        connection = writer.add_connection('/joint_states', kind, typestore=STORE)
        data = STORE.serialize_cdr(STORE.types[kind]('x'), kind)
        writer.write(connection, START, bytes(data))
    said = (
        '/joint_states is of type std_msgs/msg/String, of which there is no map; give another as '
    )
    fails(tmp_path / 'other', 'MISSING_STREAM', said)
    said = r'holds no message of /effort, only /joint_states \(std_msgs/msg/String\); name the'
    fails(tmp_path / 'other', 'MISSING_STREAM', said, Topics('', '/effort', 'none'))
    unmeasured = write_messages(tmp_path / 'unmeasured', [message()] * 3)
    fails(unmeasured, 'NO_DATA', 'no measured value arrived')


@settings(max_examples=60, deadline=None)
@given(
    joints=st.lists(
        st.lists(st.text('aäb_1', min_size=1, max_size=9), max_size=4, unique=True), max_size=12
    ),
    filled=st.lists(st.tuples(*[st.booleans()] * 3), min_size=12, max_size=12),
    frame=st.sampled_from(['', 'base', 'base_link']),
)
def test_the_fast_decoder_agrees_with_rosbags(joints, filled, frame):
    data = []
    for k, names in enumerate(joints):
        arrays = [np.arange(len(names)) + 10.0 * k if f else () for f in filled[k]]
        data.append(message(names, *arrays, stamp=START + k, frame=frame))
    raw = [bytes(STORE.serialize_cdr(x, JOINT_STATE)) for x in data]
    blocks = decode(raw, parser(map_of(JOINT_STATE), 'state'))
    assert [i for block in blocks for i in block.rows.tolist()] == list(range(len(raw)))
    for block in blocks:
        for row, place in enumerate(block.rows.tolist()):
            assert list(block.names) == data[place].name
            assert block.stamp[row] == START + place
            for values, field in zip(block.fields, FIELDS, strict=True):
                expected = getattr(data[place], field)
                found = np.empty(0) if values is None else values[row]
                np.testing.assert_array_equal(found, expected)


def test_split_bags_are_read_in_the_order_of_their_numbers(tmp_path):
    for number in (10, 9):
        start = START + number * 10**9
        messages = [message(position=[1.0 * number], stamp=start + k * MS) for k in range(4)]
        part = write_messages(tmp_path / f'part_{number}', messages, start)
        Path(part / f'part_{number}.mcap').rename(tmp_path / f'log_{number}.mcap')
        (part / 'metadata.yaml').unlink()
        part.rmdir()
    (read,) = read_bag(tmp_path)
    np.testing.assert_array_equal(read.state.position[:, 0], [9.0] * 4 + [10.0] * 4)
