# SPDX-License-Identifier: Apache-2.0
"""Streams as a rosbag2 directory that `ros2 bag play` and Foxglove open; a file that grows."""

from collections.abc import Iterator, Mapping, Sequence
import contextlib
from copy import deepcopy
from dataclasses import dataclass
from pathlib import Path
import struct
from typing import Any
import zlib

from mcap import records as mcap
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
import numpy as np
from rosbags.typesys import TypesysError
import yaml
from zstandard import ZstdCompressor

from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.files import Growing, remove_directory, replacing_directory
from ros2_ident.recording import cdr
from ros2_ident.recording.bag import Topics
from ros2_ident.recording.definition import standard
from ros2_ident.recording.limits import size_text
from ros2_ident.recording.storage import MAGIC, NAME, read_metadata
from ros2_ident.recording.streams import FIELDS, IntArray, Recording, Stream

# Latched, as the messages that are still of use to those who come later.
_LATCHED: dict[str, Any] = {'history': 'keep_last', 'depth': 1, 'reliability': 'reliable'}
_LATCHED |= {'durability': 'transient_local', 'liveliness': 'system_default'}
_FOREVER = ('deadline', 'lifespan', 'liveliness_lease_duration')
_LATCHED |= {x: {'sec': 0, 'nsec': 0} for x in _FOREVER}
_LATCHED |= {'avoid_ros_namespace_conventions': False}
# Bytes of a chunk, and what stands before the bytes of a message and before the times and places
# of a channel's messages in it (mcap.dev/spec).
_CHUNK, _MESSAGE, _INDEX = 1 << 20, struct.Struct('<BQHIQQ'), struct.Struct('<BQHI')
# Key of a bag's mark in the custom data of its metadata.
MARK = 'ros2_ident'


@dataclass(frozen=True)
class Topic:
    """A topic of any type beside the streams."""

    name: str
    kind: str  # message type, as `std_msgs/msg/String`; one of ROS 2 Jazzy's own
    times: Sequence[int] | IntArray  # log time of each message, ns
    messages: Sequence[bytes]  # their CDR bytes
    latched: bool = True  # whether the last one is of use to those who come later


def write_bag(
    path: str | Path,
    streams: Recording | Mapping[str, Stream],
    *,
    mark: str = '',
    custom: Mapping[str, str] | None = None,
    others: Sequence[Topic] = (),
) -> Path:
    """Write JointState topics as a bag: the same streams give the same bytes.

    It is an MCAP file, zstd compressed, with every checksum of the format.

    Args:
        streams: A recording, whose roles get their topics' names, or streams by topic name. A
            joint that has no value in a sample (NaN in every field) is still named there, with
            NaN.
        mark: What the bag is, where it is made anew with every run; noted in its custom data. A
            bag there that has the same mark is replaced, anything else there is never touched.
        custom: Texts for the custom data of metadata.yaml.
        others: Topics of other types, recorded as latched.

    Raises:
        IdentError: INVALID_GOAL where something is in the way or there is nothing to write.
    """
    path = Path(path)
    if isinstance(streams, Recording):
        streams = {getattr(Topics, role): stream for role, stream in streams.streams.items()}
    by_topic = {'/' + topic.lstrip('/'): stream for topic, stream in streams.items()}
    if not by_topic:
        raise ErrorCode.INVALID_GOAL.at(path, 'there is no stream to write; name at least one')
    require_room(path, mark)
    noted = {**(custom or {}), **({MARK: mark} if mark else {})}
    topics = []
    for name, x in by_topic.items():
        messages = cdr.encode(x.stamp, x.names, [x.values(field) for field in FIELDS])
        topics.append(Topic(name, cdr.JOINT_STATE, x.stamp, messages, latched=False))
    with replacing_directory(path, replace=bool(mark)) as new:
        new.mkdir()
        _write(new, [*topics, *others], noted)
    return path


def _write(folder: Path, topics: Sequence[Topic], noted: Mapping[str, str]) -> None:
    """Write all messages in the order of their log times."""
    store, file = standard(), f'{folder.name}.mcap'
    kinds = list(dict.fromkeys(topic.kind for topic in topics))
    texts = [store.generate_msgdef(kind, ros_version=2)[0].encode() for kind in kinds]
    schemas = [mcap.Schema(n, texts[n - 1], 'ros2msg', kind) for n, kind in enumerate(kinds, 1)]
    channels, stated = [], []
    for number, topic in enumerate(topics, 1):
        digest, qos = store.hash_rihs01(topic.kind), [_LATCHED] if topic.latched else []
        about = {'offered_qos_profiles': yaml.safe_dump(qos).strip(), 'topic_type_hash': digest}
        schema = kinds.index(topic.kind) + 1
        channels.append(mcap.Channel(number, topic.name, 'cdr', about, schema))
        told: dict[str, Any] = {'name': topic.name, 'type': topic.kind}
        told['serialization_format'] = 'cdr'
        told |= {'type_description_hash': digest, 'offered_qos_profiles': qos}
        stated.append({'topic_metadata': told, 'message_count': len(topic.messages)})
    when = np.concatenate([np.asarray(topic.times, dtype=np.int64) for topic in topics])
    first, last = int(when.min(initial=2**63 - 1)), int(when.max(initial=0))
    span: dict[str, Any] = {'starting_time': {'nanoseconds_since_epoch': first}}
    span |= {'duration': {'nanoseconds': max(0, last - first)}, 'message_count': when.size}
    information = {
        **{'version': 9, 'storage_identifier': 'mcap', 'ros_distro': 'rosbags'},
        **{'compression_format': '', 'compression_mode': '', 'relative_file_paths': [file]},
        **span, 'files': [{'path': file, **deepcopy(span)}], 'custom_data': dict(noted) or None,
        'topics_with_message_count': stated,
    }  # fmt: skip
    with (folder / file).open('xb') as out:
        for data in _mcap(topics, schemas, channels, when, yaml.safe_dump(information)):
            out.write(data)
    text = yaml.safe_dump({'rosbag2_bagfile_information': information})
    (folder / NAME).write_text(text, encoding='utf-8')


def _mcap(
    topics: Sequence[Topic], schemas: Sequence[mcap.Schema], channels: Sequence[mcap.Channel],
    when: IntArray, information: str,
) -> Iterator[bytes]:  # fmt: skip
    """Yield a file piece by piece, with all checksums and indexes."""
    crc = at = 0

    def of(data: bytes) -> bytes:
        nonlocal crc, at
        crc, at = zlib.crc32(data, crc), at + len(data)
        return data

    yield of(_BEGIN)
    messages = [data for topic in topics for data in topic.messages]
    channel = np.repeat(np.arange(len(topics)) + 1, [len(topic.messages) for topic in topics])
    order = np.argsort(when, kind='stable')
    head, chunks = _bytes(*schemas, *channels), []
    ends = np.cumsum([len(head), *(_MESSAGE.size + len(messages[k]) for k in order.tolist())])
    for rows in np.split(order, np.flatnonzero(np.diff(ends[:-1] // _CHUNK)) + 1):
        if not rows.size:
            break
        pieces, times = [head], when[rows]
        of_rows = (x.tolist() for x in (rows, channel[rows], times))
        for k, number, time in zip(*of_rows, strict=True):
            size = _MESSAGE.size - 9 + len(messages[k])
            pieces.append(_MESSAGE.pack(Opcode.MESSAGE, size, number, 0, time, time) + messages[k])
        places = np.cumsum([len(x) for x in pieces])[:-1]
        data, first, last = b''.join(pieces), int(times.min()), int(times.max())
        packed, head, begin = ZstdCompressor().compress(data), b'', at
        yield of(_bytes(mcap.Chunk('zstd', packed, last, first, zlib.crc32(data), len(data))))
        found, middle = dict[int, int](), at
        for number in np.unique(channel[rows]).tolist():
            inside, found[number] = channel[rows] == number, at
            pairs = np.stack([times[inside], places[inside]], axis=1).astype('<u8').tobytes()
            index = _INDEX.pack(Opcode.MESSAGE_INDEX, 6 + len(pairs), number, len(pairs))
            yield of(index + pairs)
        places_of = (middle - begin, begin, 'zstd', len(packed), last, at - middle, found)
        chunks.append(mcap.ChunkIndex(*places_of, first, len(data)))
    begin = at
    yield of(_bytes(mcap.Metadata('rosbag2', {'serialized_metadata': information.strip()})))
    metadata = mcap.MetadataIndex(begin, at - begin, 'rosbag2')
    yield of(_bytes(mcap.DataEnd(crc)))
    counts = {n: len(topic.messages) for n, topic in enumerate(topics, 1) if topic.messages}
    span = (int(when.max()), int(when.min())) if when.size else (0, 0)
    told = (0, len(channels), counts, len(chunks), when.size, *span, 1, len(schemas))
    summary, offsets, begin = b'', list[mcap.SummaryOffset](), at
    groups: dict[Opcode, Sequence[Any]] = {Opcode.SCHEMA: schemas, Opcode.CHANNEL: channels}
    groups |= {Opcode.STATISTICS: [mcap.Statistics(*told)], Opcode.CHUNK_INDEX: chunks}
    for kind, group in (groups | {Opcode.METADATA_INDEX: [metadata]}).items():
        data = _bytes(*group)
        offsets.append(mcap.SummaryOffset(kind, begin + len(summary), len(data)))
        summary += data
    middle = begin + len(summary)
    summary += _bytes(*offsets)
    crc = zlib.crc32(summary + _bytes(mcap.Footer(begin, middle, 0))[:-4])
    yield summary + _bytes(mcap.Footer(begin, middle, crc)) + MAGIC


def require_room(path: str | Path, mark: str = '') -> None:
    """Refuse, as `write_bag`, to write a bag where something is that is not ours to replace.

    Raises:
        IdentError: INVALID_GOAL with the remedy.
    """
    path, text = Path(path), 'exists already; remove it or give another directory'
    if mark:
        text = f'is no {mark} that ident wrote and will not be replaced; move it away'
    if (path.exists() or path.is_symlink()) and not (mark and _is_marked(path, mark)):
        raise ErrorCode.INVALID_GOAL.at(path, text)


def remove_bag(path: str | Path, mark: str) -> None:
    """Remove a bag that has a mark; anything else stays.

    Raises:
        IdentError: INVALID_GOAL where it cannot be removed.
    """
    if _is_marked(Path(path), mark):
        remove_directory(path)


def _is_marked(path: Path, mark: str) -> bool:
    """Return whether a bag has a mark, and its directory holds nothing else."""
    if path.is_symlink() or not path.is_dir():
        return False
    files, custom = read_metadata(path)
    return custom.get(MARK) == mark and {x.name for x in path.iterdir()} <= {NAME, *files}


# Live messages in an MCAP file as they arrive, so that a crash or a restart does not lose them.
# The records lie outside of chunks: whatever the process has written is in the file and can be
# read, whole or cut off, as any other bag (mcap.dev/spec).


def _bytes(*records: Any) -> bytes:
    builder = RecordBuilder()
    for record in records:
        record.write(builder)
    data: bytes = builder.end()  # type: ignore[no-untyped-call]
    return data


_BEGIN = MAGIC + _bytes(mcap.Header('ros2', 'ros2_ident'))
_END = _bytes(mcap.DataEnd(0), mcap.Footer(0, 0, 0)) + MAGIC


class Spool:
    """A file of messages that grows, to `limit` bytes; what it holds stays until `clear`.

    Raises:
        IdentError: INVALID_GOAL where the file cannot be written, or another process writes it.
    """

    def __init__(self, path: Path, limit: int) -> None:
        self.path, self._limit, self._file = path, limit, Growing(path)
        self.problem = ''  # why nothing more is written, in a sentence
        self._channels: dict[str, int] = {}
        ends = max(0, self._file.size - len(_END))
        self._closed = self._file.read(ends, len(_END)) == _END

    @property
    def empty(self) -> bool:
        """Whether the file holds nothing."""
        return self._file.size == 0

    def clear(self) -> None:
        """Forget all messages."""
        self._channels.clear()
        self.problem = ''
        self._write(b'', anew=True)

    def add(self, topic: str, kind: str, times: Sequence[int], messages: Sequence[bytes]) -> None:
        """Write messages of a topic that came at times, ns; a full disk or file is told once."""
        if self.problem:
            return
        records: list[Any] = []
        number = self._channels.get(topic, len(self._channels) + 1)
        if topic not in self._channels:
            self._channels[topic], definition = number, ''
            with contextlib.suppress(TypesysError, KeyError):  # a type that only its package knows
                definition, _ = standard().generate_msgdef(kind)
            records.append(mcap.Schema(number, definition.encode(), 'ros2msg', kind))
            records.append(mcap.Channel(number, topic, 'cdr', {}, number))
        for when, data in zip(times, messages, strict=True):
            records.append(mcap.Message(number, when, data, when, 0))
        out = _bytes(*records)
        if self._file.size + len(out) <= self._limit:
            return self._write(out)
        self.problem = f'{self.path}: holds {size_text(self._file.size)} and takes no more; '
        self.problem += 'after a restart later messages will be missing: raise spool_size'

    def close(self) -> None:
        """End the file and let others write it."""
        if not self.empty and not self._closed:
            self._write(_END)
        self._file.close()

    def _write(self, data: bytes, *, anew: bool = False) -> None:
        try:
            if anew:
                self._file.cut(0)
            elif self._closed:
                self._file.cut(self._file.size - len(_END))
            if data and self.empty:
                data = _BEGIN + data
            self._file.write(data)
            self._closed = False
        except IdentError as exc:
            self.problem = exc.message
