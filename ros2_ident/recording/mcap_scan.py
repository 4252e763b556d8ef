# SPDX-License-Identifier: Apache-2.0
"""The messages of an MCAP file, sound, cut off or damaged (mcap.dev/spec).

Every record is read in order, and every checksum is compared. Where a length makes no sense, the
search goes on for the next chunk, message of a known size, or end of the data. A chunk whose
checksum does not fit is left out: which of its bytes are wrong is unknown.
"""

from collections import Counter, defaultdict
import contextlib
from io import BytesIO
import mmap
from pathlib import Path
import re
import struct
from typing import Any
import zlib

from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Footer, Schema, Statistics
from mcap.summary import Summary
from mcap.writer import MCAP0_MAGIC as MAGIC

from ros2_ident.recording.content import Content, Sink
from ros2_ident.recording.storage import Budget, Damage, inflate, Losses

HEAD = struct.Struct('<BQ')
FOOTER_SIZE = HEAD.size + 20 + len(MAGIC)
_STANDARD = frozenset(Opcode)
_KNOWN = _STANDARD.union(range(0x80, 0x100))  # those from 0x80 on are private
_MESSAGE = struct.Struct('<HIQQ')
_CHUNK_START = rb'\x06.{36}(?:\x00{4}|\x04\x00{3}zstd|\x03\x00{3}lz4)'
_END_START = b'\x0f\x04' + bytes(7)
_DAMAGED = (EndOfFile, OverflowError, struct.error, ValueError)
# Sizes of messages outside of chunks that are remembered.
_SHAPES = 64


def scan(path: Path, content: Content) -> Losses:
    """Read the whole messages of an MCAP file into a bag's content.

    Returns:
        What is lost of the file; its text is empty where nothing is.

    Raises:
        Damage: The file is no MCAP file.
    """
    with path.open('rb') as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
        if data[: len(MAGIC)] != MAGIC:
            raise Damage('no MCAP file: its first bytes are others')
        walk = _Walk(data, content)
        walk.run()
        return walk.finish()


def _parsed(kind: Any, record: bytes) -> Any:
    return kind.read(ReadDataStream(BytesIO(record)))


def _note(about: Summary, opcode: int, record: bytes) -> bool:
    """Keep a schema, a channel or the counts of messages; False where the record is damaged."""
    try:
        if opcode == Opcode.STATISTICS:
            about.statistics = _parsed(Statistics, record)
        elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            schema = opcode == Opcode.SCHEMA
            found = _parsed(Schema if schema else Channel, record)
            (about.schemas if schema else about.channels)[found.id] = found
    except _DAMAGED:
        return False
    return True


class _Walk:
    """The state of reading one file."""

    def __init__(self, data: mmap.mmap, content: Content) -> None:
        self.data, self.size, self.content = data, len(data), content
        self.losses, self.budget = Losses(size=self.size), Budget(self.size)
        self.summary = self._summary()
        self.defined = Summary()
        # Topic of a channel, and where its messages go.
        self.ways: dict[int, tuple[str, Sink | None]] = {}
        self.found: Counter[str] = Counter()
        self.shapes: set[bytes] = set()

    # ------------------------------------------------------------------ the records of the file

    def run(self) -> None:
        """Walk over the data section."""
        at = before = len(MAGIC)
        crc = zlib.crc32(MAGIC)
        while at + HEAD.size <= self.size:
            opcode, length = HEAD.unpack_from(self.data, at)
            end = at + HEAD.size + length
            if opcode not in _KNOWN or end > self.size:
                # with a byte lost before, the next record began within the one before
                if not (found := self._next(before + 1)):
                    break
                self.losses.blocks += opcode == Opcode.CHUNK
                self.losses.skipped += max(1, found - at)
                at = found
                continue
            if opcode in (Opcode.DATA_END, Opcode.FOOTER):
                stated = int.from_bytes(self.data[at + HEAD.size : at + HEAD.size + 4], 'little')
                if opcode == Opcode.DATA_END and stated not in (0, crc) and not self.losses.text:
                    self.losses.say('the checksum of the file does not fit')
                return
            with memoryview(self.data) as view, view[at:end] as record:
                crc = zlib.crc32(record, crc)
            before, at = at, self._record(at, opcode, end)
        self._break_off(at)

    def _record(self, at: int, opcode: int, end: int) -> int:
        """Read one record of the data section; return where the next one begins."""
        large = end - at > HEAD.size + self.budget.chunk
        data = b'' if large else self.data[at:end]
        if opcode in (Opcode.CHUNK, Opcode.MESSAGE) and large:
            self.losses.blocks += 1
            self.losses.say('a block is larger than allowed')
        elif opcode == Opcode.CHUNK and not self._chunk(data[HEAD.size :]):
            self.losses.blocks += 1
            return end if self._follows(end) else self._next(at + 1) or self.size
        elif opcode == Opcode.MESSAGE:
            if len(self.shapes) < _SHAPES:
                self.shapes.add(data[: HEAD.size + 2])
            self._records(data)
        elif not _note(self.defined, opcode, data[HEAD.size :]):
            self.losses.skipped += end - at
        return end

    def _follows(self, at: int) -> bool:
        """Return whether three records follow each other from a place on, or fill the file."""
        for _ in range(3):
            opcode, length = HEAD.unpack(self.data[at : at + HEAD.size].ljust(HEAD.size, b'\0'))
            at += HEAD.size + length
            if opcode not in _STANDARD or at > self.size:
                return False
            if opcode == Opcode.FOOTER:
                break
        return True

    def _next(self, at: int) -> int:
        """Return the next place where a chunk, message or the end of the data begins, or 0."""
        starts = [_CHUNK_START, *(re.escape(x) for x in (_END_START, *sorted(self.shapes)))]
        pattern = re.compile(b'|'.join(starts), re.DOTALL)
        while (match := pattern.search(self.data, at)) is not None:
            at, after = match.span()
            opcode, length = HEAD.unpack_from(self.data, at)
            end = at + HEAD.size + length
            packed = int.from_bytes(self.data[after : after + 8], 'little')
            if end <= self.size and (opcode != Opcode.CHUNK or after + 8 + packed == end):
                return at
            at += 1
        return 0

    def _break_off(self, at: int) -> None:
        """Take what the last chunk of a file that breaks off still holds."""
        self.losses.end = at
        most = self.budget.chunk
        data = self.data[at : at + most]
        if data[:1] == b'\x06':
            with contextlib.suppress(*_DAMAGED):
                chunk = _parsed(Chunk, data[HEAD.size :])
                most = min(chunk.uncompressed_size, most)
                self._records(inflate(chunk.compression, chunk.data, most)[0])

    def _chunk(self, record: bytes) -> bool:
        """Take the messages of a chunk; return False where it is damaged."""
        try:
            chunk = _parsed(Chunk, record)
            size, crc = chunk.uncompressed_size, chunk.uncompressed_crc
            self.budget.take(size)
        except _DAMAGED:
            return False
        except Damage as exc:
            self.losses.say(str(exc))
            return False
        raw, sound = inflate(chunk.compression, chunk.data, size)
        whole = sound and len(raw) == size and crc in (0, zlib.crc32(raw))
        return whole and self._records(raw) == len(raw)

    def _records(self, raw: bytes) -> int:
        """Read records until one makes no sense; return its place, or the end."""
        at, size, unpack, unpack_message = 0, len(raw), HEAD.unpack_from, _MESSAGE.unpack_from
        found: dict[int, tuple[list[int], list[bytes]]] = defaultdict(lambda: ([], []))
        while at + HEAD.size <= size:
            opcode, length = unpack(raw, at)
            begin = at + HEAD.size
            end = begin + length
            if end > size:
                break
            if opcode == Opcode.MESSAGE and length >= _MESSAGE.size:
                number, _, log_time, _ = unpack_message(raw, begin)
                times, data = found[number]
                times.append(log_time)
                data.append(raw[begin + _MESSAGE.size : end])
            elif opcode not in (Opcode.SCHEMA, Opcode.CHANNEL) or not _note(
                self.defined, opcode, raw[begin:end]
            ):
                break
            at = end
        for number, (times, data) in found.items():
            if (way := self.ways.get(number) or self._way(number)) is None:
                self.losses.unknown += len(data)
                continue
            topic, target = way
            self.found[topic] += len(data)
            if target is not None:
                target(times, data)
        return at

    # ------------------------------------------------------------------ topics and their counts

    def _summary(self) -> Summary | None:
        """Return what stands between the end of the data and the footer, None for no such."""
        tail = self.data[-FOOTER_SIZE:]
        if not tail.endswith(MAGIC) or len(tail) < FOOTER_SIZE:
            return None
        stated = _parsed(Footer, tail[HEAD.size :])
        length = self.size - FOOTER_SIZE - stated.summary_start
        found, at = Summary(), 0
        if not stated.summary_start or not 0 <= length <= self.budget.chunk:
            length = 0
        records = self.data[stated.summary_start : stated.summary_start + length]
        while at + HEAD.size <= length:
            opcode, size = HEAD.unpack_from(records, at)
            first, at = at + HEAD.size, at + HEAD.size + size
            if opcode not in _KNOWN or not _note(found, opcode, records[first:at]):
                break
        crc = zlib.crc32(tail[: HEAD.size + 16], zlib.crc32(records))
        if stated.summary_crc not in (0, crc):
            self.losses.say('the checksum of its summary does not fit')
            found.statistics = None
        return found if at == length else None

    def _way(self, number: int) -> tuple[str, Sink | None] | None:
        """Return the way of a channel, as described before it or else in the summary."""
        for about in (self.defined, self.summary or Summary()):
            if (channel := about.channels.get(number)) is not None:
                schemas = (self.summary or about).schemas | about.schemas
                kind = schemas[channel.schema_id].name if channel.schema_id in schemas else ''
                if channel.message_encoding not in ('cdr', ''):
                    kind = f'{kind} ({channel.message_encoding})'
                self.ways[number] = channel.topic, self.content.open(channel.topic, kind)
                return self.ways[number]
        return None

    def finish(self) -> Losses:
        """Return what is lost, after noting topics without a message."""
        summary = self.summary or Summary()
        for number in [*self.defined.channels, *summary.channels]:
            if number not in self.ways:
                self._way(number)
        for topic, count in self.found.items():
            self.content.counts[topic] += count
        self.losses.whole = self.found.total()
        if summary.statistics is not None:
            stated: Counter[str] = Counter()
            for number, count in summary.statistics.channel_message_counts.items():
                if number in self.ways:
                    stated[self.ways[number][0]] += count
            self.losses.expect(stated, self.found)
        return self.losses
