# SPDX-License-Identifier: Apache-2.0
"""The records of an MCAP file, parsed from bytes that may be damaged (mcap.dev/spec)."""

from collections.abc import Iterator
from dataclasses import dataclass, field
import struct
from typing import BinaryIO
import zlib

MAGIC = b'\x89MCAP0\r\n'
HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK = 0x01, 0x02, 0x03, 0x04, 0x05, 0x06
INDEX, ATTACHMENT, METADATA, STATISTICS, DATA_END = 0x07, 0x09, 0x0C, 0x0B, 0x0F
KNOWN = range(0x01, 0x10)
HEAD = struct.Struct('<BQ')
MESSAGE_HEAD = struct.Struct('<HIQQ')
FOOTER_SIZE = 20
_CHUNK_HEAD = struct.Struct('<QQQI')
_FOOTER = struct.Struct('<QQI')
# Where a summary is looked for that the footer does not find, bytes from the end.
_TAIL = 1 << 24
_DATA_END_HEAD = b'\x0f\x04' + bytes(7)

Parsed = (struct.error, UnicodeDecodeError, ValueError)


@dataclass(frozen=True)
class Schema:
    """A message type: its name and how it is described."""

    name: str
    encoding: str


@dataclass(frozen=True)
class Channel:
    """A topic: its schema's number, its name, how its messages are serialised."""

    schema: int
    topic: str
    encoding: str


@dataclass
class Summary:
    """What stands at the end of a file.

    Attributes:
        schemas: By number.
        channels: By number.
        counts: Messages by channel, or None where not stated.
        damaged: Its checksum does not fit.
    """

    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    counts: dict[int, int] | None = None
    damaged: bool = False

    def kind(self, channel: Channel) -> str:
        """Return a channel's message type; with its serialisation where that is not CDR."""
        schema = self.schemas.get(channel.schema)
        name = schema.name if schema else ''
        return name if channel.encoding in ('cdr', '') else f'{name} ({channel.encoding})'

    def take(self, opcode: int, record: bytes) -> None:
        """Keep a schema, a channel or the counts of messages.

        Raises:
            ValueError: Or another of `Parsed`, where the record makes no sense.
        """
        if opcode == SCHEMA:
            (number,) = struct.unpack_from('<H', record)
            name, at = read_text(record, 2)
            self.schemas[number] = Schema(name, read_text(record, at)[0])
        elif opcode == CHANNEL:
            number, schema = struct.unpack_from('<HH', record)
            topic, at = read_text(record, 4)
            self.channels[number] = Channel(schema, topic, read_text(record, at)[0])
        elif opcode == STATISTICS:
            (size,) = struct.unpack_from('<I', record, 42)
            entries = record[46 : 46 + size]
            self.counts = dict(struct.iter_unpack('<HQ', entries))


def read_text(record: bytes, at: int) -> tuple[str, int]:
    """Return a string and the place after it.

    Raises:
        ValueError: The record ends before the string does.
    """
    (size,) = struct.unpack_from('<I', record, at)
    if at + 4 + size > len(record):
        raise ValueError('a text ends after its record')
    return record[at + 4 : at + 4 + size].decode(), at + 4 + size


@dataclass(frozen=True)
class ChunkHead:
    """What a chunk says of itself.

    Attributes:
        size: Bytes unpacked.
        crc: Checksum of these; 0 for none.
        method: How it is packed.
        begin: Where the packed bytes begin in the record.
        packed: How many there are.
    """

    size: int
    crc: int
    method: str
    begin: int
    packed: int


def parse_chunk(record: bytes | memoryview) -> ChunkHead | None:
    """Return the head of a chunk record, or None where it makes no sense."""
    try:
        _, _, size, crc = _CHUNK_HEAD.unpack_from(record)
        (length,) = struct.unpack_from('<I', record, _CHUNK_HEAD.size)
        at = _CHUNK_HEAD.size + 4
        if length > 16:
            return None
        method = bytes(record[at : at + length]).decode('ascii')
        (packed,) = struct.unpack_from('<Q', record, at + length)
    except Parsed:
        return None
    return ChunkHead(size, crc, method, at + length + 8, packed)


def records(data: bytes, at: int = 0) -> Iterator[tuple[int, int, int]]:
    """Yield opcode, begin and end of each record; the last one's end may lie outside the data."""
    size = len(data)
    unpack, head = HEAD.unpack_from, HEAD.size
    while at + head <= size:
        opcode, length = unpack(data, at)
        at += head
        yield opcode, at, at + length
        at += length


def read_summary(file: BinaryIO, size: int) -> Summary | None:
    """Read the summary at the end of a file.

    Args:
        file: The file.
        size: Its size, bytes.

    Returns:
        The summary, None where there is none.
    """
    least = HEAD.size + FOOTER_SIZE + len(MAGIC)
    if size < len(MAGIC) + least:
        return None
    file.seek(size - least)
    data = file.read(least)
    if HEAD.unpack_from(data) != (FOOTER, FOOTER_SIZE) or not data.endswith(MAGIC):
        return None
    begin, _, crc = _FOOTER.unpack_from(data, HEAD.size)
    end = size - least
    checked = data[: HEAD.size + 16]
    if len(MAGIC) < begin <= end and end - begin <= max(_TAIL, size // 4):
        file.seek(begin)
        found = _parse_summary(file.read(end - begin), checked, crc)
        if found is not None:
            return found
    # a byte more or less before it: the record that ends the data comes just before
    first = max(0, end - _TAIL)
    file.seek(first)
    tail = file.read(end - first)
    at = tail.rfind(_DATA_END_HEAD)
    while at >= 0:
        found = _parse_summary(tail[at + HEAD.size + 4 :], checked, crc)
        if found is not None and found.channels:
            return found
        at = tail.rfind(_DATA_END_HEAD, 0, at)
    return None


def _parse_summary(data: bytes, footer: bytes, crc: int) -> Summary | None:
    """Return a summary whose records make sense and fill it, else None."""
    found = Summary(damaged=bool(crc) and zlib.crc32(footer, zlib.crc32(data)) != crc)
    at = 0
    for opcode, begin, end in records(data):
        if opcode not in KNOWN or end > len(data):
            return None
        try:
            found.take(opcode, data[begin:end])
        except Parsed:
            return None
        at = end
    return found if at == len(data) else None
