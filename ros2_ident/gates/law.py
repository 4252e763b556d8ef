# SPDX-License-Identifier: Apache-2.0
"""The controller law as the log itself shows it: gains from logged effort, motion and command.

No dynamics are needed: what the controller saw and what it commanded are both in the log, so a
wrong gain shows here whatever the machine behind it does.
"""

from dataclasses import dataclass
import math

import numpy as np
from numpy.typing import NDArray
import scipy

from ros2_ident.arrays import Array
from ros2_ident.gates import scale
from ros2_ident.gates.instants import robust_size
from ros2_ident.gates.scale import near
from ros2_ident.gates.signals import best_delays, Fit, LATEST_COMMAND, sane, Signals, signals_of
from ros2_ident.models import Machine
from ros2_ident.recording import Dataset

# A delay counts where without it a law leaves so much more (mean square), and stamps that lie far
# apart where the law then leaves so much less. By hand: of coloured residuals no F test tells it.
_COUNTS, _TOGETHER = 1.02, 0.6
# An effort is limited where the law asks for more than what is logged, on so many samples, and on
# this share of all; where most of what the law misses lies there; and where it hardly follows what
# is asked, over demands that spread so far (logarithm). By hand.
_FEW, _RARE, _SPREAD = 20, 0.005, 0.2
# Gains are spoken of where the stated ones leave this share more than free ones do. By hand.
_EXCESS = 0.3
GAINS = ('position_gain', 'velocity_gain', 'integral_gain')


@dataclass(frozen=True)
class Gain:
    """One gain as the log shows it, the others as stated in the machine file.

    Attributes:
        name: Its key in the machine file; `scale` for a factor on the whole effort.
        value: Estimate, in the machine file's unit.
        misfit: RMS that is left with it, in the effort's unit.
        makes: RMS of the effort that one unit of it makes, but for a constant.
    """

    name: str
    value: float
    expected: float
    misfit: float
    makes: float = 0.0

    @property
    def ratio(self) -> float:
        """Estimate over expectation; NaN where nothing is expected."""
        return self.value / self.expected if self.expected else math.nan

    def left(self, value: float) -> float:
        """Return the RMS that is left with another value: the estimate is of least squares."""
        return math.hypot(self.misfit, (value - self.value) * self.makes)


@dataclass(frozen=True)
class Law:
    """A drive's controller law, compared with its log.

    The zeros of a PI law, k_p and k_I / k_v, can be exchanged without a trace in the log, and lie
    close together on well-tuned drives. So gains are not solved for all at once: each is fitted
    alone, and the fits are compared.

    Attributes:
        gains: Each gain fitted alone, the best explanation first.
        effort_delay: How late the logged effort is, s.
        command_delay: How late the controller took up the set-point, s; 0 where none shows.
        misfit: RMS that the law with all its coefficients free leaves, in the effort's unit.
        misfit_file: RMS that it leaves with the machine file's gains.
        explained: Share of the effort's variance that the free law explains.
        steps: RMS that the steps of the logged position alone may leave, in the effort's unit; 0
            where the law does not difference the position, or the position has no steps.
        limit: Size beyond which the logged effort does not go though the law asks for more;
            infinite where none shows.
    """

    drive: str
    gains: tuple[Gain, ...]
    effort_delay: float
    command_delay: float
    misfit: float
    misfit_file: float
    explained: float
    steps: float
    limit: float = math.inf

    @property
    def followed(self) -> float:
        """Share of the effort's variance that the machine file's gains explain, at most 1."""
        return 1.0 - (1.0 - self.explained) * (self.misfit_file / max(self.misfit, 1e-300)) ** 2

    def fits(self, misfit: float) -> bool:
        """Whether gains that leave so much, RMS, explain the log as well as free ones do."""
        return misfit**2 - self.misfit**2 <= (_EXCESS * self.misfit) ** 2

    def refutes(self, name: str, share: float) -> bool:
        """Whether a gain of so many times the stated one explains the log worse than the stated.

        And worse than free ones do, where the gain that explains most explains it as well.
        """
        left = max((g.left(share * g.expected) for g in self.gains if g.name == name), default=0.0)
        return self.fits(self.left) and left > self.misfit_file and not self.fits(left)

    @property
    def stray(self) -> bool:
        """Whether the log asks for other gains than the stated ones."""
        return not self.fits(self.misfit_file)

    @property
    def left(self) -> float:
        """RMS that is left with the stated gains, but for one of them at most."""
        if not self.gains:
            return self.misfit
        return min(self.misfit_file, self.gains[0].misfit)


def fit_law(
    machine: Machine, data: Dataset, drive: str, tracked: float = 0.0, agree: bool = False
) -> Law | None:
    """Compare the law M = k_v e + k_I int e dt + c, e = k_p (z_cmd - z) + f v_cmd - v, with a log.

    It is linear in its coefficients: of position error, velocity error, their integrals, and a
    constant. Delays of effort and set-point are found by a search around it: with all coefficients
    free, and, where the stated gains seem wrong then, with these alone. A slow motion hardly tells
    a late effort from a smaller gain, and what is stated is wrong only if it is at every delay.

    Args:
        machine: The machine file, for the law's kind, the gains expected and the torque limit;
            gains that are to be identified are taken from the log.
        tracked: How late the position follows its set-point [s]: stamps of the topics that lie far
            apart are looked for about it.
        agree: Whether stamps of position and effort are known to be those of one clock.

    Returns:
        The law; None where command, position or effort are missing or the drive stands still.
    """
    signals = signals_of(machine, data, drive)
    if signals is None:
        return None
    cycle = signals.cycle
    usual, last = (0.0, scale.LATEST_EFFORT / cycle), LATEST_COMMAND / cycle
    law = _law_at(machine, drive, signals, np.zeros(2))
    # Between samples a noisy speed is smoother, so that any delay leaves less of it.
    if law.misfit_file <= scale.OTHER_NOISE * law.steps:
        return law
    # A set-point may be rough from cycle to cycle: every cycle of its delay is looked at.
    late = [best_delays(signals, usual, lates) for lates in (np.zeros(1), np.arange(last + 1.0))]
    # The free law leaves least there. But where positions are coarse it leaves less with smaller
    # gains, at any delay that makes up for them: the stated ones choose, the plainest first.
    for delays in late:
        other = _law_at(machine, drive, signals, delays)
        law = other if _COUNTS * other.left**2 < law.left**2 else law
    if law.stray and not any(name in machine.bounds for name in GAINS):
        weights = _weights({name: sane(machine.number(name, drive)) for name in GAINS})
        held = np.array([law.command_delay / cycle])
        stated = _law_at(
            machine, drive, signals, best_delays(signals, usual, held, weights=weights)
        )
        law = stated if stated.misfit_file**2 <= _COUNTS * law.left**2 else law
    inside = signals.inside
    noise = math.hypot(machine.effort_noise, law.steps)
    if law.left <= scale.OTHER_NOISE * noise or inside.sum() < scale.FEWEST:
        return law
    # A loop follows late by at most about the time of its gain, 0.1 s where that is not known. The
    # grids are by hand.
    gain = sane(machine.number('position_gain', drive))
    reach = min(1.5 / gain, 0.1) if gain > 0.0 else 0.1
    coarse = np.arange(tracked - reach - LATEST_COMMAND, tracked + 7e-3, 2e-3)
    # A loop with feed-forward follows at once, and its law is lost within a fraction of a ms.
    sharp = tracked + np.arange(-3e-3, 3e-3, 2.5e-4)
    lates = np.unique(np.concatenate([coarse, sharp])) / cycle
    lags = usual if agree else (-scale.APART / cycle, scale.APART / cycle)
    found = best_delays(signals, lags, lates, inside)
    apart = _law_at(machine, drive, signals, found, inside)
    return apart if apart.left**2 < _TOGETHER * law.left**2 else law


def _law_at(
    machine: Machine,
    drive: str,
    signals: Signals,
    delays: Array,
    where: NDArray[np.bool_] | slice = slice(None),
) -> Law:
    """Compare the law with a log at given delays (effort, set-point) in cycles."""
    columns, effort = Fit(signals, where=where).system(delays)
    solution, free = _solve(columns, effort)
    sought = [name for name in GAINS if name in machine.bounds]
    gains = {name: sane(machine.number(name, drive)) for name in GAINS}
    gains |= _fitted(columns, effort, gains, sought, solution)
    known = _law_of(columns, gains)
    alone = []
    tried = [name for name in GAINS if gains[name] and name not in sought]
    # Without an integral part and a feed-forward it is the same as the velocity gain.
    if (signals.integral or signals.forward) and 'velocity_gain' not in sought:
        tried.append('scale')
    for name in tried:
        # The law is linear in each gain by itself.
        part = known if name == 'scale' else known - _law_of(columns, {**gains, name: 0.0})
        factor, misfit = _solve(
            np.stack([part, np.ones_like(part)], axis=1), effort - (known - part)
        )
        expected = gains.get(name, 1.0)
        value = float(factor[0]) * expected
        alone.append(Gain(name, value, expected, misfit, float(part.std()) / expected))
    alone.sort(key=lambda g: g.misfit)
    # Steps are multiplied by the gain that ran; quite another one shows.
    slope = next((abs(g.value) for g in alone[:1] if g.name == 'velocity_gain'), 0.0)
    stated = gains['velocity_gain']
    gain = stated if not slope or near(stated / slope, scale.ANOTHER) else slope
    file = _solve(np.ones((effort.size, 1)), effort - known)[1]
    lag, late = (float(x) * signals.cycle for x in delays)
    explained = 1.0 - free**2 / max(float(effort.var()), 1e-300)
    steps, limit = gain * signals.speed_steps, _limit(known, effort)
    return Law(drive, tuple(alone), lag, late, free, file, explained, steps, limit)


def _limit(asked: Array, effort: Array) -> float:
    """Return the size beyond which an effort does not go, infinite where none shows.

    There the effort hardly depends on what the law asks for; with a wrong gain it would. A limit
    lies in the upper part of what is logged: 0.4 of the highest is by hand.

    Args:
        asked: (R,) what the stated law asks for, but for a constant.
        effort: (R,) what was logged.
    """
    size = np.abs(effort)
    calm = size <= 0.5 * size.max()
    if calm.sum() < _FEW:
        calm = size <= np.median(size)
    asked = asked + float(np.median((effort - asked)[calm]))
    least = np.maximum(scale.MORE * size, 0.4 * size.max())
    beyond = (np.abs(asked) > least) & (size > 0.4 * size.max())
    if beyond.sum() < max(_FEW, _RARE * effort.size):
        return math.inf
    missed = (effort - asked) ** 2
    much, had = np.log(np.abs(asked[beyond])), np.log(size[beyond])
    if missed[beyond].sum() < scale.MOSTLY * missed.sum() or much.std() < _SPREAD:
        return math.inf
    # Short of its limit a drive follows its law, but for samples at which it leaves the limit.
    if robust_size((effort - asked)[~beyond]) ** 2 > (1.0 - scale.STRAYS) * effort.var():
        return math.inf
    slope = float(np.cov(much, had)[0, 1] / much.var())
    return float(np.median(size[beyond])) if abs(slope) < scale.STRAYS else math.inf


def _law_of(columns: Array, gains: dict[str, float]) -> Array:
    """Return the law's torque but for a constant; columns as of `Fit.system`."""
    torque: Array = columns @ _weights(gains)[: columns.shape[1]]
    return torque


def _fitted(
    columns: Array, effort: Array, gains: dict[str, float], sought: list[str], free: Array
) -> dict[str, float]:
    """Return the gains sought of a law by an effort, the others as known.

    By the free law's coefficients alone, where the search starts, they are uncertain: an integral
    of the velocity is a position.
    """
    if not sought:
        return {}
    kv = float(free[1])
    every = float(free[0]) / kv if kv else 0.0, kv, float(free[4]) if free.size > 4 else 0.0
    start = {name: x for name, x in zip(GAINS, every, strict=True) if name in sought}

    def left(x: Array) -> Array:
        rest = effort - _law_of(columns, gains | dict(zip(start, x, strict=True)))
        out: Array = rest - rest.mean()
        return out

    found = scipy.optimize.least_squares(left, list(start.values()), method='lm', x_scale='jac')
    return dict(zip(start, map(float, found.x), strict=True))


def _weights(gains: dict[str, float]) -> Array:
    """Return the weights of the columns of `Fit.system` in a law with these gains."""
    kp, kv, ki = gains['position_gain'], gains['velocity_gain'], gains['integral_gain']
    return np.array([kv * kp, kv, 0.0, ki * kp, ki])


def _solve(columns: Array, effort: Array) -> tuple[Array, float]:
    """Return the coefficients, and the RMS of the residual."""
    size = np.sqrt((columns**2).mean(axis=0)) + 1e-300
    solution = np.linalg.lstsq(columns / size, effort, rcond=1e-10)[0]
    left = effort - (columns / size) @ solution
    return solution / size, math.sqrt(float((left**2).mean()))
