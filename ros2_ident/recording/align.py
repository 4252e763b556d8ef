# SPDX-License-Identifier: Apache-2.0
"""Bring a recording's streams onto one grid of controller cycles, on which each is numbered."""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
import scipy

from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.recording import streams
from ros2_ident.recording.grid import (
    find_ticks,
    missing_samples,
    sample_period,
    SHARED,
    Ticks,
    TOLD_DRIFT,
)
from ros2_ident.recording.limits import require_memory
from ros2_ident.recording.streams import Dataset, FIELDS, FloatArray, IntArray, Recording, Stream

# A hole in the command up to so many of its samples, or so many seconds, is bridged.
_BRIDGED_SAMPLES, _BRIDGED_SECONDS = 10, 0.05
# A command of fewer samples need not have stopped where its last one came.
_STREAMED = 50
# The stream that a grid spans is the first of these.
_LEADERS = ('command', 'state', 'effort')
# Joints beside the drives that are kept.
_STRANGERS = 12
# Arrays of drives and cycles that a data set holds, twice while they are made.
_GRIDS = 10


def align(
    recording: Recording,
    drives: Sequence[str],
    cycle: float,
    *,
    need: Collection[str] = ('effort',),
    effort_scale: float | Mapping[str, float] = 1.0,
    released: bool = False,
    follows: bool = True,
) -> Dataset:
    """Put a recording on the grid of controller cycles.

    Args:
        drives: The D joints wanted, in the model's order.
        cycle: Controller cycle, s.
        need: Fields without which the data is of no use: of `position`, `velocity`, `effort`,
            `command`.
        effort_scale: Factor from the logged effort to N m or N (a torque constant, say), or that
            of each joint.
        released: Whether a stream of set-points that stops before the state does means that the
            motors were switched off.
        follows: Whether set-points of position drive the model; where not, they and the effort
            asked for are beside it.

    Returns:
        The data set. Its grid covers the command where there is one, else the state; where the
        command has a long hole, the longest stretch without one.

    Raises:
        IdentError: MISSING_STREAM, NO_DATA or BAD_VALUES, each with the remedy.
    """
    names = tuple(drives)
    if not names or len(set(names)) != len(names):
        text = f'drives are ({", ".join(names)}); name at least one, and each only once'
        raise ErrorCode.INVALID_GOAL.error(text)
    recording = streams.scale_effort(recording, effort_scale)
    asking = recording.command
    commanded, speeds_alone = recording.sets_positions, recording.sets_speeds_alone
    if not follows or ('command' not in need and not commanded):
        recording = replace(recording, command=None)
    recording, found = streams.with_positions(recording, names)
    lay = _Layout(recording, names, cycle)
    if follows and speeds_alone:
        lay.warnings.append(streams.SPEEDS_ALONE)
    if found:
        which = ', '.join(found)
        lay.warnings.append(f'state: the position of {which} is the integral of the speed, from 0')
    lay.place()
    lay.span()
    off = lay.released() if released else None
    lay.tell_outside()
    what = f'{lay.where}: a grid of {lay.cycles} controller cycles takes'
    require_memory(what, _GRIDS * lay.cycles * len(names) * 8)
    set_point = lay.set_point()
    measured = {field: lay.measured(field) for field in FIELDS}
    lay.check_need(measured, need)
    origin = lay.placed['state'] if 'state' in lay.placed else next(iter(lay.placed.values()))
    offset = origin.ticks.phase + lay.start * cycle * (1.0 + origin.ticks.drift)
    begin = origin.reference + round(offset * 1e9)
    grid = np.arange(lay.cycles, dtype=np.float64) * cycle
    beside, state = {}, recording.state
    for name in [x for x in state.names if x not in names][:_STRANGERS] if state else ():
        if state and (values := state.column('position', name)) is not None:
            beside[name] = _between(state, values, begin, grid)
    arrived = {role: lay.quality(x) for role, x in lay.placed.items()}
    said = tuple(dict.fromkeys(lay.warnings))
    efforts = _asked(asking, 'effort', names, begin, grid)
    goal = _asked(asking, 'position', names, begin, grid) if commanded else None
    shown = (*set_point, *measured.values(), arrived, said, beside, off, efforts, goal, found)
    return Dataset(names, float(cycle), begin, *shown)


def _asked(
    command: Stream | None, field: str, names: tuple[str, ...], begin: int, grid: FloatArray
) -> FloatArray | None:
    """Return what is asked for (D, K), NaN for a drive without; None where there is none.

    Beside a set-point of the motion an effort is a feed-forward, a part of what is asked for.
    """
    if command is None or command.stamp.size < 2:
        return None
    out = np.full((len(names), grid.size), np.nan)
    for row, name in zip(out, names, strict=True):
        found = (command.column(x, name) for x in ('position', 'velocity'))
        moves = any(x is not None and np.nanmax(x) > np.nanmin(x) for x in found)
        values = command.column(field, name)
        if values is not None and not (moves and field == 'effort'):
            row[:] = _between(command, values, begin, grid)
    return None if np.isnan(out).all() else out


def _between(stream: Stream, values: FloatArray, begin: int, grid: FloatArray) -> FloatArray:
    """Return values (T,) at seconds (K,) after a stamp, by straight lines."""
    there = np.isfinite(values)
    return np.interp(grid, ((stream.stamp - begin) * 1e-9)[there], values[there])


@dataclass(frozen=True)
class _Placed:
    """A stream reduced to the drives, with the cycle number of each sample."""

    stream: Stream  # the samples of the drives, one a cycle
    tick: IntArray  # their cycle numbers (T,)
    instants: FloatArray  # (T,) times in cycles: whole numbers where the stream keeps to the grid
    ticks: Ticks  # how its stamps lie on the grid
    period: float  # the typical spacing of its stamps, s
    reference: int  # the stamp that the numbers count from, ns


class _Layout:
    """The streams of a recording on a grid of controller cycles, step by step."""

    def __init__(self, recording: Recording, names: tuple[str, ...], cycle: float) -> None:
        self.recording, self.names, self.cycle = recording, names, cycle
        self.where = recording.source or 'recording'
        self.warnings = list(recording.warnings)
        self.placed: dict[str, _Placed] = {}  # the streams that hold the drives, by role
        self.start = self.cycles = 0  # first cycle of the grid, and K, their number

    def error(self, text: str, code: ErrorCode = ErrorCode.MISSING_STREAM) -> IdentError:
        """Return an error about the recording."""
        return code.error(f'{self.where}: {text}')

    def place(self) -> None:
        """Reduce the streams to the drives and number their samples on one common grid."""
        reference = 0
        # What is in one message has one stamp, and is told of once.
        remarks = dict[str, list[str]]()
        for role, whole in self.recording.streams.items():
            if (stream := self._reduced(role, whole)) is None:
                continue
            counted_from = reference if self.placed else int(stream.stamp[0])
            stream, ticks = _numbered(stream, counted_from, self.cycle)
            if not self.placed:
                reference = counted_from + round(ticks.phase * 1e9)
            elif ticks.stride and abs(ticks.phase) > 0.35 * self.cycle:
                off, other = f'{abs(ticks.phase) * 1e3:.3g} ms', next(iter(self.placed))
                said = f'stamps lie {off} beside those of {other}, near half a cycle'
                self.warnings.append(f'{role}: {said}: it may be one cycle off')
            if (doubled := int((~ticks.keep).sum())) > SHARED * ticks.keep.size:
                said = f'{doubled} samples share a controller cycle with another and are left out'
                remarks.setdefault(f'{said}; state a shorter one', []).append(role)
            if abs(ticks.drift) > TOLD_DRIFT:
                long = self.cycle * (1.0 + ticks.drift) * 1e3
                said = f'the controller cycle is {long:.6g} ms on the clock of the stamps'
                remarks.setdefault(f'{said}, not {self.cycle * 1e3:.6g} ms', []).append(role)
            kept = stream if ticks.keep.all() else stream.taken(ticks.keep)
            tick = ticks.tick[ticks.keep]
            instants = tick.astype(np.float64) if ticks.stride else ticks.raw[ticks.keep]
            period = sample_period(stream.stamp)
            self.placed[role] = _Placed(kept, tick, instants, ticks, period, counted_from)
        self.warnings += [f'{" and ".join(roles)}: {x}' for x, roles in remarks.items()]
        if 'state' not in self.placed and 'effort' not in self.placed:
            text = 'no state or effort stream holds the drives; name their topic or column'
            raise self.error(text)

    def _reduced(self, role: str, stream: Stream) -> Stream | None:
        """Return the stream with the drives only, in their order; None where it does not help."""
        missing = [name for name in self.names if name not in stream.names]
        held = ', '.join(stream.names)
        if missing and role != 'effort':
            text = f'{role} has no joint {", ".join(missing)}, it holds {held}'
            way = 'name these as drives, call them in a column map as the drives are'
            raise self.error(f'{text}; {way}, or record the others')
        said = ''
        columns = [stream.names.index(x) if x in stream.names else -1 for x in self.names]
        picked = {field: values[:, columns] for field, values in stream.fields.items()}
        for values in picked.values():
            values[:, np.less(columns, 0)] = np.nan
        picked = {field: x for field, x in picked.items() if not np.isnan(x).all()}
        if len(missing) == len(self.names):
            said = f'effort: holds none of the drives, only {held}; efforts of the state are used'
        elif not picked:
            said = f'{role}: every value of the drives is NaN; the stream is not used'
        if said:
            self.warnings.append(said)
            return None
        there = np.any([~np.isnan(x).all(axis=1) for x in picked.values()], axis=0)
        return Stream(self.names, stream.stamp[there], **{k: x[there] for k, x in picked.items()})

    def span(self) -> None:
        """Set first cycle and number of cycles of the grid."""
        role, leader = self._leader()
        first, last = (begin, end) = leader.tick[[0, -1]].tolist()
        others = {name: x.tick[[0, -1]].tolist() for name, x in self.placed.items()}
        del others[role]
        if role == 'command':
            first, last = self._longest_stretch(leader)
            # the first or last sample of the command itself may be the one that was dropped
            reach = max(5 * max(1, leader.ticks.stride), round(0.01 / self.cycle))
            low = min((x for x, _ in others.values()), default=first)
            high = max((x for _, x in others.values()), default=last)
            if first == begin and first - reach <= low < first:
                first = low
            if last == end and last < high <= last + reach:
                last = high
        for name, (low, high) in others.items():
            if (apart := max(first - high, low - last)) > 0:
                text = f'{role} and {name} do not overlap in time, they are '
                text += f'{apart * self.cycle:.3g} s apart; record them together, with one clock'
                raise self.error(text, ErrorCode.NO_DATA)
        if last <= first:
            text = f'{role} has a single sample of the drives; record a motion of several seconds'
            raise self.error(text, ErrorCode.NO_DATA)
        self.start, self.cycles = first, last - first + 1

    def _leader(self) -> tuple[str, _Placed]:
        """Return role and stream that the grid spans."""
        return next((x, self.placed[x]) for x in _LEADERS if x in self.placed)

    def _inside(self, placed: _Placed) -> tuple[IntArray, NDArray[np.bool_]]:
        """Return the cycles of the grid (T,) of a stream's samples, and which lie on it (T,)."""
        index = placed.tick - self.start
        return index, (index >= 0) & (index < self.cycles)

    def tell_outside(self) -> None:
        """Warn of streams that have samples outside the grid."""
        leader, _ = self._leader()
        for role, x in self.placed.items():
            outside = int((~self._inside(x)[1]).sum())
            if role != leader and outside > max(5, 0.02 * x.tick.size):
                said = f'{outside} of {x.tick.size} samples lie outside the {leader}, not used'
                self.warnings.append(f'{role}: {said}')

    def released(self) -> int | None:
        """Return the cycle from which on motors are off, None for none.

        The grid goes on to the end of the state where the command is a stream that stops for good.
        """
        if 'command' not in self.placed or 'state' not in self.placed:
            return None
        command, state = self.placed['command'].tick, self.placed['state'].tick
        last, end = int(command[-1]) - self.start, int(state[-1]) - self.start + 1
        streamed = command.size >= _STREAMED and last < self.cycles
        if not streamed or end - last <= self._bridged(command):
            return None
        seconds = (end - last) * self.cycle
        said = f'stops {seconds:.3g} s before the state: the motors are taken as off from there on'
        self.warnings.append(f'command: {said}')
        self.cycles = end
        # Who commands and reads in one loop has stopped commanding by the next reading.
        return int(state[state > command[-1]][0]) - self.start

    def _bridged(self, tick: IntArray) -> float:
        """Return the longest hole, in cycles, that is bridged between samples at cycles (T,)."""
        typical = float(np.median(np.diff(tick))) if tick.size > 1 else 1.0
        return max(_BRIDGED_SAMPLES * typical, _BRIDGED_SECONDS / self.cycle)

    def _longest_stretch(self, command: _Placed) -> tuple[int, int]:
        """Return first and last cycle of the command's longest stretch without a long hole."""
        tick, values = command.tick, command.stream.position
        steps = np.diff(tick)
        long = steps > self._bridged(tick)
        if values is not None and steps.size:
            # a set-point that is only sent when it changes has not lost anything while it stands
            still = np.nanmax(np.abs(np.diff(values, axis=0)), axis=1, initial=0.0) == 0.0
            long &= ~still
        holes = np.flatnonzero(long)
        begins, ends = tick[[0, *(holes + 1)]], tick[[*holes, -1]]
        best = int(np.argmax(ends - begins))
        first, last = int(begins[best]), int(ends[best])
        if holes.size:
            sizes = (float(steps.max()), float(last - first), float(tick[-1] - tick[0]))
            longest, used, whole = (x * self.cycle for x in sizes)
            said = f'has {holes.size} holes of up to {longest:.3g} s; only the longest stretch '
            said += f'without, {used:.4g} s of {whole:.4g} s, is used'
            self.warnings.append(f'command: {said}')
        return first, last

    def set_point(self) -> tuple[FloatArray, FloatArray] | tuple[None, None]:
        """Return set-point and its velocity (D, K) at every cycle, None where there is none."""
        if 'command' not in self.placed:
            return None, None
        command = self.placed['command']
        grid = np.arange(self.start, self.start + self.cycles).astype(np.float64) * self.cycle
        out, rate = np.empty((2, len(self.names), self.cycles))
        for d, name in enumerate(self.names):
            position, feed = (command.stream.column(x, name) for x in FIELDS[:2])
            if position is None:
                text = f'command: holds no position of {name}; record it, or leave the stream out'
                raise self.error(text)
            there = np.isfinite(position)
            feed = None if feed is None or np.isnan(feed[there]).any() else feed[there]
            time = command.instants[there] * self.cycle
            out[d], rate[d] = interpolate_setpoint(time, position[there], feed, grid)
        return out, rate

    def measured(self, field: str) -> FloatArray | None:
        """Return a field (D, K), NaN where no sample is, or None where it was never measured.

        Samples beside their cycle, of a stream that keeps to no grid, count as on a straight line.
        """
        out = np.full((len(self.names), self.cycles), np.nan)
        # an effort of its own topic counts before that of the state
        for role in ('state', 'effort') if field == 'effort' else ('state',):
            x = self.placed.get(role)
            if x is None or (values := x.stream.values(field)) is None:
                continue
            index, inside = self._inside(x)
            for row, column in zip(out, values.T, strict=True):
                there = ~np.isnan(column)
                if there.any():
                    told = np.interp(x.tick, x.instants[there], column[there])
                    row[:] = np.nan
                    row[index[inside & there]] = told[inside & there]
        return None if np.isnan(out).all() else out

    def check_need(self, measured: Mapping[str, FloatArray | None], need: Collection[str]) -> None:
        """Refuse data without a field that is needed, of all drives or, an effort, of one."""
        if 'command' in need and 'command' not in self.placed:
            text = 'holds no command stream; record it, or let the recorded motion drive the model'
            raise self.error(text)
        for field in filter(need.__contains__, FIELDS):
            if (values := measured[field]) is not None:
                pairs = zip(self.names, values, strict=True)
                silent = ', '.join(name for name, x in pairs if np.isnan(x).all())
                if silent and field != 'effort':
                    text = f'no {field} of {silent}; leave these out, or record theirs too'
                    raise self.error(text)
                continue
            found = self.recording.streams.items()
            if any(field in x.fields for role, x in found if role != 'command'):
                text = f'every {field} of the drives is NaN; switch the measurement on'
                raise self.error(text, ErrorCode.BAD_VALUES)
            raise self.error(f'no stream holds {field}; record it, or name its topic or column')

    def quality(self, placed: _Placed) -> streams.StreamQuality:
        """Count what of a stream lies on the grid."""
        inside = self._inside(placed)[1]
        stride, tick = placed.ticks.stride, placed.tick[inside]
        number, beside = np.divmod(tick - tick[:1], stride or 1)
        if stride and not beside.any():
            missing: int | None = int(np.ptp(number)) + 1 - number.size if number.size else 0
        else:
            missing = missing_samples(placed.stream.stamp[inside])
        rate = 1.0 / placed.period if placed.period else 0.0
        jitter = placed.ticks.jitter
        return streams.StreamQuality(int(inside.sum()), missing, rate, jitter, stride)


def _numbered(stream: Stream, reference: int, cycle: float) -> tuple[Stream, Ticks]:
    """Number a stream's samples from a stamp on, ns; return it and the numbers.

    Drives that publish one by one are numbered one by one, and put together again by cycle.
    """
    there = np.any([~np.isnan(values) for values in stream.fields.values()], axis=0)
    if np.mean(there.all(axis=1)) > 0.5 or not there.any(axis=0).all():
        return stream, find_ticks(stream.stamp, reference, cycle)
    parts = [find_ticks(stream.stamp[rows], reference, cycle) for rows in there.T]
    tick = np.unique(np.concatenate([part.tick[part.keep] for part in parts]))
    merged = {field: np.full((tick.size, len(parts)), np.nan) for field in stream.fields}
    for column, (rows, part) in enumerate(zip(there.T, parts, strict=True)):
        place = np.searchsorted(tick, part.tick[part.keep])
        for field, values in stream.fields.items():
            merged[field][place, column] = values[rows, column][part.keep]
    first = parts[0]
    length = cycle * (1.0 + first.drift)
    stamp = reference + np.round((first.phase + tick * length) * 1e9).astype(np.int64)
    stride = first.stride if len({part.stride for part in parts}) == 1 else 0
    whole, jitter = np.ones(tick.size, dtype=np.bool_), max(part.jitter for part in parts)
    ticks = Ticks(tick, tick.astype(float), whole, stride, first.phase, first.drift, jitter)
    return Stream(stream.names, stamp, **merged), ticks


Spline = Callable[[FloatArray], FloatArray]

# A step of the set-point: so many times the larger of its neighbours' changes.
_STEP_RATIO = 8.0


def interpolate_setpoint(
    time: FloatArray, position: FloatArray, velocity: FloatArray | None, wanted: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Evaluate one drive's set-point at every cycle.

    Smooth stretches are a spline through the samples: quintic where they are evenly spaced, cubic
    where not (it reacts less to samples that lie close together), and cubic Hermite where the log
    holds the velocity. A step is held until the sample that shows it: a spline would ring on both
    sides, and a controller sees the step whole.

    Args:
        time: Times of the samples (T,), s, increasing.
        position: Set-point (T,), rad or m.
        velocity: Its velocity (T,), rad/s or m/s, or None where the log holds none.
        wanted: Times (K,) to evaluate at, s, increasing; beyond the samples the nearest one is
            held.

    Returns:
        Set-point (K,) and its velocity (K,).
    """
    time, position, velocity = _fill_holds(time, position, velocity)
    out, rate = np.zeros((2, wanted.size))
    edges = [0, *(find_steps(time, position) + 1).tolist(), time.size]
    # cycles and samples fall together to within rounding: the sample that shows a step is not held
    # over
    slack = 1e-6 * (wanted[1] - wanted[0]) if wanted.size > 1 else 0.0
    for begin, end in pairwise(edges):
        low = int(np.searchsorted(wanted, time[begin] - slack)) if begin else 0
        high = int(np.searchsorted(wanted, time[end] - slack)) if end < time.size else wanted.size
        inside = wanted[low:high]
        if not inside.size:
            continue
        feed = None if velocity is None else velocity[begin:end]
        fit, slope = _smooth(time[begin:end], position[begin:end], feed)
        held = np.clip(inside, time[begin], time[end - 1])
        out[low:high] = fit(held)
        rate[low:high] = np.where(np.abs(held - inside) <= slack, slope(held), 0.0)
    return out, rate


def _fill_holds(
    time: FloatArray, position: FloatArray, velocity: FloatArray | None
) -> tuple[FloatArray, FloatArray, FloatArray | None]:
    """Repeat a set-point that stands still and is only sent when it changes.

    A spline over the long pause would swing out at its corners.
    """
    steps = np.diff(time)
    typical = float(np.median(steps)) if steps.size else 0.0
    holds = np.flatnonzero((steps > 2.5 * typical) & (np.diff(position) == 0.0))
    if not holds.size:
        return time, position, velocity
    pairs = ((k, round(steps[k] / typical)) for k in holds)
    added = np.concatenate([time[k] + steps[k] * np.arange(1, n) / n for k, n in pairs])
    place = np.searchsorted(time, added)
    velocity = None if velocity is None else np.insert(velocity, place, 0.0)
    return (
        np.insert(time, place, added), np.insert(position, place, position[place - 1]), velocity
    )  # fmt: skip


def _smooth(
    time: FloatArray, position: FloatArray, velocity: FloatArray | None
) -> tuple[Spline, Spline]:
    """Return a spline through the samples and its derivative."""
    if time.size == 1:
        level, speed = float(position[0]), 0.0 if velocity is None else float(velocity[0])
        return (lambda x: np.full(x.shape, level)), (lambda x: np.full(x.shape, speed))
    if velocity is not None:
        hermite = scipy.interpolate.CubicHermiteSpline(time, position, velocity)
        return hermite, hermite.derivative()
    steps = np.diff(time)
    even = np.mean(np.abs(steps - np.median(steps)) < 1e-3 * np.median(steps)) > 0.9
    degree = 5 if even and time.size >= 6 else 3 if time.size >= 4 else 1
    spline = scipy.interpolate.make_interp_spline(time, position, k=degree)
    return spline, spline.derivative()


def find_steps(time: FloatArray, position: FloatArray) -> IntArray:
    """Return the samples after which a set-point (T,) at times (T,) jumps.

    A jump changes far more per time than the samples on both of its sides do.
    """
    if time.size < 4:
        return np.empty(0, dtype=np.int64)
    change = np.abs(np.diff(position))
    speed = change / np.diff(time)
    # two neighbours on each side: one alone may be a plateau's corner or an accelerating start
    padded = np.pad(speed, 2)
    around = np.maximum.reduce([padded[:-4], padded[1:-3], padded[3:-1], padded[4:]])
    span = float(np.ptp(position))
    return np.flatnonzero((speed > _STEP_RATIO * around) & (change > 1e-3 * span))
