# SPDX-License-Identifier: Apache-2.0
"""What a controller saw and commanded, as a log has it: the columns of its law."""

from dataclasses import dataclass
import math

import numpy as np
from numpy.typing import NDArray

from ros2_ident.arrays import Array
from ros2_ident.gates.scale import APART, FEWEST, LATEST_EFFORT, MORE
from ros2_ident.models import Machine
from ros2_ident.recording import Dataset
from ros2_ident.recording.motion import fill_smoothly

# Beyond this share of the limit the law does not hold.
_SATURATED = 0.98
# Constants beyond this are slips of the pen whose squares would overflow.
_ABSURD = 1e50


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
