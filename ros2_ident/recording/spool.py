# SPDX-License-Identifier: Apache-2.0
"""Live messages in an MCAP file as they arrive, so that a crash or a restart does not lose them.

The records lie outside of chunks: whatever the process has written is in the file and can be read,
whole or cut off, as any other bag (mcap.dev/spec).
"""

from collections.abc import Sequence
import contextlib
from pathlib import Path
import struct

from rosbags.typesys import get_typestore, Stores, TypesysError

from ros2_ident.errors import IdentError
from ros2_ident.files import Growing
from ros2_ident.recording.limits import size_text
from ros2_ident.recording.mcap_records import (
    CHANNEL,
    DATA_END,
    FOOTER,
    FOOTER_SIZE,
    HEAD,
    HEADER,
    MAGIC,
    MESSAGE,
    MESSAGE_HEAD,
    SCHEMA,
)

_END = HEAD.size + 4 + HEAD.size + FOOTER_SIZE + len(MAGIC)


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
        self._closed = self._file.tail(_END)[_END - len(MAGIC) :] == MAGIC

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
            topic: Their topic.
            kind: Their type.
            times: When they came, ns.
            messages: Their bytes.
        """
        if self.problem:
            return
        out = bytearray()
        if topic not in self._channels:
            self._channels[topic] = len(self._channels) + 1
            out += _described(self._channels[topic], topic, kind)
        number = self._channels[topic]
        for when, data in zip(times, messages, strict=True):
            head = MESSAGE_HEAD.pack(number, 0, when, when)
            out += HEAD.pack(MESSAGE, len(head) + len(data)) + head + data
        if self._file.size + len(out) > self._limit:
            self.problem = (
                f'{self.path}: holds {size_text(self._file.size)} and takes no more; after a '
                'restart later messages will be missing: raise spool_size'
            )
            return
        self._write(bytes(out))

    def close(self) -> None:
        """End the file and let others write it."""
        if not self.empty and not self._closed:
            self._write(_record(DATA_END, bytes(4)) + _record(FOOTER, bytes(FOOTER_SIZE)) + MAGIC)
        self._file.close()

    def _write(self, data: bytes, *, anew: bool = False) -> None:
        try:
            if anew:
                self._file.cut(0)
            elif self._closed:
                self._file.cut(self._file.size - _END)
            if data and self.empty:
                text = _text('ros2') + _text('ros2_ident')
                data = MAGIC + _record(HEADER, text) + data
            self._file.write(data)
            self._closed = False
        except IdentError as exc:
            self.problem = exc.message


def _described(number: int, topic: str, kind: str) -> bytes:
    """Return the records that say what a channel is."""
    definition = ''
    with contextlib.suppress(TypesysError, KeyError):  # a type that only its package knows
        definition, _ = get_typestore(Stores.ROS2_JAZZY).generate_msgdef(kind)
    schema = struct.pack('<H', number) + _text(kind) + _text('ros2msg') + _text(definition)
    channel = struct.pack('<HH', number, number) + _text(topic) + _text('cdr') + bytes(4)
    return _record(SCHEMA, schema) + _record(CHANNEL, channel)


def _record(opcode: int, data: bytes) -> bytes:
    return HEAD.pack(opcode, len(data)) + data


def _text(value: str) -> bytes:
    raw = value.encode()
    return struct.pack('<I', len(raw)) + raw
