# SPDX-License-Identifier: Apache-2.0
"""Rows of a damaged SQLite file, page by page (sqlite.org/fileformat2.html).

The trees that lead to the pages are not needed: every leaf page of a table says so itself, and its
rows are known by their kinds of values.
"""

from collections.abc import Iterator
from dataclasses import dataclass
import struct
from typing import BinaryIO

from ros2_ident.recording.damage import Damage

MAGIC = b'SQLite format 3\0'
_TABLE_LEAF = 0x0D
_FILE_HEAD = 100
# Bytes of a value's type number 0 to 9, as the format lists them.
_INTEGERS = (0, 1, 2, 3, 4, 6, 8)

Value = int | bytes | str | None | float


@dataclass(frozen=True)
class Row:
    """One row of some table: its number there, and its values."""

    number: int
    values: tuple[Value, ...]


class Pages:
    """The pages of a file.

    Args:
        file: The file.
        size: Its size, bytes.
        largest: Bytes of the largest row that is read.

    Raises:
        Damage: The file does not begin as a SQLite file does.
    """

    def __init__(self, file: BinaryIO, size: int, largest: int) -> None:
        head = file.read(_FILE_HEAD)
        if len(head) < _FILE_HEAD or not head.startswith(MAGIC):
            raise Damage('no SQLite file: its first bytes are others')
        stated = int.from_bytes(head[16:18], 'big')
        self.page = 65536 if stated == 1 else stated
        if self.page < 512 or self.page & (self.page - 1):
            self.page = 4096
        self.usable = self.page - head[20] if head[20] <= 64 else self.page
        self.count = size // self.page + (size % self.page > 0)
        self.stated = int.from_bytes(head[28:32], 'big')
        self.damaged = 0
        self._file, self._largest = file, largest

    def rows(self) -> Iterator[Row]:
        """Yield the rows of all tables in the order of the file; damaged ones are counted."""
        for number in range(self.count):
            data = self._read(number)
            at = _FILE_HEAD if number == 0 else 0
            if len(data) < at + 8 or data[at] != _TABLE_LEAF:
                continue
            cells = int.from_bytes(data[at + 3 : at + 5], 'big')
            if at + 8 + 2 * cells > min(self.usable, len(data)):
                self.damaged += 1
                continue
            for place in struct.unpack_from(f'>{cells}H', data, at + 8):
                try:
                    yield self._row(data, place)
                except (Damage, IndexError, struct.error, UnicodeDecodeError):
                    self.damaged += 1

    def _read(self, number: int) -> bytes:
        self._file.seek(number * self.page)
        return self._file.read(self.page)

    def _row(self, data: bytes, at: int) -> Row:
        size, at = _varint(data, at)
        number, at = _varint(data, at)
        if size > self._largest:
            raise Damage('a row is larger than allowed')
        most = self.usable - 35
        if size <= most:
            payload = data[at : at + size]
        else:
            least = (self.usable - 12) * 32 // 255 - 23
            local = least + (size - least) % (self.usable - 4)
            local = local if local <= most else least
            payload = data[at : at + local] + self._overflow(
                int.from_bytes(data[at + local : at + local + 4], 'big'), size - local
            )
        if len(payload) != size:
            raise Damage('a row is not whole')
        return Row(number, tuple(_values(payload)))

    def _overflow(self, page: int, size: int) -> bytes:
        out = bytearray()
        while len(out) < size:
            if not 0 < page <= self.count:
                raise Damage('a row is not whole')
            data = self._read(page - 1)
            if len(data) < 4:
                raise Damage('a row is not whole')
            out += data[4 : min(self.usable, 4 + size - len(out))]
            if len(data) < self.usable and len(out) < size:
                raise Damage('a row is not whole')
            page = int.from_bytes(data[:4], 'big')
        return bytes(out)


def _varint(data: bytes, at: int) -> tuple[int, int]:
    value = 0
    for k in range(8):
        byte = data[at + k]
        value = value << 7 | byte & 0x7F
        if byte < 0x80:
            return value, at + k + 1
    return value << 8 | data[at + 8], at + 9


def _values(payload: bytes) -> Iterator[Value]:
    """Yield the values of a record."""
    end, at = _varint(payload, 0)
    place = end
    if end > len(payload):
        raise Damage('a row makes no sense')
    while at < end:
        kind, at = _varint(payload, at)
        value: Value
        if kind < 7:
            size = _INTEGERS[kind]
            value = int.from_bytes(payload[place : place + size], 'big', signed=True)
            value = None if kind == 0 else value
        elif kind == 7:
            size = 8
            (value,) = struct.unpack_from('>d', payload, place)
        elif kind in (8, 9):
            size, value = 0, kind - 8
        elif kind < 12:
            raise Damage('a row makes no sense')
        else:
            size = (kind - 12) // 2
            raw = payload[place : place + size]
            value = raw.decode() if kind % 2 else raw
        if place + size > len(payload):
            raise Damage('a row makes no sense')
        place += size
        yield value
    if place != len(payload):
        raise Damage('a row makes no sense')
