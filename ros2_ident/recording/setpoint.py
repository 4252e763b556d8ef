# SPDX-License-Identifier: Apache-2.0
"""The set-point at every controller cycle, from a log that holds it at a lower rate or with drops."""

import numpy as np
from scipy.interpolate import CubicHermiteSpline, make_interp_spline

from ros2_ident.recording.streams import FloatArray, IntArray

# A step of the set-point: so many times the larger of its neighbours' changes.
_STEP_RATIO = 8.0


def interpolate_setpoint(
    tick: IntArray, position: FloatArray, velocity: FloatArray | None, cycles: IntArray, cycle: float
) -> tuple[FloatArray, FloatArray]:
    """Evaluate one drive's set-point at every cycle.

    Smooth stretches are a quintic spline through the samples (cubic or linear where fewer than six), or a cubic
    Hermite spline where the log holds the set-point's velocity. A step is held until the sample that shows it:
    a spline would ring on both sides, and a controller sees the step whole.

    Args:
        tick: Cycle numbers of the samples (T,), increasing.
        position: Set-point (T,), rad or m.
        velocity: Its velocity (T,), rad/s or m/s, or None where the log holds none.
        cycles: Cycle numbers (K,) to evaluate at; beyond the samples the nearest one is held.
        cycle: Controller cycle, s.

    Returns:
        Set-point (K,) and its velocity (K,).
    """
    out = np.empty(cycles.size)
    rate = np.zeros(cycles.size)
    edges = [0, *(_steps(tick, position) + 1).tolist(), tick.size]
    for begin, end in zip(edges, edges[1:], strict=False):
        last = end == tick.size
        low = np.searchsorted(cycles, tick[begin]) if begin else 0
        high = cycles.size if last else np.searchsorted(cycles, tick[end])
        inside = cycles[low:high]
        if not inside.size:
            continue
        part = slice(begin, end)
        fit = _smooth(tick[part] * cycle, position[part], None if velocity is None else velocity[part])
        held = np.clip(inside, tick[begin], tick[end - 1])
        out[low:high] = fit(held * cycle)
        slope = np.asarray(fit(held * cycle, 1), dtype=np.float64)
        rate[low:high] = np.where(held == inside, slope, 0.0)
    return out, rate


def _smooth(
    time: FloatArray, position: FloatArray, velocity: FloatArray | None
) -> 'CubicHermiteSpline | np.typing.Any':
    if velocity is not None and time.size > 1:
        return CubicHermiteSpline(time, position, velocity)
    degree = 5 if time.size >= 6 else 3 if time.size >= 4 else min(1, time.size - 1)
    if degree < 1:
        level = float(position[0])
        return lambda x, order=0: np.full(np.shape(x), 0.0 if order else level)
    return make_interp_spline(time, position, k=degree)


def _steps(tick: IntArray, position: FloatArray) -> IntArray:
    """Return the samples after which the set-point jumps.

    A jump changes far more per cycle than the samples on both of its sides do.
    """
    if tick.size < 4:
        return np.empty(0, dtype=np.int64)
    change = np.abs(np.diff(position))
    speed = change / np.diff(tick)
    # two neighbours on each side: one alone may be a plateau's corner or an accelerating start
    padded = np.concatenate([speed[[0, 0]] * 0.0, speed, speed[[0, 0]] * 0.0])
    around = np.maximum.reduce([padded[:-4], padded[1:-3], padded[3:-1], padded[4:]])
    span = float(np.ptp(position))
    return np.flatnonzero((speed > _STEP_RATIO * around) & (change > 1e-3 * span))
