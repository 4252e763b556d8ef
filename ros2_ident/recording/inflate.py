# SPDX-License-Identifier: Apache-2.0
"""Decompression within limits: the size stated is checked before a block is decompressed."""

from bz2 import BZ2File
from collections.abc import Callable
from io import BytesIO
from typing import Any

from lz4.frame import LZ4FrameFile  # type: ignore[import-untyped]
from zstandard import ZstdDecompressor, ZstdError

from ros2_ident.recording.damage import Damage
from ros2_ident.recording.limits import Limits, size_text, variable_of

ZSTD = b'\x28\xb5\x2f\xfd'
# What the decompressors raise at damaged data.
FAILURES = (ZstdError, RuntimeError, EOFError, OSError, ValueError, MemoryError)
_PIECE = 1 << 16  # read1 of a zstd frame that is cut never ends


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
        limits: The limits.
    """

    def __init__(self, size: int, limits: Limits) -> None:
        self.limits = limits
        self._left = limits.total(size)

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
        packed: The block, or its beginning.
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
