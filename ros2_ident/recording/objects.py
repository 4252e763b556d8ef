# SPDX-License-Identifier: Apache-2.0
"""Messages of an MCAP file that are no bytes at known places: protobuf and JSON.

Each is made an object by a library and walked over: slower than CDR by two orders of magnitude.
"""

from collections.abc import Callable, Mapping, Sequence
from itertools import groupby
import json
import math
from typing import Any

import numpy as np

from ros2_ident.errors import ErrorCode
from ros2_ident.recording.cdr import Block, ByteTable
from ros2_ident.recording.definition import Path
from ros2_ident.recording.limits import limit
from ros2_ident.recording.maps import DIGITS, MessageMap
from ros2_ident.recording.streams import FIELDS, LATEST_STAMP

FORMS = ('protobuf', 'json')
# Names of a time's parts, by the message types of Google, Foxglove and ROS.
_SECONDS, _NANOSECONDS = ('seconds', 'sec'), ('nanos', 'nsec', 'nanosec')
# Joints, their values by field, and the stamp, ns, of a message.
_Row = tuple[tuple[str, ...], Mapping[str, Sequence[float]], int]
Decode = Callable[[Sequence[bytes] | ByteTable], list[Block]]


def decoder(about: MessageMap, role: str, form: str, schema: bytes) -> Decode:
    """Return what decodes a role's messages in one of `FORMS`; of protobuf by its descriptors.

    Raises:
        IdentError: INVALID_GOAL where the library is missing, BAD_VALUES for a damaged schema.
    """
    read = _reader(about.kind, form, schema)
    titles = about.names.get(role)

    def row_of(data: bytes) -> _Row:
        try:
            tree = read(data)
        except Exception as exc:  # protobuf has errors of its own, nested JSON has none
            raise ValueError('no JSON' if form == 'json' else 'no such message') from exc
        values: dict[str, list[float]] = {}
        try:
            for field, source in about.roles[role].items():
                found = _numbers(tree, source.paths[0])
                if source.chosen:
                    values.setdefault(FIELDS[0], []).append(found[source.entry(len(found))])
                else:
                    values[field] = found
            names = tuple(map(str, _entries(tree, titles))) if titles else about.joints
            stamp = sum(_nanoseconds(tree, *part) for part in about.stamp)
        except (LookupError, TypeError, AttributeError, OverflowError) as exc:
            raise ValueError(f'no such field, {exc}') from exc
        if len(names) > limit('joints') or any(
            len(x) not in (0, len(names)) for x in values.values()
        ):
            raise ValueError(f'{len(names)} names but arrays of another length')
        if abs(stamp) >= LATEST_STAMP:
            raise ValueError('a stamp that is no time')
        return names, values, stamp

    def decode(messages: Sequence[bytes] | ByteTable) -> list[Block]:
        rows = map(row_of, map(bytes, messages))
        blocks, begin = [], 0
        for _, group in groupby(rows, key=lambda x: (x[0], [*map(len, x[1].values())])):
            own = list(group)
            names = own[0][0]
            tables = [np.array([x[1].get(name, ()) for x in own], dtype=float) for name in FIELDS]
            fields = tuple(x if x.size and np.isfinite(x).any() else None for x in tables)
            stamp = np.array([x[2] for x in own], dtype=np.int64)
            blocks.append(Block(np.arange(begin, begin + len(own)), stamp, names, fields))
            begin += len(own)
        return blocks

    return decode


def _reader(kind: str, form: str, schema: bytes) -> Callable[[bytes], Any]:
    """Return what makes an object of a message; of other bytes it raises what it likes."""
    if form == 'json':
        return json.loads
    try:
        from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
    except ModuleNotFoundError:
        text = f'{kind} needs protobuf; `pip install "ros2-ident[protobuf]"`'
        raise ErrorCode.INVALID_GOAL.error(text) from None
    try:
        pool = descriptor_pool.DescriptorPool()
        files = descriptor_pb2.FileDescriptorSet.FromString(schema).file
        message_factory.GetMessages(files, pool)  # adds what a file needs before it
        made = message_factory.GetMessageClass(pool.FindMessageTypeByName(kind))
        read: Callable[[bytes], Any] = made.FromString
    except Exception as exc:  # the library lets whatever damaged bytes cause through
        text = f'the schema of {kind} cannot be read ({type(exc).__name__}); record again'
        raise ErrorCode.BAD_VALUES.error(text) from None

    return read


def _below(node: Any, name: str) -> Any:
    """Return a field of an object; None where it has no value."""
    if isinstance(node, Mapping):
        return node.get(name)
    about = node.DESCRIPTOR.fields_by_name[name]
    return None if about.has_presence and not node.HasField(name) else getattr(node, name)


def _found(tree: Any, path: Path) -> list[Any]:
    """Return what lies at a path; None for an entry without a value."""
    nodes = [tree]
    for name, index in path:
        below, nodes = [_below(node, name) for node in nodes], []
        for value in below:
            if index is None or value is None:
                nodes.append(value)
            elif isinstance(index, slice):
                nodes += value[index]
            elif isinstance(index, int):
                nodes.append(value[index])
            else:
                keys = [_below(x, index[0]) for x in value]
                nodes.append(value[keys.index(index[1])] if index[1] in keys else None)
    return nodes


def _entries(tree: Any, path: Path) -> list[Any]:
    """Return what lies at a path, of one sequence its entries."""
    found = _found(tree, path)
    one = len(found) == 1 and isinstance(found[0], Sequence) and not isinstance(found[0], str)
    return list(found[0]) if one else found


def _numbers(tree: Any, path: Path) -> list[float]:
    return [math.nan if x is None else float(x) for x in _entries(tree, path)]


def _nanoseconds(tree: Any, path: Path, unit: int) -> int:
    """Return a time, ns: a message of seconds and nanoseconds, or a number of a unit [ns]."""
    (value,) = _found(tree, path)
    if value is None:
        return 0
    if isinstance(value, (int, float)):
        return int(round(value * unit))
    if not isinstance(value, Mapping):
        value = {x.name: getattr(value, x.name) for x in value.DESCRIPTOR.fields}
    found = ([int(value[x]) for x in names if x in value] for names in (_SECONDS, _NANOSECONDS))
    second, rest = (x[0] if x else 0 for x in found)
    return int(second * 10 ** DIGITS['s'] + rest)
