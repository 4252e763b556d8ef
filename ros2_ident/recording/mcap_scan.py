# SPDX-License-Identifier: Apache-2.0
"""The messages of an MCAP file, whole or damaged: every byte is read, and accounted for.

The file is walked record by record. Where a length makes no sense, the next place is looked for at
which a chunk or a message of a known size begins. Checksums are checked where there are any; a
chunk whose checksum does not fit is left out, since nobody knows which of its bytes are wrong.
"""

from collections import Counter
from dataclasses import dataclass
from itertools import islice
import mmap
from pathlib import Path
import re
from typing import BinaryIO
import zlib

from ros2_ident.recording.content import Content, Sink
from ros2_ident.recording.damage import Damage, Losses
from ros2_ident.recording.inflate import Budget, inflate, unpack_head
from ros2_ident.recording.mcap_records import (
    ATTACHMENT,
    CHANNEL,
    Channel,
    CHUNK,
    ChunkHead,
    DATA_END,
    FOOTER,
    HEAD,
    KNOWN,
    MAGIC,
    MESSAGE,
    MESSAGE_HEAD,
    parse_chunk,
    Parsed,
    read_summary,
    records,
    SCHEMA,
    Summary,
)

# The head of a chunk: 28 bytes of times, size and checksum, and the name of its compression.
_CHUNK_START = (
    rb'\x06.{36}(?:\x00{4}|\x04\x00{3}zstd|\x03\x00{3}lz4)'  # opcode, size, head, compression
)
_END_START = rb'\x0f\x04\x00{7}'
# Kinds of messages outside of chunks whose sizes are remembered.
_SHAPES = 64


@dataclass
class _Way:
    """Where the messages of a channel go, and how many came."""

    topic: str
    target: Sink | None
    count: int = 0


def scan(path: Path, content: Content) -> Losses:
    """Read the whole messages of an MCAP file into a bag's content.

    Args:
        path: The file.
        content: What to fill.

    Returns:
        What is lost of the file; its text is empty where nothing is.

    Raises:
        Damage: The file is no MCAP file at all.
    """
    size = path.stat().st_size
    with path.open('rb') as file:
        if file.read(len(MAGIC)) != MAGIC and not _looks_like(file, size):
            raise Damage('no MCAP file: its first bytes are others')
        walk = _Walk(file, size, content)
        if walk.summary.damaged:
            walk.losses.say('the checksum of its summary does not fit')
        walk.run()
        return walk.finish()


def _looks_like(file: BinaryIO, size: int) -> bool:
    """Say whether a file with a wrong first byte still ends as an MCAP file."""
    file.seek(max(0, size - len(MAGIC)))
    return file.read() == MAGIC


class _Walk:
    """The state of reading one file."""

    def __init__(self, file: BinaryIO, size: int, content: Content) -> None:
        found = read_summary(file, size)
        self.file, self.size, self.content = file, size, content
        self.indexed = found is not None
        self.summary = found or Summary()
        self.losses = Losses(size=size)
        self.budget = Budget(size, content.limits)
        self.defined = Summary()
        self.ways: dict[int, _Way] = {}
        self.strange: Counter[int] = Counter()
        self.shapes: set[bytes] = set()  # of messages outside of chunks, and inside
        self.inner: set[bytes] = set()
        self.loose = 0  # messages outside of chunks
        self.crc = 0
        file.seek(0)
        magic = file.read(len(MAGIC))
        if magic != MAGIC:
            self.losses.say('its first bytes are others')
        self.crc = zlib.crc32(magic)

    # ------------------------------------------------------------------ the records of the file

    def run(self) -> None:
        """Walk over the data section."""
        at = before = len(MAGIC)
        while True:
            self.file.seek(at)
            head = self.file.read(HEAD.size)
            if len(head) < HEAD.size:
                self._broken_off(at)
                return
            opcode, length = HEAD.unpack(head)
            end = at + HEAD.size + length
            if opcode == FOOTER and end <= self.size:
                return
            if opcode not in KNOWN and opcode < 0x80 or end > self.size:
                # with a byte lost before, the next record began within the one before
                begin, at = at, self._resume(at, opcode, before)
                if not at:
                    return
                self.losses.skipped += max(1, at - begin)
                continue
            if length > self.budget.limits.chunk:
                self._pass(opcode, head, length)
                at = end
                continue
            data = self.file.read(length)
            if opcode == DATA_END:
                self._check_end(data)
                return
            self.crc = zlib.crc32(data, zlib.crc32(head, self.crc))
            before, at = at, self._record(at, opcode, data)

    def _record(self, at: int, opcode: int, data: bytes) -> int:
        """Read one record of the data section; return where the next one begins."""
        end = at + HEAD.size + len(data)
        if opcode == CHUNK:
            return self._chunk(at, data)
        if opcode == MESSAGE:
            self.loose += 1
            if len(self.shapes) < _SHAPES:
                self.shapes.add(HEAD.pack(opcode, len(data)) + data[:2])
            self._walk_records(HEAD.pack(opcode, len(data)) + data, 0)
        elif opcode in (SCHEMA, CHANNEL):
            self._define(opcode, data)
        elif opcode == ATTACHMENT:
            stated = int.from_bytes(data[-4:], 'little')
            if stated and zlib.crc32(data[:-4]) != stated:
                self.losses.say('the checksum of an attachment does not fit')
        elif (head := parse_chunk(data)) and head.method and head.begin + head.packed == len(data):
            # a chunk whose opcode is damaged
            self.losses.say('the kind of a record is damaged')
            return self._chunk(at, data)
        return end

    def _pass(self, opcode: int, head: bytes, length: int) -> None:
        """Pass over a record that is larger than any block may be, as an attachment is."""
        self.crc = zlib.crc32(head, self.crc)
        while length > 0:
            piece = self.file.read(min(length, 1 << 20))
            self.crc = zlib.crc32(piece, self.crc)
            length -= len(piece)
        if opcode in (CHUNK, MESSAGE):
            self.losses.blocks += 1
            self.losses.say('a block is larger than allowed')

    def _check_end(self, data: bytes) -> None:
        stated = int.from_bytes(data[:4], 'little')
        if stated and stated != self.crc and not self.losses.text:
            self.losses.say(
                'the checksum of the file does not fit'
                + ('' if self.loose else ', those of its blocks do')
            )

    def _broken_off(self, at: int) -> None:
        if self.losses.end is None:
            self.losses.end = at

    def _resume(self, at: int, opcode: int, before: int) -> int:
        """Return the next place that makes sense after a record that does not; 0 for none."""
        with mmap.mmap(self.file.fileno(), 0, access=mmap.ACCESS_READ) as data:
            found = _find_start(data, before + 1, self.shapes)
        if found:
            if opcode == CHUNK:
                self.losses.blocks += 1
            return found
        self._broken_off(at)
        if opcode == CHUNK:
            self.file.seek(at + HEAD.size)
            self._chunk_head(self.file.read(self.budget.limits.chunk))
        elif opcode == MESSAGE:
            pass  # the last message, cut off
        return 0

    # ------------------------------------------------------------------ chunks

    def _chunk(self, at: int, data: bytes) -> int:
        """Read a chunk; return where the next record begins."""
        end = at + HEAD.size + len(data)
        head = parse_chunk(data)
        if head is not None and head.begin + head.packed != len(data):
            # one of the two lengths is wrong; the inner one is, unless it fits the checksum
            other = head.begin + head.packed
            if other <= min(self.size - at - HEAD.size, self.budget.limits.chunk):
                self.file.seek(at + HEAD.size)
                if self._unpack_chunk(head, self.file.read(other)):
                    self.losses.say('the length of a block is damaged')
                    return at + HEAD.size + other
            head = None
        if head is not None and self._unpack_chunk(head, data):
            return end
        self.losses.blocks += 1
        self.file.seek(end)
        after = self.file.read(HEAD.size)
        if len(after) == HEAD.size:
            opcode, length = HEAD.unpack(after)
            if opcode in KNOWN and end + HEAD.size + length <= self.size:
                return end
        return self._resume(at, 0, at) or self.size

    def _unpack_chunk(self, head: ChunkHead, data: bytes) -> bool:
        """Take the messages of a chunk; return False where it is damaged."""
        packed = memoryview(data)[head.begin : head.begin + head.packed]
        if not head.method and head.size != len(packed):
            if not head.crc:
                self._walk_chunk(bytes(packed))
            return False
        try:
            self.budget.take(head.size)
            raw = inflate(head.method, packed, head.size)
        except Damage as exc:
            if 'allowed' in str(exc):
                self.losses.say(str(exc))
            return False
        if head.crc and zlib.crc32(raw) != head.crc:
            return False
        self._walk_chunk(raw)
        return True

    def _chunk_head(self, data: bytes) -> None:
        """Take what a chunk that was cut off still holds."""
        head = parse_chunk(data)
        if head is None:
            return
        most = min(head.size, self.budget.limits.chunk)
        raw = unpack_head(head.method, memoryview(data)[head.begin :], most)
        self._walk_records(raw, 0)

    def _walk_chunk(self, raw: bytes) -> None:
        """Read the records inside a chunk; after one that makes no sense, go on at the next."""
        at, size = self._walk_records(raw, 0), len(raw)
        if at < size or not self.inner:
            self.inner |= {
                raw[x - HEAD.size : x + 2]
                for opcode, x, end in islice(records(raw), _SHAPES)
                if opcode == MESSAGE and end <= at
            }
        while at < size:
            found = _find_start(raw, at + 1, self.inner, chunks=False) or size
            self.losses.skipped += found - at
            at = self._walk_records(raw, found)

    def _walk_records(self, raw: bytes, at: int) -> int:
        """Read records until one makes no sense; return its place, or the end."""
        size, ways = len(raw), self.ways
        unpack, unpack_message = HEAD.unpack_from, MESSAGE_HEAD.unpack_from
        while at + HEAD.size <= size:
            opcode, length = unpack(raw, at)
            begin = at + HEAD.size
            end = begin + length
            if end > size:
                return at
            if opcode == MESSAGE and length >= MESSAGE_HEAD.size:
                number, _, log_time, _ = unpack_message(raw, begin)
                way = ways.get(number) or self._way(number)
                if way is None:
                    self.strange[number] += 1
                else:
                    way.count += 1
                    if way.target is not None:
                        way.target.append(log_time, raw[begin + MESSAGE_HEAD.size : end])
            elif opcode in (SCHEMA, CHANNEL):
                self._define(opcode, raw[begin:end])
            else:
                return at
            at = end
        return at

    # ------------------------------------------------------------------ messages

    def _way(self, number: int) -> _Way | None:
        """Return the way of a channel, from its definition before or else from the summary's."""
        source = self.defined
        channel: Channel | None = source.channels.get(number)
        sound = self.indexed and not self.summary.damaged
        if number in self.summary.channels and (channel is None or sound):
            stated = self.summary.channels[number]
            if channel is not None and channel != stated:
                self.losses.say('its topics are described in two ways')
            source, channel = self.summary, stated
        if channel is None:
            return None
        if channel.schema not in source.schemas:
            source = self.summary if source is self.defined else self.defined
        kind = source.kind(channel)
        way = _Way(channel.topic, self.content.open(channel.topic, kind))
        self.ways[number] = way
        return way

    def _define(self, opcode: int, record: bytes) -> None:
        try:
            self.defined.take(opcode, record)
        except Parsed:
            self.losses.skipped += len(record)

    # ------------------------------------------------------------------ the account

    def finish(self) -> Losses:
        """Return what is lost, after noting topics without a message."""
        for number in [*self.defined.channels, *self.summary.channels]:
            if number not in self.ways:
                self._way(number)
        found: Counter[str] = Counter()
        for way in self.ways.values():
            found[way.topic] += way.count
            self.content.counts[way.topic] = self.content.counts.get(way.topic, 0) + way.count
        self.losses.whole = sum(found.values())
        self.losses.unknown = sum(self.strange.values())
        if self.summary.counts is not None and not self.summary.damaged:
            self.losses.counted = True
            stated: Counter[str] = Counter()
            for number, count in self.summary.counts.items():
                if number in self.ways:
                    stated[self.ways[number].topic] += count
            self.losses.expect(stated, found)
        return self.losses


def _find_start(
    data: bytes | mmap.mmap, at: int, shapes: set[bytes], *, chunks: bool = True
) -> int:
    """Return the next place where a chunk, a known kind of message or the end begins; 0 for none.

    Args:
        data: The bytes.
        at: Where to begin.
        shapes: The first bytes of messages that were seen: opcode, size, channel.
        chunks: Whether to look for chunks and for the end of the data.
    """
    parts = [re.escape(x) for x in sorted(shapes)]
    if chunks:
        parts += [_CHUNK_START, _END_START]
    if not parts:
        return 0
    pattern = re.compile(b'|'.join(parts), re.DOTALL)
    while (match := pattern.search(data, at)) is not None:
        at = match.start()
        opcode, length = HEAD.unpack_from(data, at)
        end = at + HEAD.size + length
        if end <= len(data):
            if opcode != CHUNK:
                return at
            head = parse_chunk(data[at + HEAD.size : at + HEAD.size + 64])
            if head is not None and head.begin + head.packed == length:
                return at
        at += 1
    return 0
