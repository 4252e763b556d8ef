# SPDX-License-Identifier: Apache-2.0
"""What a controller saw and commanded, as a log has it, and how late: the columns of its law."""

from dataclasses import dataclass
import math

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize, minimize_scalar

from ros2_ident.arrays import Array
from ros2_ident.gates.scale import APART, FEWEST, LATEST_EFFORT, MORE
from ros2_ident.models import Machine
from ros2_ident.recording import Dataset
from ros2_ident.recording.motion import fill_smoothly

# Beyond this share of the limit the law does not hold.
_SATURATED = 0.98
# Constants beyond this are slips of the pen whose squares would overflow.
_ABSURD = 1e50
# Set-points later than this are no matter of a log, s.
LATEST_COMMAND = 0.012
# A late set-point counts where without it the fit leaves so much more (mean square).
COUNTS = 1.02
# Valleys that are followed down, and how far, in cycles.
_VALLEYS = 5
_POLISH = {'xatol': 1e-2, 'fatol': 1e-9, 'maxfev': 120}


@dataclass(frozen=True)
class Signals:
    """One drive on the grid of cycles: what the law is made of, and the effort where measured."""

    cycle: float
    command: Array
    rate: Array
    position: Array
    velocity: Array
    index: NDArray[np.int64]
    effort: Array
    forward: float
    integral: bool
    speed_steps: float

    @property
    def inside(self) -> NDArray[np.bool_]:
        """Samples whose motion is in the log however far the stamps lie apart."""
        edge = APART / self.cycle
        out: NDArray[np.bool_] = (self.index > edge) & (self.index < self.position.size - edge)
        return out


def signals_of(machine: Machine, data: Dataset, drive: str) -> Signals | None:
    """Return a drive's signals; None where one is missing, or the drive stands still."""
    d = data.names.index(drive)
    if data.command_position is None or data.command_velocity is None:
        return None
    if data.position is None or data.effort is None:
        return None
    position = _filled(data.position[d])
    effort = data.effort[d]
    if position is None or not np.ptp(data.command_position[d]):
        return None
    speed_steps = 0.0
    if machine.text('law', drive) == 'cascade_p':
        # Half the sum of two readings, differenced over a cycle.
        velocity = np.zeros_like(position)
        velocity[2:] = (position[2:] - position[:-2]) * (0.5 / data.cycle)
        # Rounded to steps, a difference is one of two neighbours: at most half a step off, RMS.
        speed_steps = 0.5 * step_of(data.position[d]) * (0.5 / data.cycle)
    else:
        logged = None if data.velocity is None else _filled(data.velocity[d])
        velocity = np.gradient(position, data.cycle) if logged is None else logged
    if not np.isfinite(effort).any():
        return None
    limit = machine.number('torque_limit', drive)
    if float(np.nanmax(np.abs(effort))) > MORE * limit:
        limit = math.inf  # that is no effort in the unit of the limit
    index = np.flatnonzero(np.isfinite(effort) & (np.abs(effort) < _SATURATED * limit))
    # The first samples of the log are taken up before the delayed effort begins.
    index = index[index > LATEST_EFFORT / data.cycle]
    forward = sane(machine.number('velocity_feedforward', drive))
    if index.size < FEWEST:
        return None
    return Signals(
        data.cycle, data.command_position[d], data.command_velocity[d], position, velocity,
        index, effort[index], forward,
        machine.number('integral_gain', drive) != 0.0,
        speed_steps,
    )


def sane(value: float) -> float:
    """Return a constant as a number that can be squared; 0 where it is not known."""
    return float(np.clip(np.nan_to_num(value), -_ABSURD, _ABSURD))


def step_of(row: Array) -> float:
    """Return the step of which all values are multiples, 0 where they have none."""
    values = np.unique(row[np.isfinite(row)])
    apart = np.diff(values)
    apart = apart[apart > 1e-9 * float(np.ptp(values))] if apart.size else apart
    if not apart.size:
        return 0.0
    step = float(np.median(apart[apart < 1.5 * apart.min()]))
    count = (values - values[0]) / step
    # The step is known to its rounding only, so that far off numbers drift.
    return step if float(np.abs(count - np.round(count)).mean()) < 0.05 else 0.0


def _filled(row: Array) -> Array | None:
    """Return a row with the cycles between samples filled, None where there are too few."""
    return fill_smoothly(row) if np.isfinite(row).sum() >= FEWEST else None


class Fit:
    """The free law's equations at given delays in cycles, on every so many samples."""

    def __init__(
        self, signals: Signals, every: int = 1, where: NDArray[np.bool_] | None = None
    ) -> None:
        chosen = slice(None) if where is None else where
        self._signals = signals
        self._index = signals.index[chosen][::every]
        self._effort = signals.effort[chosen][::every]
        self.size = self._effort.size
        self.variance = float(self._effort.var()) if self.size else 0.0
        self._late = math.nan
        self._columns = np.empty(0)

    def system(self, delays: Array) -> tuple[Array, Array]:
        """Return columns and effort at the samples, for delays (effort, set-point) in cycles.

        The columns are position error, velocity error and one; with an integral part its integrals
        too.
        """
        return self._columns_at(delays[:1], float(delays[1]))[0], self._effort

    def _columns_at(self, lags: Array, late: float) -> Array:
        """Return (L, R, C) the columns for L delays of the effort."""
        if late != self._late:
            self._late = late
            self._columns = self._law(late)
        at = np.clip(self._index - lags[:, None], 0.0, len(self._columns) - 1.000001)
        whole = at.astype(int)
        part = (at - whole)[..., None]
        below = self._columns.take(whole, axis=0)
        out: Array = below + part * (self._columns.take(whole + 1, axis=0) - below)
        return out

    def left(self, delays: Array) -> float:
        """Return the mean square that is left, as a share of the effort's variance."""
        return float(self.left_at(delays[:1], float(delays[1]))[0])

    def left_at(self, lags: Array, late: float) -> Array:
        """Return (L,) the same for L delays of the effort, in cycles, at one of the set-point."""
        columns = self._columns_at(lags, late)
        turned = columns.transpose(0, 2, 1)
        normal, right = turned @ columns, turned @ self._effort
        # a drive that stands still has a column of zeros; the square has to be a number, too
        size = np.maximum(np.sqrt(np.diagonal(normal, axis1=1, axis2=2)), 1e-150)
        scaled = normal / (size[:, :, None] * size[:, None, :])
        inverse = np.linalg.pinv(scaled, rcond=1e-12, hermitian=True)
        solution = (inverse @ (right / size)[:, :, None])[..., 0] / size
        rest = self._effort - (columns @ solution[:, :, None])[..., 0]
        whole = max(self.variance * self.size, 1e-300)
        return np.asarray(np.einsum('lr,lr->l', rest, rest) / whole)

    def _law(self, late: float) -> Array:
        x = self._signals
        cycles = np.arange(x.position.size)
        error = np.interp(cycles - late, cycles, x.command) - x.position
        slip = x.forward * np.interp(cycles - late, cycles, x.rate) - x.velocity
        columns = [error, slip, np.ones_like(error)]
        if x.integral:
            columns += [np.cumsum(error) * x.cycle, np.cumsum(slip) * x.cycle]
        return np.stack(columns, axis=1)


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
            options=_POLISH | {'initial_simplex': simplex if free else simplex[:2, :1]},
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
    polished = [
        minimize(
            fit.left, s, method='Nelder-Mead', options=_POLISH | {'initial_simplex': s + step}
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
