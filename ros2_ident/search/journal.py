# SPDX-License-Identifier: Apache-2.0
"""Journal of a run, kept as it comes, so that a run that was ended goes on.

The steps of a run follow from its inputs to the bit. A run that is started again asks for each
step in turn: what the file holds is not worked out again, and what it does not hold costs time,
never another result. That is why a record may be left out, and a damaged end may be cut off.
A checksum shows damage, not that a record is what the run would have written: the caller
says what it has to be, and computes again what the answer rests on.
"""

from collections.abc import Mapping
from contextlib import AbstractContextManager
import hashlib
import json
import math
from pathlib import Path
import struct
import time
from typing import Any, NamedTuple
import zlib

import numpy as np

from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.files import Growing

Values = Mapping[str, Any]
# The last character is the version of what follows: digest of the run's key, records.
MAGIC = b'ros2_ident journal 1\n'
# Of a record: CRC-32 of the rest, bytes of head and body, digest of what was worked out.
_HEAD = struct.Struct('<III16s')
# Records beyond this may take this share of the time, and all of them so many bytes.
SMALL, SHARE, MOST = 1 << 14, 0.05, 1 << 29


def digest_of(*what: Any) -> bytes:
    """Return 16 bytes that tell inputs apart: arrays by their bytes, all else by its `repr`."""
    total = hashlib.blake2b(digest_size=16)
    for part in what:
        if isinstance(part, np.ndarray):
            total.update(f'{part.dtype.str}{part.shape}'.encode())
            total.update(np.ascontiguousarray(part).data)
        else:
            total.update(part if isinstance(part, bytes) else repr(part).encode())
        total.update(b'\0')
    return total.digest()


class Within(NamedTuple):
    """Condition on a value of a record; NaN is in no range.

    Attributes:
        shape: Its shape, None for any length; of a number empty.
        low: Least value.
        high: Largest value.
        kind: Type of the values.
    """

    shape: tuple[int | None, ...] = ()
    low: float = -math.inf
    high: float = math.inf
    kind: type = float

    def holds(self, value: Any) -> bool:
        """Return whether a value is that."""
        found = np.asarray(value)
        return (
            found.dtype == self.kind
            and found.ndim == len(self.shape)
            and all(n in (None, m) for n, m in zip(self.shape, found.shape, strict=True))
            and bool(((found >= self.low) & (found <= self.high)).all())
        )


class Journal(AbstractContextManager['Journal']):
    """A file of results by what they are of; without a path it remembers nothing.

    Args:
        path: The file; goes on where it is there, and is made where it is not.
        key: Of all that the run depends on.

    Attributes:
        failed: Why it is written no longer, a sentence; empty where it is. A full disk ends the
            journal, not the run.

    Raises:
        IdentError: BAD_VALUES where the file is another run's or no journal, INVALID_GOAL where
            it cannot be written or another process writes it.
    """

    def __init__(self, path: str | Path | None = None, key: str = '') -> None:
        self.failed = ''
        self._path = None if path is None else Path(path)
        self._file = None if path is None else Growing(path)
        self._places: dict[bytes, tuple[int, int, int]] = {}
        self._begun, self._spent = time.monotonic(), 0.0
        if self._file is not None:
            try:
                self._open(self._file, MAGIC + digest_of(key))
            except BaseException:
                self._file.close()
                raise

    def _open(self, file: Growing, head: bytes) -> None:
        """Read where the records are; what does not end whole goes."""
        there = file.read(0, len(head))
        if len(there) < len(head) and head.startswith(there):
            file.cut(0)
            file.write(head)
        elif not there.startswith(MAGIC[:-2]):
            raise IdentError(
                ErrorCode.BAD_VALUES,
                f'{self._path}: is no checkpoint; delete it, and start without it',
            )
        elif there != head:
            raise IdentError(
                ErrorCode.BAD_VALUES,
                f'{self._path}: belongs to a run of other data, parameters, bounds, seed or '
                'settings, or of another version; delete it, or go on with the same ones',
            )
        at = len(head)
        while (end := self._record(file, at)) is not None:
            at = end
        file.cut(at)

    def _record(self, file: Growing, at: int) -> int | None:
        """Note where a record is; return its end, None where there is no whole one."""
        start = file.read(at, _HEAD.size)
        if len(start) < _HEAD.size:
            return None
        crc, head, body, what = _HEAD.unpack(start)
        end: int = at + _HEAD.size + head + body
        first = at + _HEAD.size
        if end > file.size:
            return None
        if zlib.crc32(file.read(first, head + body), zlib.crc32(start[4:])) != crc:
            return None
        self._places[what] = first, head, body
        return end

    def get(self, wanted: Mapping[str, Within], *what: Any) -> dict[str, Any] | None:
        """Return what was put for the same inputs, None where nothing was that is `wanted`."""
        place = self._places.get(digest_of(*what)) if self._places else None
        if place is None or self._file is None:
            return None
        try:
            values = _read(self._file.read(place[0], place[1] + place[2]), place[1])
            fits = all(value.holds(values[name]) for name, value in wanted.items())
        except Exception:  # json and numpy each have their own
            return None
        return values if fits else None

    def put(self, values: Values, *what: Any) -> None:
        """Keep arrays, and plain data that JSON can hold, for inputs."""
        if self._file is None or self.failed:
            return
        arrays = {k: v for k, v in values.items() if isinstance(v, np.ndarray)}
        size = sum(v.nbytes for v in arrays.values())
        begin = time.monotonic()
        dear = self._spent > SHARE * (begin - self._begun) or self._file.size + size > MOST
        if size > SMALL and dear:
            return
        about = {
            'arrays': [[k, v.dtype.str, v.shape] for k, v in arrays.items()],
            'plain': {k: v for k, v in values.items() if k not in arrays},
        }
        head = json.dumps(about).encode()
        rest = struct.pack('<II16s', len(head), size, digest_of(*what))
        data = b''.join((head, *(v.tobytes() for v in arrays.values())))
        crc = zlib.crc32(data, zlib.crc32(rest))
        place = self._file.size + _HEAD.size, len(head), size
        try:
            self._file.write(struct.pack('<I', crc) + rest + data)
            self._places[digest_of(*what)] = place
        except IdentError as error:
            self.failed = error.message
        self._spent += time.monotonic() - begin

    def close(self) -> None:
        """Let go of the file."""
        if self._file is not None:
            self._file.close()
            self._file = None

    def __exit__(self, *raised: object) -> None:
        """Let go of the file."""
        self.close()


def _read(data: bytes, head: int) -> dict[str, Any]:
    """Return the values of a record, the first bytes of which are its head."""
    about = json.loads(data[:head])
    out: dict[str, Any] = about['plain']
    at = head
    for name, kind, shape in about['arrays']:
        values = np.frombuffer(data, kind, int(np.prod(shape)), at).reshape(shape).copy()
        out[name] = values
        at += values.nbytes
    return out
