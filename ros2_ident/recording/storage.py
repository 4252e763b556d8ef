# SPDX-License-Identifier: Apache-2.0
"""The files of a bag: found, hashed, unpacked."""

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
import hashlib
from pathlib import Path
import re
from tempfile import TemporaryDirectory

import zstandard

from ros2_ident.errors import ErrorCode, IdentError

SUFFIXES = ('.mcap', '.db3', '.bag')
_ZSTD = b'\x28\xb5\x2f\xfd'


def storage_files(path: str | Path) -> tuple[list[Path], list[str]]:
    """Find the files that hold a bag's messages.

    Args:
        path: A bag directory, or a bare `.mcap`, `.db3` or `.bag` file.

    Returns:
        The files in the order of recording, and sentences about what is missing around them.

    Raises:
        IdentError: NO_DATA where there is no bag at the path.
    """
    path = Path(path)
    if path.is_file():
        return [path], []
    if not path.is_dir():
        raise IdentError(
            ErrorCode.NO_DATA,
            f'{path}: does not exist; give the path of a bag directory or of an .mcap, .db3 or '
            '.bag file',
        )
    files = [x for x in path.iterdir() if x.suffix in SUFFIXES or x.suffix == '.zstd']
    files = [x for x in files if x.is_file()]
    if not files:
        raise IdentError(
            ErrorCode.NO_DATA,
            f'{path}: holds no .mcap, .db3 or .bag file; give the directory that `ros2 bag '
            'record` wrote',
        )
    # split recordings count up: bag_9 comes before bag_10
    files.sort(key=lambda x: [int(p) if p.isdigit() else p for p in re.split(r'(\d+)', x.name)])
    if (path / 'metadata.yaml').exists() or all(x.suffix == '.bag' for x in files):
        return files, []
    return files, [f'{path}: metadata.yaml is missing; `ros2 bag reindex {path}` writes it anew']


def digest(files: Iterable[Path]) -> str:
    """Return the SHA-256 of the files' bytes, one after the other, in hexadecimal."""
    total = hashlib.sha256()
    for path in files:
        with path.open('rb') as stream:
            while block := stream.read(1 << 20):
                total.update(block)
    return total.hexdigest()


@contextmanager
def unpacked(files: list[Path]) -> Iterator[list[Path]]:
    """Give the files with those that are compressed as a whole (`.zstd`) unpacked for the while.

    Args:
        files: Storage files.

    Yields:
        The files to read; a damaged one as far as it can be unpacked.
    """
    if all(x.suffix != '.zstd' for x in files):
        yield files
        return
    with TemporaryDirectory() as room:
        plain = []
        for path in files:
            if path.suffix != '.zstd':
                plain.append(path)
                continue
            target = Path(room, path.stem)
            with path.open('rb') as source, target.open('wb') as sink:
                _unpack_into(source.read(), sink.write)
            plain.append(target)
        yield plain


def unpack_messages(data: list[bytes]) -> list[bytes]:
    """Unpack messages that were compressed one by one, which only metadata.yaml would say."""
    if not data or not data[0].startswith(_ZSTD):
        return data
    plain = []
    for message in data:
        parts: list[bytes] = []
        _unpack_into(message, parts.append)
        plain.append(b''.join(parts))
    return plain


def _unpack_into(data: bytes, write: Callable[[bytes], object]) -> None:
    """Unpack zstd data as far as it is whole."""
    unpacker = zstandard.ZstdDecompressor().decompressobj()
    step = 1 << 16
    for at in range(0, len(data), step):
        try:
            write(unpacker.decompress(data[at : at + step]))
        except zstandard.ZstdError:
            return
