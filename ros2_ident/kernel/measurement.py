# SPDX-License-Identifier: Apache-2.0
"""From the torque a controller commanded to the one a log holds, and to a candidate's cost.

The simulations hand their torque on `PIECE` cycles at a time, while it is still in the processor's
cache: a cost needs no trajectory in memory, and residuals are stored at measured samples only.
"""
# mypy: ignore-errors

import numpy as np

from ros2_ident.kernel.rows import DRIVE_COUNT, MACHINE_COUNT, row_of
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
DELAY, GAIN, BIAS, LAG, CROSSTALK = (
    row_of(name, 0) - MACHINE_COUNT
    for name in ('log_delay', 'log_gain', 'log_bias', 'log_lag', 'log_crosstalk')
)

PIECE = 128
# What a drive's log keeps from one piece to the next: the rows of its part of `kept`.
VALUE, BEFORE, SQUARES = range(3)
KEPT = 3
# Rows of room to work in.
ROOM = PIECE + 1


@inlined
def _any_nonzero(par, row):
    found = False
    for lane in range(W):
        found |= par[row * W + lane] != 0.0
    return found


@called
def _log(par, torque, d, drives, first, count, cycle, kept, late):
    """Write what the log of drive `d` holds, but for the delay's whole cycles, into `late`."""
    row = MACHINE_COUNT + d * DRIVE_COUNT
    gain = load(par, (row + GAIN) * W)
    bias = load(par, (row + BIAS) * W)
    cross = load(par, (row + CROSSTALK) * W)
    lag = load(par, (row + LAG) * W)
    crossed = _any_nonzero(par, row + CROSSTALK)
    filtered = lag > spread(0.0)
    lagged = _any_nonzero(par, row + LAG)
    keep = exp(spread(-cycle) / where(filtered, lag, spread(1.0)))
    delay = load(par, (row + DELAY) * W) / spread(cycle)
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


@called
def hand_on(par, torque, first, count, cycle, wanted, measured, samples, rows, kept, room, out):
    """Write a piece of a block's torque where it is wanted, or add it to the costs.

    Args:
        par: (R * W,) rows of the candidates.
        torque: (D * PIECE * W,) commanded torque of the cycles from `first` on.
        first: The piece's first cycle.
        count: Its cycles.
        cycle: Controller cycle [s].
        wanted: (D, K) column of `out` for each drive and cycle, -1 for none.
        measured: (D, K + 1) measured torque to sum costs, NaN where there is no sample and behind
            the last cycle; (0, 0) to write torque.
        samples: (D,) how many cycles of a drive count.
        rows: (W,) row of `out` for each lane, -1 for none.
        kept: (D * KEPT * W,) what is kept between pieces; zero before the first.
        room: (ROOM * W,) to work in.
        out: (S, C) logged torque, written where it is wanted. The delay interpolates linearly
            between cycles; before the first cycle the torque is the first one.
    """
    drives, cycles = wanted.shape
    late = room[: PIECE * W]
    whole = room[PIECE * W :]
    for d in range(drives):
        if samples[d]:
            _log(par, torque, d, drives, first, count, cycle, kept, late)
            delay = load(par, (MACHINE_COUNT + d * DRIVE_COUNT + DELAY) * W) / spread(cycle)
            store(whole, 0, clip(floor(delay), spread(0.0), spread(float(cycles))))
            if measured.size:
                row = (d * KEPT + SQUARES) * W
                _square(late, whole, first, count, measured[d], kept[row : row + W])
            else:
                _write(late, whole, first, count, wanted[d], rows, out)


@inlined
def _cost(samples, kept, lane):
    """Return a lane's cost, eq. 2 of the paper, as far as errors have been summed.

    Squares only add to it, and every operation on them rises with them: it never exceeds, not in
    its last digit, what it becomes later. NaN or inf where no cost will be finite any more.
    """
    total = 0.0
    outputs = 0
    for d in range(samples.shape[0]):
        if samples[d]:
            total += np.sqrt(kept[(d * KEPT + SQUARES) * W + lane] / samples[d])
            outputs += 1
    return total / max(outputs, 1)


@called
def give_up(samples, rows, limits, kept, out):
    """Write what lanes cost that have come above their limits; return whether none is left.

    A lane's number is that of the first piece after which it was above: it does not depend on
    the lane's neighbours.

    Args:
        samples: As for `hand_on`.
        rows: As for `hand_on`; becomes -1 for a lane that is given up.
        limits: (S,) cost above which a candidate need not be simulated further; (0,) for none.
        kept: What `hand_on` kept.
        out: (S, 1) what a lane cost when it came above its limit.
    """
    if not limits.size:
        return False
    left = False
    for lane in range(W):
        if rows[lane] >= 0:
            cost = _cost(samples, kept, lane)
            if cost <= limits[rows[lane]]:
                left = True
            else:
                out[rows[lane], 0] = cost if np.isfinite(cost) else np.inf
                rows[lane] = -1
    return not left


@called
def conclude(par, finite, measured, samples, rows, kept, out):
    """Write the costs (S, 1), eq. 2 of the paper, and inf for diverged candidates.

    Args:
        par: (R * W,) rows of the candidates.
        finite: (W,) other than zero where a candidate stayed finite.
        measured: As for `hand_on`.
        samples: As for `hand_on`.
        rows: As for `hand_on`.
        kept: What `hand_on` kept.
        out: (S, C) as for `hand_on`; where costs are summed (S, 1), the RMS error averaged over
            the drives that count.
    """
    for lane in range(W):
        if rows[lane] < 0:
            continue
        good = finite[lane] != 0.0
        for d in range(samples.shape[0]):
            delay = par[(MACHINE_COUNT + d * DRIVE_COUNT + DELAY) * W + lane]
            good &= np.isfinite(delay) and delay >= 0.0
        if measured.size:
            cost = _cost(samples, kept, lane)
            good &= np.isfinite(cost) and samples.any()
            out[rows[lane], 0] = cost if good else np.inf
        elif not good:
            out[rows[lane]] = np.inf
