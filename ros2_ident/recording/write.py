# SPDX-License-Identifier: Apache-2.0
"""Streams as a rosbag2 directory that `ros2 bag play` and Foxglove open; a file that grows."""

from collections.abc import Mapping, Sequence
import contextlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mcap.data_stream import RecordBuilder
from mcap.records import Channel, DataEnd, Footer, Header, Message, Schema
import mcap.writer
from mcap.writer import MCAP0_MAGIC as MAGIC
import numpy as np
from rosbags.interfaces import (
    Connection,
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import TypesysError

from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.files import Growing, remove_directory, replacing_directory
from ros2_ident.recording import cdr
from ros2_ident.recording.bag import Topics
from ros2_ident.recording.content import JOINT_STATE
from ros2_ident.recording.limits import size_text
from ros2_ident.recording.storage import NAME, read_metadata
from ros2_ident.recording.streams import FIELDS, Recording, Stream

# Latched, as the messages that are still of use to those who come later.
_ZERO = QosTime(0, 0)
_LATCHED = Qos(
    QosHistory.KEEP_LAST,
    1,
    QosReliability.RELIABLE,
    QosDurability.TRANSIENT_LOCAL,
    _ZERO,
    _ZERO,
    QosLiveliness.SYSTEM_DEFAULT,
    _ZERO,
    False,
)
# Key of a bag's mark in the custom data of its metadata.
MARK = 'ros2_ident'


class _McapStorage:
    """File that rosbags' writer of bags writes to, by `mcap`'s writer."""

    def __init__(self, path: Path, compression: CompressionMode) -> None:
        self.path = path / f'{path.name}.mcap'
        self._file = self.path.open('xb')
        self._writer = mcap.writer.Writer(self._file, enable_data_crcs=True)
        self._writer.start('ros2', 'ros2_ident')
        self._schemas: dict[str, int] = {}
        self._channels: dict[int, int] = {}

    def add_msgtype(self, connection: Connection) -> None:
        """Describe a message type."""
        text = connection.msgdef.data.encode()
        kind = connection.msgtype
        self._schemas[kind] = self._writer.register_schema(kind, 'ros2msg', text)

    def add_connection(self, connection: Connection, offered_qos_profiles: str) -> None:
        """Describe a topic."""
        about = {'offered_qos_profiles': offered_qos_profiles}
        about['topic_type_hash'] = connection.digest
        schema = self._schemas[connection.msgtype]
        self._channels[connection.id] = self._writer.register_channel(
            connection.topic, 'cdr', schema, about
        )

    def write(self, connection: Connection, timestamp: int, data: Any) -> None:
        """Write a message."""
        self._writer.add_message(self._channels[connection.id], timestamp, data, timestamp)

    def close(self, version: int, metadata: str) -> None:
        """End the file."""
        self._writer.add_metadata('rosbag2', {'serialized_metadata': metadata})
        self._writer.finish()  # type: ignore[no-untyped-call]
        self._file.close()

    def abort(self) -> None:
        """Leave the file as it is."""
        self._file.close()


class BagWriter(Writer):
    """rosbags' writer of bags with the storage above."""

    STORAGE_PLUGINS: Mapping[StoragePlugin, Any] = {StoragePlugin.MCAP: _McapStorage}


@dataclass(frozen=True)
class Topic:
    """A topic of any type beside the streams.

    Attributes:
        name: Its name.
        kind: Message type, as `std_msgs/msg/String`; one of ROS 2 Jazzy's own.
        messages: Log time, ns, and CDR bytes of each, in order.
    """

    name: str
    kind: str
    messages: Sequence[tuple[int, bytes]]


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
        text = f'{path}: there is no stream to write; name at least one'
        raise IdentError(ErrorCode.INVALID_GOAL, text)
    require_room(path, mark)
    noted = {**(custom or {}), **({MARK: mark} if mark else {})}
    with replacing_directory(path, replace=bool(mark)) as new:
        writer = BagWriter(new, version=9, storage_plugin=StoragePlugin.MCAP)
        writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
        for key, value in sorted(noted.items()):
            writer.set_custom_data(key, value)
        _write(writer, by_topic, others)
    return path


def _write(writer: BagWriter, by_topic: Mapping[str, Stream], others: Sequence[Topic]) -> None:
    """Write all messages in the order of their stamps."""
    store = cdr.typestore()
    with writer:
        connections: list[Connection] = []
        messages: list[list[bytes]] = []
        for topic, stream in by_topic.items():
            connections.append(writer.add_connection(topic, JOINT_STATE, typestore=store))
            messages.append(
                cdr.encode(stream.stamp, stream.names, [stream.values(x) for x in FIELDS])
            )
        stamps = [stream.stamp for stream in by_topic.values()]
        for other in others:
            connections.append(
                writer.add_connection(
                    other.name, other.kind, typestore=store, offered_qos_profiles=[_LATCHED]
                )
            )
            messages.append([data for _, data in other.messages])
            stamps.append(np.array([when for when, _ in other.messages], dtype=np.int64))
        when = np.concatenate(stamps)
        which = np.repeat(np.arange(len(messages)), [len(x) for x in messages])
        row = np.concatenate([np.arange(len(x)) for x in messages])
        for k in np.argsort(when, kind='stable').tolist():
            writer.write(connections[which[k]], int(when[k]), messages[which[k]][row[k]])


def require_room(path: str | Path, mark: str = '') -> None:
    """Refuse to write a bag where something is that is not ours to replace.

    Args:
        mark: As for `write_bag`.

    Raises:
        IdentError: INVALID_GOAL with the remedy.
    """
    path = Path(path)
    if not path.exists() and not path.is_symlink():
        return
    text = 'exists already; remove it or give another directory'
    if mark:
        text = f'is no {mark} that ident wrote and will not be replaced; move it away'
    if not mark or not _is_marked(path, mark):
        raise IdentError(ErrorCode.INVALID_GOAL, f'{path}: {text}')


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


_END = _bytes(DataEnd(0), Footer(0, 0, 0)) + MAGIC


class Spool:
    """A file of messages that grows.

    Args:
        path: The file; its directory is made. What it holds stays until `clear`.
        limit: Most bytes of it.

    Attributes:
        path: The file.
        problem: Why nothing more is written, in a sentence; empty while all is well.

    Raises:
        IdentError: INVALID_GOAL where the file cannot be written, or another process writes it.
    """

    def __init__(self, path: Path, limit: int) -> None:
        self.path = path
        self.problem = ''
        self._limit = limit
        self._file = Growing(path)
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
        """Write messages of a topic, as far as there is room; a full disk or file is told once.

        Args:
            times: When they came, ns.
            messages: Their bytes.
        """
        if self.problem:
            return
        records: list[Any] = []
        if topic not in self._channels:
            self._channels[topic] = len(self._channels) + 1
            number, definition = self._channels[topic], ''
            with contextlib.suppress(TypesysError, KeyError):  # a type that only its package knows
                definition, _ = cdr.typestore().generate_msgdef(kind)
            records.append(Schema(number, definition.encode(), 'ros2msg', kind))
            records.append(Channel(number, topic, 'cdr', {}, number))
        number = self._channels[topic]
        for when, data in zip(times, messages, strict=True):
            records.append(Message(number, when, data, when, 0))
        out = _bytes(*records)
        if self._file.size + len(out) > self._limit:
            self.problem = f'{self.path}: holds {size_text(self._file.size)} and takes no more; '
            self.problem += 'after a restart later messages will be missing: raise spool_size'
            return
        self._write(out)

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
                data = MAGIC + _bytes(Header('ros2', 'ros2_ident')) + data
            self._file.write(data)
            self._closed = False
        except IdentError as exc:
            self.problem = exc.message
