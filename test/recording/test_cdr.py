# SPDX-License-Identifier: Apache-2.0
"""Joint states in CDR: what makes a layout, what is refused, at the edges."""

import struct

import numpy as np
import pytest
from rosbags.typesys import get_typestore, Stores

from ros2_ident.recording.cdr import decode, encode, parse_layout, TooManyNamesError
from ros2_ident.recording.limits import Limits

STAMP = np.array([1_700_000_000_123_456_789, -5_000_000_001], dtype=np.int64)


def message(names=('a', 'bc'), frame='', big=False, sizes=None, stamp=(5, 6)):
    """Return one JointState; the k-th value of the field f is 10 f + k."""
    order = '>' if big else '<'
    out = bytearray(struct.pack(f'{order}iI', *stamp))

    def align(size):
        out.extend(bytes(-len(out) % size))

    def text(value):
        align(4)
        raw = value.encode() + b'\0'
        out.extend(struct.pack(f'{order}I', len(raw)) + raw)

    text(frame)
    align(4)
    out.extend(struct.pack(f'{order}I', len(names)))
    for name in names:
        text(name)
    for f, size in enumerate(sizes or (len(names),) * 3):
        align(4)
        out.extend(struct.pack(f'{order}I', size))
        if size:
            align(8)
            out.extend(struct.pack(f'{order}{size}d', *(10.0 * f + k for k in range(size))))
    return bytes([0, 0 if big else 1, 0, 0]) + bytes(out)


@pytest.mark.parametrize('big', [False, True])
@pytest.mark.parametrize('frame', ['', 'x', 'base_link'])
def test_one_message_in_either_order_of_bytes(big, frame):
    (block,) = decode([message(big=big, frame=frame, stamp=(7, 999_999_999))])
    assert block.names == ('a', 'bc') and block.rows.tolist() == [0]
    assert block.stamp.tolist() == [7_999_999_999]
    assert [x.tolist() for x in block.fields] == [[[0, 1]], [[10, 11]], [[20, 21]]]
    layout = parse_layout(message(big=big, frame=frame))
    assert layout.big is big and layout.stamp == 4


@pytest.mark.parametrize('sizes', [(0, 2, 0), (2, 0, 2), (0, 0, 0)])
def test_empty_fields_are_none(sizes):
    (block,) = decode([message(sizes=sizes)])
    assert [x is not None for x in block.fields] == [size > 0 for size in sizes]
    if sizes[1]:
        assert block.fields[1].tolist() == [[10.0, 11.0]]
    with pytest.raises(ValueError, match='2 names but an array of 1 values'):
        decode([message(sizes=(2, 1, 2))])


def test_what_is_written_comes_back():
    rng = np.random.default_rng(0)
    position, effort = rng.normal(size=(2, 2, 3))
    raw = encode(STAMP, ('one', 'two_', 'three'), (position, None, effort), 'frame')
    (block,) = decode(raw)
    np.testing.assert_array_equal(block.stamp, STAMP)
    np.testing.assert_array_equal(block.fields[0], position)
    np.testing.assert_array_equal(block.fields[2], effort)
    assert block.fields[1] is None and block.names == ('one', 'two_', 'three')
    part = block.taken(np.array([1]))
    assert part.rows.tolist() == [0] and part.stamp.tolist() == STAMP[1:].tolist()
    np.testing.assert_array_equal(part.fields[2], effort[1:])
    assert message() == encode(
        np.array([5_000_000_006]), ('a', 'bc'), [np.array([[f, f + 1.0]]) for f in (0, 10, 20)]
    )[0]  # fmt: skip
    assert decode([]) == []
    (empty,) = decode(encode(STAMP, (), (None, np.empty((2, 0)), None)))
    assert empty.names == () and empty.fields == (None, None, None)


def test_messages_of_one_size_fall_apart_by_their_names_and_not_by_their_frames():
    one, two = message(('a', 'bc')), message(('b', 'cd'))
    other = message(('a', 'bc'), stamp=(9, 9))
    blocks = decode([one, other, two, one])
    assert [x.names for x in blocks] == [('a', 'bc'), ('b', 'cd'), ('a', 'bc')]
    assert [x.rows.tolist() for x in blocks] == [[0, 1], [2], [3]]
    assert blocks[0].stamp.tolist() == [5_000_000_006, 9_000_000_009]
    frames = decode([message(frame='base'), message(frame='tool')])
    assert len(frames) == 1 and frames[0].rows.tolist() == [0, 1]
    # As long, but one field fills what another had.
    one_field = [message(sizes=sizes) for sizes in ((2, 0, 0), (0, 0, 2))]
    assert len(one_field[0]) == len(one_field[1])
    parts = decode(one_field)
    assert [x.fields[0] is None for x in parts] == [False, True]
    assert len(decode([one, message(big=True)])) == 2


@pytest.mark.parametrize(
    ('raw', 'said'),
    [
        (b'\x00\x01\x00', 'no CDR message'),
        (b'\x01' + message()[1:], 'no CDR message'),
        (b'\x00\x02' + message()[2:], 'no CDR message'),
        (message()[:-1], 'message ends early'),
        (message()[:30], 'message ends early'),
        (message() + bytes(9), 'goes on after its end'),
        (message(stamp=(1, 1_000_000_000)), 'more nanoseconds than a second has'),
    ],
)
def test_what_is_no_joint_state_is_refused(raw, said):
    with pytest.raises(ValueError, match=said):
        decode([raw])


def test_names_are_limited_in_number_and_length():
    limits = Limits(joints=3, name=5)
    assert decode([message(('a', 'b', 'c'))], limits)[0].names == ('a', 'b', 'c')
    assert decode([message(('abcde',))], limits)[0].names == ('abcde',)
    with pytest.raises(TooManyNamesError, match='names 4 joints, more than the 3 allowed'):
        decode([message(('a', 'b', 'c', 'd'))], limits)
    with pytest.raises(TooManyNamesError, match='a name of 6 bytes, more than the 5 allowed'):
        decode([message(('abcdef',))], limits)
    assert decode([message(('a',), frame='a long frame')], limits)[0].names == ('a',)


@pytest.mark.parametrize('frame', ['', 'a', 'abc', 'abcde'])
def test_what_is_written_is_what_a_middleware_writes(frame):
    store = get_typestore(Stores.ROS2_JAZZY)
    for length in range(1, 10):
        names = ['n' * length, 'm']
        values = np.arange(2.0) + length
        (data,) = encode(STAMP[:1], names, [values[None], None, -values[None]], frame)
        read = store.deserialize_cdr(data, 'sensor_msgs/msg/JointState')
        assert (read.name, read.header.frame_id) == (names, frame)
        assert read.position.tolist() == values.tolist()
        assert read.effort.tolist() == (-values).tolist() and not read.velocity.size
        # Zeros between what it holds, as everyone else's: the same bytes, the same digest.
        assert data == bytes(store.serialize_cdr(read, 'sensor_msgs/msg/JointState'))
