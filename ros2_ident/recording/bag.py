# SPDX-License-Identifier: Apache-2.0
"""Read logs into recordings: MCAP, db3 and ROS 1 bags, whole or damaged, and tables."""

from collections import deque
from dataclasses import dataclass, field
from pathlib import Path
import sqlite3

import numpy as np
from rosbags.highlevel import AnyReader
from rosbags.typesys import get_typestore, Stores

from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.recording import cdr
from ros2_ident.recording.builder import RecordingBuilder
from ros2_ident.recording.mcap_scan import scan
from ros2_ident.recording.storage import digest, storage_files, SUFFIXES, unpack_messages, unpacked
from ros2_ident.recording.streams import IntArray, Recording, ROLES
from ros2_ident.recording.table import read_table
from ros2_ident.recording.table import SUFFIXES as TABLES

JOINT_STATE = 'sensor_msgs/msg/JointState'
# Messages that are decoded at once; fewer would take longer.
_PIECE = 1 << 14


@dataclass(frozen=True)
class Topics:
    """Where in a log is what: the topic of each role; an empty name leaves the role out.

    Attributes:
        state: Measured positions and velocities, and efforts where the drive reports them here.
        effort: Measured efforts on a topic of their own.
        command: The controller's set-point.
        columns: Column map of a table (CSV), which has no topics; where empty, the file
            `NAME.columns.yaml` beside `NAME.csv`.
    """

    state: str = '/joint_states'
    effort: str = '/effort'
    command: str = '/joint_command'
    columns: str = ''

    def roles(self) -> dict[str, str]:
        """Return the role of each topic, with absolute names.

        Raises:
            IdentError: INVALID_GOAL where one topic has two roles or none has any.
        """
        found: dict[str, str] = {}
        for role in ROLES:
            name = getattr(self, role)
            if not name:
                continue
            topic = '/' + str(name).lstrip('/')
            if topic in found:
                raise IdentError(
                    ErrorCode.INVALID_GOAL,
                    f'{topic} is given as {found[topic]} and as {role}; name one topic per role, '
                    f'efforts inside joint states need no {role} topic',
                )
            found[topic] = role
        if not found:
            raise IdentError(
                ErrorCode.INVALID_GOAL, 'no topic is given; name at least the state topic'
            )
        return found


class _Messages:
    """The messages of a topic in the order of log time, decoded piece by piece.

    A message as an object takes some hundred bytes; hours of them at 1 kHz would fill the memory.
    """

    def __init__(self) -> None:
        self.count = 0
        self.lost = 0
        self.blocks: deque[tuple[IntArray, cdr.Block]] = deque()
        self._fresh: list[tuple[int, bytes]] = []

    def append(self, log_time: int, data: bytes) -> None:
        """Take a message: log time [ns] and CDR bytes."""
        self.count += 1
        self._fresh.append((log_time, data))
        if len(self._fresh) >= _PIECE:
            self.decode()

    def decode(self) -> None:
        """Decode what has come since the last time; what is no JointState is counted."""
        if not self._fresh:
            return
        times = [x[0] for x in self._fresh]
        data = unpack_messages([x[1] for x in self._fresh])
        self._fresh = []
        try:
            found = cdr.decode(data)
        except (ValueError, IndexError):
            before = len(data)
            data, times = _whole_messages(data, times)
            self.lost += before - len(data)
            found = cdr.decode(data)
        clock = np.array(times, dtype=np.int64)
        self.blocks.extend((clock[block.rows], block) for block in found)

    def __len__(self) -> int:
        return self.count


@dataclass
class _Raw:
    """What a bag holds.

    Attributes:
        messages: By topic.
        types: Message type of every topic of the bag.
        counts: Messages of every topic of the bag.
        warnings: What could not be read.
    """

    messages: dict[str, _Messages] = field(default_factory=dict)
    types: dict[str, str] = field(default_factory=dict)
    counts: dict[str, int] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)


def _damaged(path: Path, text: str) -> IdentError:
    return IdentError(ErrorCode.DAMAGED_BAG, f'{path}: {text}')


def read_bag(path: str | Path, topics: Topics | None = None) -> list[Recording]:
    """Read a bag's JointState topics, or a table's columns.

    Args:
        path: A bag directory with or without metadata.yaml, a bare `.mcap`, `.db3` or `.bag`
            file, or a `.csv` file.
        topics: Which topics to read; the default names where None.

    Returns:
        One recording per uninterrupted stretch, in the order of the log. What a damaged bag does
        not yield is said in their warnings.

    Raises:
        IdentError: NO_DATA, MISSING_STREAM, DAMAGED_BAG, BAD_VALUES or INVALID_GOAL, each with
            the remedy.
    """
    path = Path(path)
    topics = topics or Topics()
    if path.suffix.lower() in TABLES:
        return read_table(path, topics.columns)
    roles = topics.roles()
    files, warnings = storage_files(path)
    raw = _read(path, files, warnings, roles)
    _check_topics(path, raw, roles)
    builder = RecordingBuilder(str(path), digest(files))
    for sentence in raw.warnings:
        builder.warn(sentence)
    for topic, role in roles.items():
        if topic in raw.messages:
            _feed(builder, role, topic, raw.messages[topic])
    return builder.build()


def _read(path: Path, files: list[Path], warnings: list[str], roles: dict[str, str]) -> _Raw:
    """Read the serialised messages, from the records one by one where the regular way fails."""
    empty = [x for x in files if not x.stat().st_size]
    if empty:
        raise _damaged(empty[0], 'is empty (0 bytes); copy or record the bag again')
    if (path / 'metadata.yaml').exists() and not warnings:
        try:
            return _read_regular([path], roles)
        except Exception:
            # an unreadable metadata.yaml around good files is everyday; the files say more
            warnings = [
                f'{path}: metadata.yaml does not fit the files; `ros2 bag reindex {path}` writes '
                'it anew'
            ]
    with unpacked(files) as plain:
        try:
            raw = _read_regular(plain, roles)
        except Exception as exc:
            # rosbags lets struct, zstd and sqlite errors of broken files through
            if isinstance(exc, MemoryError):
                raise
            if any(x.suffix != '.mcap' for x in plain):
                raise _unreadable(files, plain, exc) from exc
            # the damage says it all: metadata.yaml cannot fit a broken file
            return _read_damaged(files, plain, roles)
    raw.warnings[:0] = warnings
    return raw


def _unreadable(files: list[Path], plain: list[Path], exc: Exception) -> IdentError:
    reason = ' '.join(str(exc).split()).rstrip('.') or type(exc).__name__
    path, kind = next(
        (x, y.suffix) for x, y in zip(files, plain, strict=True) if y.suffix != '.mcap'
    )
    if kind not in SUFFIXES:
        remedy = 'give an .mcap, .db3, .bag or .csv file or a bag directory'
    elif isinstance(exc, sqlite3.Error) or kind == '.db3':
        remedy = (
            f'what is left comes out with `sqlite3 {path.name} .recover`, or copy the file again'
        )
    else:
        remedy = 'copy or record the bag again'
    return _damaged(path, f'cannot be read ({reason}); {remedy}')


def _read_regular(paths: list[Path], roles: dict[str, str]) -> _Raw:
    raw = _Raw()
    store = get_typestore(Stores.ROS2_JAZZY)
    with AnyReader(paths, default_typestore=store) as reader:
        for connection in reader.connections:
            raw.types[connection.topic] = connection.msgtype
            raw.counts[connection.topic] = (
                raw.counts.get(connection.topic, 0) + connection.msgcount
            )
        wanted = [x for x in reader.connections if x.topic in roles and x.msgtype == JOINT_STATE]
        for connection in wanted:
            raw.messages.setdefault(connection.topic, _Messages())
        if wanted:
            for connection, log_time, data in reader.messages(connections=wanted):
                # ROS 2's type: the conversion itself leaves out the header's `seq` of ROS 1
                cdr_data = data if reader.is2 else bytes(store.ros1_to_cdr(data, JOINT_STATE))
                raw.messages[connection.topic].append(log_time, cdr_data)
    return raw


def _read_damaged(files: list[Path], plain: list[Path], roles: dict[str, str]) -> _Raw:
    raw = _Raw()
    whole: dict[str, list[tuple[int, bytes]]] = {}
    for path, unpacked_file in zip(files, plain, strict=True):
        try:
            found = scan(unpacked_file)
        except ValueError as exc:
            raise _damaged(
                path, f'cannot be read ({exc}); give an .mcap, .db3, .bag or .csv file'
            ) from None
        raw.types.update(found.types)
        for topic, log_time, data in found.messages:
            raw.counts[topic] = raw.counts.get(topic, 0) + 1
            if topic in roles and found.types[topic] == JOINT_STATE:
                whole.setdefault(topic, []).append((log_time, data))
        lost = []
        if found.end < found.size:
            lost.append(f'the file breaks off after byte {found.end} of {found.size}')
        if found.lost_chunks:
            lost.append(f'{found.lost_chunks} blocks inside are damaged')
        what = ' and '.join(lost)
        if lost and not found.messages:
            raise _damaged(path, f'{what}, no message is whole; copy or record the bag again')
        if lost:
            raw.warnings.append(
                f'{path}: is damaged: {what}, {len(found.messages)} whole messages were read; '
                f'`mcap recover {path.name}` writes a sound file of the same content'
            )
    for topic, messages in whole.items():
        messages.sort(key=lambda x: x[0])
        raw.messages[topic] = _Messages()
        for log_time, data in messages:
            raw.messages[topic].append(log_time, data)
    return raw


def _check_topics(path: Path, raw: _Raw, roles: dict[str, str]) -> None:
    """Say what is wrong where no wanted topic can be read."""
    wrong = {
        topic: raw.types[topic]
        for topic in roles
        if raw.types.get(topic, JOINT_STATE) != JOINT_STATE
    }
    if wrong:
        topic, kind = next(iter(wrong.items()))
        raise IdentError(
            ErrorCode.MISSING_STREAM,
            f'{path}: {topic} is of type {kind}, expected {JOINT_STATE}; give another topic as '
            f'{roles[topic]}',
        )
    if any(raw.messages.get(topic) for topic in roles):
        return
    if not sum(raw.counts.values()):
        raise IdentError(
            ErrorCode.NO_DATA,
            f'{path}: the bag holds no message; record again while the drives publish',
        )
    silent = [topic for topic in roles if topic in raw.types]
    if silent:
        raise IdentError(
            ErrorCode.NO_DATA,
            f'{path}: {", ".join(silent)} is in the bag but without a message; record again while '
            'the drives publish',
        )
    others = sorted(topic for topic, kind in raw.types.items() if kind == JOINT_STATE)
    if others:
        raise IdentError(
            ErrorCode.MISSING_STREAM,
            f'{path}: holds none of {", ".join(roles)}; its JointState topics are '
            f'{", ".join(others)}: say which one is state, effort or command',
        )
    raise IdentError(
        ErrorCode.MISSING_STREAM,
        f'{path}: holds no {JOINT_STATE} topic, only {", ".join(sorted(raw.types)) or "nothing"}; '
        'record the topic on which the drives report their joints',
    )


def _feed(builder: RecordingBuilder, role: str, topic: str, messages: _Messages) -> None:
    """Bring the messages of a topic into the builder; they are gone afterwards."""
    messages.decode()
    if messages.lost and not messages.blocks:
        raise IdentError(
            ErrorCode.BAD_VALUES,
            f'{builder.source}: no message of {topic} is a valid {JOINT_STATE} (arrays have '
            'to be empty or as long as the names); repair the publisher',
        )
    if messages.lost:
        builder.warn(
            f'{topic}: {messages.lost} of {len(messages)} messages are no valid JointState and '
            'are left out'
        )
    unstamped = all(not block.stamp.any() for _, block in messages.blocks)
    if unstamped and messages.blocks:
        builder.warn(
            f'{topic}: all header stamps are 0, the time of recording is used; stamp the messages'
        )
    while messages.blocks:
        clock, block = messages.blocks.popleft()
        stamp = clock if unstamped else block.stamp
        builder.add_block(role, stamp, block.names, *block.fields)


def _whole_messages(data: list[bytes], log_times: list[int]) -> tuple[list[bytes], list[int]]:
    """Return the messages that decode, one by one, and their log times."""
    kept: list[bytes] = []
    times: list[int] = []
    for message, log_time in zip(data, log_times, strict=True):
        try:
            blocks = cdr.decode([message])
        except (ValueError, IndexError):
            continue
        if blocks[0].names and len(set(blocks[0].names)) == len(blocks[0].names):
            kept.append(message)
            times.append(log_time)
    return kept, times
