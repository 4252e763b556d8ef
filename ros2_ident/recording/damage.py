# SPDX-License-Identifier: Apache-2.0
"""Damaged files: what they have lost, in one sentence, and decompression within limits."""

from bz2 import BZ2File
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from io import BytesIO
from typing import Any

from lz4.frame import LZ4FrameFile  # type: ignore[import-untyped]
from zstandard import ZstdDecompressor, ZstdError

from ros2_ident.recording.limits import Limits, size_text, variable_of

ZSTD = b'\x28\xb5\x2f\xfd'
# What the decompressors raise at damaged data.
FAILURES = (ZstdError, RuntimeError, EOFError, OSError, ValueError, MemoryError)
_PIECE = 1 << 16  # read1 of a zstd frame that is cut never ends


class Damage(Exception):
    """A part of a file that cannot be used; the text says what is wrong with it."""


@dataclass
class Losses:
    """Damage of one file.

    Attributes:
        size: The file's size, bytes.
        whole: Messages read.
        messages: Messages known to be lost; 0 where nothing in the file tells.
        end: First byte that could not be read where the file breaks off, or None.
        blocks: Compressed blocks inside the file that are damaged.
        skipped: Bytes between the blocks that make no sense.
        unknown: Messages of a topic that is described nowhere.
        counted: The file itself states how many messages it holds.
        said: Whatever else was found, without subject.
    """

    size: int = 0
    whole: int = 0
    messages: int = 0
    end: int | None = None
    blocks: int = 0
    skipped: int = 0
    unknown: int = 0
    counted: bool = False
    said: list[str] = field(default_factory=list)

    def say(self, text: str) -> None:
        """Add something found; the same twice is said once, and no more than a few things."""
        if text not in self.said and len(self.said) < 4:
            self.said.append(text)

    def expect(self, counts: Mapping[str, int], found: Mapping[str, int]) -> None:
        """Compare the messages that a file states with those found, topic by topic."""
        self.messages = sum(max(0, n - found.get(topic, 0)) for topic, n in counts.items())

    @property
    def text(self) -> str:
        """The damage, without subject; empty for none."""
        parts = []
        if self.end is not None:
            parts.append(f'the file breaks off after byte {self.end} of {self.size}')
        if self.blocks:
            parts.append(
                f'{self.blocks} {"block" if self.blocks == 1 else "blocks"} inside '
                f'{"is" if self.blocks == 1 else "are"} damaged'
            )
        if self.skipped:
            parts.append(f'{self.skipped} bytes make no sense')
        if self.unknown:
            parts.append(f'{self.unknown} messages belong to no topic')
        parts += self.said
        if self.messages and not parts:
            parts.append('messages are missing')
        return ' and '.join(parts)


def open_zstd(source: Any) -> Any:
    """Return a file of what zstd frames, one after the other, decompress to."""
    return ZstdDecompressor().stream_reader(source, read_across_frames=True)


_OPEN: dict[str, Callable[[bytes], Any]] = {
    '': BytesIO,
    'zstd': open_zstd,
    'lz4': lambda packed: LZ4FrameFile(BytesIO(packed)),
    'bz2': lambda packed: BZ2File(BytesIO(packed)),
}


class Budget:
    """How much the blocks of one file may still decompress to.

    Args:
        size: The file's size, bytes.
    """

    def __init__(self, size: int) -> None:
        self.limits = Limits.from_environment()
        self._left = self.limits.total(size)

    def take(self, size: int) -> None:
        """Allow a block to decompress to `size` bytes.

        Raises:
            Damage: It may not.
        """
        if size > self.limits.chunk:
            raise Damage(
                f'a block claims to unpack to {size_text(size)}, more than the '
                f'{size_text(self.limits.chunk)} allowed ({variable_of("chunk")})'
            )
        if size > self._left:
            raise Damage(
                f'its blocks unpack to more than {self.limits.ratio} times the size of the file, '
                f'the most allowed ({variable_of("ratio")})'
            )
        self._left -= size


def inflate(method: str, packed: bytes, most: int) -> tuple[bytes, bool]:
    """Decompress a block as far as it goes.

    Args:
        method: '', 'zstd', 'lz4' or 'bz2'.
        most: Bytes to which it may decompress.

    Returns:
        At most `most` bytes, and whether nothing in the block is damaged and no more would come.
    """
    out, sound = bytearray(), method in _OPEN
    try:
        with _OPEN.get(method, BytesIO)(packed if sound else b'') as stream:
            while len(out) <= most:
                piece = stream.read(min(_PIECE, most + 1 - len(out)))
                if not piece:
                    break
                out += piece
    except FAILURES:
        sound = False
    return bytes(out[:most]), sound and len(out) <= most
