# SPDX-License-Identifier: Apache-2.0
"""What is lost of a file that is damaged at a known place, to the message and to the byte."""

import struct
import zlib

import numpy as np
import pytest
from reader_cases import (
    JOINT_STATE,
    MAGIC,
    make_recording,
    mcap_bytes,
    message_record,
    raw_messages,
    record,
    ros_1_file,
    TOPICS,
)

from ros2_ident.recording import mcap_scan, rosbag1_scan
from ros2_ident.recording.content import Content
from ros2_ident.recording.damage import Damage, Losses
from ros2_ident.recording.limits import Limits
from ros2_ident.recording.mcap_records import (
    records,
)

RECORDING = make_recording(40)
COUNT = 120  # messages of three topics
MESSAGES = [message_record(TOPICS.index(t), w, d) for w, t, d in raw_messages(RECORDING)]
ROLES = dict(zip(TOPICS, (('state',), ('effort',), ('command',)), strict=True))
INDEX = 40  # messages of a topic


def scanned(tmp_path, data, scan=mcap_scan.scan, **limits):
    path = tmp_path / 'log'
    path.write_bytes(data)
    content = Content(ROLES, Limits(**limits))
    return scan(path, content), content


def starts(data, opcode):
    """Return where the records of a kind begin in an MCAP file."""
    return [begin - 9 for kind, begin, _ in records(data, len(MAGIC)) if kind == opcode]


def changed(data, at, value):
    return data[:at] + value + data[at + len(value) :]


# ---------------------------------------------------------------------- MCAP, whole


@pytest.mark.parametrize(
    'kept', [{}, {'method': 'lz4'}, {'crc': False}, {'early': False}, {'chunk': 0}]
)
def test_of_a_sound_file_nothing_is_lost(tmp_path, kept):
    losses, content = scanned(tmp_path, mcap_bytes(RECORDING, **kept))
    assert losses.text == '' and losses.counted
    assert (losses.whole, losses.messages, losses.unknown, losses.skipped) == (COUNT, 0, 0, 0)
    assert content.counts == dict.fromkeys(TOPICS, INDEX)
    assert content.types == dict.fromkeys(TOPICS, JOINT_STATE)
    for (topic, _), kept_messages in content.messages.items():
        kept_messages.sort()
        stamps = np.concatenate([clock for clock, _ in kept_messages.blocks])
        assert stamps.tolist() == [w for w, t, _ in raw_messages(RECORDING) if t == topic]


def test_the_first_bytes_and_the_last(tmp_path):
    whole = mcap_bytes(RECORDING)
    losses, _ = scanned(tmp_path, changed(whole, 1, b'X'))
    assert losses.whole == COUNT and 'its first bytes are others' in losses.text
    with pytest.raises(Damage, match='no MCAP file'):
        scanned(tmp_path, changed(whole, 1, b'X')[:-1])
    # The checksum of the data is that of every byte before it.
    (end,) = starts(whole, 15)
    losses, _ = scanned(tmp_path, changed(whole, end + 9, struct.pack('<I', 5)))
    assert losses.text == 'the checksum of the file does not fit, those of its blocks do'
    loose = mcap_bytes(RECORDING, chunk=0)
    (end,) = starts(loose, 15)
    losses, _ = scanned(tmp_path, changed(loose, end + 9, struct.pack('<I', 5)))
    assert losses.text == 'the checksum of the file does not fit'
    attached = record(9, bytes(50_000))
    data = whole[: starts(whole, 6)[0]] + attached + whole[starts(whole, 6)[0] :]
    (end,) = starts(data, 15)
    fits = changed(data, end + 9, struct.pack('<I', zlib.crc32(data[:end])))
    assert scanned(tmp_path, fits, chunk=20_000)[0].text == ''


# ---------------------------------------------------------------------- MCAP, damaged


def test_a_wrong_byte_in_a_block_costs_the_block(tmp_path):
    whole = mcap_bytes(RECORDING, chunk=30)
    chunks = starts(whole, 6)
    assert len(chunks) == 4
    at = chunks[1] + 200
    losses, _ = scanned(tmp_path, changed(whole, at, bytes([whole[at] ^ 1])))
    assert (losses.blocks, losses.whole, losses.messages) == (1, 90, 30)
    assert losses.text == '1 block inside is damaged'
    both = changed(changed(whole, at, b'\xaa\xbb'), chunks[3] + 300, b'\xaa\xbb')
    losses, _ = scanned(tmp_path, both)
    assert (losses.blocks, losses.whole, losses.messages) == (2, 60, 60)
    assert losses.text == '2 blocks inside are damaged'


def test_a_block_longer_than_the_file_costs_the_block_and_is_counted_once(tmp_path):
    whole = mcap_bytes(RECORDING, chunk=30)
    at = starts(whole, 6)[1]
    for wrong in (len(whole), 1 << 40):
        losses, _ = scanned(tmp_path, changed(whole, at + 1, struct.pack('<Q', wrong)))
        assert (losses.blocks, losses.whole, losses.messages, losses.end) == (1, 90, 30, None)


@pytest.mark.parametrize('method', ['', 'zstd'])
def test_a_file_that_breaks_off_in_a_block_gives_what_is_whole_in_it(tmp_path, method):
    whole = mcap_bytes(RECORDING, method, chunk=60)
    second = starts(whole, 6)[1]
    end = starts(whole, 15)[0]
    cut = whole[: (second + end) // 2]
    losses, _ = scanned(tmp_path, cut)
    assert losses.end == second and not losses.counted
    assert (60 if method else 80) <= losses.whole < COUNT
    assert losses.text == f'the file breaks off after byte {second} of {len(cut)}'
    losses, _ = scanned(tmp_path, whole[: second + 5])
    assert (losses.end, losses.whole) == (second, 60)
    losses, _ = scanned(tmp_path, whole[:end])
    assert (losses.end, losses.whole, losses.blocks) == (end, COUNT, 0)


def test_loose_messages_are_found_again_after_a_byte_is_lost(tmp_path):
    loose = mcap_bytes(RECORDING, chunk=0, crc=False)
    places = starts(loose, 5)
    assert len(places) == COUNT
    for k in (20, 60, 100):
        at = places[k] + 60
        losses, _ = scanned(tmp_path, loose[:at] + loose[at + 1 :])
        # Its last byte is the next one's first: nobody can tell, but the next begins elsewhere.
        assert (losses.whole, losses.skipped) == (COUNT, 1)
        assert losses.text == '1 bytes make no sense'
        # The kind itself.
        losses, _ = scanned(tmp_path, changed(loose, places[k], b'\x55'))
        assert (losses.whole, losses.messages) == (COUNT - 1, 1)
        assert losses.skipped == len(MESSAGES[k])
    losses, _ = scanned(tmp_path, loose[: places[100] + 30])
    assert (losses.end, losses.whole) == (places[100], 100)


# ---------------------------------------------------------------------- MCAP, topics


def test_topics_described_in_two_ways_are_those_of_a_sound_summary(tmp_path):
    whole = mcap_bytes(RECORDING, crc=False)
    at = whole.index(b'/effort')
    losses, content = scanned(tmp_path, changed(whole, at, b'/affort'))
    assert 'its topics are described in two ways' in losses.text
    assert content.counts['/effort'] == INDEX and losses.whole == COUNT
    # Where its checksum does not fit, the first description stays.
    checked = mcap_bytes(RECORDING)
    late = checked.rindex(b'/effort')
    losses, content = scanned(tmp_path, changed(checked, late, b'/affort'))
    assert losses.text == 'the checksum of its summary does not fit'
    assert content.counts['/effort'] == INDEX and not losses.counted


def test_messages_that_the_file_states_and_does_not_hold_are_missed(tmp_path):
    whole = mcap_bytes(RECORDING, crc=False)
    (table,) = starts(whole, 11)
    first = table + 9 + 46 + 2
    losses, _ = scanned(tmp_path, changed(whole, first, struct.pack('<Q', 43)))
    assert (losses.messages, losses.text) == (3, 'messages are missing')
    losses, _ = scanned(tmp_path, changed(whole, first, struct.pack('<Q', 37)))
    assert (losses.messages, losses.text) == (0, '')


# ---------------------------------------------------------------------- ROS 1


def fields(**values):
    out = b''
    for name, value in values.items():
        raw = name.encode() + b'=' + value
        out += struct.pack('<I', len(raw)) + raw
    return struct.pack('<I', len(out)) + out


def rows_of_1(data, at=13):
    """Yield place, header and data of each record of a ROS 1 bag."""
    while at + 8 <= len(data):
        (size,) = struct.unpack_from('<I', data, at)
        (more,) = struct.unpack_from('<I', data, at + 4 + size)
        begin = at + 8 + size
        yield at, data[at + 4 : at + 4 + size], begin, begin + more
        at = begin + more


def chunks_of_1(data):
    return [(at, end) for at, head, _, end in rows_of_1(data) if b'op=\x05' in head]


@pytest.fixture(scope='module', params=[None, 'BZ2', 'LZ4'])
def bag(request, tmp_path_factory):
    path = tmp_path_factory.mktemp('bag') / 'a.bag'
    ros_1_file(path, RECORDING, request.param, chunk=1 << 12)
    return path.read_bytes()


def walked(tmp_path, data, **limits):
    return scanned(tmp_path, data, rosbag1_scan.scan, **limits)


def test_of_a_sound_ros_1_bag_nothing_is_lost(bag, tmp_path):
    losses, content = walked(tmp_path, bag)
    assert (losses.text, losses.whole, losses.messages) == ('', COUNT, 0)
    assert content.counts == dict.fromkeys(TOPICS, INDEX)
    assert content.types == dict.fromkeys(TOPICS, JOINT_STATE)
    for kept in content.messages.values():
        kept.sort()
        assert kept.lost == 0
        stamps = np.concatenate([clock for clock, _ in kept.blocks])
        assert stamps.tolist() == RECORDING.state.stamp.tolist()
    with pytest.raises(Damage, match='no ROS 1 bag of version 2.0'):
        walked(tmp_path, changed(bag, 2, b'x'))


def test_what_is_lost_with_a_block_of_ros_1(bag, tmp_path):
    chunks = chunks_of_1(bag)
    assert len(chunks) >= 3
    at, end = chunks[1]
    whole_without = {}
    # The compression of a block, and the size it states.
    for name, value in ((b'compression=', b'X'), (b'size=', b'\xff\xff\xff\x7f')):
        place = bag.index(name, at) + len(name)
        losses, _ = walked(tmp_path, changed(bag, place, value))
        whole_without[name] = losses.whole
        assert losses.blocks == 1 and losses.messages == COUNT - losses.whole > 0
    assert len(set(whole_without.values())) == 1
    # A head that makes no sense: the next block is found, the index of this one is skipped.
    losses, _ = walked(tmp_path, changed(bag, at, b'\xff\xff\xff\xff'))
    assert losses.whole == whole_without[b'size=']
    assert losses.skipped == chunks[2][0] - at and losses.end is None
    last, _ = chunks[-1]
    losses, _ = walked(tmp_path, changed(bag, last, b'\xff\xff\xff\xff'))
    assert losses.end == last and losses.whole < COUNT
    # A block that is larger than allowed.
    losses, _ = walked(tmp_path, bag, chunk=100)
    assert losses.blocks == len(chunks) and losses.whole == 0
    assert 'larger than allowed' in losses.text


def test_a_ros_1_bag_that_breaks_off(bag, tmp_path):
    chunks = chunks_of_1(bag)
    at, end = chunks[1]
    before, _ = walked(tmp_path, bag[:at])
    assert before.end is None or before.end == at
    losses, _ = walked(tmp_path, bag[: (at + end) // 2])
    assert losses.end == at
    assert losses.whole >= before.whole > 0 and losses.messages == 0
    if b'compression=none' in bag:
        assert losses.whole > before.whole


def test_an_index_that_is_damaged_or_was_never_written(bag, tmp_path):
    head = bag.index(b'index_pos=') + len(b'index_pos=')
    losses, content = walked(tmp_path, changed(bag, head, bytes(8)))
    assert losses.text == 'it was never closed and has no index'
    assert losses.whole == COUNT and content.counts == dict.fromkeys(TOPICS, INDEX)
    (index,) = struct.unpack_from('<Q', bag, head)
    losses, _ = walked(tmp_path, changed(bag, index, b'\xff\xff\xff\xff'))
    assert 'its index is damaged' in losses.text and losses.whole == COUNT
    for name in (b'conn_count=', b'chunk_count='):
        place = bag.index(name) + len(name)
        (stated,) = struct.unpack_from('<I', bag, place)
        more = changed(bag, place, struct.pack('<I', stated + 1))
        losses, _ = walked(tmp_path, more)
        assert losses.whole == COUNT and losses.messages == 0
        fewer = changed(bag, place, struct.pack('<I', stated - 1))
        losses, _ = walked(tmp_path, fewer)
        assert losses.text == 'its index is damaged'
    # What the index counts and the blocks do not hold is missing.
    info = next(b for _, h, b, _ in rows_of_1(bag, index) if b'op=\x06' in h)
    (count,) = struct.unpack_from('<I', bag, info + 4)
    losses, _ = walked(tmp_path, changed(bag, info + 4, struct.pack('<I', count + 5)))
    assert (losses.messages, losses.text) == (5, 'messages are missing')


def test_an_encrypted_bag_is_refused(tmp_path):
    head = fields(op=b'\x03', index_pos=bytes(8), conn_count=bytes(4), chunk_count=bytes(4))
    plain = b'#ROSBAG V2.0\n' + head + struct.pack('<I', 4) + b'    '
    losses, _ = walked(tmp_path, plain)
    assert losses.whole == 0 and 'never closed' in losses.text
    secret = fields(op=b'\x03', index_pos=bytes(8), conn_count=bytes(4), chunk_count=bytes(4),
                    encryptor=b'AES')  # fmt: skip
    with pytest.raises(Damage, match='the bag is encrypted'):
        walked(tmp_path, b'#ROSBAG V2.0\n' + secret + struct.pack('<I', 4) + b'    ')


# ---------------------------------------------------------------------- the account


def test_what_is_lost_is_said_in_one_sentence():
    losses = Losses(size=100, whole=7)
    assert losses.text == ''
    losses.say('one')
    losses.say('one')
    for word in ('two', 'three', 'four', 'five'):
        losses.say(word)
    assert losses.said == ['one', 'two', 'three', 'four']
    losses.end, losses.blocks, losses.skipped, losses.unknown = 0, 2, 3, 4
    assert losses.text.startswith(
        'the file breaks off after byte 0 of 100 and 2 blocks inside are damaged and 3 bytes make '
        'no sense and 4 messages belong to no topic and one and two'
    )
    losses.expect({'a': 5, 'b': 3}, {'a': 2, 'b': 9})
    assert losses.messages == 3
    losses.expect({'a': 5, 'b': 3}, {'a': 5})
    assert losses.messages == 3
    said = Losses(whole=7, messages=2).sentence('log', 'copy it')
    assert (
        said
        == 'log: is damaged: messages are missing, 7 whole messages were read, 2 are lost; copy it'
    )
    assert 'are lost' not in Losses(whole=7, skipped=1).sentence('log', 'x')
