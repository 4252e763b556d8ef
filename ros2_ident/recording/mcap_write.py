# SPDX-License-Identifier: Apache-2.0
"""A writer of bags whose MCAP files carry every checksum that the format has."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import mcap.writer
from rosbags.interfaces import Connection
from rosbags.rosbag2 import CompressionMode, StoragePlugin, Writer


class _McapStorage:
    """What rosbags' writer of bags writes to, by `mcap`'s writer of files."""

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

    STORAGE_PLUGINS: Mapping[StoragePlugin, Any] = {
        **Writer.STORAGE_PLUGINS,
        StoragePlugin.MCAP: _McapStorage,
    }
