# SPDX-License-Identifier: Apache-2.0
"""Write streams as a rosbag2 directory that `ros2 bag play` and Foxglove open."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
import shutil
from typing import Literal

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
from rosbags.typesys import get_typestore, Stores

from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.recording import cdr
from ros2_ident.recording.bag import JOINT_STATE, Topics
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
_STORAGES = {'mcap': StoragePlugin.MCAP, 'sqlite3': StoragePlugin.SQLITE3}


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
    topics: Topics | None = None,
    overwrite: bool = False,
    storage: Literal['mcap', 'sqlite3'] = 'mcap',
    custom: Mapping[str, str] | None = None,
    others: Sequence[Topic] = (),
) -> Path:
    """Write JointState topics as a bag: the same streams give the same bytes.

    Args:
        path: The directory to make.
        streams: A recording, whose roles get their topics' names, or streams by topic name. A
            joint that has no value in a sample (NaN in every field) is still named there, with
            NaN.
        topics: Topic names of the roles of a recording.
        overwrite: Replace a bag that is already there; anything else there is never touched.
        storage: `mcap` (zstd compressed) or `sqlite3`.
        custom: Texts for the custom data of metadata.yaml.
        others: Topics of other types, recorded as latched.

    Returns:
        The directory.

    Raises:
        IdentError: INVALID_GOAL where something is in the way or there is nothing to write.
    """
    path = Path(path)
    if isinstance(streams, Recording):
        names = topics or Topics()
        streams = {getattr(names, role): stream for role, stream in streams.streams.items()}
    by_topic = {'/' + topic.lstrip('/'): stream for topic, stream in streams.items()}
    if not by_topic:
        raise IdentError(
            ErrorCode.INVALID_GOAL, f'{path}: there is no stream to write; name at least one'
        )
    _make_room(path, overwrite)
    store = get_typestore(Stores.ROS2_JAZZY)
    writer = Writer(path, version=9, storage_plugin=_STORAGES[storage])
    if storage == 'mcap':
        writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
    for key, value in sorted((custom or {}).items()):
        writer.set_custom_data(key, value)
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
    return path


def _make_room(path: Path, overwrite: bool) -> None:
    if not path.exists():
        return
    if not overwrite:
        raise IdentError(
            ErrorCode.INVALID_GOAL, f'{path}: exists already; remove it or give another directory'
        )
    known = ('.mcap', '.db3', '.zstd')
    if not path.is_dir() or any(
        x.suffix not in known and x.name != 'metadata.yaml' for x in path.iterdir()
    ):
        raise IdentError(
            ErrorCode.INVALID_GOAL,
            f'{path}: is no bag and will not be replaced; give another directory',
        )
    shutil.rmtree(path)
