# SPDX-License-Identifier: Apache-2.0
"""Messages of a damaged MCAP file: a walk over its records that takes what is whole.

The regular reader needs the summary at the file's end, which a recording that was cut off does not
have.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
import struct
import zlib

from lz4.frame import LZ4FrameDecompressor  # type: ignore[import-untyped]
import zstandard

_MAGIC = b'\x89MCAP0\r\n'
_FOOTER, _SCHEMA, _CHANNEL, _MESSAGE, _CHUNK = 0x02, 0x03, 0x04, 0x05, 0x06
_SIZE = struct.Struct('<BQ')
_MESSAGE_HEAD = struct.Struct('<HIQQ')
_CHUNK_HEAD = struct.Struct('<QQQI')
# No recorder writes larger records; a length beyond is damage.
_LARGEST = 1 << 32


@dataclass
class Scan:
    """What was found in the file.

    Attributes:
        messages: Topic, log time [ns] and bytes, in the order of the file.
        types: Message type of each topic.
        end: First byte that could not be read; the file's size where all could.
        size: The file's size, bytes.
        lost_chunks: Compressed blocks inside the file that could not be unpacked.
    """

    messages: list[tuple[str, int, bytes]] = field(default_factory=list)
    types: dict[str, str] = field(default_factory=dict)
    end: int = 0
    size: int = 0
    lost_chunks: int = 0


def scan(path: Path) -> Scan:
    """Read the whole messages of an MCAP file, damaged or not.

    Args:
        path: The file.

    Returns:
        Messages and the place where reading ended.

    Raises:
        ValueError: The file is no MCAP file at all.
    """
    data = path.read_bytes()
    if not data.startswith(_MAGIC):
        raise ValueError('no MCAP file: its first bytes are others')
    found = Scan(size=len(data), end=len(_MAGIC))
    schemas: dict[int, str] = {}
    topics: dict[int, str] = {}
    for opcode, begin, end in _records(data, len(_MAGIC)):
        if opcode == _FOOTER:
            found.end = len(data)
            break
        if opcode == _CHUNK:
            raw, whole = _unpack(memoryview(data)[begin : min(end, len(data))])
            for inner, first, last in _records(raw, 0):
                if last <= len(raw):
                    _take(inner, raw[first:last], found, schemas, topics)
            found.lost_chunks += not whole and end <= len(data)
        elif end <= len(data):
            _take(opcode, data[begin:end], found, schemas, topics)
        if end > len(data):
            break
        found.end = end
    return found


def _records(data: bytes, at: int) -> Iterator[tuple[int, int, int]]:
    """Yield opcode, begin and end of each record; the last one's end may lie outside the data."""
    while at + _SIZE.size <= len(data):
        opcode, size = _SIZE.unpack_from(data, at)
        at += _SIZE.size
        if opcode == 0 or size > _LARGEST:
            return
        yield opcode, at, at + size
        at += size


def _text(record: bytes, at: int) -> tuple[str, int]:
    (size,) = struct.unpack_from('<I', record, at)
    return record[at + 4 : at + 4 + size].decode(), at + 4 + size


def _take(
    opcode: int, record: bytes, found: Scan, schemas: dict[int, str], topics: dict[int, str]
) -> None:
    """Keep a schema, a channel or a message; a record that makes no sense is left."""
    try:
        if opcode == _MESSAGE:
            channel, _, log_time, _ = _MESSAGE_HEAD.unpack_from(record)
            if channel in topics:
                found.messages.append((topics[channel], log_time, record[_MESSAGE_HEAD.size :]))
        elif opcode == _SCHEMA:
            (number,) = struct.unpack_from('<H', record)
            schemas[number] = _text(record, 2)[0]
        elif opcode == _CHANNEL:
            number, schema = struct.unpack_from('<HH', record)
            topics[number] = _text(record, 4)[0]
            found.types[topics[number]] = schemas.get(schema, '')
    except (struct.error, UnicodeDecodeError):
        return


def _unpack(record: memoryview) -> tuple[bytes, bool]:
    """Return a chunk's content as far as it can be unpacked, and whether that is all of it."""
    try:
        _, _, size, crc = _CHUNK_HEAD.unpack_from(record)
        (name_size,) = struct.unpack_from('<I', record, _CHUNK_HEAD.size)
        at = _CHUNK_HEAD.size + 4
        method = bytes(record[at : at + name_size]).decode()
        (packed_size,) = struct.unpack_from('<Q', record, at + name_size)
    except (struct.error, UnicodeDecodeError):
        return b'', False
    packed = record[at + name_size + 8 :][:packed_size]
    raw = bytes(packed) if not method else _decompress(method, packed)
    whole = len(raw) == size and (not crc or zlib.crc32(raw) == crc)
    if len(raw) == size and not whole:
        # a wrong checksum over complete data: some byte is wrong and nobody knows which
        return b'', False
    return raw, whole


def _decompress(method: str, packed: memoryview) -> bytes:
    """Unpack as far as possible: both formats give what precedes the damage."""
    if method not in ('zstd', 'lz4'):
        return b''
    unpacker = (
        zstandard.ZstdDecompressor().decompressobj()
        if method == 'zstd'
        else LZ4FrameDecompressor()
    )
    out = bytearray()
    step = 1 << 14
    for at in range(0, len(packed), step):
        try:
            out += unpacker.decompress(bytes(packed[at : at + step]))
        except (zstandard.ZstdError, RuntimeError, EOFError):
            break
    return bytes(out)
