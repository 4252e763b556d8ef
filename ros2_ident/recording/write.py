# SPDX-License-Identifier: Apache-2.0
"""Write streams as a rosbag2 directory that `ros2 bag play` and Foxglove open."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mcap.writer
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

from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.files import remove_directory, replacing_directory
from ros2_ident.recording import cdr
from ros2_ident.recording.bag import Topics
from ros2_ident.recording.ros2_control import JOINT_STATE
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
        raise IdentError(
            ErrorCode.INVALID_GOAL, f'{path}: there is no stream to write; name at least one'
        )
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
    if not mark:
        raise IdentError(
            ErrorCode.INVALID_GOAL, f'{path}: exists already; remove it or give another directory'
        )
    if not _is_marked(path, mark):
        raise IdentError(
            ErrorCode.INVALID_GOAL,
            f'{path}: is no {mark} that ident wrote and will not be replaced; move it away or '
            'give another directory',
        )


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
    about = read_metadata(path)
    if about is None or about.custom.get(MARK) != mark:
        return False
    return {x.name for x in path.iterdir()} <= {NAME, *about.files}
