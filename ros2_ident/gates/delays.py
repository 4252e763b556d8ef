# SPDX-License-Identifier: Apache-2.0
"""How late effort and set-point are in a log: the delays at which the free law leaves least."""

import numpy as np
from scipy.optimize import minimize, minimize_scalar

from ros2_ident.arrays import Array
from ros2_ident.gates.scale import APART, LATEST_EFFORT
from ros2_ident.gates.signals import Fit, Signals

# Set-points later than this are no matter of a log, s.
LATEST_COMMAND = 0.012
# A late set-point counts where without it the fit leaves so much more (mean square).
COUNTS = 1.02
# Valleys that are followed down.
_VALLEYS = 5


def usual_delays(signals: Signals) -> list[Array]:
    """Return the delays (effort, set-point) in cycles that a log may have, the plainest first.

    The free law leaves least there. But where positions are coarse it leaves less with smaller
    gains, at any delay that makes up for them: whoever knows the gains has to choose.
    """
    high, late = LATEST_EFFORT / signals.cycle, LATEST_COMMAND / signals.cycle
    rough = Fit(signals, every=max(1, signals.effort.size // 1500))
    # A set-point may be rough from cycle to cycle: every cycle of its delay is looked at.
    lates = np.arange(0.0, late + 1.0)
    wide, narrow = (max(1.0, round(t / signals.cycle)) for t in (0.008, 0.002))
    grid = _scan(rough, np.arange(0.0, high + 1.0, wide), lates)
    for _, lag, first in (min(grid), min(entry for entry in grid if entry[2] == 0.0)):
        near = np.arange(max(0.0, lag - wide), min(high, lag + wide) + 1.0, narrow)
        grid += _scan(rough, near, np.array([first]))
    fine = Fit(signals, every=max(1, signals.effort.size // 4000))

    def polish(start: tuple[float, float], free: bool) -> tuple[float, Array]:
        corner = np.array(start)
        simplex = corner + np.array([[0.0, 0.0], [narrow, 0.0], [0.0, 0.5 if free else 0.0]])
        found = minimize(
            (lambda x: fine.left(x)) if free else (lambda x: fine.left(np.array([x[0], 0.0]))),
            corner if free else corner[:1],
            method='Nelder-Mead',
            bounds=((0.0, high), (0.0, late))[: 2 if free else 1],
            options={
                'xatol': 1e-2, 'fatol': 1e-9, 'maxfev': 120,
                'initial_simplex': simplex if free else simplex[:2, :1],
            },
        )
        return float(found.fun), np.array([found.x[0], found.x[1] if free else 0.0])

    _, lag, first = min(grid)
    best, delays = polish((lag, first), True)
    _, lag, _ = min(entry for entry in grid if entry[2] == 0.0)
    plain, in_time = polish((lag, 0.0), False)
    none = np.zeros(2)
    return [none, in_time] if plain < COUNTS * best or delays[1] < 0.5 else [none, in_time, delays]


def delay_as_stated(signals: Signals, weights: Array, late: float) -> Array:
    """Return the delays (effort, set-point) in cycles at which known gains leave least.

    Args:
        signals: The drive.
        weights: (C,) what the law multiplies the columns of `Fit.system` by; further ones of a
            law with an integral part are left out where this one has none.
        late: Delay of the set-point in cycles, held.
    """
    rough, fine = (
        Fit(signals, every=max(1, signals.effort.size // some)) for some in (1500, 4000)
    )

    def left(fit: Fit, lag: float) -> float:
        columns, effort = fit.system(np.array([lag, late]))
        return float((effort - columns @ weights[: columns.shape[1]]).var())

    high, wide = LATEST_EFFORT / signals.cycle, max(1.0, round(0.002 / signals.cycle))
    lag = min(np.arange(0.0, high + 1.0, wide), key=lambda lag: left(rough, lag))
    found = minimize_scalar(
        lambda lag: left(fine, lag),
        bounds=(max(0.0, lag - wide), min(high, lag + wide)),
        method='bounded',
        options={'xatol': 1e-2},
    )
    return np.array([float(found.x), late])


def delays_apart(signals: Signals, fit: Fit, tracked: float, gain: float) -> Array:
    """Return the delays (effort, set-point) in cycles, of either sign, that leave least.

    Args:
        signals: The drive.
        fit: Its equations at samples that are `inside`.
        tracked: How late the position follows its set-point, s.
        gain: Position gain [1/s]; 0 where it is not known.
    """
    # A loop follows late by at most about the time of its gain.
    reach = min(1.5 / gain, 0.1) if gain > 0.0 else 0.1
    coarse = np.arange(tracked - reach - LATEST_COMMAND, tracked + 5e-3, 2e-3)
    # A loop with feed-forward follows at once, and its law is lost within a fraction of a ms.
    sharp = tracked + np.arange(-3e-3, 3e-3, 2.5e-4)
    lates = np.unique(np.concatenate([coarse, sharp])) / signals.cycle
    edge, wide = APART / signals.cycle, max(1.0, round(0.006 / signals.cycle))
    grid = sorted(_scan(fit, np.arange(-edge, edge + 1.0, wide), lates))
    # Several valleys may look alike from afar.
    starts: list[Array] = []
    for _, lag, late in grid:
        if len(starts) < _VALLEYS and all(abs(lag - s[0]) > 2.0 * wide for s in starts):
            starts.append(np.array([lag, late]))
    step = np.array([[0.0, 0.0], [0.5 * wide, 0.0], [0.0, 5e-4 / signals.cycle]])
    options = {'xatol': 1e-2, 'fatol': 1e-9, 'maxfev': 120}
    polished = [
        minimize(
            fit.left, s, method='Nelder-Mead', options={**options, 'initial_simplex': s + step}
        )
        for s in starts
    ]
    return np.asarray(min(polished, key=lambda found: float(found.fun)).x)


def _scan(fit: 'Fit', lags: Array, lates: Array) -> list[tuple[float, float, float]]:
    """Return (what is left, effort delay, set-point delay) for all pairs of delays in cycles."""
    return [
        (float(left), float(lag), float(late))
        for late in lates
        for lag, left in zip(lags, fit.left_at(lags, float(late)), strict=True)
    ]
