# SPDX-License-Identifier: Apache-2.0
"""Joint states in CDR: what makes a layout, what is refused, at the edges."""

import struct

import numpy as np
import pytest
from rosbags.typesys import get_typestore, Stores

from ros2_ident.recording.cdr import decode, encode

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


def test_messages_fall_apart_by_names_fields_and_order_of_bytes_and_not_by_frames():
    one, two = message(), message(('b', 'cd'))
    blocks = decode([one, message(stamp=(9, 9), frame='x'), two, message(big=True)])
    assert [x.names for x in blocks] == [('a', 'bc'), ('a', 'bc'), ('b', 'cd'), ('a', 'bc')]
    for block in blocks:
        assert [x.tolist() for x in block.fields] == [[[0, 1]], [[10, 11]], [[20, 21]]]
    assert len(decode([message(frame='base'), message(frame='tool')])) == 1
    # As long, but one field fills what another had.
    parts = decode([message(sizes=sizes) for sizes in ((2, 0, 0), (0, 0, 2))])
    assert [x.fields[0] is None for x in parts] == [False, True]


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


def test_what_is_written_is_what_a_middleware_writes():
    store = get_typestore(Stores.ROS2_JAZZY)
    for length in range(1, 10):
        names = ['n' * length, 'm']
        values = np.arange(2.0) + length
        (data,) = encode(STAMP[:1], names, [values[None], None, -values[None]])
        read = store.deserialize_cdr(data, 'sensor_msgs/msg/JointState')
        assert read.name == names
        assert read.position.tolist() == values.tolist()
        assert read.effort.tolist() == (-values).tolist() and not read.velocity.size
        # Zeros between what it holds, as everyone else's: the same bytes, the same digest.
        assert data == bytes(store.serialize_cdr(read, 'sensor_msgs/msg/JointState'))
