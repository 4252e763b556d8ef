# SPDX-License-Identifier: Apache-2.0
"""The messages of a ROS 1 bag, whole or damaged (wiki.ros.org/Bags/Format/2.0).

The file is walked record by record as it was written, without its index, so that a bag that was
cut off or never indexed gives what is whole. The index at its end is only used for what it says of
topics and numbers of messages. The format has no checksums.
"""

from collections import Counter
from dataclasses import dataclass, field
from functools import cache, partial
import mmap
from pathlib import Path
import struct
from typing import BinaryIO

from rosbags.typesys import get_types_from_msg, get_typestore, Stores
from rosbags.typesys.msg import normalize_msgtype
from rosbags.typesys.store import Typestore

from ros2_ident.recording.content import Content, Sink
from ros2_ident.recording.damage import Damage, Losses
from ros2_ident.recording.inflate import Budget, inflate, unpack_head
from ros2_ident.recording.ros2_control import CONTROLLER_STATE

MAGIC = b'#ROSBAG V2.0\n'
_MESSAGE, _BAG, _INDEX, _CHUNK, _INFO, _CONNECTION = 2, 3, 4, 5, 6, 7
_METHODS = {b'none': '', b'bz2': 'bz2', b'lz4': 'lz4'}
_U32, _U64, _TIME = struct.Struct('<I'), struct.Struct('<Q'), struct.Struct('<II')
# No header is longer but a connection's, which holds the text of the message definition.
_LONGEST = 1 << 16
# The fields of ROS 1's joint_trajectory_controller, which rosbags does not know.
_CONTROLLER_STATE = '''
std_msgs/Header header
string[] joint_names
trajectory_msgs/JointTrajectoryPoint desired
trajectory_msgs/JointTrajectoryPoint actual
trajectory_msgs/JointTrajectoryPoint error
'''
_CHUNK_FIELD = b'\x04\x00\x00\x00op=\x05'

Fields = dict[bytes, bytes]


@dataclass
class _Way:
    topic: str
    target: Sink | None
    count: int = 0


@dataclass
class _Index:
    """What the end of a bag says: connections, and the messages of each."""

    connections: dict[int, tuple[str, str]] = field(default_factory=dict)
    counts: Counter[int] = field(default_factory=Counter)
    complete: bool = False


def parse_header(data: bytes) -> Fields:
    """Return the fields of a record's header.

    Raises:
        Damage: It makes no sense.
    """
    found: Fields = {}
    at, end = 0, len(data)
    while at < end:
        if at + 4 > end:
            raise Damage('a header ends early')
        (size,) = _U32.unpack_from(data, at)
        text = data[at + 4 : at + 4 + size]
        name, mark, value = text.partition(b'=')
        if len(text) != size or not mark or not name:
            raise Damage('a header makes no sense')
        found[name] = value
        at += 4 + size
    return found


def _number(fields: Fields, name: bytes, kind: struct.Struct = _U32) -> int:
    value = fields.get(name, b'')
    if len(value) != kind.size:
        raise Damage('a header makes no sense')
    return int(kind.unpack(value)[0])


def _operation(fields: Fields) -> int:
    value = fields.get(b'op', b'')
    return value[0] if len(value) == 1 else 0


def scan(path: Path, content: Content) -> Losses:
    """Read the whole messages of a ROS 1 bag into a bag's content, as they are.

    Args:
        path: The file.
        content: What to fill.

    Returns:
        What is lost of the file; its text is empty where nothing is.

    Raises:
        Damage: The file is no ROS 1 bag, or is encrypted.
    """
    size = path.stat().st_size
    with path.open('rb') as file:
        if file.read(len(MAGIC)) != MAGIC:
            raise Damage('no ROS 1 bag of version 2.0: its first bytes are others')
        walk = _Walk(file, size, content)
        walk.run()
        return walk.finish()


class _Walk:
    """The state of reading one file."""

    def __init__(self, file: BinaryIO, size: int, content: Content) -> None:
        self.file, self.size, self.content = file, size, content
        self.losses = Losses(size=size)
        self.budget = Budget(size, content.limits)
        self.ways: dict[int, _Way] = {}
        self.strange = 0
        self.index_at = 0
        self.defined: dict[int, tuple[str, str]] = {}
        self.index = self._read_index()

    # ------------------------------------------------------------------ records

    def _record(self, at: int) -> tuple[Fields, int, int] | None:
        """Return header, begin and end of the data of a record; None where it makes no sense."""
        self.file.seek(at)
        head = self.file.read(4)
        if len(head) < 4:
            return None
        (size,) = _U32.unpack(head)
        if not 0 < size <= min(_LONGEST, self.size - at - 8):
            return None
        data = self.file.read(size + 4)
        if len(data) < size + 4:
            return None
        try:
            fields = parse_header(data[:size])
        except Damage:
            return None
        begin = at + 8 + size
        return fields, begin, begin + int(_U32.unpack_from(data, size)[0])

    def run(self) -> None:
        """Walk over the chunks."""
        at = len(MAGIC)
        while at < self.size:
            found = self._record(at)
            if found is None or found[2] > self.size:
                begin, at = at, self._resume(at, found)
                if not at:
                    return
                self.losses.skipped += at - begin
                continue
            fields, begin, end = found
            kind = _operation(fields)
            if kind == _CHUNK:
                self._chunk(fields, begin, end)
            elif kind == _CONNECTION:
                self.file.seek(begin)
                self._define(fields, self.file.read(end - begin))
            elif kind == _MESSAGE:
                self.file.seek(begin)
                self._message(fields, self.file.read(end - begin))
            elif kind not in (_BAG, _INDEX, _INFO):
                self.losses.skipped += end - at
            at = end

    def _resume(self, at: int, broken: tuple[Fields, int, int] | None) -> int:
        """Return where the next chunk begins after a record that makes no sense; 0 for none."""
        with mmap.mmap(self.file.fileno(), 0, access=mmap.ACCESS_READ) as data:
            place = data.find(_CHUNK_FIELD, at + 16)
            while place >= 0:
                for begin in range(place - 4, max(at, place - 64), -1):
                    found = self._record(begin)
                    chunk = found is not None and _operation(found[0]) == _CHUNK
                    if chunk and found is not None and found[2] <= self.size:
                        return begin
                place = data.find(_CHUNK_FIELD, place + 1)
        if self.losses.end is None and at != self.index_at:
            self.losses.end = at
        if broken is not None and _operation(broken[0]) == _CHUNK:
            fields, begin, _ = broken
            self.file.seek(begin)
            packed = self.file.read(self.budget.limits.chunk)
            method = _METHODS.get(fields.get(b'compression', b''), '?')
            if method != '?':
                self._walk_chunk(unpack_head(method, packed, self.budget.limits.chunk), cut=True)
        return 0

    # ------------------------------------------------------------------ chunks

    def _chunk(self, fields: Fields, begin: int, end: int) -> None:
        method = _METHODS.get(fields.get(b'compression', b''), '?')
        try:
            size = _number(fields, b'size')
            if end - begin > self.budget.limits.chunk:
                raise Damage('a block is larger than allowed')
            self.budget.take(size)
            self.file.seek(begin)
            raw = inflate(method, self.file.read(end - begin), size)
        except Damage as exc:
            self.losses.blocks += 1
            if 'allowed' in str(exc):
                self.losses.say(str(exc))
            return
        self._walk_chunk(raw)

    def _walk_chunk(self, raw: bytes, *, cut: bool = False) -> None:
        """Take the messages of a chunk up to where it makes no sense."""
        at, size = 0, len(raw)
        while at + 8 <= size:
            (length,) = _U32.unpack_from(raw, at)
            begin = at + 8 + length
            if begin > size:
                break
            end = begin + int(_U32.unpack_from(raw, begin - 4)[0])
            if end > size:
                break
            try:
                fields = parse_header(raw[at + 4 : begin - 4])
                kind = _operation(fields)
                if kind == _MESSAGE:
                    self._message(fields, raw[begin:end])
                elif kind == _CONNECTION:
                    self._define(fields, raw[begin:end])
                else:
                    break
            except Damage:
                break
            at = end
        if at < size and not cut:
            self.losses.blocks += 1
            self.losses.skipped += size - at

    # ------------------------------------------------------------------ messages

    def _define(self, fields: Fields, data: bytes) -> None:
        try:
            number = _number(fields, b'conn')
            self.defined.setdefault(number, _described(fields, data))
        except Damage:
            self.losses.skipped += len(data)

    def _way(self, number: int) -> _Way | None:
        described = self.index.connections.get(number) or self.defined.get(number)
        if described is None:
            return None
        topic, kind = described
        target = self.content.open(topic, kind, partial(_cdr_of_ros1, kind))
        way = self.ways[number] = _Way(topic, target)
        return way

    def _message(self, fields: Fields, data: bytes) -> None:
        time = fields.get(b'time', b'')
        if len(time) != _TIME.size:
            raise Damage('a message has no time')
        number = _number(fields, b'conn')
        way = self.ways.get(number) or self._way(number)
        if way is None:
            self.strange += 1
            return
        way.count += 1
        if way.target is not None:
            seconds, nanoseconds = _TIME.unpack(time)
            way.target.append(seconds * 1_000_000_000 + nanoseconds, data)

    # ------------------------------------------------------------------ the index

    def _read_index(self) -> _Index:
        """Read connections and counts of messages at the end of the file, as far as they go."""
        index = _Index()
        found = self._record(len(MAGIC))
        if found is None or _operation(found[0]) != _BAG:
            return index
        fields = found[0]
        if fields.get(b'encryptor'):
            raise Damage('the bag is encrypted')
        try:
            at = _number(fields, b'index_pos', _U64)
            wanted = _number(fields, b'conn_count') + _number(fields, b'chunk_count')
        except Damage:
            return index
        if not at:
            self.losses.say('it was never closed and has no index')
            return index
        if at > self.size:
            return index
        self.index_at = at
        read = 0
        while at < self.size and read < wanted:
            found = self._record(at)
            if found is None or found[2] > self.size or not self._take_index(index, found):
                break
            at = found[2]
            read += 1
        index.complete = read == wanted and at == self.size
        if not index.complete:
            index.counts.clear()
            if at < self.size:
                self.losses.say('its index is damaged')
        return index

    def _take_index(self, index: _Index, found: tuple[Fields, int, int]) -> bool:
        """Take one record of the index; return whether it makes sense."""
        fields, begin, end = found
        kind = _operation(fields)
        self.file.seek(begin)
        data = self.file.read(end - begin)
        try:
            if kind == _CONNECTION:
                index.connections[_number(fields, b'conn')] = _described(fields, data)
            elif kind == _INFO and len(data) == 8 * _number(fields, b'count'):
                index.counts.update(dict(struct.iter_unpack('<II', data)))
            else:
                return False
        except Damage:
            return False
        return True

    def finish(self) -> Losses:
        """Return what is lost, after noting topics without a message."""
        for number in [*self.index.connections, *self.defined]:
            if number not in self.ways:
                self._way(number)
        found: Counter[str] = Counter()
        stated: Counter[str] = Counter()
        for number, way in self.ways.items():
            found[way.topic] += way.count
            stated[way.topic] += self.index.counts[number]
        for topic, count in found.items():
            self.content.counts[topic] = self.content.counts.get(topic, 0) + count
        self.losses.whole = sum(found.values())
        self.losses.unknown = self.strange
        self.losses.expect(stated, found)
        return self.losses


def _described(fields: Fields, data: bytes) -> tuple[str, str]:
    """Return topic and message type of a connection."""
    try:
        name = fields[b'topic'].decode()
        kind = normalize_msgtype(parse_header(data)[b'type'].decode())
    except (KeyError, UnicodeDecodeError):
        raise Damage('a connection makes no sense') from None
    parts = '/'.join(x for x in name.split('/') if x)
    return f'/{parts}' if name.startswith('/') else parts, kind


def _cdr_of_ros1(kind: str, data: bytes) -> bytes:
    """Return the CDR of a serialised message of ROS 1, whose header has a number more."""
    return bytes(_store().ros1_to_cdr(data, kind))


@cache
def _store() -> Typestore:
    store = get_typestore(Stores.ROS2_JAZZY)
    store.register(get_types_from_msg(_CONTROLLER_STATE, CONTROLLER_STATE))
    return store
