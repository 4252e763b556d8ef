# SPDX-License-Identifier: Apache-2.0
"""The controller law as the log itself shows it: gains from logged effort, motion and command.

No dynamics are needed: what the controller saw and what it commanded are both in the log, so a
wrong gain shows here whatever the machine behind it does.
"""

from dataclasses import dataclass
import math

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from ros2_ident.models import Machine
from ros2_ident.recording import Dataset
from ros2_ident.recording.motion import fill_smoothly
from ros2_ident.search.noise import correlation_time

Array = NDArray[np.float64]

# Efforts later than this, and set-points later than that, are no matter of a log, s.
LATEST_EFFORT, LATEST_COMMAND = 0.12, 0.012
# A late set-point counts where without it the fit leaves so much more (mean square).
_COUNTS = 1.02
# Stamps of topics may lie so far apart, s; that is looked for where a law misses the effort by so
# many times its noise, and believed where it then leaves so much less of it (mean square).
APART, _MISSED, _TOGETHER = 0.5, 1.5, 0.6
# Valleys that are followed down.
_VALLEYS = 5
# Beyond this share of the limit the law does not hold.
_SATURATED = 0.98
# A feed-forward of this or more is a slip of the pen whose squares would overflow.
_ABSURD = 1e9
# An effort beyond the limit by this factor is none in its unit.
_BEYOND = 1.2
_GAINS = ('position_gain', 'velocity_gain', 'integral_gain')


@dataclass(frozen=True)
class Gain:
    """One gain as the log shows it, the others being what the machine file says.

    Attributes:
        name: Its key in the machine file; `scale` for a factor on the whole effort.
        value: Estimate, in the machine file's unit.
        error: Standard error.
        expected: The machine file's value.
        misfit: RMS that is left with it, in the effort's unit.
    """

    name: str
    value: float
    error: float
    expected: float
    misfit: float

    @property
    def ratio(self) -> float:
        """Estimate over expectation; NaN where nothing is expected."""
        return self.value / self.expected if self.expected else math.nan


@dataclass(frozen=True)
class Law:
    """A drive's controller law, compared with its log.

    The zeros of a PI law, k_p and k_I / k_v, can be exchanged without a trace in the log, and lie
    close together on well-tuned drives. So gains are not solved for all at once: each is fitted
    alone, and the fits are compared.

    Attributes:
        drive: Name.
        gains: Each gain fitted alone, the best explanation first.
        effort_delay: How late the logged effort is, s.
        command_delay: How late the controller took up the set-point, s; 0 where none shows.
        misfit: RMS that the law with all its coefficients free leaves, in the effort's unit.
        misfit_file: RMS that it leaves with the machine file's gains.
        explained: Share of the effort's variance that the free law explains.
        samples: Samples used.
        steps: RMS that the steps of the logged position alone may leave, in the effort's unit; 0
            where the law does not difference the position, or the position has no steps.
    """

    drive: str
    gains: tuple[Gain, ...]
    effort_delay: float
    command_delay: float
    misfit: float
    misfit_file: float
    explained: float
    samples: int
    steps: float = 0.0

    @property
    def excess(self) -> float:
        """RMS that the machine file's gains leave beyond the free law, in the effort's unit."""
        return math.sqrt(max(0.0, self.misfit_file**2 - self.misfit**2))


@dataclass(frozen=True)
class _Signals:
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


def fit_law(
    machine: Machine, data: Dataset, drive: str, tracked: float = 0.0
) -> Law | None:
    """Compare the law M = k_v e + k_I int e dt + c, e = k_p (z_cmd - z) + f v_cmd - v, with a log.

    It is linear in its coefficients: of position error, velocity error, their integrals, and a
    constant. Delays of effort and set-point are found by a search around it.

    Args:
        machine: The machine file, for the law's kind, the gains expected and the torque limit;
            gains that are to be identified are taken from the log.
        data: The recording on the grid of controller cycles.
        drive: The drive.
        tracked: How late the position follows its set-point [s]: stamps of the topics that lie far
            apart are looked for about it.

    Returns:
        The law; None where command, position or effort are missing or the drive stands still.
    """
    signals = _signals(machine, data, drive)
    if signals is None:
        return None
    delays = _delays(signals)
    apart = _delays_apart(signals, delays, machine, drive, tracked)
    system = _Fit(signals) if apart is None else _Fit(signals, where=_inside(signals))
    delays = delays if apart is None else apart
    columns, effort = system.system(delays)
    solution, _, free = _solve(columns, effort)
    sought = [name for name in _GAINS if name in machine.bounds]
    gains = {name: float(np.nan_to_num(machine.number(name, drive))) for name in _GAINS}
    gains |= {name: value for name, value in _gains_of(solution).items() if name in sought}
    known = _law_of(columns, gains)
    alone = []
    for name in (*gains, 'scale'):
        if name == 'scale' and not signals.integral and signals.forward == 0.0:
            continue  # the same as the velocity gain
        if name in sought or (name != 'scale' and not gains[name]):
            continue
        if name == 'scale' and 'velocity_gain' in sought:
            continue
        # The law is linear in each gain by itself.
        part = known if name == 'scale' else known - _law_of(columns, {**gains, name: 0.0})
        factor, error, misfit = _solve(
            np.stack([part, np.ones_like(part)], axis=1), effort - (known - part)
        )
        expected = gains.get(name, 1.0)
        alone.append(
            Gain(name, float(factor[0]) * expected, error * abs(expected), expected, misfit)
        )
    file = _solve(np.ones((effort.size, 1)), effort - known)[2]
    return Law(
        drive,
        tuple(sorted(alone, key=lambda g: g.misfit)),
        float(delays[0]) * signals.cycle,
        float(delays[1]) * signals.cycle,
        free,
        file,
        1.0 - free**2 / max(float(effort.var()), 1e-300),
        effort.size,
        _nearer(gains['velocity_gain'], abs(float(solution[1]))) * signals.speed_steps,
    )


def _nearer(stated: float, found: float) -> float:
    """Return the velocity gain that ran: the stated one unless the log shows quite another."""
    return stated if 0.5 * found < stated < 2.0 * found else found


def _gains_of(solution: Array) -> dict[str, float]:
    """Return the gains of a free law's coefficients, columns as of `_Fit.system`."""
    kv = float(solution[1])
    integral = float(solution[4]) if solution.size > 4 else 0.0
    position = float(solution[0]) / kv if kv else 0.0
    return dict(zip(_GAINS, (position, kv, integral), strict=True))


def _law_of(columns: Array, gains: dict[str, float]) -> Array:
    """Return the law's torque but for a constant; columns as of `_Fit.system`."""
    kp, kv, ki = gains['position_gain'], gains['velocity_gain'], gains['integral_gain']
    torque: Array = (kv * kp) * columns[:, 0] + kv * columns[:, 1]
    if ki:
        torque = torque + (ki * kp) * columns[:, 3] + ki * columns[:, 4]
    return torque


def _solve(columns: Array, effort: Array) -> tuple[Array, float, float]:
    """Return the coefficients, the first one's standard error and the RMS that is left."""
    scale = np.sqrt((columns**2).mean(axis=0)) + 1e-300
    solution = np.linalg.lstsq(columns / scale, effort, rcond=1e-10)[0]
    left = effort - (columns / scale) @ solution
    variance = float(left @ left) / max(1, left.size - len(scale)) * correlation_time(left)
    normal = (columns / scale).T @ (columns / scale)
    error = math.sqrt(max(0.0, variance * float(np.linalg.pinv(normal)[0, 0]))) / float(scale[0])
    return solution / scale, error, math.sqrt(float((left**2).mean()))


def _delays(signals: _Signals) -> Array:
    """Return the delays (effort, set-point) in cycles at which the free law leaves least."""
    high, late = LATEST_EFFORT / signals.cycle, LATEST_COMMAND / signals.cycle
    rough = _Fit(signals, every=max(1, signals.effort.size // 1500))
    # A set-point may be rough from cycle to cycle: every cycle of its delay is looked at.
    lates = np.arange(0.0, late + 1.0)
    wide, narrow = (max(1.0, round(t / signals.cycle)) for t in (0.008, 0.002))
    grid = _scan(rough, np.arange(0.0, high + 1.0, wide), lates)
    for _, lag, first in (min(grid), min(entry for entry in grid if entry[2] == 0.0)):
        near = np.arange(max(0.0, lag - wide), min(high, lag + wide) + 1.0, narrow)
        grid += _scan(rough, near, np.array([first]))
    fine = _Fit(signals, every=max(1, signals.effort.size // 4000))

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
    return in_time if plain < _COUNTS * best or delays[1] < 0.5 else delays


def _inside(signals: _Signals) -> NDArray[np.bool_]:
    """Return the samples whose motion is in the log however far the stamps lie apart."""
    edge = APART / signals.cycle
    out: NDArray[np.bool_] = (signals.index > edge) & (
        signals.index < signals.position.size - edge
    )
    return out


def _delays_apart(
    signals: _Signals, found: Array, machine: Machine, drive: str, tracked: float
) -> Array | None:
    """Return delays in cycles as of topics whose stamps lie apart; None where they do not."""
    edge = APART / signals.cycle
    rough = _Fit(signals, every=max(1, signals.effort.size // 800), where=_inside(signals))
    if rough.size < 200:
        return None
    gain = abs(float(_solve(*rough.system(found))[0][1]))
    noise = _MISSED * math.hypot(machine.effort_noise, gain * signals.speed_steps)
    plain = rough.left(found)
    if plain * rough.variance < noise**2:
        return None
    # A loop follows late by at most about the time of its gain.
    gain = machine.number('position_gain', drive)
    reach = min(1.5 / gain, 0.1) if gain > 0.0 else 0.1
    coarse = np.arange(tracked - reach - LATEST_COMMAND, tracked + 5e-3, 2e-3)
    # A loop with feed-forward follows at once, and its law is lost within a fraction of a ms.
    sharp = tracked + np.arange(-3e-3, 3e-3, 2.5e-4)
    lates = np.unique(np.concatenate([coarse, sharp])) / signals.cycle
    wide = max(1.0, round(0.006 / signals.cycle))
    grid = sorted(_scan(rough, np.arange(-edge, edge + 1.0, wide), lates))
    # Several valleys may look alike from afar.
    starts: list[Array] = []
    for _, lag, late in grid:
        if len(starts) < _VALLEYS and all(abs(lag - s[0]) > 2.0 * wide for s in starts):
            starts.append(np.array([lag, late]))
    step = np.array([[0.0, 0.0], [0.5 * wide, 0.0], [0.0, 5e-4 / signals.cycle]])
    polished = [
        minimize(
            rough.left,
            start,
            method='Nelder-Mead',
            options={
                'xatol': 1e-2, 'fatol': 1e-9, 'maxfev': 120, 'initial_simplex': start + step,
            },
        )
        for start in starts
    ]
    best = min(polished, key=lambda found: float(found.fun))
    return np.asarray(best.x) if float(best.fun) < _TOGETHER * plain else None


def _scan(fit: '_Fit', lags: Array, lates: Array) -> list[tuple[float, float, float]]:
    """Return (what is left, effort delay, set-point delay) for all pairs of delays in cycles."""
    return [
        (fit.left(np.array([lag, late])), float(lag), float(late))
        for late in lates
        for lag in lags
    ]


class _Fit:
    """The free law's equations at given delays in cycles, on every so many samples."""

    def __init__(
        self, signals: _Signals, every: int = 1, where: NDArray[np.bool_] | None = None
    ) -> None:
        chosen = slice(None) if where is None else where
        self._signals = signals
        self._index = signals.index[chosen][::every]
        self._effort = signals.effort[chosen][::every]
        self.size = self._effort.size
        self.variance = float(self._effort.var()) if self.size else 0.0
        self._late = -1.0
        self._columns = np.empty(0)

    def system(self, delays: Array) -> tuple[Array, Array]:
        """Return columns and effort at the samples, for delays (effort, set-point) in cycles.

        The columns are position error, velocity error and one; with an integral part its integrals
        too.
        """
        if delays[1] != self._late:
            self._late = float(delays[1])
            self._columns = self._law(self._late)
        at = np.clip(self._index - delays[0], 0.0, len(self._columns) - 1.000001)
        whole = at.astype(int)
        part = (at - whole)[:, None]
        below, above = self._columns[whole], self._columns[whole + 1]
        return below + part * (above - below), self._effort

    def left(self, delays: Array) -> float:
        """Return the mean square that is left, as a share of the effort's variance."""
        columns, effort = self.system(delays)
        normal, right = columns.T @ columns, columns.T @ effort
        size = np.sqrt(np.diag(normal)) + 1e-300
        solution = np.linalg.lstsq(normal / np.outer(size, size), right / size, rcond=1e-12)[0]
        rest = effort - columns @ (solution / size)
        return float(rest @ rest) / max(float(effort.var()) * effort.size, 1e-300)

    def _law(self, late: float) -> Array:
        x = self._signals
        cycles = np.arange(x.position.size)
        error = np.interp(cycles - late, cycles, x.command) - x.position
        slip = x.forward * np.interp(cycles - late, cycles, x.rate) - x.velocity
        columns = [error, slip, np.ones_like(error)]
        if x.integral:
            columns += [np.cumsum(error) * x.cycle, np.cumsum(slip) * x.cycle]
        return np.stack(columns, axis=1)


def _signals(machine: Machine, data: Dataset, drive: str) -> _Signals | None:
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
        speed_steps = 0.5 * _step(data.position[d]) * (0.5 / data.cycle)
    else:
        logged = None if data.velocity is None else _filled(data.velocity[d])
        velocity = np.gradient(position, data.cycle) if logged is None else logged
    limit = machine.number('torque_limit', drive)
    if float(np.nanmax(np.abs(effort))) > _BEYOND * limit:
        limit = math.inf  # that is no effort in the unit of the limit
    index = np.flatnonzero(np.isfinite(effort) & (np.abs(effort) < _SATURATED * limit))
    # The first samples of the log are taken up before the delayed effort begins.
    index = index[index > LATEST_EFFORT / data.cycle]
    forward = machine.number('velocity_feedforward', drive)
    if index.size < 200 or not abs(forward) < _ABSURD:
        return None
    return _Signals(
        data.cycle, data.command_position[d], data.command_velocity[d], position, velocity,
        index, effort[index], forward,
        machine.number('integral_gain', drive) != 0.0,
        speed_steps,
    )


def _step(row: Array) -> float:
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
    return fill_smoothly(row) if np.isfinite(row).sum() >= 100 else None
