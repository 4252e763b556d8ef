# SPDX-License-Identifier: Apache-2.0
"""Arrays of a MATLAB file, level 5 (MathWorks, MAT-File Format, R2023b), and their names in 7.3.

SciPy's reader is not made for damaged files, as its documentation says: some end the process.
"""

from collections.abc import Iterator, Sequence
from itertools import islice
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
# Classes of arrays: structures, texts, numbers from double to uint64, and objects, as a
# timeseries, of which only MATLAB knows what they hold; all others are passed over.
_STRUCTURE, _CHARACTERS, _NUMBERS, _OBJECT, _COMPLEX = 2, 4, range(6, 16), 17, 0x0800
# Whole numbers and texts as MATLAB writes them, and as others do.
_WHOLE, _TEXTS = (5, 6), (1, 2, 16)
_HEADER, _DEEPEST, _MOST = 128, 8, 100_000
_NOTHING = 0, memoryview(b'')


def arrays_of(data: bytes) -> Iterator[tuple[str, NDArray[Any]]]:
    """Yield the arrays of numbers in a file's bytes, those of structures by paths with points.

    Of several structures in one array each is called by the text that tells it apart.

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
    for kind, payload in _elements(memoryview(data)[_HEADER:], order):
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
            for inner, body in _elements(memoryview(raw), order):
                if inner == _MATRIX:
                    yield from _matrix(body, order, '', 0)
        elif kind == _MATRIX:
            yield from _matrix(payload, order, '', 0)


def linked_in(file: Any) -> Iterator[tuple[str, Any]]:
    """Yield the data sets of a file of level 7.3, by paths as `arrays_of` has them.

    Fields of several structures in one array, and cells, are references to what lies elsewhere.

    Args:
        file: That h5py has opened.
    """
    yield from _linked(file, file, '', 0)


def _linked(file: Any, node: Any, path: str, deep: int) -> Iterator[tuple[str, Any]]:
    if not hasattr(node, 'items'):
        if not (node.external or node.is_virtual):  # else it lies in other files
            yield path, node
        return
    hard = (x for x in node if type(node.get(x, getlink=True)).__name__ == 'HardLink')
    below = {x: node[x] for x in hard if not x.startswith('#')} if deep < _DEEPEST else {}
    held = {
        name: [file[ref] for ref in one[()].ravel() if ref]
        for name, one in below.items()
        if 'ref' in (getattr(getattr(one, 'dtype', None), 'metadata', None) or ())
        and one.size <= _MOST
    }
    cells = {x for x in held if below[x].attrs.get('MATLAB_class') == b'cell'}
    texts = [[*map(_characters, held[x])] for x in held if x not in cells]
    told = next((x for x in texts if len({*x}) == len(x) > 1 and '' not in x), [])
    before = f'{path}.' if path else ''
    for name, one in below.items():
        for k, other in enumerate(held.get(name, ())):
            called = f'.{told[k]}' if k < len(told) else f'[{k}]' * (len(held[name]) > 1)
            at = f'{before}{name}[{k}]' if name in cells else f'{path}{called}.{name}'
            yield from _linked(file, other, at, deep + 1)
        if name not in held:
            yield from _linked(file, one, before + name, deep + 1)


def _characters(node: Any) -> str:
    """Return a line of text in a data set, empty for all else."""
    if node.attrs.get('MATLAB_class') != b'char' or not hasattr(node, 'dtype'):
        return ''
    return ''.join(map(chr, np.ravel(node[()]).tolist()))


def _elements(data: memoryview, order: str) -> Iterator[tuple[int, memoryview]]:
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
    data: memoryview, order: str, before: str, deep: int, name: str = ''
) -> Iterator[tuple[str, NDArray[Any]]]:
    """Yield the array of an element, or those in a structure."""
    parts = iter(_elements(data, order))

    def part(*kinds: int) -> memoryview:
        found, payload = next(parts, _NOTHING)
        if found not in kinds:
            raise ValueError(f'a data element of type {found} is not expected')
        return payload

    if not data:  # an empty array in a structure
        return
    flags = int(_numbers(6, part(6), order)[0])
    if flags & 0xFF == _OBJECT:
        yield before + (name or str(part(*_TEXTS), 'latin-1')), np.empty(0)
        return
    shape = tuple(_numbers(5, part(*_WHOLE), order).tolist())
    own = str(part(*_TEXTS), 'latin-1')
    name = name or own  # empty in a structure
    kind = flags & 0xFF
    if kind == _STRUCTURE and deep < _DEEPEST:
        width = int(_numbers(5, part(5), order)[0])
        text = bytes(part(*_TEXTS))
        if not 0 < width <= 64 or len(text) % width:
            raise ValueError('names of fields that make no sense')
        fields = [text[k : k + width].split(b'\0')[0] for k in range(0, len(text), width)]
        bodies = [body for inner, body in parts if inner == _MATRIX]
        count = len(fields)
        if len(bodies) != math.prod(shape) * count:
            raise ValueError(f'{len(bodies)} values in {math.prod(shape)} structures of {count}')
        for k, called in enumerate(_called(bodies, count, order)):
            for field, body in zip(fields, bodies[k * count :], strict=False):
                path = f'{before}{name}{called}.'
                yield from _matrix(body, order, path, deep + 1, field.decode('latin-1'))
    elif kind in _NUMBERS and math.prod(shape) and not flags & _COMPLEX:
        values = _numbers(*next(parts, _NOTHING), order)
        if min(shape, default=0) < 0 or math.prod(shape) != values.size:
            raise ValueError(f'{values.size} numbers in an array of {shape}')
        if before + name:  # what has no name holds objects
            yield before + name, values.reshape(shape, order='F')


def _called(bodies: Sequence[memoryview], count: int, order: str) -> Iterator[str]:
    """Yield what tells structures apart: the first field with another text in each; or numbers.

    Args:
        bodies: Values of the first structure's fields, of the second one's, and so on.
        count: Fields of a structure.
    """
    structures = range(len(bodies) // max(1, count))
    for n in range(count if len(structures) > 1 else 0):
        texts = {_text(body, order) for body in bodies[n::count]}
        if len(texts) == len(structures) and '' not in texts:
            yield from (f'.{_text(body, order)}' for body in bodies[n::count])
            return
    yield from (f'[{k}]' if len(structures) > 1 else '' for k in structures)


def _text(data: memoryview, order: str) -> str:
    """Return a line of text, empty for all else."""
    if not data:
        return ''
    flags, _, _, (kind, text) = (*islice(_elements(data, order), 4), *[_NOTHING] * 4)[:4]
    if _numbers(*flags, order)[0] & 0xFF != _CHARACTERS:
        return ''
    wide = 'utf-16-le' if order == '<' else 'utf-16-be'
    return str(text, {1: 'latin-1', 2: 'latin-1', 16: 'utf-8'}.get(kind, wide), 'replace')


def _numbers(kind: int, data: memoryview, order: str) -> NDArray[Any]:
    form = _FORMATS.get(kind)
    if form is None or not data or len(data) % int(form[1:]):
        raise ValueError('numbers of no known format')
    return np.frombuffer(data, dtype=order + form).astype(form)
