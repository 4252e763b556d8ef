# SPDX-License-Identifier: Apache-2.0
"""From what the simulated drives did to what a log holds of it, and to a candidate's cost.

The simulations hand their torque on `PIECE` cycles at a time, while it is still in the processor's
cache: a cost needs no trajectory in memory, and residuals are stored at measured samples only.

Where motors' positions and velocities are wanted, too, they are handed on beside the torque; the
log holds them as they were at the controller's instants.
"""
# mypy: ignore-errors

from typing import Literal

import numpy as np

from ros2_ident.kernel.rows import DRIVE, DRIVE_COUNT, MACHINE_COUNT
from ros2_ident.lanes import (
    called,
    clip,
    exp,
    floor,
    inlined,
    load,
    spread,
    store,
    take,
    where,
    WIDTH,
)

W = WIDTH

PIECE = 128
# What is measured, in the order of the outputs; `Task` has a row of each for every drive.
Quantity = Literal['effort', 'position', 'velocity']
QUANTITIES: tuple[Quantity, ...] = ('effort', 'position', 'velocity')
MOTIONS = len(QUANTITIES) - 1
# What a drive's log keeps from one piece to the next: the rows of its part of `kept`. From SQUARES
# on, a row for each quantity.
VALUE, BEFORE, SQUARES = range(3)
KEPT = SQUARES + len(QUANTITIES)
# Rows of room to work in.
ROOM = PIECE + 1


@inlined
def any_nonzero(par, row):
    """Return whether any lane's number of a row is not zero."""
    found = False
    for lane in range(W):
        found |= par[row * W + lane] != 0.0
    return found


@called
def _log(par, torque, d, drives, first, count, cycle, kept, late):
    """Write what the log of drive `d` holds, but for the delay's whole cycles, into `late`."""
    row = MACHINE_COUNT + d * DRIVE_COUNT
    gain = load(par, (row + DRIVE.log_gain) * W)
    bias = load(par, (row + DRIVE.log_bias) * W)
    cross = load(par, (row + DRIVE.log_crosstalk) * W)
    lag = load(par, (row + DRIVE.log_lag) * W)
    crossed = any_nonzero(par, row + DRIVE.log_crosstalk)
    filtered = lag > spread(0.0)
    lagged = any_nonzero(par, row + DRIVE.log_lag)
    keep = exp(spread(-cycle) / where(filtered, lag, spread(1.0)))
    delay = load(par, (row + DRIVE.log_delay) * W) / spread(cycle)
    part = delay - floor(delay)
    value = load(kept, (d * KEPT + VALUE) * W)
    before = load(kept, (d * KEPT + BEFORE) * W)
    for j in range(count):
        raw = gain * load(torque, (d * PIECE + j) * W) + bias
        if crossed:
            for other in range(drives):
                if other != d:
                    raw = raw + cross * load(torque, (other * PIECE + j) * W)
        if first + j == 0:
            value = raw
            before = raw
        if lagged:
            value = where(filtered, keep * value + (1.0 - keep) * raw, raw)
        else:
            value = raw
        store(late, j * W, value + part * (before - value))
        before = value
    store(kept, (d * KEPT + VALUE) * W, value)
    store(kept, (d * KEPT + BEFORE) * W, before)


@called
def _write(late, whole, first, count, columns, rows, out):
    """Write a drive's log to where it is wanted."""
    cycles = columns.shape[0]
    for lane in range(W):
        row = rows[lane]
        shift = int(whole[lane])
        if row < 0:
            continue
        if first == 0:
            for k in range(min(shift, cycles)):
                if columns[k] >= 0:
                    out[row, columns[k]] = late[lane]
        for j in range(min(count, cycles - shift - first)):
            column = columns[first + shift + j]
            if column >= 0:
                out[row, column] = late[j * W + lane]


@called
def _square(late, whole, first, count, measured, squares):
    """Add a drive's squared errors to `squares`."""
    cycles = measured.shape[0] - 1
    if first == 0:
        for lane in range(W):
            for k in range(int(whole[lane])):
                error = measured[k] - late[lane]
                if not np.isnan(measured[k]):
                    squares[lane] += error * error
    total = load(squares, 0)
    last = spread(float(cycles))
    at = load(whole, 0) + float(first)
    for j in range(count):
        # Behind the last cycle stands a NaN, as where there is no sample.
        sample = take(measured, where(at < last, at, last))
        error = sample - load(late, j * W)
        total = total + where(sample >= sample, error * error, spread(0.0))
        at = at + 1.0
    store(squares, 0, total)


@inlined
def _cost(task, kept, lane):
    """Return a lane's cost, eq. 2 of the paper, as far as errors have been summed.

    Squares only add to it, and every operation on them rises with them: it never exceeds, not in
    its last digit, what it becomes later. NaN or inf where no cost will be finite any more, or
    nothing is measured.
    """
    total = 0.0
    outputs = 0
    for q in range(task.samples.shape[0]):
        for d in range(task.samples.shape[1]):
            if task.samples[q, d]:
                square = kept[(d * KEPT + SQUARES + q) * W + lane]
                total += task.weights[q] * np.sqrt(square / task.samples[q, d])
                outputs += 1
    return total / outputs if outputs else np.inf


@called
def _give_up(task, rows, kept):
    """Write what lanes cost that have come above their limits; return whether none is left.

    A lane's number is that of the first piece after which it was above: it does not depend on
    the lane's neighbours.
    """
    if not task.limits.size:
        return False
    left = False
    for lane in range(W):
        if rows[lane] >= 0:
            cost = _cost(task, kept, lane)
            if cost <= task.limits[rows[lane]]:
                left = True
            else:
                task.out[rows[lane], 0] = cost if np.isfinite(cost) else np.inf
                rows[lane] = -1
    return not left


@called
def hand_on(par, torque, moves, first, count, cycle, task, rows, kept, room):
    """Write a piece of a block's log where it is wanted, or add it to the costs.

    Return whether every lane's cost has come above its limit. A quantity is the effort or, where Q
    is 3 and not 1, the motors' position or velocity.

    Args:
        par: (R * W,) rows of the candidates.
        torque: (D * PIECE * W,) commanded torque of the cycles from `first` on.
        moves: (2 * D * PIECE * W,) the motors' positions, then their velocities; not looked at
            where Q is 1.
        first: The piece's first cycle.
        count: Its cycles.
        cycle: Controller cycle [s].
        task: A `group.Task`. The torque's delay interpolates linearly between cycles; before the
            first cycle the torque is the first one.
        rows: (W,) row of `out` for each lane, -1 for none and for a lane that is given up: its
            `out` gets what it cost then.
        kept: (D * KEPT * W,) what is kept between pieces; zero before the first.
        room: (ROOM * W,) to work in.
    """
    quantities, drives, cycles = task.wanted.shape
    late = room[: PIECE * W]
    whole = room[PIECE * W :]
    for q in range(quantities):
        for d in range(drives):
            if not task.samples[q, d]:
                continue
            if q == 0:
                _log(par, torque, d, drives, first, count, cycle, kept, late)
                row = MACHINE_COUNT + d * DRIVE_COUNT + DRIVE.log_delay
                delay = load(par, row * W) / spread(cycle)
                store(whole, 0, clip(floor(delay), spread(0.0), spread(float(cycles))))
                seen = late
            else:
                at = ((q - 1) * drives + d) * PIECE * W
                seen = moves[at : at + PIECE * W]
                store(whole, 0, spread(0.0))
            if task.measured.size:
                row = (d * KEPT + SQUARES + q) * W
                _square(seen, whole, first, count, task.measured[q, d], kept[row : row + W])
            else:
                _write(seen, whole, first, count, task.wanted[q, d], rows, task.out)
    return _give_up(task, rows, kept)


@called
def conclude(par, moved, task, rows, kept):
    """Write the costs (S, 1), eq. 2 of the paper, and inf for diverged candidates.

    Args:
        par: (R * W,) rows of the candidates.
        moved: (N * W,) where candidates came to, and how fast: all finite but of diverged ones.
        task: As for `hand_on`; a cost is weight times RMS error, averaged over the quantities of
            drives that count.
        rows: As for `hand_on`.
        kept: What `hand_on` kept.
    """
    for lane in range(W):
        if rows[lane] < 0:
            continue
        good = True
        for r in range(moved.shape[0] // W):
            good &= np.isfinite(moved[r * W + lane])
        for d in range(task.samples.shape[1]):
            delay = par[(MACHINE_COUNT + d * DRIVE_COUNT + DRIVE.log_delay) * W + lane]
            good &= np.isfinite(delay) and delay >= 0.0
        if task.measured.size:
            cost = _cost(task, kept, lane)
            good &= np.isfinite(cost)
            task.out[rows[lane], 0] = cost if good else np.inf
        elif not good:
            task.out[rows[lane]] = np.inf
