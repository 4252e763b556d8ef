# SPDX-License-Identifier: Apache-2.0
"""Arrays of a MATLAB file, level 5 (MathWorks, MAT-File Format, R2023b).

SciPy's reader is not made for damaged files, as its documentation says: some end the process.
"""

from collections.abc import Iterator
import math
import struct
from typing import Any
import zlib

import numpy as np
from numpy.typing import NDArray

from ros2_ident.recording.limits import require_memory, total_of

# Numbers by the type of a data element.
_FORMATS = {1: 'i1', 2: 'u1', 3: 'i2', 4: 'u2', 5: 'i4', 6: 'u4', 7: 'f4', 9: 'f8'}
_FORMATS |= {12: 'i8', 13: 'u8'}
_MATRIX, _COMPRESSED = 14, 15
# Classes of arrays: structures, numbers from double to uint64, and objects, as a timeseries, of
# which only MATLAB knows what they hold; all others are passed over.
_STRUCTURE, _NUMBERS, _OBJECT, _COMPLEX = 2, range(6, 16), 17, 0x0800
# Whole numbers and texts as MATLAB writes them, and as others do.
_WHOLE, _TEXTS = (5, 6), (1, 2, 16)
_HEADER, _DEEPEST = 128, 8


def arrays_of(data: bytes) -> Iterator[tuple[str, NDArray[Any]]]:
    """Yield the arrays of numbers in a file's bytes, those of structures by paths with points.

    Of an object an empty one.

    Raises:
        ValueError: The file is damaged, or of another level.
        IdentError: BAD_VALUES where an array takes more memory than allowed.
    """
    mark = data[126:128]
    if len(data) < _HEADER or mark not in (b'IM', b'MI'):
        raise ValueError('it is no MATLAB file of level 5 or 7.3; save it by `save -v7`')
    order = '<' if mark == b'IM' else '>'
    left = total_of(len(data))
    for kind, payload in _elements(data[_HEADER:], order):
        if kind == _COMPRESSED:
            unpack = zlib.decompressobj()
            try:
                raw = unpack.decompress(payload, left)
            except zlib.error as exc:
                raise ValueError(str(exc)) from exc
            left -= len(raw)
            require_memory('an array takes', 3 * len(raw))
            if unpack.unconsumed_tail or not unpack.eof:
                raise ValueError('a packed array is larger than allowed, or cut off')
            for inner, body in _elements(raw, order):
                if inner == _MATRIX:
                    yield from _matrix(body, order, '', 0)
        elif kind == _MATRIX:
            yield from _matrix(payload, order, '', 0)


def _elements(data: bytes, order: str) -> Iterator[tuple[int, bytes]]:
    """Yield type and bytes of the data elements that follow each other."""
    at = 0
    while at + 8 <= len(data):
        kind, size = struct.unpack_from(f'{order}II', data, at)
        if kind >> 16:  # a small one: type and size in one word
            kind, size = kind & 0xFFFF, kind >> 16
            begin, after = at + 4, at + 8
        else:
            begin = at + 8
            # those that are compressed are not filled up
            after = begin + size + (0 if kind == _COMPRESSED else -size % 8)
        if begin + size > len(data):
            raise ValueError('it ends early')
        yield kind, data[begin : begin + size]
        at = after


def _matrix(
    data: bytes, order: str, before: str, deep: int, name: str = ''
) -> Iterator[tuple[str, NDArray[Any]]]:
    """Yield the array of an element, or those in a structure."""
    parts = iter(_elements(data, order))

    def part(*kinds: int) -> bytes:
        found, payload = next(parts, (0, b''))
        if found not in kinds:
            raise ValueError(f'a data element of type {found} is not expected')
        return payload

    if not data:  # an empty array in a structure
        return
    flags = int(_numbers(6, part(6), order)[0])
    if flags & 0xFF == _OBJECT:
        yield before + (name or part(*_TEXTS).decode('latin-1')), np.empty(0)
        return
    shape = tuple(_numbers(5, part(*_WHOLE), order).tolist())
    own = part(*_TEXTS).decode('latin-1')
    name = name or own  # empty in a structure
    kind = flags & 0xFF
    if kind == _STRUCTURE and math.prod(shape) == 1 and deep < _DEEPEST:
        width = int(_numbers(5, part(5), order)[0])
        text = part(*_TEXTS)
        if not 0 < width <= 64 or len(text) % width:
            raise ValueError('names of fields that make no sense')
        names = [text[k : k + width].split(b'\0')[0] for k in range(0, len(text), width)]
        for field, (inner, body) in zip(names, parts, strict=True):
            if inner == _MATRIX:
                path = f'{before}{name}.'
                yield from _matrix(body, order, path, deep + 1, field.decode('latin-1'))
    elif kind in _NUMBERS and not flags & _COMPLEX:
        values = _numbers(*next(parts, (0, b'')), order)
        if min(shape, default=0) < 0 or math.prod(shape) != values.size:
            raise ValueError(f'{values.size} numbers in an array of {shape}')
        if before + name:  # what has no name holds objects
            yield before + name, values.reshape(shape, order='F')


def _numbers(kind: int, data: bytes, order: str) -> NDArray[Any]:
    form = _FORMATS.get(kind)
    if form is None or not data or len(data) % int(form[1:]):
        raise ValueError('numbers of no known format')
    return np.frombuffer(data, dtype=order + form).astype(form)
