# SPDX-License-Identifier: Apache-2.0
"""The messages of a file: MCAP, sound, cut off or damaged (mcap.dev/spec); db3; ROS 1.

Every record is read in order, and every checksum is compared. Where a length makes no sense, the
search goes on for the next chunk, message of a known size, or end of the data. A chunk whose
checksum does not fit is left out: which of its bytes are wrong is unknown. Of the others, which
have no checksums, a sound db3 and an indexed ROS 1 bag are read.
"""

from collections import Counter, defaultdict
from collections.abc import Sequence
from contextlib import closing, suppress
from io import BytesIO
import mmap
from pathlib import Path
import re
import sqlite3
import struct
from types import SimpleNamespace
from typing import Any
from urllib.parse import quote
import zlib

from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Footer, Schema, Statistics
from mcap.summary import Summary
import numpy as np
from rosbags.rosbag1 import Reader, ReaderError
from rosbags.rosbag1.reader import decompressors, Header, read_bytes, read_uint32, RecordType

from ros2_ident.recording.cdr import ByteTable
from ros2_ident.recording.content import Content, Sink
from ros2_ident.recording.limits import limit, printable
from ros2_ident.recording.storage import Budget, Damage, inflate, Losses, MAGIC, SUFFIXES

HEAD = struct.Struct('<BQ')
FOOTER_SIZE = HEAD.size + 20 + len(MAGIC)
_STANDARD, _DEFINE = frozenset(Opcode), (Opcode.SCHEMA, Opcode.CHANNEL)
_KNOWN = _STANDARD.union(range(0x80, 0x100))  # those from 0x80 on are private
_MESSAGE = struct.Struct('<HIQQ')
_CHUNK_START = rb'\x06.{36}(?:\x00{4}|\x04\x00{3}zstd|\x03\x00{3}lz4)'
_END_START = b'\x0f\x04' + bytes(7)
# Messages that are compared before all that may be of one size.
_TRIED = 16
_DAMAGED = (EndOfFile, OverflowError, struct.error, ValueError)


def scan(path: Path, content: Content) -> Losses:
    """Read the whole messages of a file into a bag's content; return what is lost of it.

    Raises:
        Damage: The file is not what its suffix states, or cannot be salvaged.
    """
    if not path.stat().st_size:
        raise Damage('')
    if path.suffix not in SUFFIXES:
        raise Damage('its kind is not known')
    kinds = {'.mcap': _scan_mcap, '.bag': _scan_ros1, '.db3': _scan_db3}
    return kinds[path.suffix](path, content)


def _mapped(path: Path) -> mmap.mmap:
    with path.open('rb') as file:
        return mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)


def _scan_mcap(path: Path, content: Content) -> Losses:
    with _mapped(path) as data:
        if data[: len(MAGIC)] != MAGIC:
            raise Damage('no MCAP file: its first bytes are others')
        return _Walk(data, content).run()


def _parsed(kind: Any, record: bytes) -> Any:
    return kind.read(ReadDataStream(BytesIO(record)))


def _run(raw: bytes, at: int, step: int) -> int:
    """Return how many messages from a place on have one channel and size."""
    for most in (_TRIED, (len(raw) - at) // step):
        count = min(most, (len(raw) - at) // step)
        heads = np.ndarray((count, HEAD.size + 2), np.uint8, raw, at, (step, 1))
        other = (heads != heads[0]).any(axis=1)
        if other.any():
            return int(other.argmax())
    return count


def _note(about: Summary, opcode: int, record: bytes) -> bool:
    """Keep a schema, a channel or the counts of messages; False where the record is damaged."""
    with suppress(*_DAMAGED):
        if opcode == Opcode.STATISTICS:
            about.statistics = _parsed(Statistics, record)
        elif opcode in _DEFINE:
            schema = opcode == Opcode.SCHEMA
            found = _parsed(Schema if schema else Channel, record)
            (about.schemas if schema else about.channels)[found.id] = found
        return True
    return False


class _Walk:
    """The state of reading one MCAP file."""

    def __init__(self, data: mmap.mmap, content: Content) -> None:
        self.data, self.size, self.content = data, len(data), content
        self.losses, self.budget = Losses(size=self.size), Budget(self.size)
        self.summary = self._summary()
        self.defined = Summary()
        # Topic of a channel, and where its messages go.
        self.ways: dict[int, tuple[str, Sink | None]] = {}
        self.found: Counter[str] = Counter()
        self.before = -1, 0  # channel and size of the last message
        self.starts = [_CHUNK_START, re.escape(_END_START)]

    def run(self) -> Losses:
        """Walk over the data section; return what is lost."""
        at = before = len(MAGIC)
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
                if opcode == Opcode.DATA_END and stated and not self.losses.text:
                    with memoryview(self.data) as view, view[:at] as records:
                        if zlib.crc32(records) != stated:
                            self.losses.say('the checksum of the file does not fit')
                return self._finish()
            before, at = at, self._record(at, opcode, end)
            if opcode == Opcode.CHUNK and not self.losses.text and self._all_shown():
                return self._finish()
        # what the last chunk of a file that breaks off still holds
        self.losses.end = at
        data = self.data[at : at + self.budget.chunk]
        with suppress(*_DAMAGED):
            if data[:1] == b'\x06':
                chunk = _parsed(Chunk, data[HEAD.size :])
                most = min(chunk.uncompressed_size, self.budget.chunk)
                self._records(inflate(chunk.compression, chunk.data, most)[0])
        return self._finish()

    def _all_shown(self) -> bool:
        """Say whether the rest of the file, of which nothing is wanted, shows no more."""
        about, stated = self.summary.statistics, Counter[str]()
        counts = {n: k for n, k in about.channel_message_counts.items() if k} if about else {}
        if not counts or counts.keys() - self.ways.keys():
            return False
        for number, count in counts.items():
            stated[self.ways[number][0]] += count
        if shown := self.content.has_shown(stated):
            self.found = stated
        return shown

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
            self.starts[2:] = [rb'\x05.{5}\0\0\0']
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
        pattern = re.compile(b'|'.join(self.starts), re.DOTALL)
        while (match := pattern.search(self.data, at)) is not None:
            at, after = match.span()
            opcode, length = HEAD.unpack_from(self.data, at)
            end = at + HEAD.size + length
            packed = int.from_bytes(self.data[after : after + 8], 'little')
            fits = opcode != Opcode.MESSAGE or self._follows(at)
            if end <= self.size and fits and (opcode != Opcode.CHUNK or after + 8 + packed == end):
                return at
            at += 1
        return 0

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
                step = HEAD.size + length
                if (number, length) == self.before and (run := _run(raw, at, step)) > 1:
                    self._give(number, *found.pop(number, ([], [])))
                    place = begin + _MESSAGE.size
                    table = np.ndarray((run, end - place), np.uint8, raw, place, (step, 1))
                    times = np.ndarray((run,), '<u8', raw, begin + 6, (step,)).tolist()
                    self._give(number, times, table)
                    at += run * step
                    continue
                self.before = number, length
                times, data = found[number]
                times.append(log_time)
                data.append(raw[begin + _MESSAGE.size : end])
            elif opcode not in _DEFINE or not _note(self.defined, opcode, raw[begin:end]):
                break
            at = end
        for number, (times, data) in found.items():
            self._give(number, times, data)
        return at

    def _give(self, number: int, times: list[int], data: Sequence[bytes] | ByteTable) -> None:
        """Give messages of a channel to where they go."""
        if (way := self.ways.get(number) or self._way(number)) is None:
            self.losses.unknown += len(data)
            return
        topic, target = way
        self.found[topic] += len(data)
        if target is not None and len(data):
            target(times, data)

    def _summary(self) -> Summary:
        """Return what stands between the end of the data and the footer, empty for no such."""
        tail, found, at = self.data[-FOOTER_SIZE:], Summary(), 0
        if not tail.endswith(MAGIC) or len(tail) < FOOTER_SIZE:
            return found
        stated = _parsed(Footer, tail[HEAD.size :])
        length = self.size - FOOTER_SIZE - stated.summary_start
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
        return found if at == length else Summary()

    def _way(self, number: int) -> tuple[str, Sink | None] | None:
        """Return the way of a channel, as described before it or else in the summary."""
        for about in (self.defined, self.summary):
            if (channel := about.channels.get(number)) is not None:
                schemas = self.summary.schemas | about.schemas
                schema = schemas.get(channel.schema_id) or Schema(0, b'', '', '')
                form = channel.message_encoding
                form = schema.encoding if form in ('cdr', 'ros1', '') else form
                target = self.content.open(channel.topic, schema.name, form, schema.data)
                self.ways[number] = channel.topic, target
                break
        return self.ways.get(number)

    def _finish(self) -> Losses:
        """Return what is lost, after noting topics without a message."""
        for number in [*self.defined.channels, *self.summary.channels]:
            if number not in self.ways:
                self._way(number)
        for topic, count in self.found.items():
            self.content.counts[topic] += count
        self.losses.whole = self.found.total()
        about, stated = self.summary.statistics, Counter[str]()
        counts = about.channel_message_counts if about else {}
        for number in counts.keys() & self.ways.keys():
            stated[self.ways[number][0]] += counts[number]
        self.losses.messages = (stated - self.found).total()
        return self.losses


_METHODS = {unpack: '' if name == 'none' else name for name, unpack in decompressors.items()}


def _scan_ros1(path: Path, content: Content) -> Losses:
    losses = Losses(size=path.stat().st_size)
    reader = _Chunks(path)
    # no stated length makes its reader allocate more than is there
    reader.path = SimpleNamespace(open=lambda _: _mapped(path))
    try:
        reader.open()
    except Exception as exc:  # the parser lets whatever damaged bytes cause through
        said = str(exc).rstrip('.') if isinstance(exc, ReaderError) else ''
        raise Damage(printable(said) or 'its index is damaged') from None
    with reader.bio:  # type: ignore[union-attr]
        reader.read(content, losses)
    return losses


class _Chunks(Reader):
    """A reader of whole chunks, which needs no index of their messages: it would fill memory."""

    def read_index_data(self, pos: int, indexes: Any) -> None:
        """Pass over the index of a chunk."""

    def read(self, content: Content, losses: Losses) -> None:
        """Fill a bag's content, and count what is lost."""
        budget, ways = Budget(losses.size), dict[int, tuple[str, Sink | None]]()
        for x in self.connections:
            target = content.open(x.topic, x.msgtype, 'ros1msg', x.msgdef.data.encode())
            ways[x.id] = x.topic, target
        stated = 0
        for info in self.chunk_infos:
            stated += sum(info.connection_counts.values())
            try:
                chunk = self.chunks[info.pos]
                self.bio.seek(chunk.datapos)  # type: ignore[union-attr]
                packed = read_bytes(self.bio, chunk.datasize)  # type: ignore[arg-type]
                raw, sound = inflate(_METHODS[chunk.decompressor], packed, budget.chunk)
                budget.take(len(raw) + (not sound and len(raw) == budget.chunk))
                if not sound:
                    raise ReaderError
                stream = BytesIO(raw)
                while stream.tell() < len(stream.getbuffer()):
                    header = Header.read(stream)
                    data = read_bytes(stream, read_uint32(stream))
                    if header.get_uint8('op') == RecordType.MSGDATA:
                        topic, target = ways[header.get_uint32('conn')]
                        content.counts[topic] += 1
                        losses.whole += 1
                        if target is not None:
                            target([header.get_time('time')], [data])
            except Damage as exc:
                losses.blocks += 1
                losses.say(str(exc))
            except Exception:  # the parser lets whatever damaged bytes cause through
                losses.blocks += 1
        losses.messages = max(0, stated - losses.whole)


_SOUND_STEPS, _STEPS_PER_BYTE, _EVERY = 2_000_000, 20, 10_000


def _scan_db3(path: Path, content: Content) -> Losses:
    losses = Losses(size=path.stat().st_size)
    wal = path.with_name(path.name + '-wal')
    if wal.is_file() and wal.stat().st_size:
        losses.say(f'{wal.name} beside it holds messages that were never moved into it')
    name = f'file:{quote(str(path))}?mode=ro&immutable=1'
    try:
        with closing(sqlite3.connect(name, uri=True)) as base:
            _guard(base, losses.size)
            if base.execute('PRAGMA quick_check(1)').fetchone() != ('ok',):
                raise Damage('SQLite finds it malformed')
            _read(base, content, losses)
    except (sqlite3.Error, UnicodeDecodeError, OverflowError, TypeError) as exc:
        raise Damage(f'SQLite cannot read it: {exc}') from None
    return losses


def _guard(base: sqlite3.Connection, size: int) -> None:
    """Let no damaged or crafted file compute without end, or anything but read tables."""
    left = iter(range((_SOUND_STEPS + _STEPS_PER_BYTE * size) // _EVERY))
    base.set_progress_handler(lambda: next(left, None) is None, _EVERY)
    base.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, limit('chunk'))
    base.execute('PRAGMA trusted_schema = OFF')
    base.execute('PRAGMA cell_size_check = ON')
    known = dict(base.execute('SELECT name, type FROM sqlite_master'))
    if known.get('topics') != 'table' or known.get('messages') != 'table':
        raise Damage("none of its tables is a bag's")


def _read(base: sqlite3.Connection, content: Content, losses: Losses) -> None:
    ways: dict[int, tuple[str, Sink | None]] = {}
    texts: dict[str, tuple[str, bytes]] = {}
    with suppress(sqlite3.Error):  # bags of Humble and before have no definitions
        query = 'SELECT topic_type, encoding, encoded_message_definition FROM message_definitions'
        texts = {kind: (str(form), str(text).encode()) for kind, form, text in base.execute(query)}
    query = 'SELECT id, name, type, serialization_format FROM topics ORDER BY id'
    for number, name, kind, form in base.execute(query):
        known = texts.get(kind, ('ros2msg', b'')) if form in ('cdr', '') else (form, b'')
        ways[number] = name, content.open(name, kind, *known)
    counts = base.execute('SELECT topic_id, count(*) FROM messages GROUP BY topic_id')
    found: Counter[int] = Counter(dict(counts))
    losses.unknown = sum(count for number, count in found.items() if number not in ways)
    wanted = [number for number, (_, target) in ways.items() if target is not None]
    places = ', '.join('?' * len(wanted))
    query = f'SELECT topic_id, timestamp, data FROM messages WHERE topic_id IN ({places}) '  # noqa: S608
    for number, when, data in base.execute(f'{query}ORDER BY timestamp, rowid', wanted):
        if not isinstance(when, int) or not isinstance(data, bytes):
            found[number] -= 1
            losses.unknown += 1
            continue
        ways[number][1]([when], [data])  # type: ignore[misc]
    for number, (topic, _) in ways.items():
        content.counts[topic] += found[number]
        losses.whole += found[number]
