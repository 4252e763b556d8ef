# SPDX-License-Identifier: Apache-2.0
"""The files of a bag: found, hashed, unpacked, and what metadata.yaml says of them."""

from bz2 import BZ2File
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
import hashlib
from io import BytesIO
from pathlib import Path
import re
import shlex
import shutil
from tempfile import TemporaryDirectory
from typing import Any

from lz4.frame import LZ4FrameFile  # type: ignore[import-untyped]
import yaml
from zstandard import ZstdDecompressor, ZstdError

from ros2_ident.errors import ErrorCode
from ros2_ident.files import read_small, unreadable
from ros2_ident.recording.limits import limit, size_text, total_of, variable_of

ZSTD = b'\x28\xb5\x2f\xfd'
# What the decompressors raise at damaged data.
FAILURES = (ZstdError, RuntimeError, EOFError, OSError, ValueError, MemoryError)
# What JSON and YAML of another content raise: a number may be too large for a float, too.
UNFIT = (LookupError, TypeError, ValueError, AttributeError, RecursionError, OverflowError)
_PIECE = 1 << 16  # read1 of a zstd frame that is cut never ends


class Damage(Exception):
    """A part of a file that cannot be used; the text says what is wrong with it."""


@dataclass
class Losses:
    """Damage of one file."""

    size: int = 0  # of the file, bytes
    whole: int = 0  # messages read
    messages: int = 0  # known to be lost; 0 where nothing in the file tells
    end: int | None = None  # first byte that could not be read where the file breaks off
    blocks: int = 0  # compressed blocks inside the file that are damaged
    skipped: int = 0  # bytes between the blocks that make no sense
    unknown: int = 0  # messages of a topic that is described nowhere
    said: list[str] = field(default_factory=list)  # whatever else was found, without subject

    def say(self, text: str) -> None:
        """Add something found; the same twice is said once, and no more than a few things."""
        if text not in self.said and len(self.said) < 4:
            self.said.append(text)

    @property
    def text(self) -> str:
        """The damage, without subject; empty for none."""
        several = self.blocks != 1
        blocks = f'{self.blocks} block{"s" * several} inside {"are" if several else "is"}'
        said = {
            f'the file breaks off after byte {self.end} of {self.size}': self.end is not None,
            f'{blocks} damaged': self.blocks,
            f'{self.skipped} bytes make no sense': self.skipped,
            f'{self.unknown} messages belong to no topic': self.unknown,
        }
        parts = [*(text for text, there in said.items() if there), *self.said]
        return ' and '.join(parts) or 'messages are missing' * bool(self.messages)


# Files of what blocks decompress to, of zstd also frames one after the other.
_OPEN: dict[str, Callable[[Any], Any]] = {
    '': BytesIO,
    'zstd': lambda packed: ZstdDecompressor().stream_reader(packed, read_across_frames=True),
    'lz4': lambda packed: LZ4FrameFile(BytesIO(packed)),
    'bz2': lambda packed: BZ2File(BytesIO(packed)),
}


class Budget:
    """How much the blocks of one file of `size` bytes may still decompress to."""

    def __init__(self, size: int) -> None:
        self.chunk = limit('chunk')
        self._left = total_of(size)

    def take(self, size: int) -> None:
        """Allow a block to decompress to `size` bytes.

        Raises:
            Damage: It may not.
        """
        if size > self.chunk:
            text = f'a block claims to unpack to {size_text(size)}, more than the '
            raise Damage(f'{text}{size_text(self.chunk)} allowed ({variable_of("chunk")})')
        if size > self._left:
            text = f'its blocks unpack to more than {limit("ratio")} times the size of the file'
            raise Damage(f'{text}, the most allowed ({variable_of("ratio")})')
        self._left -= size


def inflate(method: str, packed: bytes, most: int) -> tuple[bytes, bool]:
    """Decompress a block as far as it goes.

    Args:
        method: '', 'zstd', 'lz4' or 'bz2'.
        most: Bytes to which it may decompress.

    Returns:
        At most `most` bytes, and whether nothing in the block is damaged and no more would come.
    """
    pieces, size, sound = list[bytes](), 0, method in _OPEN
    try:
        with _OPEN.get(method, BytesIO)(packed if sound else b'') as stream:
            while size <= most and (piece := stream.read(min(_PIECE, most + 1 - size))):
                pieces.append(piece)
                size += len(piece)
    except FAILURES:
        sound = False
    return b''.join(pieces)[:most], sound and size <= most


SUFFIXES = ('.mcap', '.db3', '.bag')
NAME = 'metadata.yaml'
# Refusal of a damaged file.
damaged = ErrorCode.DAMAGED_BAG.at
# Beginning and end of an MCAP file.
MAGIC = b'\x89MCAP0\r\n'
# No recorder writes more.
_LARGEST = 1 << 22
_LOADER: type[yaml.SafeLoader] = getattr(yaml, 'CSafeLoader', yaml.SafeLoader)


def storage_files(path: str | Path) -> tuple[list[Path], list[str]]:
    """Find the files that hold the messages of a bag directory, or of a bare file.

    Returns:
        The files in the order of recording, and sentences about what is missing around them.

    Raises:
        IdentError: NO_DATA where there is no bag at the path.
    """
    path = Path(path)
    if path.is_file():
        return [path], []
    if not path.is_dir():
        text = 'give the path of a bag directory or an .mcap, .db3 or .bag file'
        raise ErrorCode.NO_DATA.error(f'{path}: {unreadable(path)}; {text}')
    files = [x for x in path.iterdir() if x.suffix in (*SUFFIXES, '.zstd') and x.is_file()]
    if not files:
        text = 'holds no .mcap, .db3 or .bag file; give what `ros2 bag record` wrote, or one table'
        raise ErrorCode.NO_DATA.at(path, text)
    files.sort(key=lambda x: counted(x.name))
    stated = [path / x for x in read_metadata(path)[0]]
    said, there = '', (path / NAME).exists()
    if sorted(stated) != sorted(files) and (there or any(x.suffix != '.bag' for x in files)):
        said = 'does not fit the files' if there else 'is missing'
    if stated and all(x.is_file() for x in stated):
        files = list(dict.fromkeys(stated))
    remedy = f'`ros2 bag reindex {shlex.quote(str(path))}` writes it anew'
    return files, [f'{path}: metadata.yaml {said}; {remedy}'] if said else []


def counted(name: str) -> list[str | int]:
    """Return the order of a name: bag_9 comes before bag_10."""
    return [int(x) if x.isdigit() else x for x in re.split(r'(\d+)', name)]


def digest(files: Iterable[Path]) -> str:
    """Return the SHA-256 of the files' bytes, one after the other, in hexadecimal."""
    total = hashlib.sha256()
    for path in files:
        with path.open('rb') as stream:
            hashlib.file_digest(stream, lambda: total)
    return total.hexdigest()


@contextmanager
def unpacked(files: list[Path]) -> Iterator[list[tuple[Path, bool]]]:
    """Give the files with those that are compressed as a whole (`.zstd`) unpacked for the while.

    Yields:
        The files to read, and whether each is whole; a damaged one as far as it can be unpacked.

    Raises:
        IdentError: DAMAGED_BAG where one unpacks to more than allowed, or than the disk holds.
    """
    with TemporaryDirectory() as room:
        plain = []
        for number, path in enumerate(files):
            target, whole = path, True
            if path.suffix == '.zstd':
                target = Path(room, str(number), path.stem)
                target.parent.mkdir()
                whole = _unpack_file(path, target)
            plain.append((target, whole))
        yield plain


def _unpack_file(path: Path, target: Path) -> bool:
    """Unpack a file; return whether it is whole."""
    size = path.stat().st_size
    # the disk is other programs' too
    free = shutil.disk_usage(target.parent).free // 2
    left = most = min(limit('unpacked'), total_of(size), free)
    with path.open('rb') as source, _OPEN['zstd'](source) as pieces, target.open('wb') as sink:
        try:
            while piece := pieces.read(1 << 13):
                left -= len(piece)
                if left < 0:
                    text = f'unpacks from {size_text(size)} to more than {size_text(most)}, the '
                    text += 'most that is allowed or that the disk holds; unpack it by `zstd -d`, '
                    text += f'or raise {variable_of("unpacked")} (MiB) and {variable_of("ratio")}'
                    raise damaged(path, text)
                sink.write(piece)
        except FAILURES:
            return False
    return True


def read_metadata(folder: Path) -> tuple[list[str], dict[str, str]]:
    """Return the storage files and the custom data of a bag's metadata.yaml, as far as it is one.

    Nothing else is taken from it: the files themselves hold it.
    """
    with suppress(OSError, yaml.YAMLError, *UNFIT):
        text = read_small(folder / NAME, _LARGEST).decode()
        data = yaml.load(text, Loader=_LOADER)  # noqa: S506 - safe
        info = data['rosbag2_bagfile_information']
        custom = {str(k): str(v) for k, v in (info.get('custom_data') or {}).items()}
        return [Path(str(x)).name for x in info['relative_file_paths']], custom
    return [], {}
