# SPDX-License-Identifier: Apache-2.0
"""Read logs into recordings: MCAP, db3 and ROS 1 bags, whole or damaged, and tables."""

from collections import Counter
from dataclasses import dataclass
from pathlib import Path

from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.recording import db3_scan, mcap_scan, rosbag1_scan
from ros2_ident.recording.builder import RecordingBuilder
from ros2_ident.recording.content import Content, JOINT_STATE, Messages
from ros2_ident.recording.damage import Damage, Losses
from ros2_ident.recording.limits import Limits
from ros2_ident.recording.metadata import Metadata, NAME, read_metadata
from ros2_ident.recording.shown import listed, printable
from ros2_ident.recording.storage import damaged, digest, storage_files, SUFFIXES, unpacked
from ros2_ident.recording.streams import Recording, ROLES
from ros2_ident.recording.table import read_table
from ros2_ident.recording.table import SUFFIXES as TABLES


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


def read_bag(
    path: str | Path, topics: Topics | None = None, limits: Limits | None = None
) -> list[Recording]:
    """Read a bag's JointState topics, or a table's columns.

    Args:
        path: A bag directory with or without metadata.yaml, a bare `.mcap`, `.db3` or `.bag`
            file, or a `.csv` file.
        topics: Which topics to read; the default names where None.
        limits: How much of the machine it may take; those of the environment where None.

    Returns:
        One recording per uninterrupted stretch, in the order of the log. What a damaged bag does
        not yield is said in their warnings.

    Raises:
        IdentError: NO_DATA, MISSING_STREAM, DAMAGED_BAG, BAD_VALUES or INVALID_GOAL, each with
            the remedy.
    """
    path = Path(path)
    topics = topics or Topics()
    limits = limits or Limits.from_environment()
    if path.suffix.lower() in TABLES:
        return read_table(path, topics.columns, limits)
    roles = topics.roles()
    files, warnings = storage_files(path)
    metadata = read_metadata(path)
    if (path / NAME).exists() and not warnings:
        listed_files = [path / x for x in metadata.files] if metadata else []
        if listed_files and all(x.is_file() for x in listed_files):
            files = listed_files
        else:
            metadata = None
            warnings.append(_unfit(path))
    content = Content(frozenset(roles), limits)
    _scan_all(path, files, content, metadata)
    if not content.warnings:  # damage says it all: metadata.yaml cannot fit a broken file
        content.warnings[:0] = warnings
    _check_topics(path, content, roles)
    builder = RecordingBuilder(str(path), digest(files), limits)
    for sentence in content.warnings:
        builder.warn(sentence)
    for topic, role in roles.items():
        if topic in content.messages:
            _feed(builder, role, topic, content.messages[topic])
    return builder.build()


def _unfit(path: Path) -> str:
    return (
        f'{path}: metadata.yaml does not fit the files; `ros2 bag reindex {path}` writes it anew'
    )


def _scan_all(path: Path, files: list[Path], content: Content, metadata: Metadata | None) -> None:
    """Read the serialised messages of all files; say what is lost.

    Raises:
        IdentError: DAMAGED_BAG where no file yields a message and one is damaged.
    """
    refused: list[IdentError] = []
    scanned: list[tuple[Path, Losses]] = []
    with unpacked(files, content.limits) as plain:
        for file, (place, whole) in zip(files, plain, strict=True):
            try:
                losses = _scan(place, content, metadata if len(files) == 1 else None)
            except Damage as exc:
                refused.append(_unreadable(file, place.suffix, str(exc)))
                continue
            if not whole:
                losses.say('it cannot be unpacked to its end')
            scanned.append((file, losses))
            if metadata is not None:
                content.sort()  # the files follow each other
        content.sort()
    if refused and not any(losses.whole for _, losses in scanned):
        raise refused[0]
    content.warnings += [x.message for x in refused]
    if metadata is not None and len(files) == 1 and scanned:
        scanned[0][1].expect(metadata.counts, content.counts)
    for file, losses in scanned:
        _account(file, losses, content, alone=len(files) == 1)
    if metadata is not None and len(files) > 1 and not refused:
        lost = sum((Counter(metadata.counts) - Counter(content.counts)).values())
        if lost and not content.warnings:
            content.warnings.append(_unfit(path))


def _account(file: Path, losses: Losses, content: Content, *, alone: bool) -> None:
    """Say what a file has lost.

    Raises:
        IdentError: DAMAGED_BAG where it is the only file and nothing is left of it.
    """
    if not losses.text:
        return
    name = printable(file.name)
    if not losses.whole:
        error = damaged(file, f'{losses.text}, no message is whole; copy or record the bag again')
        if alone:
            raise error
        content.warnings.append(error.message)
        return
    remedy = {
        '.mcap': f'`mcap recover {name}` writes a sound file of the same content',
        '.db3': f'`sqlite3 {name} .recover` may find more, or copy the file again',
    }.get(file.suffix, 'copy the file again')
    content.warnings.append(losses.sentence(file, remedy))


def _scan(path: Path, content: Content, metadata: Metadata | None) -> Losses:
    """Read one file by its kind."""
    if not path.stat().st_size:
        raise Damage('')
    if path.suffix == '.mcap':
        return mcap_scan.scan(path, content)
    if path.suffix == '.bag':
        return rosbag1_scan.scan(path, content)
    if path.suffix == '.db3':
        return db3_scan.scan(path, content, metadata.checksums if metadata else None)
    raise Damage('its kind is not known')


def _unreadable(path: Path, kind: str, reason: str) -> IdentError:
    if not reason:
        return damaged(path, 'is empty (0 bytes); copy or record the bag again')
    if kind not in SUFFIXES:
        remedy = 'give an .mcap, .db3, .bag or .csv file or a bag directory'
    elif kind == '.db3':
        remedy = (
            f'what is left comes out with `sqlite3 {path.name} .recover`, or copy the file again'
        )
    else:
        remedy = 'copy or record the bag again'
    return damaged(path, f'cannot be read ({reason}); {remedy}')


def _check_topics(path: Path, raw: Content, roles: dict[str, str]) -> None:
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
            f'{path}: {topic} is of type {printable(kind)}, expected {JOINT_STATE}; give '
            f'another topic as {roles[topic]}',
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
            f'{listed(others)}: say which one is state, effort or command',
        )
    raise IdentError(
        ErrorCode.MISSING_STREAM,
        f'{path}: holds no {JOINT_STATE} topic, only {listed(sorted(raw.types)) or "nothing"}; '
        'record the topic on which the drives report their joints',
    )


def _feed(builder: RecordingBuilder, role: str, topic: str, messages: Messages) -> None:
    """Bring the messages of a topic into the builder; they are gone afterwards."""
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
