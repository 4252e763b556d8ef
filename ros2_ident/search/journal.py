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
import io
import math
from pathlib import Path
import struct
from typing import Any, NamedTuple
import zlib

import numpy as np

from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.files import Growing

# The last character is the version of what follows: digest of the run's key, records.
MAGIC = b'ros2_ident journal 2\n'
# Of a record: bytes of its archive of numpy, their CRC-32, and digest of its inputs.
_HEAD = struct.Struct('<QI16s')
# All records may take so many bytes.
MOST = 1 << 29


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
            raise ErrorCode.BAD_VALUES.error(
                f'{self._path}: is no checkpoint; delete it, and start without it'
            )
        elif there != head:
            raise ErrorCode.BAD_VALUES.error(
                f'{self._path}: belongs to a run of other data, parameters, bounds, seed or '
                'settings, or of another version; delete it, or go on with the same ones'
            )
        end = len(head)
        while end + _HEAD.size <= file.size:
            size, crc, what = _HEAD.unpack(file.read(end, _HEAD.size))
            first = end + _HEAD.size
            if first + size > file.size:
                break
            self._places[what] = first, size, crc
            end = first + size
        file.cut(end)

    def get(self, wanted: Mapping[str, Within], *what: Any) -> dict[str, Any] | None:
        """Return what was put for the same inputs, None where nothing was that is `wanted`."""
        place = self._places.get(digest_of(*what)) if self._places else None
        if place is None or self._file is None:
            return None
        data = self._file.read(*place[:2])
        if zlib.crc32(data) != place[2]:
            return None
        try:
            with np.load(io.BytesIO(data), allow_pickle=False) as kept:
                arrays = {name: kept[name] for name in kept}
            values = {name: x if x.ndim else x.item() for name, x in arrays.items()}
            fits = all(value.holds(values[name]) for name, value in wanted.items())
        except Exception:  # numpy and zipfile each have their own
            return None
        return values if fits else None

    def put(self, values: Mapping[str, Any], *what: Any) -> None:
        """Keep arrays and numbers for inputs."""
        if self._file is None or self.failed or self._file.size > MOST:
            return
        archive = io.BytesIO()
        np.savez(archive, **values)
        data, key = archive.getvalue(), digest_of(*what)
        place = self._file.size + _HEAD.size, len(data), zlib.crc32(data)
        try:
            self._file.write(_HEAD.pack(*place[1:], key) + data)
            self._places[key] = place
        except IdentError as error:
            self.failed = error.message

    def __exit__(self, *raised: object) -> None:
        """Let go of the file."""
        if self._file is not None:
            self._file.close()
            self._file = None
