# SPDX-License-Identifier: Apache-2.0
"""Live messages in an MCAP file as they arrive, so that a crash or a restart does not lose them.

The records lie outside of chunks: whatever the process has written is in the file and can be read,
whole or cut off, as any other bag (mcap.dev/spec).
"""

from collections.abc import Sequence
import contextlib
from pathlib import Path
from typing import Any

from mcap.data_stream import RecordBuilder
from mcap.records import Channel, DataEnd, Footer, Header, Message, Schema
from mcap.writer import MCAP0_MAGIC as MAGIC
from rosbags.typesys import TypesysError

from ros2_ident.errors import IdentError
from ros2_ident.files import Growing
from ros2_ident.recording.cdr import typestore
from ros2_ident.recording.limits import size_text


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
            records += _described(self._channels[topic], topic, kind)
        number = self._channels[topic]
        for when, data in zip(times, messages, strict=True):
            records.append(Message(number, when, data, when, 0))
        out = _bytes(*records)
        if self._file.size + len(out) > self._limit:
            self.problem = (
                f'{self.path}: holds {size_text(self._file.size)} and takes no more; after a '
                'restart later messages will be missing: raise spool_size'
            )
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


def _described(number: int, topic: str, kind: str) -> tuple[Schema, Channel]:
    """Return the records that say what a channel is."""
    definition = ''
    with contextlib.suppress(TypesysError, KeyError):  # a type that only its package knows
        definition, _ = typestore().generate_msgdef(kind)
    schema = Schema(number, definition.encode(), 'ros2msg', kind)
    return schema, Channel(number, topic, 'cdr', {}, number)
