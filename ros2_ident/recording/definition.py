# SPDX-License-Identifier: Apache-2.0
"""Message definitions, and where the fields that they name lie in a serialised message.

Serialised as ROS 2 does (CDR, version 1: each number on a multiple of its size) or ROS 1 (without
gaps). Definitions are parsed by `rosbags`: ROS 1 and 2 `.msg`, and OMG IDL as ROS 2 writes it.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
import re
from typing import Any

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.typesys import get_types_from_idl, get_types_from_msg, get_typestore, Stores
from rosbags.typesys.store import Typestore

from ros2_ident.errors import ErrorCode
from ros2_ident.recording.limits import limit, variable_of

# Kinds of definitions, as MCAP names them.
OF_ROS = ('ros2msg', 'ros2idl', 'ros1msg')
_SEVERAL = (Nodetype.ARRAY, Nodetype.SEQUENCE)
# Format of each number in numpy.
_FORMATS = {'bool': 'u1', 'byte': 'u1', 'char': 'u1', 'float32': 'f4', 'float64': 'f8'}
_FORMATS |= {f'{sign}int{8 * size}': f'{sign[:1] or "i"}{size}' for sign in ('', 'u')
             for size in (1, 2, 4, 8)}  # fmt: skip
_HEADER = 4  # bytes of encapsulation before the first byte that alignment counts from
# CDR may be filled up to its alignment; more at the end is another message.
_PADDING = 8
# A definition is some kilobytes of text; types in it are nested a few deep.
_LARGEST, _DEEPEST = 1 << 18, 32
# Steps of walking over a message for each of its bytes, beyond which its definition is a trap.
_STEPS = 8
# What stands between the files that a definition in IDL consists of.
_IDL = re.compile(r'^={80}\s+IDL: \S+\s*$', re.MULTILINE)
_PATH = re.compile(r'([A-Za-z]\w*)(?:\[(?:(-?\d+)|(-?\d*):(-?\d*)|(\w+)=(\w+))\])?(?:\.|$)')

# A path to fields: each name with an index, a slice, or the name of the field beside it that holds
# the entry's key, and that key.
Path = tuple[tuple[str, None | int | slice | tuple[str, str]], ...]


def path_of(text: str) -> Path:
    """Return the path that a text states, as `a.b[3].c`, `a[0:7].c` or `a.values[keys=effort]`.

    Raises:
        ValueError: It is no path.
    """
    steps: list[Any] = []
    at = 0
    while at < len(text) or not steps:
        if (found := _PATH.match(text, at)) is None:
            raise ValueError(f'{text!r} is no path of fields')
        name, number, low, high, key, value = found.groups()
        if number is not None:
            steps.append((name, int(number)))
        elif low is not None:
            steps.append((name, slice(*(int(x) if x else None for x in (low, high)))))
        else:
            steps.append((name, (key, value) if key else None))
        at = found.end()
    return tuple(steps)


@dataclass(frozen=True)
class Numbers:
    """Where numbers of one format lie in a message."""

    places: range  # byte of each; -1 for nowhere
    format: str


@dataclass(frozen=True)
class Definition:
    """Fields of a message type, and of all that it is made of."""

    kind: str  # as `sensor_msgs/msg/JointState`
    types: Mapping[str, Sequence[tuple[str, Any]]]  # fields by type, as `rosbags` has them
    whole: bool = True  # whether it is known to the end
    gaps: bool = True  # whether numbers are aligned (ROS 2) or without a gap (ROS 1)

    def has(self, path: Path) -> bool:
        """Say whether it has the fields of a path."""
        kind = self.kind
        for name, _ in path:
            about = dict(self.types.get(kind, ())).get(name)
            if about is None:
                return False
            while about[0] in _SEVERAL:
                about = about[1][0]
            kind = about[1] if about[0] == Nodetype.NAME else ''
        return True

    def numbers(self, most: int) -> list[str]:
        """Return paths of at most so many fields of real numbers, for a user to choose from."""
        found: list[str] = []

        def look(kind: str, before: str, depth: int) -> None:
            for name, about in self.types.get(kind, ()):
                several = about[0] in _SEVERAL
                inner = about[1][0] if several else about
                path = before + name + '[:]' * several
                if len(found) < most and depth < _DEEPEST and inner[0] == Nodetype.NAME:
                    look(inner[1], path + '.', depth + 1)
                elif len(found) < most and inner[1][0] in ('float32', 'float64'):
                    found.append(path)

        look(self.kind, '', 0)
        return found


def definition_of(kind: str, form: str, data: bytes) -> Definition | None:
    """Return what a definition in a file says, None where it says nothing that can be read.

    Args:
        kind: The message type.
        form: `ros2msg`, `ros2idl` or `ros1msg`.
        data: UTF-8, with the types it is made of, each after a line of `=`.
    """
    if not 0 < len(data) <= _LARGEST or form not in OF_ROS:
        return None
    try:
        text = data.decode('utf-8', 'replace')
        if form == 'ros2idl':
            own = {k: v for x in _IDL.split(text) if x for k, v in get_types_from_idl(x).items()}
        else:
            own = get_types_from_msg(text, kind)
    except Exception:  # the parser lets whatever damaged texts cause through
        return None
    types: Mapping[str, Sequence[tuple[str, Any]]] = {name: x for name, (_, x) in own.items()}
    parts = (about for fields in types.values() for _, about in fields)
    inner = (about[1][0] if about[0] in _SEVERAL else about for about in parts)
    if not types.keys() >= {x[1] for x in inner if x[0] == Nodetype.NAME}:
        types = {**_standard_fields(), **types}
    return Definition(kind, types, gaps=form != 'ros1msg') if kind in own else None


@cache
def standard() -> Typestore:
    """Return the messages of ROS 2 Jazzy itself; some hundred classes are made for them."""
    return get_typestore(Stores.ROS2_JAZZY)


@cache
def _standard_fields() -> Mapping[str, Sequence[tuple[str, Any]]]:
    return {kind: fields for kind, (_, fields) in standard().fielddefs.items()}


def standard_of(kind: str) -> Definition | None:
    """Return a message of ROS 2 Jazzy itself, None where there is none of that name."""
    types = _standard_fields()
    return Definition(kind, types) if kind in types else None


class Cursor:
    """Walks over one serialised message and notes which of its bytes make its layout.

    Of ROS 2, where it has `gaps`, the message has its four bytes of encapsulation.

    Raises:
        ValueError: The bytes are no message, here and in every step.
        IdentError: BAD_VALUES where joints are more, or their names longer, than is allowed.
    """

    def __init__(self, data: bytes, gaps: bool = True) -> None:
        head = _HEADER if gaps else 0
        if gaps and (len(data) < head or data[0] != 0 or data[1] not in (0, 1)):
            raise ValueError('no CDR message')
        self.big = gaps and data[1] == 0  # whether numbers are big-endian
        self.fixed = np.zeros(len(data), dtype=np.bool_)  # the bytes of lengths and names (L,)
        self.fixed[: head // 2] = True
        self.at = head  # place of the next byte
        self._data, self._gaps, self._left = data, gaps, 10_000 + _STEPS * len(data)

    def skip(self, size: int, align: int) -> int:
        """Pass over a value of some bytes; return its place."""
        begin = self.at + (-(self.at - _HEADER) % align if self._gaps else 0)
        if begin + size > len(self._data):
            raise ValueError('message ends early')
        self.at = begin + size
        return begin

    def count(self) -> int:
        """Return a length."""
        begin = self.skip(4, 4)
        self.fixed[begin : self.at] = True
        return int.from_bytes(self._data[begin : self.at], 'big' if self.big else 'little')

    def text(self, *, free: bool) -> str:
        """Return a string; a free one may differ from message to message, and is not returned."""
        size = self.count()
        begin = self.skip(size, 1)
        if not free and size > limit('name') + 1:
            text = f'a joint has a name of {size - 1} bytes, more than the {limit("name")} allowed'
            raise ErrorCode.BAD_VALUES.error(f'{text}; shorten it, or raise {variable_of("name")}')
        self.fixed[begin : self.at] = not free
        return '' if free else self._data[begin : self.at].rstrip(b'\0').decode()

    def _numbers(self, number: int, form: str) -> Numbers:
        size = int(form[1:])
        begin = self.skip(size * number, size) if number else self.at
        return Numbers(range(begin, begin + size * number, size), form)

    def one(self, about: Any, definition: Definition, kept: Any, deep: int = 0) -> Any:
        """Pass over one value; return its place, or of a message its fields' by name.

        Args:
            kept: Names of the fields that are looked for, nested; None for none.
        """
        node, inner = about
        self._left -= 1
        if self._left < 0 or deep > _DEEPEST:
            raise ValueError('a definition nested without end')
        if node in _SEVERAL:
            number = inner[1] if node == Nodetype.ARRAY else self.count()
            base, (name, *_) = inner[0][0] == Nodetype.BASE, inner[0][1]
            if base and name in _FORMATS:
                return self._numbers(number, _FORMATS[name])
            if number > len(self._data):
                raise ValueError('more values than bytes')
            if kept is not None and base and number > limit('joints'):
                text = f'a message names {number} joints, more than the {limit("joints")} allowed'
                remedy = f'record the drives only, or raise {variable_of("joints")}'
                raise ErrorCode.BAD_VALUES.error(f'{text}; {remedy}')
            return [self.one(inner[0], definition, kept, deep + 1) for _ in range(number)]
        if node == Nodetype.BASE:
            if inner[0] in _FORMATS:
                return self._numbers(1, _FORMATS[inner[0]])
            if inner[0] == 'string':
                return self.text(free=kept is None)
            raise ValueError(f'{inner[0]} is not read')
        if inner not in definition.types:
            raise ValueError(f'{inner} is not defined')
        kept = kept or {}
        found = {}
        for name, field in definition.types[inner]:
            value = self.one(field, definition, kept.get(name), deep + 1)
            if name in kept:
                found[name] = value
        if not definition.types[inner] and definition.gaps:
            self.skip(1, 1)  # an empty message has a member nevertheless
        return found


def walker(
    definition: Definition, paths: Iterable[Path]
) -> Callable[[bytes], tuple[Mapping[str, Any], Cursor]]:
    """Return what finds fields in a message: their places, nested, and what walked over it.

    Args:
        definition: Of the message's type.
        paths: Of the fields.

    Raises:
        ValueError: When called, where the bytes are no such message.
        IdentError: When called, as `Cursor`.
    """
    kept: dict[str, Any] = {}
    for path in paths:
        level = kept
        for name, index in path:
            if isinstance(index, tuple):
                level.setdefault(index[0], {})
            level = level.setdefault(name, {})

    def walk(data: bytes) -> tuple[Mapping[str, Any], Cursor]:
        cursor = Cursor(data, definition.gaps)
        found = cursor.one((Nodetype.NAME, definition.kind), definition, kept)
        if definition.whole and len(data) - cursor.at > _PADDING:
            raise ValueError('message goes on after its end')
        return found, cursor

    return walk


def found_at(tree: Mapping[str, Any], path: Path) -> list[Any]:
    """Return what lies at a path: strings, or `Numbers`.

    Raises:
        ValueError: There is no such entry.
    """
    nodes: list[Any] = [tree]
    for name, index in path:
        below: list[Any] = []
        for node in nodes:
            if not isinstance(node, Mapping) or name not in node:
                raise ValueError(f'no {name} where it belongs')
            entry: Any = index
            value: Any = node[name]
            several: Any = value if isinstance(value, list) else [value]
            if numbers := isinstance(value, Numbers):
                several = value.places
            if isinstance(index, tuple):
                keys = node[index[0]]
                if len(keys) != len(several):
                    raise ValueError(f'not as many {name} as {index[0]}')
                if index[1] not in keys:
                    below.append(Numbers(range(-1, 0), 'f8'))
                    continue
                entry = keys.index(index[1])
            if isinstance(entry, int):
                if not -len(several) <= entry < len(several):
                    raise ValueError('not as many entries as asked for')
                entry = slice(entry, entry + 1 or None)
            chosen = several if entry is None else several[entry]
            below += [Numbers(chosen, value.format)] if numbers else chosen
        nodes = below
    return nodes
