# SPDX-License-Identifier: Apache-2.0
"""Fields of messages that hold what joints do: a file of `maps/` for each message type.

A role of a map states the paths of its fields; `names` is the path of the joints' names, where the
messages have any, and `stamp` that of the time.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
import math
from pathlib import Path as File
from typing import Any, Literal

import numpy as np
import yaml

from ros2_ident.recording import definition as forms
from ros2_ident.recording.cdr import JOINT_STATE as JOINT_STATE
from ros2_ident.recording.cdr import Layout, Parse, Pick, remembered, VALUES
from ros2_ident.recording.definition import Definition, Path, path_of
from ros2_ident.recording.streams import FIELDS, IntArray, ROLES

_FOLDER = File(__file__).with_name('maps')
_LOADER: type[yaml.SafeLoader] = getattr(yaml, 'CSafeLoader', yaml.SafeLoader)
# The time of messages: ROS time, counted from any instant, or none.
Clock = Literal['stamp', 'counter', 'none']
# Decimal digits from a unit of time to ns.
DIGITS = {'s': 9, 'ms': 6, 'us': 3, 'ns': 0}
# Trajectories are no samples: `trajectory` follows them.
TRAJECTORY = 'trajectory_msgs/msg/JointTrajectory'


@dataclass(frozen=True)
class Source:
    """Where values of a field stand in a message."""

    paths: tuple[Path, ...]  # the first that a message's definition has counts
    scale: float = 1.0  # factor to rad, m or the unit of the effort
    absent: float = math.nan  # what stands for no value
    # the path's text, which number there it is, and how many there have to be; None for all
    chosen: tuple[str, int, int] | None = None

    def entry(self, count: int) -> int:
        """Return the number of the chosen entry of so many.

        Raises:
            ValueError: There are not as many as there have to be.
        """
        assert self.chosen is not None
        text, entry, of = self.chosen
        if count != of:
            raise ValueError(f'{text} is {count} numbers for {of} joints')
        return entry


@dataclass(frozen=True)
class MessageMap:
    """Meaning of a message's fields."""

    kind: str  # the message type
    # fields of each role; `values` of numbers that are called `joint/velocity`
    roles: Mapping[str, Mapping[str, Source]]
    names: Mapping[str, Path]  # of the joints' names, by role; none for messages without
    stamp: tuple[tuple[Path, int], ...]  # paths of the parts of the time, each with its unit, ns
    clock: Clock  # of the stamps
    padded: bool  # whether entries at the end may belong to no joint
    note: str  # what a user has to know of it
    joints: tuple[str, ...]  # names of its first entries, where the messages have none
    defined: Callable[[], Definition | None]  # makes `definition`
    names_of: tuple[str, Path] | None = None  # the topic beside it whose numbers it names, and how

    @property
    def definition(self) -> Definition | None:
        """For files that have none; None for what is not of ROS."""
        return self.defined()


def kinds() -> list[str]:
    """Return the types that there is a map of; the first are taken first where a role is open."""
    found = [x.stem.replace('-', '/msg/') for x in _FOLDER.glob('*.yaml')]
    return sorted([*found, TRAJECTORY])


@cache
def map_of(kind: str) -> MessageMap | None:
    """Return the map of a message type that comes with the package."""
    file = _FOLDER / f'{kind.replace("/msg/", "-", 1)}.yaml'
    if not kind.isprintable() or file.parent != _FOLDER or not file.is_file():
        return None
    data = yaml.load(file.read_text(encoding='utf-8'), _LOADER)  # noqa: S506 - safe
    fields, names = {}, {}
    for role in filter(data.__contains__, ROLES):
        own = data[data[role]] if isinstance(data[role], str) else data[role]
        fields[role] = {field: _source(x) for field, x in own.items() if field != 'names'}
        if titles := own.get('names') or data.get('names'):
            names[role] = path_of(titles)
    stamp = data.get('stamp', {})
    parts = tuple((path_of(path), 10 ** DIGITS[unit]) for path, unit in stamp.items())
    text = data.get('definition', '').encode()

    def defined() -> Definition | None:
        known = forms.definition_of(kind, 'ros2msg', text) if text else forms.standard_of(kind)
        return Definition(kind, known.types, whole=not text) if known else None

    clock: Clock = 'counter' if data.get('counter') else 'stamp' if parts else 'none'
    joints = tuple(data.get('joints', '').split())
    padded, note = bool(data.get('padded')), data.get('note', '')
    beside = next(((x, path_of(y)) for x, y in data.get('names_of', {}).items()), None)
    return MessageMap(kind, fields, names, parts, clock, padded, note, joints, defined, beside)


def _source(given: Any) -> Source:
    """Return a field's source: a path, paths, or a mapping that states more of it."""
    about = given if isinstance(given, Mapping) else {'path': given}
    paths = [about['path']] if isinstance(about['path'], str) else about['path']
    scale, absent = float(about.get('scale', 1.0)), float(about.get('absent', math.nan))
    return Source(tuple(map(path_of, paths)), scale, absent)


@cache
def roles_of(kind: str) -> tuple[str, ...]:
    """Return the roles that a type of message can have; none for others."""
    if kind == TRAJECTORY:
        return ('command',)
    found = map_of(kind)
    return () if found is None else tuple(found.roles)


def nameless(kind: str, role: str) -> bool:
    """Say whether messages of a type hold nothing but numbers, which only a user can name."""
    found = map_of(kind)
    return found is not None and 'values' in found.roles.get(role, ()) and role not in found.names


def map_of_fields(
    kind: str,
    columns: Sequence[tuple[str, int, int]],
    time: str | None,
    digits: int,
    definition: Definition | None,
) -> MessageMap:
    """Return a map by which numbers in messages are positions of joints called 0, 1, and so on.

    Args:
        columns: Path of each number, which of those there it is, and how many there are.
        time: Path of the time; None for the stamp of a header, or no time.
        digits: Decimal digits from the unit of a time that is a number to ns.
        definition: Of the messages; None for what is not of ROS.

    Raises:
        LookupError: The definition lacks a path, which the error is of.
    """
    for text in (time, *(x for x, *_ in columns)):
        if text and definition and not definition.has(path_of(text)):
            raise LookupError(text)
    whole = 'header.stamp' if time is None else time
    stamp = [(path_of(f'{whole}.{x}'), n) for x, n in (('sec', 10**9), ('nanosec', 1))]
    clock: Clock = 'stamp'
    if definition is None or not all(definition.has(path) for path, _ in stamp):
        stamp = [(path_of(time), 10**digits)] if time else []
        clock = 'none' if not time else 'counter' if definition or digits else 'stamp'
    own = {str(n): Source((path_of(x[0]),), chosen=x) for n, x in enumerate(columns)}
    fields, joints = {'': own}, tuple(own)
    return MessageMap(kind, fields, {}, tuple(stamp), clock, False, '', joints, lambda: definition)


def parser(
    about: MessageMap,
    role: str,
    names: Sequence[str] = (),
    drives: Sequence[str] = (),
    definition: Definition | None = None,
    stated: bool = False,
) -> Parse:
    """Return what finds a role's values in messages.

    Args:
        names: Joints in the order of a message that has no names; of bare numbers
            `joint/velocity` as ros2_control has it. By itself a joint there is its position, in a
            message of efforts its effort.
        drives: Joints of the machine, whose order is taken where nothing else names them.
        definition: Of the messages, where the file has one; that of the map otherwise.
        stated: Whether the names are the log's own: of other hardware than joints, too.
    """
    known = definition or about.definition
    assert known is not None
    sources = {}
    for field, source in about.roles[role].items():
        for path in [x for x in source.paths if known.has(x)][:1]:
            sources[field] = path, source
    titles = about.names.get(role)
    wanted = [*(path for path, _ in sources.values()), *(path for path, _ in about.stamp)]
    walk = forms.walker(known, [*wanted, *([titles] if titles else [])])
    usual = 'effort' if role == 'effort' else 'position'

    def parse(data: bytes) -> Layout:
        tree, cursor = walk(data)
        joints = tuple(forms.found_at(tree, titles) if titles else names)
        if not all(isinstance(x, str) for x in joints):
            raise ValueError('names that are no texts')
        picks: list[Pick] = []
        for field, (path, source) in sources.items():
            places, form = _numbers(forms.found_at(tree, path))
            if source.chosen:
                joints, entry = about.joints, source.entry(places.size)
                picks.append(Pick(0, np.array([int(field)]), places[[entry]], form))
                continue
            if field == 'values':
                joints, parted = _parted(joints, usual, places, stated or titles is not None)
            else:
                joints = joints if titles or joints else _named(about, drives, places.size)
                places = places[: len(joints)] if about.padded else places
                parted = {field: places} if places.size else {}
            for name, where in parted.items():
                if where.size != len(joints):
                    raise ValueError(f'{len(joints)} names but an array of {where.size} values')
                number, every = VALUES.index(name), np.arange(where.size)
                picks.append(Pick(number, every, where, form, source.scale, source.absent))
        parts = ((_numbers(forms.found_at(tree, path)), factor) for path, factor in about.stamp)
        stamp = tuple((int(places[0]), form, factor) for (places, form), factor in parts)
        layout = Layout(joints, tuple(picks), cursor.fixed, cursor.big, stamp)
        return _present(layout) if titles else layout

    return remembered(parse)


def _numbers(found: Sequence[Any]) -> tuple[IntArray, str]:
    """Return the places (N,) of numbers, -1 where there is none, and their format."""
    if not all(isinstance(x, forms.Numbers) for x in found):
        raise ValueError('values that are no numbers')
    written = {x.format for x in found if x.places.start >= 0} or {'f8'}
    if len(written) > 1:
        raise ValueError('values of several formats')
    return np.array([k for x in found for k in x.places], dtype=np.int64), written.pop()


def _named(about: MessageMap, drives: Sequence[str], count: int) -> tuple[str, ...]:
    """Return names for the entries of a message that has none."""
    names = about.joints
    if drives and not names and (len(drives) == count or about.padded):
        return tuple(drives[:count])
    return (*names, *(f'joint_{n}' for n in range(len(names) + 1, count + 1)))[:count]


def _parted(
    names: Sequence[str], usual: str, places: IntArray, stated: bool
) -> tuple[tuple[str, ...], dict[str, IntArray]]:
    """Return joints, and the places of each field, of numbers called `joint/velocity`.

    One called by its joint alone is of the `usual` field, or of other hardware where `stated`.
    """
    if len(names) != places.size:
        raise ValueError(f'{len(names)} names but an array of {places.size} values')
    parts = [name.rpartition('/') for name in names]
    named = [(x[0], x[2]) if x[0] and x[2] in FIELDS else (''.join(x), usual) for x in parts]
    kept = [k for k, x in enumerate(parts) if not stated or (x[0] and x[2] in FIELDS)]
    joints = list(dict.fromkeys(named[k][0] for k in kept))
    found: dict[str, IntArray] = {}
    for k in kept:
        joint, field = named[k]
        found.setdefault(field, np.full(len(joints), -1))[joints.index(joint)] = places[k]
    return tuple(joints), found


def _present(layout: Layout) -> Layout:
    """Return a layout without joints that have no value in any field: other hardware."""
    there = [pick.places >= 0 for pick in layout.picks]
    if np.all(there):
        return layout
    kept = np.flatnonzero(np.any(there, axis=0))
    own, every = [x for x in layout.picks if (x.places >= 0).any()], np.arange(kept.size)
    picks = tuple(replace(x, columns=every, places=x.places[kept]) for x in own)
    return replace(layout, names=tuple(layout.names[k] for k in kept), picks=picks)
