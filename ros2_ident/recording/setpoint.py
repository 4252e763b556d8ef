# SPDX-License-Identifier: Apache-2.0
"""The set-point at every controller cycle, from a log with fewer or dropped samples."""

from collections.abc import Callable

import numpy as np
from scipy.interpolate import CubicHermiteSpline, make_interp_spline

from ros2_ident.recording.streams import FloatArray, IntArray

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
    out = np.empty(wanted.size)
    rate = np.zeros(wanted.size)
    edges = [0, *(find_steps(time, position) + 1).tolist(), time.size]
    # cycles and samples fall together to within rounding: the sample that shows a step is not held
    # over
    slack = 1e-6 * (wanted[1] - wanted[0]) if wanted.size > 1 else 0.0
    for begin, end in zip(edges, edges[1:], strict=False):
        low = int(np.searchsorted(wanted, time[begin] - slack)) if begin else 0
        high = int(np.searchsorted(wanted, time[end] - slack)) if end < time.size else wanted.size
        inside = wanted[low:high]
        if not inside.size:
            continue
        part = slice(begin, end)
        fit, slope = _smooth(
            time[part], position[part], None if velocity is None else velocity[part]
        )
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
    if not steps.size:
        return time, position, velocity
    typical = float(np.median(steps))
    holds = np.flatnonzero((steps > 2.5 * typical) & (np.diff(position) == 0.0))
    if not holds.size:
        return time, position, velocity
    counts = np.round(steps[holds] / typical).astype(np.int64)
    added = np.concatenate(
        [time[k] + steps[k] * np.arange(1, n) / n for k, n in zip(holds, counts, strict=True)]
    )
    place = np.searchsorted(time, added)
    time = np.insert(time, place, added)
    if velocity is not None:
        velocity = np.insert(velocity, place, 0.0)
    return time, np.insert(position, place, position[place - 1]), velocity


def _smooth(
    time: FloatArray, position: FloatArray, velocity: FloatArray | None
) -> tuple[Spline, Spline]:
    """Return a spline through the samples and its derivative."""
    if time.size == 1:
        level, speed = float(position[0]), 0.0 if velocity is None else float(velocity[0])
        return (lambda x: np.full(x.shape, level)), (lambda x: np.full(x.shape, speed))
    if velocity is not None:
        hermite = CubicHermiteSpline(time, position, velocity)
        return hermite, hermite.derivative()
    steps = np.diff(time)
    even = np.mean(np.abs(steps - np.median(steps)) < 1e-3 * np.median(steps)) > 0.9
    degree = 5 if even and time.size >= 6 else 3 if time.size >= 4 else 1
    spline = make_interp_spline(time, position, k=degree)
    return spline, spline.derivative()


def find_steps(time: FloatArray, position: FloatArray) -> IntArray:
    """Return the samples after which a set-point jumps.

    A jump changes far more per time than the samples on both of its sides do.

    Args:
        time: Times of the samples (T,), s, increasing.
        position: Set-point (T,), rad or m.
    """
    if time.size < 4:
        return np.empty(0, dtype=np.int64)
    change = np.abs(np.diff(position))
    speed = change / np.diff(time)
    # two neighbours on each side: one alone may be a plateau's corner or an accelerating start
    padded = np.concatenate([speed[[0, 0]] * 0.0, speed, speed[[0, 0]] * 0.0])
    around = np.maximum.reduce([padded[:-4], padded[1:-3], padded[3:-1], padded[4:]])
    span = float(np.ptp(position))
    return np.flatnonzero((speed > _STEP_RATIO * around) & (change > 1e-3 * span))
