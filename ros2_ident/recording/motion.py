# SPDX-License-Identifier: Apache-2.0
"""Recorded motion smoothed without delay, its derivatives, and the lag between two signals."""

from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
import math
import sys

import numpy as np
from numpy.typing import NDArray
import scipy

from ros2_ident.arrays import highest
from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.recording.align import align
from ros2_ident.recording.grid import sample_period
from ros2_ident.recording.streams import Dataset, FloatArray, Recording

# Motion faster than this is noise or a shock; the judgement needs none of it, Hz.
CUTOFF = 15.0
# An effort that is later than this is no measurement of the same motion, s.
LATEST = 0.12
# Slower than this share of the top speed is rest.
REST = 0.01
# The highest cutoff, in shares of the rate: the filter needs room below half of it.
ROOM = 0.2
_ORDER = 4
# Friction turns over within this share of the top speed. By hand.
_TURNS = 0.02


@dataclass(frozen=True)
class Motion:
    """A drive's motion on an even grid, smoothed."""

    period: float  # time from sample to sample, s
    position: FloatArray  # (T,), rad or m
    velocity: FloatArray  # (T,), rad/s or m/s
    acceleration: FloatArray  # (T,), rad/s^2 or m/s^2
    reported: FloatArray | None  # the velocity that the drive reports (T,), NaN where none
    effort: FloatArray | None  # (T,), N m or N, NaN where none
    beside: FloatArray  # (M, T) positions of the other joints, rad or m
    goal: FloatArray | None = None  # set-point of the position (T,), rad or m

    @property
    def resting(self) -> NDArray[np.bool_]:
        """Where the drive rests (T,)."""
        return np.asarray(np.abs(self.velocity) < REST * np.abs(self.velocity).max())

    @cached_property
    def regressors(self) -> FloatArray:
        """Columns (T, 6) of inertia, friction and gravity, smoothed as the effort is."""
        friction = direction(self.velocity)
        # Gravity of a joint that turns is both; within a radian, the place and its square.
        weight = np.sin(self.position), np.cos(self.position)
        constant = np.ones_like(friction)
        rows = np.stack([self.acceleration, self.velocity, friction, *weight, constant])
        return self.slowly(rows).T

    def slowly(self, rows: FloatArray) -> FloatArray:
        """Return rows (..., T) without what is faster than the motion that is judged."""
        return low_pass(rows, self.period, min(CUTOFF, ROOM / self.period))


def motion_of(recording: Recording, name: str) -> Motion:
    """Return one drive's smoothed motion at about its own sampling rate.

    Raises:
        IdentError: Where the drive has too few samples, or no position.
    """
    period = sample_period(recording.state.stamp) if recording.state else 0.0
    data = align(recording, [name], period or 1e-3, need=('position',), follows=False)
    return motion_in(data, name)


def motion_in(data: Dataset, name: str) -> Motion:
    """Return one drive's smoothed motion on the grid of a data set; else as `motion_of`."""
    assert data.position is not None
    d = data.names.index(name)
    cutoff = allowed_cutoff(data.position[d], data.cycle, CUTOFF)
    moved = smooth_motion(data.position[d], data.cycle, cutoff)
    position, velocity, acceleration = (x[0] for x in moved)
    reported, effort = (None if x is None else x[d] for x in (data.velocity, data.effort))
    others = [*np.delete(data.position, d, axis=0), *data.beside.values()]
    rows = [fill_gaps(row) for row in others if np.isfinite(row).sum() > 1]
    beside = low_pass(np.array(rows).reshape(len(rows), data.cycles), data.cycle, cutoff)
    goal = None if data.goal is None or np.isnan(data.goal[d]).all() else data.goal[d]
    return Motion(data.cycle, position, velocity, acceleration, reported, effort, beside, goal)


def direction(velocity: FloatArray) -> FloatArray:
    """Return the direction (T,) of a velocity, from -1 to 1, as friction turns over with it."""
    return np.asarray(np.tanh(velocity / (_TURNS * np.abs(velocity).max())))


def count_reversals(velocity: FloatArray) -> int:
    """Count changes of direction of a velocity (T,) between stretches of real motion."""
    signs = np.sign(velocity[np.abs(velocity) > 0.05 * np.abs(velocity).max()])
    return int((np.diff(signs) != 0).sum())


def fill_gaps(values: FloatArray) -> FloatArray:
    """Fill NaN linearly."""
    there = np.isfinite(values)
    if there.all():
        return values
    index = np.arange(values.size)
    return np.interp(index, index[there], values[there])


def fill_smoothly(values: FloatArray) -> FloatArray:
    """Fill NaN by a cubic spline: straight lines would cut the tips of a fast oscillation."""
    there = np.flatnonzero(np.isfinite(values))
    if there.size == values.size or there.size < 4:
        return fill_gaps(values)
    spline = scipy.interpolate.make_interp_spline(there.astype(float), values[there], k=3)
    return np.asarray(spline(np.clip(np.arange(values.size), there[0], there[-1]).astype(float)))


def samples_of(row: FloatArray, cycle: float) -> tuple[NDArray[np.intp], float]:
    """Return the cycles of a row with a sample, and the time from one to the next, s."""
    there = np.flatnonzero(np.isfinite(row))
    return there, cycle * float(np.median(np.diff(there))) if there.size > 1 else cycle


def allowed_cutoff(position: FloatArray, cycle: float, wanted: float) -> float:
    """Return the cutoff with which positions can be smoothed, as near to the wanted one as may be.

    Args:
        position, cycle: As of `smooth_motion`.
        wanted: Frequency up to which motion is wanted, Hz.

    Returns:
        The frequency wanted, or a fifth of the rate of the slowest drive's samples, Hz.
    """
    periods = (samples_of(row, cycle)[1] for row in np.atleast_2d(position))
    return min(wanted, ROOM / max(periods, default=cycle))


def smooth_motion(
    position: FloatArray, cycle: float, cutoff: float, ahead: float = 0.0
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Smooth recorded positions and differentiate them twice, without delay.

    Cycles without a sample are filled by a cubic spline through the samples. A Butterworth
    low-pass of order 4 runs forwards and backwards (its gain at `cutoff` is then a half, not
    0.71); velocity and acceleration are the derivatives of a quintic spline through the result,
    exact for the frequencies that pass.

    Both ends are continued by point reflection, as if the motion went on with the velocity it has
    there. Motion that starts and ends at rest is therefore reproduced to its ends; else the
    acceleration of the first and last `1 / cutoff` seconds is drawn towards zero and better left
    out.

    Args:
        position: Measured positions (D, K), rad or m, NaN at cycles without a sample.
        cycle: Time from cycle to cycle, s.
        cutoff: Frequency up to which motion is kept, Hz; below half the sampling rate.
        ahead: Cycles after each cycle's beginning at which the motion is wanted, 0 to 1.

    Returns:
        Position, velocity and acceleration, each (D, K), without NaN; before a drive's first and
        after its last sample it stands still.

    Raises:
        IdentError: BAD_VALUES where a drive has fewer than four samples or the cutoff does not fit
            the rate.
    """
    position = np.atleast_2d(np.asarray(position, dtype=np.float64))
    for row, samples in enumerate(position, 1):
        there, period = samples_of(samples, cycle)
        rate = 1.0 / period
        if there.size < 4:
            text = f'drive {row} of {len(position)} has {there.size} position samples, at least 4 '
            raise ErrorCode.BAD_VALUES.error(f'{text}are needed; record longer')
        if not 0.0 < cutoff < 0.5 * rate:
            text = f'the smoothing cutoff is {cutoff:g} Hz but positions come at {rate:g} Hz; '
            raise ErrorCode.BAD_VALUES.error(f'{text}choose one between 0 and {0.5 * rate:g} Hz')
    smooth = low_pass(np.stack([fill_smoothly(row) for row in position]), cycle, cutoff)
    # time in cycles keeps the spline's knots well scaled
    time = np.arange(smooth.shape[1], dtype=np.float64)
    degree = 5 if time.size > 5 else 3
    spline = scipy.interpolate.make_interp_spline(time, smooth, k=degree, axis=1)
    if ahead:
        time += ahead
        smooth = np.ascontiguousarray(spline(time))
    velocity, acceleration = (np.ascontiguousarray(spline(time, n)) / cycle**n for n in (1, 2))
    return smooth, velocity, acceleration


# A Butterworth filter with the numbers of `scipy.signal`: to import that package, or numba, takes
# longer than to filter a short log without; from so many values on the import is the shorter.
MANY = 300_000
# Rows that are filtered side by side: those of a log of a minute fill half a cache.
_BESIDE = 64


def butterworth(order: int, share: float) -> tuple[FloatArray, FloatArray]:
    """Return poles (order,) and second-order sections (order / 2, 6), by the bilinear transform.

    Args:
        order: Even.
        share: Cutoff over half the rate.
    """
    wide = 4.0 * np.tan(np.pi * share / 2.0)
    analogue = -wide * np.exp(1j * np.pi * np.arange(1.0 - order, order, 2.0) / (2 * order))
    poles = (4.0 + analogue) / (4.0 - analogue)
    upper, lower = (x[np.argsort(x.real)] for x in (poles[poles.imag > 0], poles[poles.imag < 0]))
    pairs = (upper + lower.conj()) / 2
    # the pair nearest to the unit circle is the last
    pairs = pairs[np.argsort(np.abs(1 - np.abs(pairs)), kind='stable')[::-1]]
    sections = np.array([[1.0, 2.0, 1.0, *np.poly([p, p.conj()])] for p in pairs])
    sections[0, :3] *= wide**order * np.real(1.0 / np.prod(4.0 - analogue))
    return poles, sections


def forwards_and_backwards(sections: FloatArray, rows: FloatArray, reach: int) -> FloatArray:
    """Filter rows (..., K), continued at either end by `reach` values turned about the last."""
    # as if the first value had lasted
    still, gain = np.empty((len(sections), 2)), 1.0
    for state, (b0, b1, b2, a0, a1, a2) in zip(still, sections, strict=True):
        rest = np.linalg.solve([[a0 + a1, -1.0], [a2, 1.0]], [b1 - a1 * b0, b2 - a2 * b0])
        state[:] = gain * rest
        gain *= np.sum([b0, b1, b2]) / np.sum([a0, a1, a2])
    run = _one_by_one
    if rows.size > MANY or 'numba' in sys.modules:
        from ros2_ident.recording.sections import run_both_ways

        run = run_both_ways
    flat = rows.reshape(-1, rows.shape[-1])
    inside = slice(reach, reach + flat.shape[1])
    out = np.empty(flat.shape)
    for begin in range(0, len(flat), _BESIDE):
        few = flat[begin : begin + _BESIDE].T
        beside = np.empty((len(few) + 2 * reach, few.shape[1]))
        beside[:reach] = 2 * few[0] - few[reach:0:-1]
        beside[inside] = few
        beside[inside.stop :] = 2 * few[-1] - few[-2 : -reach - 2 : -1]
        run(sections, still, beside)
        out[begin : begin + _BESIDE] = beside[inside].T
    return out.reshape(rows.shape)


def _one_by_one(sections: FloatArray, still: FloatArray, rows: FloatArray) -> None:
    """Filter columns (K, R) in place, see `sections.run_both_ways`."""
    for column in rows.T:
        for _ in range(2):
            values: list[float] = column.tolist()
            states = (still * column[0]).tolist()
            for (b0, b1, b2, _, a1, a2), (now, then) in zip(
                sections.tolist(), states, strict=True
            ):
                for k, value in enumerate(values):
                    values[k] = new = b0 * value + now
                    now = b1 * value - a1 * new + then
                    then = b2 * value - a2 * new
            column[:] = values[::-1]


def settling(cycle: float, cutoff: float) -> int:
    """Return after how many cycles `low_pass` has forgotten an end of a log to a thousandth."""
    poles, _ = butterworth(_ORDER, cutoff / (0.5 / cycle))
    return int(np.ceil(np.log(1e-3) / np.log(np.abs(poles).max())))


def low_pass(values: FloatArray, cycle: float, cutoff: float, order: int = _ORDER) -> FloatArray:
    """Low-pass rows forwards and backwards: no delay.

    Args:
        values: Rows (..., K) without NaN.
        cycle: Time from column to column, s.
        cutoff: Frequency of gain one half, Hz; at or above half the rate the values come back as
            they are.
        order: Of the Butterworth filter that runs each way, even.

    Returns:
        The smooth rows (..., K).
    """
    if cutoff >= 0.499 / cycle:
        return np.array(values, dtype=np.float64)
    _, sections = butterworth(order, cutoff / (0.5 / cycle))
    # the filter has forgotten its start after a few periods of the cutoff
    reach = min(values.shape[-1] - 1, int(np.ceil(3.0 / (cutoff * cycle))))
    return forwards_and_backwards(sections, values, reach)


def correlation(values: FloatArray, row: FloatArray) -> FloatArray:
    """Return (T + K - 1,) sums of products of (T,) values and (K,) a row at every shift."""
    size = values.size + row.size - 1
    fast = scipy.fft.next_fast_len(size, True)
    product = scipy.fft.rfft(values, fast) * scipy.fft.rfft(row[::-1], fast)
    return np.asarray(scipy.fft.irfft(product, fast)[:size])


def best_lag(
    columns: FloatArray, target: FloatArray, period: float, earliest: float
) -> tuple[float, FloatArray, float]:
    """Find the lag at which the columns (T, P) explain the target (T,) best.

    Args:
        columns: (T, P), `period` s from sample to sample.
        earliest: Least lag, s; the target may precede the columns by so much.

    Returns:
        Lag, s; the P coefficients there, and the share of the target's variance they explain.
    """
    most = target.size // 4
    low = max(int(np.floor(earliest / period)), -most)
    high = min(int(np.ceil(LATEST / period)), most)
    # what stays inside of the target at every shift
    x = columns[max(0, -low) : target.size - max(0, high)]
    y = target[max(0, low) : target.size - max(0, -high)]
    size = np.sqrt((x**2).sum(axis=0)) + 1e-300
    x = x / size
    inside = slice(len(x) - 1, y.size)
    found = np.stack([correlation(y, row)[inside] for row in x.T])
    inverse = np.linalg.pinv(x.T @ x, rcond=1e-12, hermitian=True)
    solution = inverse @ found
    mean, square = (correlation(y**k, np.ones(len(x)))[inside] / len(x) for k in (1, 2))
    left = square - (solution * found).sum(axis=0) / len(x)
    off = mean - x.mean(axis=0) @ solution
    shares = 1.0 - (left - off**2) / np.maximum(square - mean**2, 1e-300)
    best = int(np.argmax(shares))
    # a parabola gives the lag to a fraction of a sample
    lag = (low + best + float(np.clip(highest(shares, best), -0.5, 0.5))) * period
    return lag, solution[:, best] / size, float(shares[best])


# Part of a log for which a recorded motion determines efforts: below a frequency, in motion. The
# acceleration of a position that is read with an error s, at a rate f and below a frequency B, is
# wrong by s (2 pi)^2 sqrt(2 B^5 / (5 f)), and the effort that an inertia asks for by as much times
# the inertia. The noise of a logged effort grows only with sqrt(B).
# The highest band, as a share of the rate, and the lowest, Hz.
_HIGHEST, LOWEST = 0.1, 3.0
# What readings of the position ask for may be this share of the effort's noise, or this share of
# how the effort varies: no log of an effort is better than that.
_OF_NOISE, _OF_EFFORT = 1.0 / 3.0, 1e-3
# Step from one band that is tried to the next.
_STEP = 0.95
# Frequency below which an inertia is looked for, Hz; and samples that it takes.
_SLOW, _FEWEST = 5.0, 200
# Differences of this order keep noise and lose the motion; their gain on white noise, and how many
# times their median they are at most where nothing else is.
_DIFFERENCES, _GAIN, _USUAL = 4, math.sqrt(70.0), 6.0
# Friction turns over in many of them: this share counts, and so many deviations bound it.
_LOW, _OF_LOW = 0.2, 0.2533
# Readings of a place that does not change lie within so many standard deviations of their noise.
_SPREAD = 7.0
# Samples to either side of a change of direction that friction may turn over at: the motion holds
# nothing above a third of their rate.
_TURN = 3.0


def told_band(data: Dataset) -> float:
    """Return the frequency below which motion tells efforts, Hz.

    Args:
        data: Positions and efforts of some joints; without efforts a tenth of the rate.

    Returns:
        Where the worst joint's readings ask for a third of the noise of its effort, or for a
        thousandth of the effort if that is more; at most a tenth of the rate.
    """
    if data.position is None:
        return _HIGHEST / data.cycle
    bands = []
    for d, row in enumerate(data.position):
        there, period = samples_of(row, data.cycle)
        bands.append(_HIGHEST / period)
        if data.effort is None or min(there.size, np.isfinite(data.effort[d]).sum()) < _FEWEST:
            continue
        position, effort = row[there], fill_gaps(data.effort[d])[there]
        read = _inertia(position, effort, period) * (2.0 * math.pi) ** 2 * _noise(position)
        # of the effort where friction turns over least
        quiet = np.quantile(np.abs(np.diff(effort, _DIFFERENCES)), _LOW)
        noise, least = float(quiet) / (_GAIN * _OF_LOW), _OF_EFFORT * float(np.std(effort))
        while bands[d] > LOWEST:
            asked = read * math.sqrt(0.4 * bands[d] ** 5 * period)
            if asked <= max(_OF_NOISE * noise * math.sqrt(2.0 * bands[d] * period), least):
                break
            bands[d] *= _STEP
    return min(bands)


def standing(
    position: FloatArray,
    velocity: FloatArray,
    cycle: float,
    cutoff: float,
    least: FloatArray | None = None,
) -> NDArray[np.bool_]:
    """Return where joints stand still or turn, as far as their readings tell.

    Args:
        position, cycle, cutoff: As of `smooth_motion`.
        velocity: Of the smoothed motion (D, K).
        least: (D,) speeds below which they stand all the same, rad/s or m/s.

    Returns:
        (D, K) where the readings of a period of the cutoff differ by no more than their step,
        their noise or the least speed, and the samples at a change of direction, whose instant
        they do not tell; nowhere for a joint that never moves.
    """
    out = np.zeros(position.shape, dtype=bool)
    slow = np.zeros(len(position)) if least is None else least
    for row, rate, still, speed in zip(position, velocity, out, slow, strict=True):
        there, period = samples_of(row, cycle)
        if not there.size:
            continue
        seen = row[there]
        window = 2 * math.ceil(0.5 / (cutoff * period)) + 1
        apart = scipy.ndimage.maximum_filter1d(seen, window)
        apart = apart - scipy.ndimage.minimum_filter1d(seen, window)
        same = max(step_of(seen), _SPREAD * _noise(seen), speed * (window - 1) * period)
        quiet = apart <= same * (1.0 + 1e-9)
        if not quiet.all():
            quiet = scipy.ndimage.maximum_filter1d(quiet, window)
            nearest = np.searchsorted(there, np.arange(row.size))
            still[:] = quiet[np.minimum(nearest, there.size - 1)]
            # Smoothed, a motion rings where it comes to rest.
            turns = (np.diff(np.sign(rate), append=np.sign(rate[-1])) != 0.0) & ~still
            still |= scipy.ndimage.maximum_filter1d(turns, 2 * round(_TURN * period / cycle) + 1)
    return out


def still(position: FloatArray) -> bool:
    """Return whether readings (T,) differ by no more than their step, or their noise, makes them.

    So many of white noise range over some 2 sqrt(2 ln T) standard deviations.
    """
    seen = position[np.isfinite(position)]
    if seen.size < 2:
        return True
    noise = 2.0 * math.sqrt(2.0 * math.log(seen.size)) * _noise(seen)
    return float(np.ptp(seen)) <= max(step_of(seen), noise)


def speed_error(position: FloatArray, cycle: float, cutoff: float) -> float:
    """Return by how much a joint's speed is off below a frequency, as far as readings tell, 1/s.

    A position that is read with an error s, at a rate f, has a speed that is wrong by
    2 pi s sqrt(2 B^3 / (3 f)) below a frequency B.

    Args:
        position: One row (K,) of those of `smooth_motion`.
        cycle, cutoff: As there; the frequency is the cutoff.
    """
    there, period = samples_of(position, cycle)
    if not there.size:
        return 0.0
    error = max(_noise(position[there]), step_of(position[there]) / math.sqrt(12.0))
    return 2.0 * math.pi * error * math.sqrt(2.0 / 3.0 * cutoff**3 * period)


def _noise(seen: FloatArray) -> float:
    """Return the standard deviation of the noise of readings (T,), where they change at all.

    Beside impacts and turns of friction.
    """
    if seen.size <= _DIFFERENCES:
        return 0.0
    moves = np.lib.stride_tricks.sliding_window_view(np.diff(seen) != 0.0, _DIFFERENCES)
    fast = np.abs(np.diff(seen, _DIFFERENCES))[moves.any(axis=1)]
    fast = fast[fast <= _USUAL * np.median(fast)] if fast.size else np.zeros(1)
    return float(np.sqrt(np.mean(fast**2))) / _GAIN


def step_of(seen: FloatArray) -> float:
    """Return the least by which readings (T,) differ; 0 for fewer than two of them."""
    gaps = np.diff(np.unique(seen))
    gaps = gaps[gaps > 1e-9 * np.abs(seen).max()]
    return float(gaps.min()) if gaps.size else 0.0


def _inertia(position: FloatArray, effort: FloatArray, cycle: float) -> float:
    """Return how the slow effort of a joint grows with its own acceleration."""
    cutoff = min(_SLOW, _HIGHEST / cycle)
    with suppress(IdentError):
        place, speed, change = (x[0] for x in smooth_motion(position, cycle, cutoff))
        if np.abs(speed).max() > 0.0:
            columns = [change, direction(speed), speed, np.sin(place), np.cos(place)]
            system = np.stack([*columns, np.ones_like(place)], axis=1)
            slow = low_pass(effort, cycle, cutoff)
            return abs(float(np.linalg.lstsq(system, slow, rcond=1e-9)[0][0]))
    return 0.0
