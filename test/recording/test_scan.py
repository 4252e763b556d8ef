# SPDX-License-Identifier: Apache-2.0
"""What is lost of a file that is damaged at a known place, to the message and to the byte."""

import struct
import zlib

import numpy as np
import pytest
from reader_cases import (
    chunk_record,
    definitions,
    JOINT_STATE,
    MAGIC,
    make_recording,
    mcap_bytes,
    message_record,
    raw_messages,
    record,
    ros_1_file,
    text,
    TOPICS,
)

from ros2_ident.recording import mcap_scan, rosbag1_scan
from ros2_ident.recording.content import Content
from ros2_ident.recording.damage import Damage, Losses
from ros2_ident.recording.limits import Limits
from ros2_ident.recording.mcap_records import (
    Channel,
    parse_chunk,
    read_summary,
    read_text,
    records,
    Schema,
    Summary,
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


def test_records_that_are_none_of_ours_are_passed_over(tmp_path):
    attachment = b'x' * 40
    sound = record(9, attachment + struct.pack('<I', zlib.crc32(attachment)))
    wrong = record(9, attachment + struct.pack('<I', 1))
    bare = record(9, attachment + bytes(4))
    own = record(0x80, b'any') + record(0xFF, b'') + record(12, b'notes' * 9)
    plain = mcap_bytes(RECORDING, crc=False)
    (first, *_) = starts(plain, 6)
    for more, said in ((sound, ''), (bare, ''), (own, ''), (wrong, 'an attachment does not fit')):
        losses, _ = scanned(tmp_path, plain[:first] + more + plain[first:])
        assert losses.whole == COUNT and said in losses.text and bool(losses.text) is bool(said)
    # One that is larger than a block may be is an attachment, or lost.
    for opcode, blocks in ((9, 0), (5, 1), (6, 1)):
        large = record(opcode, bytes(30_000))
        losses, _ = scanned(tmp_path, plain[:first] + large + plain[first:], chunk=29_999)
        assert (losses.whole, losses.blocks) == (COUNT, blocks)
        assert ('larger than allowed' in losses.text) is bool(blocks)


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


def test_lengths_of_a_block_that_disagree(tmp_path):
    whole = mcap_bytes(RECORDING, chunk=30)
    (first, second, *_) = starts(whole, 6)
    length = second - first - 9
    outer = first + 1
    for wrong in (length - 7, length + 3):
        losses, _ = scanned(tmp_path, changed(whole, outer, struct.pack('<Q', wrong)))
        assert (losses.whole, losses.text) == (COUNT, 'the length of a block is damaged')
    inner = first + 9 + 28 + 4
    packed = length - 28 - 4 - 8
    assert struct.unpack_from('<Q', whole, inner) == (packed,)
    for wrong in (packed - 1, packed + 1, 1 << 60):
        losses, _ = scanned(tmp_path, changed(whole, inner, struct.pack('<Q', wrong)))
        assert (losses.blocks, losses.whole, losses.messages) == (1, 90, 30)
    # Without a checksum what stands in a block of another size is taken as far as it goes.
    bare = mcap_bytes(RECORDING, chunk=30, crc=False)
    size = starts(bare, 6)[0] + 9 + 16
    losses, _ = scanned(tmp_path, changed(bare, size, struct.pack('<Q', 5)))
    assert (losses.blocks, losses.whole) == (1, COUNT)


def test_a_block_longer_than_the_file_costs_the_block_and_is_counted_once(tmp_path):
    whole = mcap_bytes(RECORDING, chunk=30)
    at = starts(whole, 6)[1]
    for wrong in (len(whole), 1 << 40):
        losses, _ = scanned(tmp_path, changed(whole, at + 1, struct.pack('<Q', wrong)))
        assert (losses.blocks, losses.whole, losses.messages, losses.end) == (1, 90, 30, None)


def test_an_attachment_larger_than_any_block_is_passed_over(tmp_path):
    whole = mcap_bytes(RECORDING, chunk=30, crc=False)
    at = starts(whole, 6)[2]
    large = record(9, bytes(3_000_001))
    losses, _ = scanned(tmp_path, whole[:at] + large + whole[at:], chunk=1 << 20)
    assert (losses.whole, losses.blocks) == (COUNT, 0)
    # A block of messages is not.
    losses, _ = scanned(tmp_path, whole[:at] + chunk_record(bytes(3_000_001)) + whole[at:],
                        chunk=1 << 20)  # fmt: skip
    assert (losses.whole, losses.blocks) == (COUNT, 1)
    assert 'a block is larger than allowed' in losses.text


def test_a_kind_that_is_damaged_is_told_by_what_is_inside(tmp_path):
    for method in ('lz4', 'zstd'):
        whole = mcap_bytes(RECORDING, method, chunk=30)
        losses, _ = scanned(tmp_path, changed(whole, starts(whole, 6)[2], b'\x07'))
        assert losses.whole == COUNT and 'the kind of a record is damaged' in losses.text


@pytest.mark.parametrize('opcode', [0, 0x10, 0x7F])
def test_after_a_kind_that_is_none_the_next_block_is_found(tmp_path, opcode):
    whole = mcap_bytes(RECORDING, chunk=30)
    (_, second, third, _) = starts(whole, 6)
    losses, _ = scanned(tmp_path, changed(whole, second, bytes([opcode])))
    assert losses.whole == 90 and losses.messages == 30
    assert losses.skipped == third - second
    last = starts(whole, 6)[3]
    losses, _ = scanned(tmp_path, changed(whole, last, bytes([opcode])))
    assert losses.whole == 90 and losses.skipped == starts(whole, 15)[0] - last
    assert losses.end is None


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


def test_inside_a_block_without_checksum_it_goes_on_at_the_next_message(tmp_path):
    raw = b''.join(MESSAGES)
    for k, lost in ((1, [1, 2]), (50, [50]), (119, [119])):
        at = len(b''.join(MESSAGES[:k]))
        damaged = changed(raw, at, b'\x44')
        body = MAGIC + definitions() + chunk_record(damaged, crc=False)
        losses, _ = scanned(tmp_path, body + record(15, bytes(4)))
        # Only what has been seen before is known again.
        assert (losses.whole, losses.blocks) == (COUNT - len(lost), 0)
        assert losses.skipped == sum(len(MESSAGES[x]) for x in lost)
    # Up to an end that is cut.
    body = MAGIC + definitions() + chunk_record(raw[:-5], crc=False) + record(15, bytes(4))
    losses, _ = scanned(tmp_path, body)
    assert (losses.whole, losses.skipped) == (COUNT - 1, len(MESSAGES[-1]) - 5)


# ---------------------------------------------------------------------- MCAP, topics


def test_messages_of_a_channel_that_nobody_describes_are_counted(tmp_path):
    strange = message_record(9, 5, b'x' * 30)
    data = MAGIC + definitions() + b''.join(MESSAGES) + strange * 2 + record(15, bytes(4))
    losses, _ = scanned(tmp_path, data)
    assert (losses.whole, losses.unknown) == (COUNT, 2)
    assert '2 messages belong to no topic' in losses.text


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


def test_a_topic_without_a_message_is_known(tmp_path):
    data = MAGIC + definitions(topics=(*TOPICS, '/none')) + b''.join(MESSAGES)
    _, content = scanned(tmp_path, data + record(15, bytes(4)))
    assert content.counts == dict.fromkeys(TOPICS, INDEX) | {'/none': 0}
    assert content.types['/none'] == JOINT_STATE


def test_messages_that_the_file_states_and_does_not_hold_are_missed(tmp_path):
    whole = mcap_bytes(RECORDING, crc=False)
    (table,) = starts(whole, 11)
    first = table + 9 + 46 + 2
    losses, _ = scanned(tmp_path, changed(whole, first, struct.pack('<Q', 43)))
    assert (losses.messages, losses.text) == (3, 'messages are missing')
    losses, _ = scanned(tmp_path, changed(whole, first, struct.pack('<Q', 37)))
    assert (losses.messages, losses.text) == (0, '')


# ---------------------------------------------------------------------- MCAP, records


def test_a_summary_is_read_where_the_footer_says_or_before_the_end(tmp_path):
    path = tmp_path / 'a'

    def read(data):
        path.write_bytes(data)
        with path.open('rb') as file:
            return read_summary(file, len(data))

    whole = mcap_bytes(RECORDING)
    found = read(whole)
    assert found.counts == dict.fromkeys(range(3), INDEX) and not found.damaged
    assert found.channels[1] == Channel(1, '/effort', 'cdr')
    assert found.schemas == {1: Schema(JOINT_STATE, 'ros2msg')}
    # A byte more or less before it.
    cut = starts(whole, 6)[0] + 50
    for data in (whole[:cut] + whole[cut + 1 :], whole[:cut] + b'xyz' + whole[cut:]):
        moved = read(data)
        assert moved.channels == found.channels and moved.counts == found.counts
    footer = len(whole) - 8 - 20 - 9
    for place in (0, 7, footer + 1, 1 << 60):
        assert read(changed(whole, footer + 9, struct.pack('<Q', place))).channels
    for data in (whole[:-1], whole[:30], b'', changed(whole, footer, b'\x03')):
        assert read(data) is None
    assert read(changed(whole, footer + 1, b'\x15')) is None
    damaged = read(changed(whole, footer - 3, b'\x77'))
    assert damaged.damaged
    assert not read(changed(mcap_bytes(RECORDING, crc=False), footer, whole[footer:][:0])).damaged


def test_a_text_ends_in_its_record():
    raw = text('ab') + text('ä')
    assert read_text(raw, 0) == ('ab', 6) and read_text(raw, 6) == ('ä', 12)
    for wrong in (raw[:5], raw[:11]):
        with pytest.raises((ValueError, struct.error)):
            read_text(wrong, 6 if len(wrong) > 6 else 0)


def test_the_head_of_a_block_says_where_it_begins():
    (head,) = [parse_chunk(chunk_record(b'abc', 'lz4')[9:])]
    assert (head.size, head.method, head.crc) == (3, 'lz4', zlib.crc32(b'abc'))
    assert head.begin == 28 + 4 + 3 + 8
    assert head.begin + head.packed == len(chunk_record(b'abc', 'lz4')) - 9
    for length, known in ((0, True), (16, True), (17, False)):
        name = b'n' * length
        raw = bytes(28) + text(name) + struct.pack('<Q', 7)
        found = parse_chunk(raw)
        assert (found is not None) is known
        if found:
            assert (found.method, found.packed) == (name.decode(), 7)
    assert parse_chunk(bytes(31)) is None
    assert parse_chunk(bytes(28) + text(b'\xff') + bytes(8)) is None


def test_kinds_name_their_serialisation():
    summary = Summary(schemas={1: Schema('pkg/msg/A', 'ros2msg')})
    assert (
        summary.kind(Channel(1, '/a', 'cdr')) == summary.kind(Channel(1, '/a', '')) == 'pkg/msg/A'
    )
    assert summary.kind(Channel(1, '/a', 'json')) == 'pkg/msg/A (json)'
    assert summary.kind(Channel(2, '/a', 'cdr')) == ''


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


@pytest.mark.parametrize(
    ('raw', 'said'),
    [
        (b'\x01\x00\x00', 'ends early'),
        (struct.pack('<I', 5) + b'a=bc', 'makes no sense'),
        (struct.pack('<I', 3) + b'abc', 'makes no sense'),
        (struct.pack('<I', 3) + b'=bc', 'makes no sense'),
    ],
)
def test_headers_of_ros_1_that_make_no_sense(raw, said):
    with pytest.raises(Damage, match=said):
        rosbag1_scan.parse_header(raw)


def test_headers_of_ros_1():
    raw = fields(a=b'1=2', bc=b'')[4:]
    assert rosbag1_scan.parse_header(raw) == {b'a': b'1=2', b'bc': b''}
    assert rosbag1_scan.parse_header(b'') == {}


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
