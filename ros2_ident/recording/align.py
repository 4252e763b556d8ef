# SPDX-License-Identifier: Apache-2.0
"""Bring a recording's streams onto one grid of controller cycles."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

import numpy as np

from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.recording.dataset import AlignQuality, Dataset, StreamQuality
from ros2_ident.recording.grid import sample_period
from ros2_ident.recording.limits import Limits, too_large
from ros2_ident.recording.placing import place, Placed
from ros2_ident.recording.setpoint import interpolate_setpoint
from ros2_ident.recording.streams import (
    FIELDS,
    FloatArray,
    Recording,
    scale_effort,
    Stream,
    with_positions,
)

# A hole in the command up to so many of its samples, or so many seconds, is bridged.
_BRIDGED_SAMPLES, _BRIDGED_SECONDS = 10, 0.05
# A command of fewer samples need not have stopped where its last one came.
_STREAMED = 50
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
    limits: Limits | None = None,
    released: bool = False,
    follows: bool = True,
) -> Dataset:
    """Put a recording on the grid of controller cycles.

    Args:
        recording: The recording.
        drives: The D joints wanted, in the model's order.
        cycle: Controller cycle, s.
        need: Fields without which the data is of no use: of `position`, `velocity`, `effort`,
            `command`.
        effort_scale: Factor from the logged effort to N m or N (a torque constant, say), or that
            of each joint.
        limits: How much memory the grid may take; the default where None.
        released: Whether a stream of set-points that stops before the state does means that the
            motors were switched off.
        follows: Whether set-points of position drive the model; where not, of the command only
            the effort asked for is taken.

    Returns:
        The data set. Its grid covers the command where there is one, else the state; where the
        command has a long hole, the longest stretch without one.

    Raises:
        IdentError: MISSING_STREAM, NO_DATA or BAD_VALUES, each with the remedy.
    """
    names = tuple(drives)
    if not names or len(set(names)) != len(names):
        raise IdentError(
            ErrorCode.INVALID_GOAL,
            f'drives are ({", ".join(names)}); name at least one, and each only once',
        )
    recording = scale_effort(recording, effort_scale)
    asking = recording.command
    if not follows or ('command' not in need and _only_efforts(asking)):
        recording = replace(recording, command=None)
    warnings = list(recording.warnings)
    recording, found = with_positions(recording, names)
    if found:
        warnings.append(
            f'state: no position of {", ".join(found)} was recorded; it is the integral of the '
            'speed, from 0'
        )
    placed = place(recording, names, cycle, warnings)
    where = recording.source or 'recording'
    start, cycles = _span(where, placed, cycle, warnings)
    off = None
    if released:
        off, cycles = _released(placed, start, cycles, cycle, warnings)
    _check_memory(where, cycles, len(names), limits or Limits())
    command = placed.get('command')
    position = velocity = None
    if command is not None:
        position, velocity = _setpoint(command, start, cycles, cycle)
    measured = {field: _measured(field, placed, names, start, cycles) for field in FIELDS}
    _check_need(where, recording, names, measured, command is not None, need)
    quality = AlignQuality(
        tuple(_quality(x, names, start, cycles) for x in placed.values()),
        tuple(dict.fromkeys(warnings)),
    )
    origin = placed['state'] if 'state' in placed else next(iter(placed.values()))
    begin = origin.stamp_of(start, cycle)
    return Dataset(
        names,
        float(cycle),
        begin,
        position,
        velocity,
        measured['position'],
        measured['velocity'],
        measured['effort'],
        quality,
        _beside(recording, names, begin, cycles, cycle),
        off,
        _asked(asking, names, begin, cycles, cycle),
    )


def _only_efforts(command: Stream | None) -> bool:
    """Whether a command asks for efforts and nothing else."""
    return command is not None and command.position is None and command.effort is not None


def _asked(
    command: Stream | None, names: tuple[str, ...], begin: int, cycles: int, cycle: float
) -> FloatArray | None:
    """Return the effort asked for (D, K), NaN for a drive without; None where there is none.

    Beside a set-point of the motion an effort is a feed-forward, a part of what is asked for.
    """
    if command is None or command.effort is None:
        return None
    moved = np.zeros(len(command.names), dtype=bool)
    for values in (command.position, command.velocity):
        if values is not None:
            moved |= np.nan_to_num(np.nanmax(values, axis=0) - np.nanmin(values, axis=0)) > 0.0
    time = (command.stamp - begin) * 1e-9
    grid = np.arange(cycles) * cycle
    out = np.full((len(names), cycles), np.nan)
    for row, name in zip(out, names, strict=True):
        column = command.names.index(name) if name in command.names else -1
        if column < 0 or moved[column]:
            continue
        values = command.effort[:, column]
        there = np.isfinite(values)
        if there.sum() > 1:
            row[:] = np.interp(grid, time[there], values[there])
    return None if np.isnan(out).all() else out


def _beside(
    recording: Recording, names: tuple[str, ...], begin: int, cycles: int, cycle: float
) -> dict[str, FloatArray]:
    """Return positions of the joints that are no drives, where each has been measured."""
    state = recording.state
    if state is None or state.position is None:
        return {}
    time = (state.stamp - begin) * 1e-9
    grid = np.arange(cycles) * cycle
    strangers = [n for n in state.names if n not in names][:_STRANGERS]
    columns = {n: state.position[:, state.names.index(n)] for n in strangers}
    return {
        n: np.interp(grid, time[np.isfinite(x)], x[np.isfinite(x)])
        for n, x in columns.items()
        if np.isfinite(x).any()
    }


def _check_memory(where: str, cycles: int, drives: int, limits: Limits) -> None:
    """Refuse a grid that would not fit.

    Raises:
        IdentError: BAD_VALUES.
    """
    needed = _GRIDS * cycles * drives * 8
    if needed > limits.memory:
        raise too_large(
            f'{where}: a grid of {cycles} controller cycles takes', needed, limits.memory, 'memory'
        )


def _span(
    where: str, placed: dict[str, Placed], cycle: float, warnings: list[str]
) -> tuple[int, int]:
    """Return first cycle and number of cycles of the grid."""
    leader = placed.get('command') or placed.get('state') or placed['effort']
    first, last = int(leader.tick[0]), int(leader.tick[-1])
    others = [x for x in placed.values() if x is not leader]
    if leader.role == 'command':
        first, last = _longest_stretch(leader, cycle, warnings)
        # the first or last sample of the command itself may be the one that was dropped
        reach = max(5 * max(1, leader.ticks.stride), round(0.01 / cycle))
        low = min((int(x.tick[0]) for x in others), default=first)
        high = max((int(x.tick[-1]) for x in others), default=last)
        if first == int(leader.tick[0]):
            first = low if first - reach <= low < first else first
        if last == int(leader.tick[-1]):
            last = high if last < high <= last + reach else last
    for other in others:
        if other.tick[-1] < first or other.tick[0] > last:
            gap = max(first - int(other.tick[-1]), int(other.tick[0]) - last) * cycle
            raise IdentError(
                ErrorCode.NO_DATA,
                f'{where}: {leader.role} and {other.role} do not overlap in time, they are '
                f'{gap:.3g} s apart; record them together, with one clock for all stamps',
            )
        outside = int(((other.tick < first) | (other.tick > last)).sum())
        if outside > 0.02 * other.tick.size and outside > 5:
            warnings.append(
                f'{other.role}: {outside} of {other.tick.size} samples lie outside the '
                f'{leader.role} and are not used'
            )
    if last <= first:
        raise IdentError(
            ErrorCode.NO_DATA,
            f'{where}: {leader.role} has a single sample of the drives; record a motion of '
            'several seconds',
        )
    return first, last - first + 1


def _released(
    placed: dict[str, Placed], start: int, cycles: int, cycle: float, warnings: list[str]
) -> tuple[int | None, int]:
    """Return the cycle from which on motors are off, None for none, and the cycles up to then.

    The grid goes on to the end of the state where the command is a stream that stops for good.
    """
    if 'command' not in placed or 'state' not in placed:
        return None, cycles
    command, state = placed['command'].tick, placed['state'].tick
    last = int(command[-1]) - start
    end = int(state[-1]) - start + 1
    if command.size < _STREAMED or last >= cycles:
        return None, cycles
    typical = float(np.median(np.diff(command)))
    if end - last <= max(_BRIDGED_SAMPLES * typical, _BRIDGED_SECONDS / cycle):
        return None, cycles
    outside = [w for w in warnings if w.startswith('state: ') and 'outside the command' in w]
    for warning in outside:
        warnings.remove(warning)
    warnings.append(
        f'command: stops {(end - last) * cycle:.3g} s before the state; the motors are taken as '
        'switched off from there on'
    )
    # Who commands and reads in one loop has stopped commanding by the next reading.
    return int(state[state > command[-1]][0]) - start, end


def _longest_stretch(command: Placed, cycle: float, warnings: list[str]) -> tuple[int, int]:
    """Return first and last cycle of the longest stretch of the command without a long hole."""
    tick = command.tick
    values = command.samples('position')
    steps = np.diff(tick)
    typical = float(np.median(steps)) if steps.size else 1.0
    long = steps > max(_BRIDGED_SAMPLES * typical, _BRIDGED_SECONDS / cycle)
    if values is not None and steps.size:
        # a set-point that is only sent when it changes has not lost anything while it stands
        still = np.nanmax(np.abs(np.diff(values, axis=0)), axis=1, initial=0.0) == 0.0
        long &= ~still
    holes = np.flatnonzero(long)
    if not holes.size:
        return int(tick[0]), int(tick[-1])
    begins = np.concatenate([[0], holes + 1])
    ends = np.concatenate([holes, [tick.size - 1]])
    best = int(np.argmax(tick[ends] - tick[begins]))
    first, last = int(tick[begins[best]]), int(tick[ends[best]])
    warnings.append(
        f'command: has {holes.size} holes of up to {float(steps.max()) * cycle:.3g} s; only the '
        f'longest stretch without, {(last - first) * cycle:.4g} s of '
        f'{float(tick[-1] - tick[0]) * cycle:.4g} s, is used'
    )
    return first, last


def _setpoint(
    command: Placed, start: int, cycles: int, cycle: float
) -> tuple[FloatArray, FloatArray]:
    """Return set-point and its velocity (D, K) at every cycle."""
    position, velocity = command.samples('position'), command.samples('velocity')
    if position is None:
        raise IdentError(
            ErrorCode.MISSING_STREAM,
            'command: holds no position of the drives; record the position set-point, or leave '
            'the topic out',
        )
    grid = np.arange(start, start + cycles).astype(np.float64) * cycle
    time = command.instants * cycle
    out = np.empty((position.shape[1], cycles))
    rate = np.empty_like(out)
    for column, name in enumerate(command.stream.names):
        there = ~np.isnan(position[:, column])
        if not there.any():
            raise IdentError(
                ErrorCode.BAD_VALUES,
                f'command: every position of {name} is NaN; record its set-point, or leave the '
                'topic out',
            )
        feed = None
        if velocity is not None:
            feed = velocity[there, column]
            feed = None if np.isnan(feed).any() else feed
        out[column], rate[column] = interpolate_setpoint(
            time[there], position[there, column], feed, grid
        )
    return out, rate


def _measured(
    field: str, placed: dict[str, Placed], names: tuple[str, ...], start: int, cycles: int
) -> FloatArray | None:
    """Return a measured field (D, K) with NaN where no sample is, or None where never measured."""
    out = np.full((len(names), cycles), np.nan)
    for column in range(len(names)):
        for role in ('effort', 'state') if field == 'effort' else ('state',):
            if role not in placed:
                continue
            values = placed[role].samples(field)
            if values is None or np.isnan(values[:, column]).all():
                continue
            index = placed[role].tick - start
            inside = (index >= 0) & (index < cycles)
            out[column, index[inside]] = values[inside, column]
            break
    return None if np.isnan(out).all() else out


def _check_need(
    where: str,
    recording: Recording,
    names: tuple[str, ...],
    measured: dict[str, FloatArray | None],
    commanded: bool,
    need: Collection[str],
) -> None:
    """Refuse data without a field that is needed."""
    if 'command' in need and not commanded:
        raise IdentError(
            ErrorCode.MISSING_STREAM,
            f'{where}: holds no command stream; record the set-point, or let the recorded motion '
            'drive the model',
        )
    for field in FIELDS:
        if field not in need:
            continue
        values = measured[field]
        if values is not None:
            silent = [n for n, row in zip(names, values, strict=True) if np.isnan(row).all()]
            if not silent:
                continue
            raise IdentError(
                ErrorCode.MISSING_STREAM,
                f'{where}: no {field} of {", ".join(silent)}; leave these drives out, or record '
                'theirs too',
            )
        sent = any(
            stream.values(field) is not None
            for role, stream in recording.streams.items()
            if role != 'command'
        )
        if sent:
            raise IdentError(
                ErrorCode.BAD_VALUES,
                f'{where}: every {field} of the drives is NaN; switch the measurement on in the '
                'drive, or name the topic that carries it',
            )
        article = 'an' if field == 'effort' else 'a'
        raise IdentError(
            ErrorCode.MISSING_STREAM,
            f'{where}: no stream holds {article} {field}; record it, or name the topic that '
            'carries it',
        )


def _quality(placed: Placed, names: tuple[str, ...], start: int, cycles: int) -> StreamQuality:
    """Count what of a stream lies on the grid."""
    tick = placed.tick
    inside = (tick >= start) & (tick < start + cycles)
    used = int(inside.sum())
    stride = placed.ticks.stride
    steps = np.diff(tick[inside])
    usual = stride or (float(np.median(steps)) if steps.size else 1.0)
    missing = int(np.maximum(np.round(steps / usual) - 1, 0).sum()) if steps.size else 0
    nan = {}
    for field in FIELDS:
        values = placed.samples(field)
        if values is None:
            continue
        for column, name in enumerate(names):
            count = int(np.isnan(values[inside, column]).sum())
            if 0 < count < used:
                nan[f'{field} {name}'] = count
    period = sample_period(placed.stream.stamp)
    return StreamQuality(
        placed.role,
        used,
        missing,
        1.0 / period if period else 0.0,
        placed.ticks.jitter,
        stride,
        nan,
    )
