# SPDX-License-Identifier: Apache-2.0
"""From single messages to recordings: the one way in for bags and for live topics."""

from collections.abc import Mapping, Sequence
import copy
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.recording.limits import Limits, too_large, variable_of
from ros2_ident.recording.outliers import leave_out
from ros2_ident.recording.segments import match_segments, split_pauses, split_stamps
from ros2_ident.recording.shown import listed, printable
from ros2_ident.recording.streams import (
    FIELDS,
    FloatArray,
    IntArray,
    LATEST_STAMP,
    Recording,
    ROLES,
    Stream,
)

# builtin_interfaces/Time counts seconds in 32 bits, until 2038.
_LAST_ROS_TIME = (1 << 31) * 1_000_000_000
# Nothing that is measured is larger; its square would overflow soon.
_ABSURD = 1e30

# The source of messages that come as they are sent.
LIVE = 'live'


# Blocks that are put together: single messages would take more room than their values.
_MANY = 1024

# Stamps (T,), the D joints, and position, velocity and effort, each (T, D) or None.
_Block = tuple[IntArray, tuple[str, ...], Sequence[FloatArray | None]]


@dataclass
class _Track:
    """All messages of one role, in the order of arrival, and the place of each joint in them."""

    blocks: list[_Block] = field(default_factory=list)
    joints: dict[str, int] = field(default_factory=dict)
    count: int = 0
    fresh: int = 0

    def add(self, stamp: IntArray, joints: tuple[str, ...], fields: Sequence[Any]) -> None:
        """Append messages."""
        for name in joints:
            self.joints.setdefault(name, len(self.joints))
        self.blocks.append((stamp, joints, fields))
        self.count += len(stamp)
        self.fresh += 1
        if self.fresh == _MANY:
            self.blocks[-_MANY:] = [self.joined(self.blocks[-_MANY:])]
            self.fresh = 0

    def measured(self, blocks: Sequence[_Block]) -> list[bool]:
        """Say which of position, velocity and effort blocks hold."""
        return [any(joints and x[i] is not None for _, joints, x in blocks) for i in range(3)]

    def joined(self, blocks: Sequence[_Block]) -> _Block:
        """Return blocks as one of all joints, NaN where a message does not name one."""
        stamp = np.concatenate([x for x, *_ in blocks])
        shape = (stamp.size, len(self.joints))
        fields = [np.full(shape, np.nan) if x else None for x in self.measured(blocks)]
        begin = 0
        for own, joints, values in blocks:
            rows = slice(begin, begin + len(own))
            begin = rows.stop
            columns = [self.joints[name] for name in joints]
            for target, part in zip(fields, values, strict=True):
                if target is not None and part is not None:
                    target[rows, columns] = part
        return stamp, tuple(self.joints), fields


class RecordingBuilder:
    """Collect JointState messages and cut them into recordings.

    A message may name any joints in any order and leave any array empty. Nothing is sorted across
    a backward step of the stamps: it closes a segment (a bag played in a loop, a seek). Single
    messages that only overtook each other are put back into order and counted.

    Args:
        source: Where the messages come from, for the recordings and the errors.
        sha256: Hash of the bag, empty for live data.
        limits: How many joints, and how much memory they may take.
        notes: What is worth knowing of where the values come from, one sentence each.
    """

    def __init__(
        self,
        source: str = LIVE,
        sha256: str = '',
        limits: Limits | None = None,
        notes: Sequence[str] = (),
    ) -> None:
        self.source = source
        self.notes = tuple(notes)
        self.sha256 = sha256
        self.limits = limits or Limits()
        self._tracks = {role: _Track() for role in ROLES}
        self._warnings: list[str] = []

    @property
    def counts(self) -> dict[str, int]:
        """Messages taken so far, by role."""
        return {role: track.count for role, track in self._tracks.items()}

    def copied(self) -> 'RecordingBuilder':
        """Return a copy, which another thread may build while this one collects."""
        other = copy.copy(self)
        other._warnings = [*self._warnings]
        other._tracks = {
            role: replace(x, blocks=[*x.blocks], joints={**x.joints})
            for role, x in self._tracks.items()
        }
        return other

    def warn(self, sentence: str) -> None:
        """Attach a sentence to every recording that will be built; repeated ones are kept once."""
        if sentence not in self._warnings:
            self._warnings.append(sentence)

    def clear(self) -> None:
        """Forget all messages and warnings."""
        self._tracks = {role: _Track() for role in ROLES}
        self._warnings = []

    def add_block(
        self,
        role: str,
        stamp: IntArray,
        names: Sequence[str],
        position: FloatArray | None = None,
        velocity: FloatArray | None = None,
        effort: FloatArray | None = None,
    ) -> None:
        """Append T messages of the same joints, in arrays that nobody writes to afterwards.

        Args:
            role: `state`, `effort` or `command`.
            stamp: Header stamps (T,), ns, in the order of arrival.
            names: The D joints.
            position: Positions (T, D), or None where not measured.
            velocity: Velocities (T, D), or None.
            effort: Efforts (T, D), or None.

        Raises:
            IdentError: BAD_VALUES where the shapes do not fit.
        """
        if role not in self._tracks:
            raise self._bad(f'role is {role!r}; choose one of {", ".join(ROLES)}')
        track = self._tracks[role]
        joints = self._named(role, names)
        fields = (position, velocity, effort)
        shape = (len(stamp), len(joints))
        for part in fields:
            if part is not None and part.shape != shape:
                raise self._bad(
                    f'{self.source}: a block of {role} has shape {part.shape}, expected {shape} '
                    '(messages, joints)'
                )
        if len(set(joints)) != len(joints):
            raise self._bad(
                f'{self.source}: a message of {role} names a joint twice ({listed(joints)}); '
                'give each joint its own name'
            )
        if not len(stamp):
            return
        if int(stamp.max()) >= LATEST_STAMP or int(stamp.min()) <= -LATEST_STAMP:
            raise self._bad(
                f'{self.source}: a stamp of {role} is no time, it lies more than a century off; '
                'send nanoseconds since 1970'
            )
        track.add(np.asarray(stamp, dtype=np.int64), joints, fields)

    def add_columns(
        self, stamp: IntArray, columns: Mapping[tuple[str, str, str], FloatArray]
    ) -> None:
        """Append a table; a row without any value of a role is no message of it.

        Args:
            stamp: Stamps of the rows (T,), ns.
            columns: Values (T,) by role, joint and field.

        Raises:
            IdentError: As `add_block`.
        """
        for role in dict.fromkeys(role for role, *_ in columns):
            own = {(joint, field): x for (of, joint, field), x in columns.items() if of == role}
            joints = list(dict.fromkeys(joint for joint, _ in own))
            fields: dict[str, FloatArray] = {}
            for (joint, name), row in own.items():
                table = fields.setdefault(name, np.full((len(stamp), len(joints)), np.nan))
                table[:, joints.index(joint)] = row
            there = np.any([~np.isnan(x).all(axis=1) for x in fields.values()], axis=0)
            taken = {name: x[there] for name, x in fields.items()}
            self.add_block(role, stamp[there], joints, *map(taken.get, FIELDS))

    def build(self) -> list[Recording]:
        """Cut what was collected into recordings.

        Returns:
            One recording per segment, in the order of arrival; the builder keeps its messages.

        Raises:
            IdentError: NO_DATA before the first message, BAD_VALUES where the stamps make no
                sense.
        """
        warnings = list(self._warnings)
        pieces: dict[str, list[Stream]] = {}
        for role, track in self._tracks.items():
            if track.count:
                pieces[role] = self._streams(role, track, warnings)
        if not any(pieces.values()):
            raise IdentError(
                ErrorCode.NO_DATA,
                f'{self.source}: no measured value arrived; check the topic names and that the '
                'drives publish',
            )
        groups = []
        for group in match_segments(pieces):
            parts = split_pauses(group)
            groups += [_in_range(part, warnings) for part in parts]
            if len(parts) > 1:
                warnings.append(_paused(parts))
        return [
            Recording(
                **group,
                source=self.source,
                sha256=self.sha256,
                warnings=tuple(warnings),
                notes=self.notes,
            )
            for group in groups
        ]

    @staticmethod
    def _bad(text: str) -> IdentError:
        return IdentError(ErrorCode.BAD_VALUES, text)

    def _named(self, role: str, names: Sequence[str]) -> tuple[str, ...]:
        """Return the names as they may be shown, within the limits of a stream."""
        track, limits = self._tracks[role], self.limits
        joints = tuple(names)
        if all(name in track.joints for name in joints):
            return joints
        longest = max(map(len, joints))
        new = sum(name not in track.joints for name in joints)
        what = ''
        if longest > limits.name:
            what = (
                f'a name of {longest} characters, more than the {limits.name} allowed; shorten '
                f'it, or raise {variable_of("name")}'
            )
        elif len(track.joints) + new > limits.joints:
            what = (
                f'more than {limits.joints} joints; record the drives only, or raise '
                f'{variable_of("joints")}'
            )
        if what:
            raise self._bad(f'{self.source}: {role} names {what}')
        return tuple(printable(name, 8 * limits.name) for name in joints)

    def _streams(self, role: str, track: _Track, warnings: list[str]) -> list[Stream]:
        """Return the segments of one role."""
        names = list(track.joints)
        measured = track.measured(track.blocks)
        if not any(measured):
            warnings.append(
                f'{role}: {track.count} messages without any value; nothing was measured there'
            )
            return []
        needed = 3 * sum(measured) * len(names) * track.count * 8
        if needed > self.limits.memory:
            what = f'{self.source}: {role} with {len(names)} joints takes'
            raise too_large(what, needed, self.limits.memory, 'memory')
        stamp, _, fields = track.joined(track.blocks)
        for target in fields:
            if target is not None and (bad := np.abs(target) > _ABSURD).any():
                target[bad] = np.nan
                warnings.append(
                    f'{role}: {int(bad.sum())} infinite values are taken as not measured'
                )
        split = split_stamps(stamp, f'{self.source}: {role}')
        if split.stray.size:
            warnings.append(_strayed(role, stamp, split.stray))
        if split.reordered:
            warnings.append(
                f'{role}: {split.reordered} messages overtook others and were put back into order'
            )
        streams = []
        repeated = 0
        for rows in split.segments:
            # Most logs are one segment in order: a copy of all of it would say nothing new.
            untouched = not split.reordered and rows.size == stamp.size
            part, cut, doubled = _merge(
                stamp if untouched else stamp[rows],
                [x if untouched or x is None else x[rows] for x in fields],
            )
            warnings += leave_out(role, part, names, cut)
            for values in cut:
                if values is not None:
                    values.setflags(write=False)
            repeated += doubled
            streams.append(Stream(tuple(names), part, *cut))
        if repeated:
            warnings.append(
                f'{role}: {repeated} values came twice with the same stamp, the later one counts; '
                'look for two publishers on one topic'
            )
        return streams


def _strayed(role: str, stamp: IntArray, rows: IntArray) -> str:
    """Return what to say of messages that are left out for their stamps."""
    off = np.abs(stamp[rows] - stamp[np.maximum(rows - 1, 0)]).max() * 1e-9
    what = 'message has a stamp' if rows.size == 1 else 'messages have stamps'
    return (
        f'{role}: {rows.size} {what} up to {float(off):.3g} s apart from those before and after, '
        f'the first is number {int(rows[0]) + 1}, and {"is" if rows.size == 1 else "are"} left out'
    )


def _in_range(group: dict[str, Stream], warnings: list[str]) -> dict[str, Stream]:
    """Return a recording whose stamps a bag can hold: from 0 on where they cannot be ROS times.

    A scope counts from its trigger on, negative before it, and LabVIEW from 1904.
    """
    begin = min(int(x.stamp[0]) for x in group.values())
    end = max(int(x.stamp[-1]) for x in group.values())
    if begin >= 0 and end < _LAST_ROS_TIME:
        return group
    whole = begin // 1_000_000_000
    warnings.append(
        f'the stamps begin at {begin * 1e-9:.6g} s, which no ROS time can be: {whole} s are taken '
        'from all of them'
    )
    shift = whole * 1_000_000_000
    return {role: replace(x, stamp=x.stamp - shift) for role, x in group.items()}


def _paused(parts: list[dict[str, Stream]]) -> str:
    """Return what to say of pauses in which nothing came."""
    begins = [min(int(x.stamp[0]) for x in part.values()) for part in parts]
    ends = [max(int(x.stamp[-1]) for x in part.values()) for part in parts]
    longest = max(b - a for a, b in zip(ends, begins[1:], strict=False)) * 1e-9
    return (
        f'nothing came for up to {longest:.4g} s: the recorder paused or its clock was set; the '
        f'{len(parts)} stretches are taken one by one'
    )


def _merge(
    stamp: IntArray, fields: list[FloatArray | None]
) -> tuple[IntArray, list[FloatArray | None], int]:
    """Join rows of equal stamps: drives that publish one by one, or a value that came twice.

    Args:
        stamp: Stamps (T,), ns, never decreasing.
        fields: Arrays (T, D) or None.

    Returns:
        Stamps (U,) without repetition, the fields (U, D) with the latest measured value of each
        joint, and how many values were overwritten.
    """
    first = np.diff(stamp, prepend=stamp[0] - 1) != 0
    if first.all():
        return stamp, fields, 0
    starts = np.flatnonzero(first)
    merged: list[FloatArray | None] = []
    repeated = 0
    for values in fields:
        if values is None:
            merged.append(None)
            continue
        there = ~np.isnan(values)
        row = np.where(there, np.arange(stamp.size)[:, None], -1)
        last = np.maximum.reduceat(row, starts, axis=0)
        picked = np.take_along_axis(values, np.maximum(last, 0), axis=0)
        merged.append(np.where(last >= 0, picked, np.nan))
        repeated += int(there.sum() - (last >= 0).sum())
    return stamp[starts], merged, repeated
