# SPDX-License-Identifier: Apache-2.0
"""The messages of a sound db3 bag and of an indexed ROS 1 bag; neither format has checksums."""

from collections import Counter
from contextlib import closing
from functools import cache
from io import BytesIO
import mmap
from pathlib import Path
import sqlite3
from typing import Any
from urllib.parse import quote

from rosbags.rosbag1 import Reader, ReaderError
from rosbags.rosbag1.reader import (
    decompressors,
    Header,
    read_bytes,
    read_uint32,
    RecordType,
)
from rosbags.typesys import get_types_from_msg, get_typestore, Stores
from rosbags.typesys.store import Typestore

from ros2_ident.recording.content import Content, Sink
from ros2_ident.recording.limits import limit
from ros2_ident.recording.ros2_control import CONTROLLER_STATE
from ros2_ident.recording.shown import printable
from ros2_ident.recording.storage import Budget, Damage, inflate, Losses

# The fields of ROS 1's joint_trajectory_controller, which rosbags does not know.
_CONTROLLER_STATE = '''
std_msgs/Header header
string[] joint_names
trajectory_msgs/JointTrajectoryPoint desired
trajectory_msgs/JointTrajectoryPoint actual
trajectory_msgs/JointTrajectoryPoint error
'''
_METHODS = {unpack: '' if name == 'none' else name for name, unpack in decompressors.items()}


def scan_ros1(path: Path, content: Content) -> Losses:
    """Read the messages of a ROS 1 bag into a bag's content, chunk by chunk.

    Returns:
        What is lost of the file; its text is empty where nothing is.

    Raises:
        Damage: The file is no ROS 1 bag, is encrypted, or has no sound index.
    """
    losses = Losses(size=path.stat().st_size)
    reader = _Chunks(path)
    reader.path = _Mapped(path)  # type: ignore[assignment]
    try:
        reader.open()
    except Exception as exc:  # the parser lets whatever damaged bytes cause through
        said = str(exc).rstrip('.') if isinstance(exc, ReaderError) else ''
        raise Damage(printable(said) or 'its index is damaged') from None
    with reader.bio:  # type: ignore[union-attr]
        reader.read(content, losses)
    return losses


class _Mapped:
    """A path whose file is mapped: no stated length makes it allocate more than is there."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def open(self, mode: str) -> mmap.mmap:
        """Map the file."""
        with self._path.open(mode) as file:
            return mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)


class _Chunks(Reader):
    """A reader of whole chunks, which needs no index of their messages: it would fill memory."""

    def read_index_data(self, pos: int, indexes: Any) -> None:
        """Pass over the index of a chunk."""

    def read(self, content: Content, losses: Losses) -> None:
        """Fill a bag's content, and count what is lost."""
        budget = Budget(losses.size)
        topics = {x.id: x.topic for x in self.connections}
        kinds = {x.id: x.msgtype for x in self.connections}
        targets = {x.id: content.open(x.topic, x.msgtype) for x in self.connections}
        found, stated = Counter[str](), Counter[int]()
        for info in self.chunk_infos:
            stated.update(info.connection_counts)
            try:
                stream = BytesIO(self._decompressed(info.pos, budget))
                while stream.tell() < len(stream.getbuffer()):
                    header = Header.read(stream)
                    data = read_bytes(stream, read_uint32(stream))
                    if header.get_uint8('op') == RecordType.MSGDATA:
                        number = header.get_uint32('conn')
                        found[topics[number]] += 1
                        if (target := targets[number]) is not None:
                            target([header.get_time('time')], [_cdr(kinds[number], data)])
            except Damage as exc:
                losses.blocks += 1
                losses.say(str(exc))
            except Exception:  # the parser lets whatever damaged bytes cause through
                losses.blocks += 1
        for topic in topics.values():
            content.counts[topic] = found[topic]
        losses.whole = found.total()
        losses.messages = max(0, stated.total() - losses.whole)

    def _decompressed(self, place: int, budget: Budget) -> bytes:
        """Return the content of a chunk.

        Raises:
            Damage: It is larger than allowed.
            ReaderError: It is damaged.
        """
        chunk, most = self.chunks[place], budget.chunk
        self.bio.seek(chunk.datapos)  # type: ignore[union-attr]
        packed = read_bytes(self.bio, chunk.datasize)  # type: ignore[arg-type]
        raw, sound = inflate(_METHODS[chunk.decompressor], packed, most)
        budget.take(len(raw) + (not sound and len(raw) == most))
        if not sound:
            raise ReaderError
        return raw


def _cdr(kind: str, data: bytes) -> bytes:
    """Return the CDR of a serialised message of ROS 1, whose header has a number more.

    Empty where it is no such message.
    """
    try:
        return bytes(_store().ros1_to_cdr(data, kind))
    except Exception:  # generated code lets whatever damaged bytes cause through
        return b''


@cache
def _store() -> Typestore:
    store = get_typestore(Stores.ROS2_JAZZY)
    store.register(get_types_from_msg(_CONTROLLER_STATE, CONTROLLER_STATE))
    return store


_SOUND_STEPS, _STEPS_PER_BYTE, _EVERY = 2_000_000, 20, 10_000


def scan_db3(path: Path, content: Content) -> Losses:
    """Read the messages of a db3 file into a bag's content.

    Returns:
        What is lost of the file; its text is empty where nothing is.

    Raises:
        Damage: SQLite finds it malformed, or no bag.
    """
    losses = Losses(size=path.stat().st_size)
    wal = path.with_name(path.name + '-wal')
    if wal.is_file() and wal.stat().st_size:
        losses.say(f'{wal.name} beside it holds messages that were never moved into it')
    name = f'file:{quote(str(path))}?mode=ro&immutable=1'
    try:
        with closing(sqlite3.connect(name, uri=True)) as base:
            _guard(base, losses.size)
            if base.execute('PRAGMA quick_check(1)').fetchone() != ('ok',):
                raise Damage('SQLite finds it malformed')
            _read(base, content, losses)
    except (sqlite3.Error, UnicodeDecodeError, OverflowError, TypeError) as exc:
        raise Damage(f'SQLite cannot read it: {exc}') from None
    return losses


def _guard(base: sqlite3.Connection, size: int) -> None:
    """Let no damaged or crafted file compute without end, or anything but read tables."""
    left = (_SOUND_STEPS + _STEPS_PER_BYTE * size) // _EVERY

    def tick() -> int:
        nonlocal left
        left -= 1
        return left < 0

    base.set_progress_handler(tick, _EVERY)
    base.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, limit('chunk'))
    base.execute('PRAGMA trusted_schema = OFF')
    base.execute('PRAGMA cell_size_check = ON')
    known = dict(base.execute('SELECT name, type FROM sqlite_master'))
    if known.get('topics') != 'table' or known.get('messages') != 'table':
        raise Damage("none of its tables is a bag's")


def _read(base: sqlite3.Connection, content: Content, losses: Losses) -> None:
    ways: dict[int, tuple[str, Sink | None]] = {}
    query = 'SELECT id, name, type, serialization_format FROM topics ORDER BY id'
    for number, name, kind, form in base.execute(query):
        kind = kind if form in ('cdr', '') else f'{kind} ({form})'
        ways[number] = name, content.open(name, kind)
    found: Counter[int] = Counter()
    found.update(dict(base.execute('SELECT topic_id, count(*) FROM messages GROUP BY topic_id')))
    losses.unknown = sum(count for number, count in found.items() if number not in ways)
    wanted = [number for number, (_, target) in ways.items() if target is not None]
    rows = base.execute(
        'SELECT topic_id, timestamp, data FROM messages WHERE topic_id IN '  # noqa: S608
        f'({", ".join("?" * len(wanted))}) ORDER BY timestamp, rowid',
        wanted,
    )
    for number, when, data in rows:
        if not isinstance(when, int) or not isinstance(data, bytes):
            found[number] -= 1
            losses.unknown += 1
            continue
        ways[number][1]([when], [data])  # type: ignore[misc]
    for number, (topic, _) in ways.items():
        content.counts[topic] += found[number]
        losses.whole += found[number]
