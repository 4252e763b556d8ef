# SPDX-License-Identifier: Apache-2.0
"""Unpacking within bounds: what a block claims to become is checked before it is unpacked."""

from bz2 import BZ2Decompressor
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from lz4.frame import LZ4FrameDecompressor  # type: ignore[import-untyped]
import zstandard

from ros2_ident.recording.damage import Damage
from ros2_ident.recording.limits import Limits, size_text, variable_of

ZSTD = b'\x28\xb5\x2f\xfd'
METHODS = ('', 'zstd', 'lz4', 'bz2')
# Packed bytes at a time: zstd packs zeros 30,000 times smaller.
_STEP = 1 << 10
_PIECE = 1 << 20


class Budget:
    """How much the blocks of one file may still unpack to.

    Args:
        size: The file's size, bytes.
        limits: The limits.
    """

    def __init__(self, size: int, limits: Limits) -> None:
        self.limits = limits
        self._left = limits.total(size)

    def take(self, size: int) -> None:
        """Allow a block to unpack to `size` bytes.

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


def inflate(method: str, packed: bytes | memoryview, size: int) -> bytes:
    """Unpack a whole block.

    Args:
        method: One of `METHODS`.
        packed: The block.
        size: Bytes that it has to become; allowed before.

    Raises:
        Damage: It is damaged or becomes anything else.
    """
    if method not in METHODS:
        raise Damage('a block is packed in an unknown way')
    if not method:
        raw = bytes(packed)
    elif method == 'zstd':
        raw = _inflate_zstd(packed, size)
    else:
        raw = _inflate_other(method, packed, size)
    if len(raw) != size:
        raise Damage('a block unpacks to another size than stated')
    return raw


def _inflate_zstd(packed: bytes | memoryview, size: int) -> bytes:
    try:
        # zstandard trusts a size stated in the frame and allocates it at once
        stated = zstandard.frame_content_size(packed)
        if stated > size:
            raise Damage('a block unpacks to another size than stated')
        if stated == size:
            return zstandard.ZstdDecompressor().decompress(packed, allow_extra_data=False)
    except zstandard.ZstdError:
        pass  # several frames, or damage: frame by frame tells which
    out = bytearray()
    for piece, whole in unpack_zstd(lambda: iter([bytes(packed)])):
        out += piece
        if not whole:
            raise Damage('a block cannot be unpacked')
        if len(out) > size:
            raise Damage('a block unpacks to another size than stated')
    return bytes(out)


def _unpacker(method: str) -> Any:
    return LZ4FrameDecompressor() if method == 'lz4' else BZ2Decompressor()


def _inflate_other(method: str, packed: bytes | memoryview, size: int) -> bytes:
    unpacker = _unpacker(method)
    try:
        raw: bytes = unpacker.decompress(bytes(packed), size + 1)
        if len(raw) == size and not unpacker.eof:
            raw += unpacker.decompress(b'', 1)
    except (RuntimeError, EOFError, OSError, ValueError, MemoryError):
        raise Damage('a block cannot be unpacked') from None
    if not unpacker.eof:
        raise Damage('a block unpacks to another size than stated')
    return raw


def unpack_zstd(source: Callable[[], Iterator[bytes]]) -> Iterator[tuple[bytes, bool]]:
    """Unpack zstd frames, one after the other, in pieces of bounded size.

    Args:
        source: Gives the packed data in pieces.

    Yields:
        Pieces, each with True; at damage or a missing end one empty piece with False.
    """
    begun = False
    unpacker = zstandard.ZstdDecompressor().decompressobj(write_size=_PIECE)
    for data in source():
        for at in range(0, len(data), _STEP):
            part = data[at : at + _STEP]
            while part:
                if unpacker.eof:
                    unpacker = zstandard.ZstdDecompressor().decompressobj(write_size=_PIECE)
                begun = True
                try:
                    piece = unpacker.decompress(part)
                except zstandard.ZstdError:
                    yield b'', False
                    return
                part = unpacker.unused_data if unpacker.eof else b''
                yield piece, True
    if not begun or not unpacker.eof:
        yield b'', False


def stated_size(path: Path) -> int:
    """Return the bytes that the first zstd frame of a file says it unpacks to; -1 for unknown."""
    with path.open('rb') as file:
        head = file.read(32)
    try:
        return int(zstandard.frame_content_size(head))
    except zstandard.ZstdError:
        return -1


def unpack_head(method: str, packed: bytes | memoryview, most: int) -> bytes:
    """Unpack what a block that was cut off still holds.

    Args:
        method: One of `METHODS`.
        packed: The beginning of the block.
        most: Bytes after which to stop.
    """
    if not method:
        return bytes(packed[:most])
    out = bytearray()
    if method == 'zstd':
        for piece, _ in unpack_zstd(lambda: iter([bytes(packed)])):
            out += piece
            if len(out) > most:
                break
        return bytes(out[:most])
    unpacker = _unpacker(method)
    try:
        for at in range(0, len(packed), _STEP):
            out += unpacker.decompress(bytes(packed[at : at + _STEP]), max(1, most - len(out)))
            if len(out) >= most or unpacker.eof:
                break
    except (RuntimeError, EOFError, OSError, ValueError, MemoryError):
        pass
    return bytes(out)
