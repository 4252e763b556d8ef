# SPDX-License-Identifier: Apache-2.0
"""Read logs into recordings: bags whole or damaged, tables, LeRobot folders."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
import shlex

import numpy as np

from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.recording.builder import RecordingBuilder
from ros2_ident.recording.columns import load_topics, stated_units, summed
from ros2_ident.recording.content import Content, Messages, why
from ros2_ident.recording.lerobot import INFO, read_lerobot, Travel
from ros2_ident.recording.limits import listed, printable
from ros2_ident.recording.maps import JOINT_STATE, kinds, map_of, nameless, roles_of
from ros2_ident.recording.scan import scan
from ros2_ident.recording.storage import Damage, damaged, digest, storage_files, SUFFIXES, unpacked
from ros2_ident.recording.streams import FloatArray, IntArray, Recording, ROLES
from ros2_ident.recording.table import ARRAYS, of_columns, read_columns, TABLES


@dataclass(frozen=True)
class Topics:
    """Where in a log is what: the topic of each role; `none`, or an empty name, for no such topic.

    Where a log has no topic of a default name, what ros2_control publishes is taken instead. One
    of another name was named, and has to be there.

    Attributes:
        state: Measured positions and velocities, and efforts where the drive reports them here.
        effort: Measured efforts on a topic of their own.
        command: The controller's set-point.
        columns: Column map of a table (CSV) or of the fields of a bag's topics; of a table, where
            empty, the file `NAME.columns.yaml` beside `NAME.csv`. Of a LeRobot folder its robot's
            calibration.
        names: Joints in the order of messages that name none; of a Float64MultiArray also
            `joint/velocity`.
        so_far: Whether the log is of a node that may not have heard every topic yet.
        position_unit: Unit of the positions in a LeRobot folder: rad, deg or percent; where empty,
            it is told by the ends of the joints.
    """

    state: str = '/joint_states'
    effort: str = '/effort'
    command: str = '/joint_command'
    columns: str = ''
    names: tuple[str, ...] = ()
    so_far: bool = False
    position_unit: str = ''

    def topic(self, role: str) -> str:
        """Return the absolute name of a role's topic, empty for none."""
        name = str(getattr(self, role)).lstrip('/')
        return '' if name in ('', 'none') else '/' + name

    def named(self, role: str) -> bool:
        """Say whether a role has a topic of another name than the default: it has to be there."""
        return not self.so_far and self.topic(role) not in ('', getattr(Topics, role))

    def roles(self) -> dict[str, tuple[str, ...]]:
        """Return the roles of each topic, with absolute names.

        Raises:
            IdentError: INVALID_GOAL where none has any.
        """
        found: dict[str, tuple[str, ...]] = {}
        for role in ROLES:
            if topic := self.topic(role):
                found[topic] = (*found.get(topic, ()), role)
        if not found:
            raise ErrorCode.INVALID_GOAL.error('no topic is given; name at least the state topic')
        return found


def read_bag(
    path: str | Path,
    topics: Topics | None = None,
    travel: Travel | None = None,
    drives: Sequence[str] = (),
) -> list[Recording]:
    """Read what joints do from a bag's topics, or a table's columns.

    Args:
        path: A bag directory with or without metadata.yaml, a bare `.mcap`, `.db3` or `.bag`
            file, a `.csv` file, arrays, or a LeRobot folder.
        topics: Which topics to read; the default names where None.
        travel: Ends of the machine's joints, by which a LeRobot folder's unit is told.
        drives: The machine's joints, whose order is taken where messages name none.

    Returns:
        One recording per uninterrupted stretch, in the order of the log. What a damaged bag does
        not yield is said in their warnings.

    Raises:
        IdentError: NO_DATA, MISSING_STREAM, DAMAGED_BAG, BAD_VALUES, WRONG_UNITS or INVALID_GOAL,
            each with the remedy.
    """
    path = Path(path)
    topics = topics or Topics()
    try:
        if of_columns(path):
            return read_columns(path, topics.columns)
        if (path / INFO).is_file():  # a LeRobot folder
            roles = [role for role in ROLES if topics.topic(role)]
            return read_lerobot(path, roles, topics.position_unit, topics.columns, travel)
        return _read(path, topics, tuple(drives))
    except OSError as exc:
        text = f'cannot be read ({exc.strerror or exc}); give the path of a log'
        raise ErrorCode.NO_DATA.error(f'{printable(str(path))}: {text}') from exc


def read_bags(
    paths: Sequence[str | Path],
    topics: Topics | None = None,
    travel: Travel | None = None,
    drives: Sequence[str] = (),
) -> list[Recording]:
    """Read logs one after the other.

    Raises:
        IdentError: As `read_bag`; INVALID_GOAL where two hold the same, which would count twice
            and make every interval too narrow.
    """
    found: list[Recording] = []
    of: dict[str, str] = {}
    for path in paths:
        found += (recordings := read_bag(path, topics, travel, drives))
        name, digest = printable(str(path)), recordings[0].sha256
        if digest in of:
            text = f'is the same log as {of[digest]} and would count twice; name it once'
            raise ErrorCode.INVALID_GOAL.at(name, text)
        of[digest] = name
    return found


def _read(path: Path, topics: Topics, drives: tuple[str, ...]) -> list[Recording]:
    notes: tuple[str, ...] = ()
    roles, (files, warnings) = topics.roles(), storage_files(path)
    layouts = load_topics(topics.columns) if topics.columns else {}
    content = _scanned(files, Content(roles, topics.names, drives, layouts))
    for topic in (x for x in layouts if not content.counts.get(x)):
        held = listed(f'{x} ({kind})' for x, kind in sorted(content.types.items()))
        text = f'{path}: holds no message of {topic}, only {held}; correct the column map'
        raise ErrorCode.MISSING_STREAM.error(text)
    if not layouts:
        content.titles = titles = content.titled()
        chosen, open_, notes = supplemented(topics, content, drives)
        if chosen != topics or titles:
            roles = chosen.roles()
            content = _scanned(files, Content(roles, chosen.names, drives, titles=titles))
        read = any(x.count for x in content.messages.values())
        if open_ and not read and not any(map(topics.named, ROLES)):
            raise ErrorCode.MISSING_STREAM.error(f'{path}: {open_[0]}')
        _check_topics(path, content, roles, topics)
        notes = (*open_, *notes)
    read_from = [*files, Path(topics.columns)] if layouts else files
    # damage says it all: metadata.yaml cannot fit a broken file
    said = content.warnings or warnings
    builder = RecordingBuilder(str(path), digest(read_from), notes, said)
    for (topic, role), messages in content.messages.items():
        _tell(builder, role, topic, content, messages)
        if topic in layouts:
            columns = layouts[topic].columns
            stamp, rows = _joined(messages, len(columns))
            units = stated_units(topics.columns, columns)
            builder.add_columns(stamp, summed(topics.columns, columns, stamp, [*rows.T]), units)
        while messages.blocks:
            block = messages.blocks.popleft()
            builder.add_block(role, block.stamp, block.names, *block.fields)
    return builder.build()


def _joined(messages: Messages, width: int) -> tuple[IntArray, FloatArray]:
    """Take the stamps (T,) and first fields (T, width) of all blocks."""
    blocks = [*messages.blocks]
    messages.blocks.clear()
    pairs = ((x.fields[0], x.stamp.size) for x in blocks)
    values = [np.full((size, width), np.nan) if own is None else own for own, size in pairs]
    return np.concatenate([x.stamp for x in blocks]), np.concatenate(values)


def supplemented(
    topics: Topics, content: Content, drives: Sequence[str] = ()
) -> tuple[Topics, tuple[str, ...], tuple[str, ...]]:
    """Give the roles whose default topics a log does not have to others.

    A topic of the default's name in a namespace goes before what ros2_control or a robot
    publishes. Of several the one that names most of the machine's joints is taken.

    Returns:
        The topics to read, a sentence on each role that several could have, and one on each topic
        that was chosen or could be.
    """
    offered = list(content.offered())
    chosen: dict[str, str] = {}
    several, notes = [], []
    for role in ROLES:
        if not _is_open(topics, role, content, chosen):
            continue
        default = getattr(topics, role)
        for kind in (JOINT_STATE, *kinds()):
            able = [x for x, its, roles in offered if its == kind and role in roles]
            if kind == JOINT_STATE:
                able = [x for x in able if x.endswith(default)]
            if not able:
                continue
            named = [len(content.joints_of(x, role) & {*drives}) for x in able]
            best = [x for x, count in zip(able, named, strict=True) if count == max(named)]
            if len(best) == 1:
                chosen[role] = best[0]
                why = ', of joints of the machine' if len(able) > 1 else ''
                notes.append(f'{role}: no {default}, {best[0]} is taken ({kind}{why})')
            else:
                text = f'{role}: {listed(best)} hold one; name one of them by --{role}-topic'
                several.append(text)
            break
    for topic, kind, roles in offered:
        if topic in chosen.values() or kind == JOINT_STATE:
            continue
        names, bare = '', [x for x in ('command', 'state') if nameless(kind, x)]
        if not roles and bare:
            roles, names = (bare[0],), ' --joint-names A,B (the joints in its order)'
        ways = ' or '.join(f'--{role}-topic {topic}{names}' for role in roles)
        said = f'; to read it: {ways}' if roles else ': it holds no values'
        notes.append(f'{topic} ({kind}) is not read{said}')
    found = replace(topics, **chosen)  # type: ignore[arg-type]
    return found, tuple(several), (*notes, *_others(content))


# Fields of a type without a map that are shown, and topics in a list.
_SHOWN, _LISTED = 4, 20


def _others(content: Content) -> list[str]:
    """Return a sentence on each topic of a type without a map, and one on those without numbers.

    Names of numbers show whether a column map is worth writing.
    """
    found, bare = list[str](), []
    for topic, kind in sorted(content.types.items()):
        if roles_of(kind) or map_of(kind) is not None:
            continue
        known = content.definition(topic)
        fields = known.numbers(_SHOWN + 1) if known and len(found) < _LISTED else []
        if fields:
            said = f'{topic} ({printable(kind)}) is not read, there is no map of its type'
            found.append(f'{said}; it holds {listed(fields, _SHOWN)}')
        else:
            bare.append(f'{topic} ({kind})')
    return [*found, *([f'not read: {listed(bare, _LISTED)}'] if bare else [])]


def _is_open(topics: Topics, role: str, content: Content, chosen: Mapping[str, str]) -> bool:
    """Say whether a role has its default topic, and the log and the state chosen lack it."""
    if topics.topic(role) != getattr(Topics, role) or topics.topic(role) in content.types:
        return False
    if role == 'effort' and 'state' in chosen:
        about = map_of(content.types[chosen['state']])
        return about is None or 'effort' in about.roles
    state = content.messages.get((topics.topic('state'), 'state'))
    efforts = [x.fields[2] for x in state.blocks] if role == 'effort' and state else []
    return not any(x is not None and np.isfinite(x).any() for x in efforts)


def _scanned(files: list[Path], content: Content) -> Content:
    """Return the content with the messages of all files, and in warnings what is lost."""
    refused: list[IdentError] = []
    found = 0
    with unpacked(files) as plain:
        for file, (place, whole) in zip(files, plain, strict=True):
            try:
                losses = scan(place, content)
            except Damage as exc:
                refused.append(_unreadable(file, place.suffix, str(exc)))
                continue
            found += losses.whole
            if not whole:
                losses.say('it cannot be unpacked to its end')
            if losses.text and not losses.whole:
                said = f'{losses.text}, no message is whole; copy or record the bag again'
                refused.append(damaged(file, said))
            elif losses.text:
                remedy = 'copy the file again'
                if file.suffix == '.mcap':
                    name = printable(shlex.quote(file.name))
                    remedy = f'`mcap recover {name}` writes a sound file of the same content'
                lost = f', {losses.messages} are lost' if losses.messages else ''
                read = f'{losses.whole} whole messages were read{lost}'
                content.warnings.append(f'{file}: is damaged: {losses.text}, {read}; {remedy}')
    for messages in content.messages.values():
        messages.finish()
    if refused and not found:
        raise refused[0]
    content.warnings += [x.message for x in refused]
    return content


def _unreadable(path: Path, kind: str, reason: str) -> IdentError:
    if not reason:
        return damaged(path, 'is empty (0 bytes); copy or record the bag again')
    if kind not in SUFFIXES:
        text = f'{printable(kind) or "a file without a suffix"} is not a format read here; '
        text += 'give a bag, .mcap, .db3, .bag or its directory, or write a table with a column '
        text += f'map: {", ".join((TABLES[0], *ARRAYS))}'
        return ErrorCode.INVALID_GOAL.at(path, text)
    name = shlex.quote(path.name)
    remedy = {
        '.bag': f'`rosbag reindex {name}` writes the index of what is whole, or ',
        '.db3': f'what is left comes out with `sqlite3 {name} .recover`, or ',
    }.get(kind, '')
    return damaged(path, f'cannot be read ({reason}); {remedy}copy or record the bag again')


def _check_topics(
    path: Path, raw: Content, roles: dict[str, tuple[str, ...]], topics: Topics
) -> None:
    """Say what is wrong where no wanted topic, or not every named one, can be read."""
    for topic, several in roles.items():
        kind = raw.types.get(topic, JOINT_STATE)
        for role in (x for x in several if x not in roles_of(kind)):
            text = f'which holds no {role}; give another as {role}'
            if not roles_of(kind):
                text = f'of which there is no map; give another as {role}, or --columns with the '
                text += 'fields that it is in'
            text = f'{topic} is of type {printable(kind)}, {text}'
            raise ErrorCode.MISSING_STREAM.at(path, text)
        about = map_of(kind)
        same = about is None or len({str(about.roles[x]) for x in several}) < len(several)
        if len(several) > 1 and same:
            text = f'{topic} is given as {several[0]} and as {several[1]}; name one topic per role'
            raise ErrorCode.INVALID_GOAL.error(text)
        if nameless(kind, several[0]) and not raw.names and topic not in raw.titles:
            text = f'{topic} is an array without names; name the joints in its order, as a,b or '
            text += 'a/velocity,b/velocity: --joint-names (the node: joint_names)'
            raise ErrorCode.INVALID_GOAL.error(text)
    if not sum(raw.counts.values()):
        text = 'the bag holds no message; record again while the drives publish'
        raise ErrorCode.NO_DATA.at(path, text)
    named = [x for x, several in roles.items() if any(map(topics.named, several))]
    lacking = [x for x in named if not raw.counts.get(x)]
    if lacking or not any(messages.count for messages in raw.messages.values()):
        held = listed(f'{x} ({kind})' for x, kind in sorted(raw.types.items()) if raw.counts[x])
        text = f'holds no message of {", ".join(lacking or roles)}, only {held}; name the topics '
        text += 'of state, effort and command, or `none` for one that was not recorded, or give '
        text += 'their fields by --columns'
        raise ErrorCode.MISSING_STREAM.at(path, text)


def _tell(
    builder: RecordingBuilder, role: str, topic: str, content: Content, messages: Messages
) -> None:
    """Say what is lost of a topic, what its times, names and gains are."""
    kind = content.types[topic]
    about = None if content.mapped else map_of(kind)
    named = kind.rpartition('/')[2]
    if messages.lost and not messages.blocks:
        reason = messages.why if content.mapped else why(kind, role)
        text = f'no message of {topic} is a valid {kind} ({reason})'
        raise ErrorCode.BAD_VALUES.error(f'{builder.source}: {text}; repair the publisher')
    said = []
    if messages.lost:
        lost = f'{messages.lost} of {messages.count} messages'
        said.append(f'{lost} are no valid {named} and are left out')
    if messages.unstamped and messages.clock == 'none':
        said.append(f'{named} has no stamp, the time of recording is used, some milliseconds late')
    elif messages.unstamped:
        said.append('all header stamps are 0, the time of recording is used; stamp the messages')
    said += messages.said
    names = messages.blocks[0].names if messages.blocks else ()
    said += [about.note] if about is not None and about.note else []
    given = content.names or topic in content.titles
    if about is not None and role not in about.names and not given and messages.blocks:
        called = f'{listed(names, 4)} in their order; name others by --joint-names'
        said.append(f'its messages have no names: joints are called {called}')
    for sentence in said:
        builder.warn(f'{topic}: {sentence}')
    gains = []
    for (name, n), (low, high) in sorted(messages.gains.items()):
        if n < len(names):
            end = f' to {high:.4g}' if high > low else ''
            gains.append(f'{name} of {names[n]} {low:.4g}{end}')
    if gains:
        builder.notes += (f'{topic} comes with gains: {listed(gains, 24)}',)
