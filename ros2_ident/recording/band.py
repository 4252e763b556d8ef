# SPDX-License-Identifier: Apache-2.0
"""Part of a log for which a recorded motion determines efforts: below a frequency, in motion.

The acceleration of a position that is read with an error s, at a rate f and below a frequency B,
is wrong by s (2 pi)^2 sqrt(2 B^5 / (5 f)), and the effort that an inertia asks for by as much
times the inertia. The noise of a logged effort grows only with sqrt(B).
"""

import math

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d, minimum_filter1d

from ros2_ident.errors import IdentError
from ros2_ident.recording.dataset import Dataset
from ros2_ident.recording.motion import fill_gaps, low_pass, samples_of, smooth_motion
from ros2_ident.recording.streams import FloatArray

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
_ORDER, _GAIN, _USUAL = 4, math.sqrt(70.0), 6.0
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
    return min(_of_joint(data, d) for d in range(len(data.names)))


def standing(
    position: FloatArray,
    velocity: FloatArray,
    cycle: float,
    cutoff: float,
    least: FloatArray | None = None,
) -> NDArray[np.bool_]:
    """Return where joints stand still or turn, as far as their readings tell.

    Args:
        position: Measured (D, K), NaN at cycles without a sample.
        velocity: Of the smoothed motion (D, K).
        cycle: Time from cycle to cycle, s.
        cutoff: Frequency up to which their motion is kept, Hz.
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
        apart = maximum_filter1d(seen, window) - minimum_filter1d(seen, window)
        same = max(_step(seen), _SPREAD * _noise(seen), speed * (window - 1) * period)
        quiet = apart <= same * (1.0 + 1e-9)
        if not quiet.all():
            quiet = maximum_filter1d(quiet, window)
            nearest = np.searchsorted(there, np.arange(row.size))
            still[:] = quiet[np.minimum(nearest, there.size - 1)]
            # Smoothed, a motion rings where it comes to rest.
            turns = (np.diff(np.sign(rate), append=np.sign(rate[-1])) != 0.0) & ~still
            still |= maximum_filter1d(turns, 2 * round(_TURN * period / cycle) + 1)
    return out


def speed_error(position: FloatArray, cycle: float, cutoff: float) -> float:
    """Return by how much a joint's speed is off below a frequency, as far as readings tell, 1/s.

    A position that is read with an error s, at a rate f, has a speed that is wrong by
    2 pi s sqrt(2 B^3 / (3 f)) below a frequency B.

    Args:
        position: Measured (K,), NaN at cycles without a sample.
        cycle: Time from cycle to cycle, s.
        cutoff: The frequency, Hz.
    """
    there, period = samples_of(position, cycle)
    if not there.size:
        return 0.0
    error = max(_noise(position[there]), _step(position[there]) / math.sqrt(12.0))
    return 2.0 * math.pi * error * math.sqrt(2.0 / 3.0 * cutoff**3 * period)


def _of_joint(data: Dataset, d: int) -> float:
    """Return the band of one joint, the highest where nothing is known of it."""
    if data.position is None:
        return _HIGHEST / data.cycle
    there, period = samples_of(data.position[d], data.cycle)
    highest = _HIGHEST / period
    if data.effort is None or min(there.size, np.isfinite(data.effort[d]).sum()) < _FEWEST:
        return highest
    position, effort = data.position[d][there], fill_gaps(data.effort[d])[there]
    read = _inertia(position, effort, period) * (2.0 * math.pi) ** 2 * _noise(position)
    noise, least = _quietest(effort), _OF_EFFORT * float(np.std(effort))
    band = highest
    while band > LOWEST:
        asked = read * math.sqrt(0.4 * band**5 * period)
        if asked <= max(_OF_NOISE * noise * math.sqrt(2.0 * band * period), least):
            break
        band *= _STEP
    return band


def _noise(seen: FloatArray) -> float:
    """Return the standard deviation of the noise of readings (T,), where they change at all.

    Beside impacts and turns of friction.
    """
    if seen.size <= _ORDER:
        return 0.0
    moved = np.lib.stride_tricks.sliding_window_view(np.diff(seen) != 0.0, _ORDER).any(axis=1)
    fast = np.abs(np.diff(seen, _ORDER))[moved]
    fast = fast[fast <= _USUAL * np.median(fast)] if fast.size else np.zeros(1)
    return float(np.sqrt(np.mean(fast**2))) / _GAIN


def _quietest(effort: FloatArray) -> float:
    """Return the standard deviation of the noise of efforts (T,) where they turn over least."""
    return float(np.quantile(np.abs(np.diff(effort, _ORDER)), _LOW)) / (_GAIN * _OF_LOW)


def _step(seen: FloatArray) -> float:
    """Return the least by which readings (T,) differ."""
    gaps = np.diff(np.unique(seen))
    gaps = gaps[gaps > 1e-9 * np.abs(seen).max()]
    return float(gaps.min()) if gaps.size else 0.0


def _inertia(position: FloatArray, effort: FloatArray, cycle: float) -> float:
    """Return how the slow effort of a joint grows with its own acceleration."""
    cutoff = min(_SLOW, _HIGHEST / cycle)
    try:
        place, speed, change = (x[0] for x in smooth_motion(position[None], cycle, cutoff))
    except IdentError:
        return 0.0
    still = 0.02 * float(np.abs(speed).max())
    if still <= 0.0:
        return 0.0
    columns = [change, np.tanh(speed / still), speed, np.sin(place), np.cos(place)]
    system = np.stack([*columns, np.ones_like(place)], axis=1)
    slow = low_pass(effort[None], cycle, cutoff)[0]
    return abs(float(np.linalg.lstsq(system, slow, rcond=1e-9)[0][0]))
