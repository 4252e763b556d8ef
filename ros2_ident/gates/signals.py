# SPDX-License-Identifier: Apache-2.0
"""Inputs and output of a controller as logged, and their delays: the columns of its law."""

from dataclasses import dataclass
import math

import numpy as np
from numpy.typing import NDArray
import scipy

from ros2_ident.arrays import Array, fast_noise
from ros2_ident.gates import scale
from ros2_ident.models import Machine
from ros2_ident.recording import Dataset
from ros2_ident.recording.motion import fill_smoothly

# Constants beyond this are slips of the pen: squares of the products of two would overflow.
_ABSURD = float(np.finfo(float).max ** 0.25)
# Set-points later than this are no matter of a log, s. By hand.
LATEST_COMMAND = 0.012
# Effort delays between which no valley is missed, s, and valleys that are followed down. By hand.
_WIDE, _VALLEYS = 6e-3, 3


@dataclass(frozen=True)
class Signals:
    """One drive on the grid of cycles: inputs of its law, and the effort where measured."""

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
        edge = scale.APART / self.cycle
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
        rates = None if data.velocity is None else data.velocity[d]
        logged = None if rates is None else _filled(rates)
        # The controller's own reading of it has other noise.
        if rates is None or logged is None:
            velocity = np.gradient(position, data.cycle)
            speed_steps = _noise(data.position[d]) / (math.sqrt(2.0) * data.cycle)
        else:
            velocity, speed_steps = logged, _noise(rates)
    if not np.isfinite(effort).any():
        return None
    limit = machine.number('torque_limit', drive)
    if float(np.nanmax(np.abs(effort))) > scale.MORE * limit:
        limit = math.inf  # that is no effort in the unit of the limit
    # As near to its limit as that the law does not hold.
    index = np.flatnonzero(np.isfinite(effort) & (np.abs(effort) < scale.OWN * limit))
    # The first samples of the log are taken up before the delayed effort begins.
    index = index[index > scale.LATEST_EFFORT / data.cycle]
    if index.size < scale.FEWEST:
        return None
    forward = sane(machine.number('velocity_feedforward', drive))
    if 'velocity_feedforward' in machine.bounds:
        parts = data.command_position[d] - position, -velocity, data.command_velocity[d]
        columns = np.stack([*parts, np.ones_like(position)], axis=1)[index]
        _, slope, ahead, _ = np.linalg.lstsq(columns, effort[index], rcond=None)[0]
        low, high, _ = machine.box('velocity_feedforward', drive)
        forward = float(np.clip(ahead / slope, low, high)) if slope else low
    command, rate = data.command_position[d], data.command_velocity[d]
    integral, kept = machine.number('integral_gain', drive) != 0.0, effort[index]
    return Signals(
        data.cycle, command, rate, position, velocity, index, kept, forward, integral, speed_steps
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


def _noise(row: Array) -> float:
    """Return the standard deviation of what is fast in a row, NaN where there is no sample."""
    return fast_noise(row[np.isfinite(row)])


def _filled(row: Array) -> Array | None:
    """Return a row with the cycles between samples filled, None where there are too few."""
    return fill_smoothly(row) if np.isfinite(row).sum() >= scale.FEWEST else None


class Fit:
    """A law's equations at given delays in cycles, on at most about so many samples.

    Args:
        most: How many samples; all where None.
        weights: What a law of known gains multiplies the columns by; further ones of a law with an
            integral part are left out where this one has none. The constant is free all the same.
    """

    def __init__(
        self,
        signals: Signals,
        most: int | None = None,
        where: NDArray[np.bool_] | slice = slice(None),
        weights: Array | None = None,
    ) -> None:
        every = max(1, signals.effort[where].size // most) if most else 1
        self._signals = signals
        self._index = signals.index[where][::every]
        self._effort = signals.effort[where][::every]
        self._weights = weights
        self._late = math.nan
        self._columns = np.empty(0)

    def system(self, delays: Array) -> tuple[Array, Array]:
        """Return columns and effort at the samples, for delays (effort, set-point) in cycles.

        The columns: position error, velocity error, one, and integrals of an integral part.
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

    def left(self, lags: Array, late: float) -> Array:
        """Return (L,) the mean square that is left, as a share of the effort's variance.

        Args:
            lags: (L,) delays of the effort, cycles.
            late: Delay of the set-point, cycles.
        """
        columns = self._columns_at(lags, late)
        whole = max(float(self._effort.var()), 1e-300)
        if self._weights is not None:
            rest = self._effort - columns @ self._weights[: columns.shape[-1]]
            return np.asarray(rest.var(axis=1) / whole)
        turned = columns.transpose(0, 2, 1)
        normal, right = turned @ columns, turned @ self._effort
        # a drive that stands still has a column of zeros; the square has to be a number, too
        size = np.maximum(np.sqrt(np.diagonal(normal, axis1=1, axis2=2)), 1e-150)
        scaled = normal / (size[:, :, None] * size[:, None, :])
        inverse = np.linalg.pinv(scaled, rcond=1e-12, hermitian=True)
        solution = (inverse @ (right / size)[:, :, None])[..., 0] / size
        rest = self._effort - (columns @ solution[:, :, None])[..., 0]
        return np.asarray((rest**2).mean(axis=1) / whole)

    def _law(self, late: float) -> Array:
        x = self._signals
        cycles = np.arange(x.position.size)
        error = np.interp(cycles - late, cycles, x.command) - x.position
        slip = x.forward * np.interp(cycles - late, cycles, x.rate) - x.velocity
        columns = [error, slip, np.ones_like(error)]
        if x.integral:
            columns += [np.cumsum(error) * x.cycle, np.cumsum(slip) * x.cycle]
        return np.stack(columns, axis=1)


def best_delays(
    signals: Signals,
    lags: tuple[float, float],
    lates: Array,
    where: NDArray[np.bool_] | slice = slice(None),
    weights: Array | None = None,
) -> Array:
    """Return the delays (effort, set-point) in cycles at which a law leaves least.

    Several valleys of a grid are followed down: from afar they may look alike.

    Args:
        lags: Least and largest delay of the effort, cycles.
        lates: Delays of the set-point that are looked at, cycles; none between where there is one.
        weights: Those of known gains, as of `Fit`; free gains where None.
    """
    rough, fine = (Fit(signals, most, where, weights) for most in (800, 4000))
    wide = max(1.0, round(_WIDE / signals.cycle))
    grid = np.minimum(np.arange(lags[0], lags[1] + 1.0, wide), lags[1])
    found = sorted(
        (float(left), float(lag), float(late))
        for late in lates
        for lag, left in zip(grid, rough.left(grid, float(late)), strict=True)
    )
    starts: list[Array] = []
    for _, lag, late in found:
        if len(starts) < _VALLEYS and all(abs(lag - s[0]) > 2.0 * wide for s in starts):
            starts.append(np.array([lag, late]))

    def left(free: Array, start: Array) -> float:
        lag, late = np.append(free, start[free.size :])
        return float(fine.left(np.array([lag]), float(late))[0])

    count = 2 if len(lates) > 1 else 1
    step = np.array([[0.0, 0.0], [0.5 * wide, 0.0], [0.0, 5e-4 / signals.cycle]])
    polished = [
        scipy.optimize.minimize(
            left,
            start[:count],
            (start,),
            'Nelder-Mead',
            bounds=(lags, (float(min(lates)), float(max(lates))))[:count],
            options={'xatol': 1e-2, 'initial_simplex': (start + step)[: count + 1, :count]},
        )
        for start in starts
    ]
    best = min(range(len(starts)), key=lambda k: float(polished[k].fun))
    return np.append(polished[best].x, starts[best][count:])
