# SPDX-License-Identifier: Apache-2.0
"""From single messages to recordings: the one way in for bags and for live topics."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np

from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.recording import streams
from ros2_ident.recording.grid import sample_period
from ros2_ident.recording.limits import limit, listed, require_memory, short, unfit, variable_of
from ros2_ident.recording.outliers import leave_out
from ros2_ident.recording.streams import FIELDS, FloatArray, IntArray, Recording, ROLES, Stream

# builtin_interfaces/Time counts seconds in 32 bits, until 2038.
_LAST_ROS_TIME = (1 << 31) * 1_000_000_000
# Nothing that is measured is larger; its square would overflow soon.
_ABSURD = 1e30
# The source of messages that come as they are sent.
LIVE = 'live'
# A message may overtake at most so many others; further back it is a restart.
_OVERTAKE = 3
# More restarts than this, and more than this share of the messages, are two clocks on one topic.
_MANY, _SHARE = 10, 0.02
# Nothing at all came for so long, s and in samples: what was before and after are two recordings.
_PAUSE, _PAUSE_SAMPLES = 10.0, 50
# Stamps of so many messages in a row, and of this share of all, may lie apart by themselves; so
# many periods off is apart.
_STRAY, _STRAY_SHARE, _APART = 3, 0.01, 10.0
# So many messages do not overtake each other on one connection.
_LATE_SHARE = 0.25

# Stamps (T,), the D joints, and position, velocity and effort, each (T, D) or None.
_Block = tuple[IntArray, tuple[str, ...], Sequence[FloatArray | None]]


@dataclass
class _Track:
    """All messages of one role, in the order of arrival, and the place of each joint in them."""

    blocks: list[_Block] = field(default_factory=list)
    joints: dict[str, int] = field(default_factory=dict)
    count: int = 0

    @property
    def measured(self) -> list[bool]:
        """Which of position, velocity and effort the messages hold."""
        return [any(joints and x[i] is not None for _, joints, x in self.blocks) for i in range(3)]

    def joined(self) -> tuple[IntArray, list[FloatArray | None]]:
        """Return stamps (T,) and fields (T, D) of all, NaN where a message names no such joint.

        Messages are forgotten on the way, from the last on, whose memory an allocator can return:
        hours of them twice would not fit.
        """
        stamp = np.concatenate([x for x, *_ in self.blocks])
        shape = (stamp.size, len(self.joints))
        fields = [np.empty(shape) if x else None for x in self.measured]
        end = stamp.size
        while self.blocks:
            own, joints, values = self.blocks.pop()
            rows = slice(end - len(own), end)
            end = rows.start
            columns = [self.joints[name] for name in joints]
            for target, part in zip(fields, values, strict=True):
                if target is not None:
                    target[rows] = np.nan
                    if part is not None:
                        target[rows, columns] = part
        return stamp, fields


class RecordingBuilder:
    """Collect JointState messages and cut them into recordings.

    A message may name any joints in any order and leave any array empty. Nothing is sorted across
    a backward step of the stamps: it closes a segment (a bag played in a loop, a seek). Single
    messages that only overtook each other are put back into order and counted.

    Args:
        source: Where the messages come from, for the recordings and the errors.
        sha256: Hash of the bag, empty for live data.
        notes: What is worth knowing of where the values come from, one sentence each.
        warnings: As `warn` takes them.
    """

    def __init__(
        self, source: str = LIVE, sha256: str = '', notes: Sequence[str] = (),
        warnings: Sequence[str] = (),
    ) -> None:  # fmt: skip
        self.source, self.sha256, self.notes = source, sha256, tuple(notes)
        self.clear()
        self._warnings += dict.fromkeys(warnings)

    def copied(self) -> 'RecordingBuilder':
        """Return a copy, which another thread may build while this one collects."""
        other = RecordingBuilder(self.source, self.sha256, self.notes, self._warnings)
        for role, x in self._tracks.items():
            other._tracks[role] = _Track([*x.blocks], {**x.joints}, x.count)
        return other

    def warn(self, sentence: str) -> None:
        """Attach a sentence to every recording that will be built; repeated ones are kept once."""
        if sentence not in self._warnings:
            self._warnings.append(sentence)

    def clear(self) -> None:
        """Forget all messages and warnings."""
        self._tracks = {role: _Track() for role in ROLES}
        self._units: dict[tuple[str, str], str] = {}
        self._warnings: list[str] = []

    def add_block(
        self,
        role: str,
        stamp: IntArray,
        names: Sequence[str],
        position: FloatArray | None = None,
        velocity: FloatArray | None = None,
        effort: FloatArray | None = None,
    ) -> None:
        """Append T messages of the same D joints, in arrays that are not written to afterwards.

        Args:
            role: `state`, `effort` or `command`.
            stamp: Header stamps (T,), ns, in the order of arrival.
            names: The joints.
            position: (T, D), or None where not measured, as velocity and effort.

        Raises:
            IdentError: BAD_VALUES where the shapes do not fit.
        """
        if role not in self._tracks:
            raise self._bad(f'role is {role!r}; choose one of {", ".join(ROLES)}')
        track = self._tracks[role]
        joints = tuple(names)
        fresh = [name for name in joints if name not in track.joints]
        if fresh and len({*track.joints, *fresh}) > limit('joints'):
            text = f'{role} names more than {limit("joints")} joints; record the drives only'
            raise self._bad(f'{text}, or raise {variable_of("joints")}')
        for name in fresh:
            if why := unfit(name):
                raise self._bad(f'{role} names a joint {short(name)}, {why}')
        fields = (position, velocity, effort)
        shape = (len(stamp), len(joints))
        for part in fields:
            if part is not None and part.shape != shape:
                raise self._bad(f'a block of {role} has shape {part.shape}, expected {shape}')
        if len(set(joints)) != len(joints):
            text = f'a message of {role} names a joint twice ({listed(joints)})'
            raise self._bad(f'{text}; give each joint its own name')
        if not len(stamp):
            return
        if max(int(stamp.max()), -int(stamp.min())) >= streams.LATEST_STAMP:
            raise self._bad(f'a stamp of {role} is no time; send nanoseconds since 1970')
        track.joints |= {name: len(track.joints) + n for n, name in enumerate(fresh)}
        track.blocks.append((np.asarray(stamp, dtype=np.int64), joints, fields))
        track.count += len(stamp)

    def add_columns(
        self,
        stamp: IntArray,
        columns: Mapping[tuple[str, str, str], FloatArray],
        units: Mapping[tuple[str, str], str] | None = None,
    ) -> None:
        """Append a table; a row without any value of a role is no message of it.

        Args:
            stamp: Stamps of the rows (T,), ns.
            columns: Values (T,) by role, joint and field.
            units: As of a `Recording`.

        Raises:
            IdentError: As `add_block`.
        """
        self._units |= units or {}
        for role in dict.fromkeys(role for role, *_ in columns):
            joints = list(dict.fromkeys(joint for of, joint, _ in columns if of == role))
            fields: dict[str, FloatArray] = {}
            for (of, joint, name), row in columns.items():
                if of == role:
                    table = fields.setdefault(name, np.full((len(stamp), len(joints)), np.nan))
                    table[:, joints.index(joint)] = row
            there = np.any([~np.isnan(x).all(axis=1) for x in fields.values()], axis=0)
            taken = {name: x[there] for name, x in fields.items()}
            self.add_block(role, stamp[there], joints, *map(taken.get, FIELDS))

    def build(self) -> list[Recording]:
        """Cut what was collected into recordings, one per segment, in the order of arrival.

        The builder is empty afterwards.

        Raises:
            IdentError: NO_DATA before the first message, BAD_VALUES where the stamps make no
                sense.
        """
        warnings = list(self._warnings)
        tracks = {role: x for role, x in self._tracks.items() if x.count}
        pieces = {role: self._streams(role, x, warnings) for role, x in tracks.items()}
        if not any(pieces.values()):
            text = 'no measured value arrived; check the topic names and that the drives publish'
            raise self._bad(text, ErrorCode.NO_DATA)
        found = []
        for group in _match_segments(pieces):
            about = {'source': self.source, 'sha256': self.sha256, 'notes': self.notes}
            whole = Recording(**group, **about, units=self._units)  # type: ignore[arg-type]
            parts = _split_pauses(whole)
            found += [_in_range(part, warnings) for part in parts]
            if len(parts) > 1:
                pauses = (b.begin - a.end for a, b in pairwise(parts))
                longest = max(pauses) * 1e-9
                said = f'nothing came for up to {longest:.4g} s: the recorder paused or its clock '
                warnings.append(f'{said}was set; {len(parts)} stretches are taken one by one')
        return [replace(x, warnings=tuple(warnings)) for x in found]

    def _bad(self, text: str, code: ErrorCode = ErrorCode.BAD_VALUES) -> IdentError:
        return code.at(self.source, text)

    def _streams(self, role: str, track: _Track, warnings: list[str]) -> list[Stream]:
        names = list(track.joints)
        if not any(track.measured):
            warnings.append(f'{role}: {track.count} messages without any value')
            return []
        needed = 3 * sum(track.measured) * len(names) * track.count * 8
        require_memory(f'{self.source}: {role} with {len(names)} joints takes', needed)
        stamp, fields = track.joined()
        for target in fields:
            if target is not None and (bad := (target > _ABSURD) | (target < -_ABSURD)).any():
                target[bad] = np.nan
                said = f'{int(bad.sum())} infinite values are taken as not measured'
                warnings.append(f'{role}: {said}')
        stray = _find_stray(stamp)
        if stray.size:
            off = np.abs(stamp[stray] - stamp[np.maximum(stray - 1, 0)]).max() * 1e-9
            said = f'messages with stamps up to {off:.3g} s apart from those before and after'
            first = f'the first is number {int(stray[0]) + 1}'
            warnings.append(f'{role}: {said} are left out: {stray.size}, {first}')
        there = np.delete(np.arange(stamp.size), stray)
        segments, late = _cut(stamp[there], f'{self.source}: {role}')
        if late:
            said = f'{late} messages overtook others and were put back into order'
            warnings.append(f'{role}: {said}')
        found, repeated = [], 0
        for rows in (there[x] for x in segments):
            part, own = stamp, fields
            # Most logs are one segment in order: a copy of all of it would say nothing new.
            if late or rows.size < stamp.size:
                part, own = stamp[rows], [None if x is None else x[rows] for x in fields]
            part, cut, doubled = _merge(part, own)
            warnings += leave_out(role, part, names, cut)
            for values in cut:
                if values is not None:
                    values.setflags(write=False)
            repeated += doubled
            found.append(Stream(tuple(names), part, *cut))
        if repeated:
            said = f'{repeated} values came twice with the same stamp, the later one counts; look'
            warnings.append(f'{role}: {said} for two publishers on one topic')
        return found


def _in_range(recording: Recording, warnings: list[str]) -> Recording:
    """Return a recording whose stamps a bag can hold: from 0 on where they cannot be ROS times.

    A scope counts from its trigger on, negative before it, and LabVIEW from 1904.
    """
    begin = recording.begin
    if begin >= 0 and recording.end < _LAST_ROS_TIME:
        return recording
    whole = begin // 1_000_000_000
    said = f'the stamps begin at {begin * 1e-9:.6g} s, which no ROS time can be'
    warnings.append(f'{said}: {whole} s are taken from all of them')
    less = whole * 1_000_000_000
    own = {k: replace(x, stamp=x.stamp - less) for k, x in recording.streams.items()}
    return replace(recording, **own)  # type: ignore[arg-type]


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
    starts = np.flatnonzero(np.diff(stamp, prepend=stamp[0] - 1))
    if starts.size == stamp.size:
        return stamp, fields, 0
    merged: list[FloatArray | None] = [None] * len(fields)
    repeated = 0
    for n, values in enumerate(fields):
        if values is not None:
            there = ~np.isnan(values)
            row = np.where(there, np.arange(stamp.size)[:, None], -1)
            last = np.maximum.reduceat(row, starts, axis=0)
            picked = np.take_along_axis(values, np.maximum(last, 0), axis=0)
            merged[n] = np.where(last >= 0, picked, np.nan)
            repeated += int(there.sum() - (last >= 0).sum())
    return stamp[starts], merged, repeated


def _find_stray(stamp: IntArray) -> IntArray:
    """Return the messages whose stamps lie apart from those before and after, which fit together.

    One wrong bit in a stamp does that. A clock that was set goes on from where it was set to.
    """
    steps, most = np.diff(stamp), max(_STRAY, _STRAY_SHARE * stamp.size)
    forward = steps[steps > 0]
    period = float(np.median(forward)) if forward.size else np.inf
    leaps = np.flatnonzero(np.abs(steps) > _APART * period).tolist()
    found: list[int] = []
    if stamp.size < 2 * _STRAY + 2 or len(leaps) > 2 * most:
        leaps = []
    for n, k in enumerate(leaps):
        near = [x for x in leaps[n + 1 : n + 1 + _STRAY] if x <= k + _STRAY]
        for last in near if not found or k > found[-1] else ():
            around = int(stamp[last + 1] - stamp[k])
            inside = stamp[k + 1 : last + 1]
            outside = (inside < stamp[k]) | (inside > stamp[last + 1])
            if 0 < around <= (last - k + 3) * period and outside.all():
                found += range(k + 1, last + 1)
                break
    return np.array(found if len(found) <= most else [], dtype=np.int64)


def _cut(stamp: IntArray, where: str) -> tuple[list[IntArray], int]:
    """Cut a stream at the backward steps of its stamps.

    A message that was merely overtaken has a stamp of its own, lies at most a few periods back,
    and the next stamps go on above the highest one so far; everything else that steps back is a
    restart.

    Args:
        stamp: Stamps (T,), ns, in the order of arrival.

    Returns:
        Rows of each segment in the order of their stamps, and how many messages were overtaken.

    Raises:
        IdentError: BAD_VALUES where the stamps jump back and forth all the time.
    """
    steps = np.diff(stamp)
    back = np.flatnonzero(steps < 0) + 1
    if not back.size:
        return [np.arange(stamp.size)], 0
    forward = steps[steps > 0]
    period = float(np.median(forward)) if forward.size else 0.0
    cuts, late, resume = [0], 0, 0
    for start in back.tolist():
        if start < resume:
            continue
        length = _overtaken(stamp, start, cuts[-1], period)
        late, resume = late + length, start + length
        if not length:
            cuts.append(start)
    restarts = len(cuts) - 1
    if restarts > max(_MANY, _SHARE * stamp.size) or late > max(_MANY, _LATE_SHARE * stamp.size):
        text = f'the stamps step back {back.size} times in {stamp.size} messages: two publishers '
        text += 'with different clocks share the topic; record one of them, or remap the other'
        raise ErrorCode.BAD_VALUES.at(where, text)
    parts = np.split(np.arange(stamp.size), cuts[1:])
    return [part[np.argsort(stamp[part], kind='stable')] for part in parts], late


def _overtaken(stamp: IntArray, start: int, begin: int, period: float) -> int:
    """Return how many messages from `start` on were only overtaken; 0 at a new segment."""
    highest = stamp[start - 1]
    window = stamp[start : start + _OVERTAKE + 1]
    ahead = np.flatnonzero(window > highest)
    if not ahead.size and start + window.size < stamp.size:
        return 0
    length = int(ahead[0]) if ahead.size else window.size
    run = window[:length]
    # a restart sends stamps again that were there before; an overtaken message brings a new one
    before = stamp[max(begin, start - 4 * _OVERTAKE) : start]
    far = length > _OVERTAKE or highest - run.min() > _OVERTAKE * period
    return 0 if far or np.isin(run, before).any() or run.min() < stamp[begin] else length


def _match_segments(pieces: dict[str, list[Stream]]) -> list[dict[str, Stream]]:
    """Return the segments by role, in the order of arrival, that belong to each play of a bag.

    Topics jump back at slightly different moments, but each of them once per restart: with equal
    numbers of segments the k-th belong together. Where one role missed a play, its segments go,
    one after the other, where their stamps overlap most.
    """
    leader = max(pieces.values(), key=len)
    groups: list[dict[str, Stream]] = [{} for _ in leader]
    for role, own in pieces.items():
        place = -1
        for last, stream in enumerate(own, len(leader) - len(own)):
            free = leader[place + 1 : last + 1]
            a, b = stream.stamp[[0, -1]]
            both = [min(b, x.stamp[-1]) - max(a, x.stamp[0]) for x in free]
            place += 1 + int(np.argmax(np.maximum(both, 0)))
            groups[place][role] = stream
    return groups


def _split_pauses(recording: Recording) -> list[Recording]:
    """Cut one recording where no stream has a sample for long.

    A grid over a clock that was set forward would hold the years between. A command that is only
    sent when it changes is no pause, since the state goes on.
    """
    stamps = [x.stamp for x in recording.streams.values()]
    periods = [x for x in map(sample_period, stamps) if x]
    pause = round(1e9 * max(_PAUSE, _PAUSE_SAMPLES * min(periods, default=0.0)))
    spans: list[tuple[int, int]] = []
    for stamp in stamps:
        long = np.flatnonzero(np.diff(stamp) > pause)
        spans += zip(stamp[[0, *(long + 1)]].tolist(), stamp[[*long, -1]].tolist(), strict=True)
    begins, ends = np.array(sorted(spans)).T
    ends = np.maximum.accumulate(ends)
    last = np.flatnonzero(begins[1:] - ends[:-1] > pause)
    if not last.size:
        return [recording]
    parts = zip(begins[[0, *(last + 1)]].tolist(), ends[[*last, -1]].tolist(), strict=True)
    return [recording.between(begin, end + 1) for begin, end in parts]
