# SPDX-License-Identifier: Apache-2.0
"""From single messages to recordings: the one way in for bags and for live topics."""

from array import array
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.recording.limits import Limits, too_large, variable_of
from ros2_ident.recording.outliers import leave_out
from ros2_ident.recording.segments import match_segments, split_pauses, split_stamps
from ros2_ident.recording.shown import listed, printable
from ros2_ident.recording.streams import (
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


@dataclass
class _Layout:
    """Messages of one shape: the same joints in the same order, the same fields filled."""

    names: tuple[str, ...]
    filled: tuple[bool, bool, bool]
    values: 'array[float]' = field(default_factory=lambda: array('d'))

    @property
    def width(self) -> int:
        return len(self.names) * sum(self.filled)


@dataclass
class _Track:
    """All messages of one role, in the order of arrival."""

    stamp: 'array[int]' = field(default_factory=lambda: array('q'))
    layout_id: 'array[int]' = field(default_factory=lambda: array('I'))
    layouts: list[_Layout] = field(default_factory=list)
    known: dict[tuple[tuple[str, ...], tuple[bool, bool, bool]], int] = field(default_factory=dict)

    joints: dict[str, int] = field(default_factory=dict)

    def layout(self, names: tuple[str, ...], filled: tuple[bool, bool, bool]) -> int:
        """Return the number of a layout."""
        key = (names, filled)
        number = self.known.get(key)
        if number is None:
            number = self.known[key] = len(self.layouts)
            self.layouts.append(_Layout(names, filled))
            for name in names:
                self.joints.setdefault(name, len(self.joints))
        return number


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
        return {role: len(track.stamp) for role, track in self._tracks.items()}

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
        """Append T messages of the same joints.

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
        track = self._track(role)
        joints = self._named(role, names)
        rows = len(stamp)
        parts = [x for x in (position, velocity, effort) if x is not None]
        for part in parts:
            if part.shape != (rows, len(joints)):
                raise IdentError(
                    ErrorCode.BAD_VALUES,
                    f'{self.source}: a block of {role} has shape {part.shape}, expected '
                    f'{(rows, len(joints))} (messages, joints)',
                )
        filled = tuple(x is not None for x in (position, velocity, effort))
        if len(set(joints)) != len(joints):
            raise IdentError(
                ErrorCode.BAD_VALUES,
                f'{self.source}: a message of {role} names a joint twice ({listed(joints)}); '
                'give each joint its own name',
            )
        if not rows:
            return
        if int(stamp.max()) >= LATEST_STAMP or int(stamp.min()) <= -LATEST_STAMP:
            raise IdentError(
                ErrorCode.BAD_VALUES,
                f'{self.source}: a stamp of {role} is no time, it lies more than a century off; '
                'send nanoseconds since 1970',
            )
        number = track.layout(joints, (filled[0], filled[1], filled[2]))
        if parts:
            track.layouts[number].values.frombytes(
                np.concatenate(parts, axis=1, dtype=np.float64).tobytes()
            )
        track.stamp.frombytes(np.ascontiguousarray(stamp, dtype=np.int64).tobytes())
        track.layout_id.frombytes(np.full(rows, number, dtype=np.uint32).tobytes())

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
            if track.stamp:
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

    def _track(self, role: str) -> _Track:
        try:
            return self._tracks[role]
        except KeyError:
            raise IdentError(
                ErrorCode.BAD_VALUES, f'role is {role!r}; choose one of {", ".join(ROLES)}'
            ) from None

    def _named(self, role: str, names: Sequence[str]) -> tuple[str, ...]:
        """Return the names as they may be shown, within the limits of a stream."""
        track, limits = self._track(role), self.limits
        joints = tuple(names)
        if all(name in track.joints for name in joints):
            return joints
        longest = max(map(len, joints))
        new = sum(name not in track.joints for name in joints)
        if longest > limits.name or len(track.joints) + new > limits.joints:
            what = (
                f'a name of {longest} characters, more than the {limits.name} allowed; shorten '
                f'it, or raise {variable_of("name")}'
                if longest > limits.name
                else f'more than {limits.joints} joints; record the drives only, or raise '
                f'{variable_of("joints")}'
            )
            raise IdentError(ErrorCode.BAD_VALUES, f'{self.source}: {role} names {what}')
        return tuple(printable(name, 8 * limits.name) for name in joints)

    def _streams(self, role: str, track: _Track, warnings: list[str]) -> list[Stream]:
        """Return the segments of one role."""
        names = list(track.joints)
        measured = [
            any(layout.filled[i] and layout.names for layout in track.layouts) for i in range(3)
        ]
        if not any(measured):
            warnings.append(
                f'{role}: {len(track.stamp)} messages without any value; nothing was measured '
                'there'
            )
            return []
        stamp = np.array(track.stamp, dtype=np.int64)
        needed = 3 * sum(measured) * len(names) * stamp.size * 8
        if needed > self.limits.memory:
            raise too_large(
                f'{self.source}: {role} with {len(names)} joints takes',
                needed,
                self.limits.memory,
                'memory',
            )
        fields = self._fields(track, names, measured)
        for array_ in fields:
            if array_ is not None and (bad := np.abs(array_) > _ABSURD).any():
                array_[bad] = np.nan
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

    @staticmethod
    def _fields(track: _Track, names: list[str], measured: list[bool]) -> list[FloatArray | None]:
        """Return the three fields (T, D) in the order of arrival."""
        count = len(track.stamp)
        number = np.array(track.layout_id, dtype=np.int64)
        fields: list[FloatArray | None] = [
            np.full((count, len(names)), np.nan) if there else None for there in measured
        ]
        order = np.argsort(number, kind='stable')
        edges = np.searchsorted(number[order], np.arange(len(track.layouts) + 1))
        for index, layout in enumerate(track.layouts):
            if not layout.width:
                continue
            rows = order[edges[index] : edges[index + 1]]
            columns = np.array([track.joints[name] for name in layout.names])
            # a copy: a view would lock the growing array against the next append
            block = np.array(layout.values, dtype=np.float64).reshape(rows.size, layout.width)
            offset = 0
            for i in range(3):
                target = fields[i]
                if layout.filled[i] and target is not None:
                    target[np.ix_(rows, columns)] = block[:, offset : offset + len(columns)]
                    offset += len(columns)
        return fields


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
    first: NDArray[np.bool_] = np.ones(stamp.size, dtype=np.bool_)
    first[1:] = np.diff(stamp) != 0
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
