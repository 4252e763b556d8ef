# SPDX-License-Identifier: Apache-2.0
"""The sign of an effort: whether it is a torque that moves the drive as it was logged.

By mean power where a drive passes the same positions both ways. There what lifts a weight, strains
a spring or accelerates a mass is given back: the power left is friction's, and positive. Of a
joint that others load these are passes in one posture, the others at rest. The standard error is
that of sums over blocks of the log, so that noise and ripple of any colour are allowed for (Liang
and Zeger 1986, Biometrika 73(1)).
"""

import math
from typing import Literal

import numpy as np
from numpy.typing import NDArray
import scipy

from ros2_ident.recording.motion import best_lag, fill_gaps, LATEST, Motion
from ros2_ident.recording.streams import FloatArray

Sign = Literal['right', 'held', 'reversed', 'unsigned', 'either', 'open']

# What is no torque of the drive as it was logged.
WRONG: frozenset[Sign] = frozenset({'reversed', 'unsigned', 'either'})
# What to say of it, with the remedy.
SAID: dict[Sign, str] = {
    'right': 'the effort overcomes friction, so it has the sign of the motion',
    'held': 'others move the drive, as the ground does a foot, and its effort draws it to its '
    'set-point, so it has the sign of the motion',
    'reversed': 'where the same positions are passed both ways the effort takes power from the '
    'drive: its sign is reversed against the motion; negate the effort or the position in the '
    'driver, or for this log the torque_constant, of a table the scale',
    'unsigned': 'the effort never changes its sign while the drive reverses: only its size was '
    'logged; log the signed one, or write "sign: velocity" in the column map of a table',
    'either': 'the effort never changes its sign while the drive reverses, takes power from it '
    'and follows no law of the motion: only its size was logged, or it is reversed; log the '
    'signed one, and negate it only where it is signed already',
    'open': 'whether the effort has the sign of the motion does not show in this log',
}
# Slower than this share of the top speed is no motion; positions fall into so many cells, samples
# into so many blocks.
_SLOW, _CELLS, _BLOCKS = 0.05, 20, 20
# The sign of a power is certain where chance makes as much with less than this probability.
_CHANCE = 1e-3
# An effort passes zero, and falls to it, by these shares of its largest values, and stays there
# for this share of the time; a drive that has stood longer may be braked or off, s.
_PASSES, _FALLS, _OFTEN, _STOOD = 0.005, 0.02, 0.005, 0.1
# Share of a variance that is left where another reading of an effort explains it clearly better.
_PLAINER = 0.5
# Share of an effort's variance from which on the motion is known to explain it.
KNOWN = 0.85


def sign_of(motion: Motion, alone: bool = False) -> Sign:
    """Judge the sign of a drive's effort.

    Args:
        alone: Whether other joints load this one, so that power is judged only while they rest
            where they rest on the way back, too.

    Returns:
        `unsigned` where the effort never changes its sign while the drive reverses, though its
        friction does, `either` where it may be reversed as well; `held` where power is taken from
        the drive, but its set-point tells the sign; `open` where it does not show.
    """
    assert motion.effort is not None
    effort, place = fill_gaps(motion.effort), motion.position
    back = [np.max(np.maximum.accumulate(way * place) - way * place) for way in (1, -1)]
    if _CELLS * min(back) <= np.ptp(place):
        return 'open'
    slow = _SLOW * float(np.abs(motion.velocity).max())
    moving = np.abs(motion.velocity) > slow
    others = motion.beside if alone else motion.beside[:0]
    near = 2 * round(_STOOD / motion.period) + 1
    # What starts or stops is slow as well, and loads the joint by its acceleration.
    change = np.abs(np.gradient(others, motion.period, axis=1))
    rest = scipy.ndimage.maximum_filter1d(change, near, axis=1)
    there = moving & (rest < slow).all(axis=0) & np.isfinite(motion.effort)
    turns = np.count_nonzero(np.diff(np.sign(motion.velocity[moving])))
    # There and back once, direction is a function of time: what drifts looks like friction.
    power = _power(motion, effort, others, there) if turns > 1 else np.nan
    certain = _certain()
    top = float(np.percentile(effort, 99))
    if effort.min() >= -_PASSES * top:
        # A weight keeps away from zero; the size of an effort falls to it when its sign changes.
        around = scipy.ndimage.maximum_filter1d(moving, near)
        falls = float(np.mean(effort[around] < _FALLS * top)) > _OFTEN
        if falls or (abs(power) < certain and not alone):
            return 'unsigned'
        # With the sign of the motion a size is an effort that the motion explains.
        readings = effort, np.sign(motion.velocity) * effort
        known, share = (effort_lag(motion, x)[1] for x in readings)
        plain, other = (float(np.var(motion.slowly(x))) for x in readings)
        if (1.0 - share) * other < _PLAINER * ((1.0 - known) * plain):
            return 'unsigned'
        if power < -certain and known < KNOWN:
            return 'either'
    if power < -certain:
        return 'held' if _held(motion, effort) else 'reversed'
    return 'right' if power > certain else 'open'


def _certain() -> float:
    """Return what a sign's slope over its standard error has to reach."""
    return float(-scipy.special.stdtrit(_BLOCKS - 1, _CHANCE))


def _held(motion: Motion, effort: FloatArray) -> bool:
    """Whether an effort (T,) goes towards the set-point, by a law that explains it best.

    So a controller answers what others do to the drive; where it makes the motion itself, inertia,
    friction and weight explain more.
    """
    if motion.goal is None:
        return False
    rows = motion.goal - motion.position, motion.velocity, np.ones(effort.size), effort
    *law, asked = motion.slowly(np.stack(rows))
    gains = np.linalg.lstsq(np.stack(law, axis=1), asked, rcond=None)[0]
    left = float(np.var(asked - gains @ law))
    known = effort_lag(motion, effort)[1]
    return gains[0] > 0.0 and left < (1.0 - known) * float(np.var(asked))


def _power(
    motion: Motion, effort: FloatArray, others: FloatArray, there: NDArray[np.bool_]
) -> float:
    """Return the mean power at positions passed both ways over its standard error, or NaN.

    Of efforts (T,) without NaN at samples `there` (T,), with `others` (M, T) that load the joint.
    """
    place = motion.position - motion.position.min()
    axes = np.vstack([place, others - others.min(axis=1, keepdims=True)])
    span = np.maximum(axes.max(axis=1, keepdims=True), 1e-300)
    cells = np.minimum(_CELLS * axes / span, _CELLS - 1).astype(int)
    cell = np.unique(cells, axis=1, return_inverse=True)[1].ravel()
    ways = [np.isin(cell, cell[there & (w * motion.velocity > 0.0)]) for w in (1, -1)]
    at = np.flatnonzero(there & ways[0] & ways[1])
    if at.size < 2 * _BLOCKS:
        return np.nan
    drift, smooth = np.arange(place.size), motion.slowly(effort)
    rows = np.stack([motion.velocity, motion.acceleration, place, drift, smooth])
    rows, cell = rows[:, at], cell[at]
    sums = np.stack([np.bincount(cell, row) for row in rows])
    rows = rows - (sums / np.maximum(np.bincount(cell), 1))[:, cell]
    # The part of the velocity that positions, accelerations and drifts cannot have.
    other = rows[1:-1].T / np.maximum(np.linalg.norm(rows[1:-1], axis=1), 1e-300)
    return _certainty(rows[0], other, rows[-1])


def _certainty(own: FloatArray, other: FloatArray, target: FloatArray) -> float:
    """Return the slope of a target (T,) on its own row (T,) over its standard error.

    What other columns (T, P) can have of both is left out.
    """
    both = np.stack([own, target], axis=1)
    own, left = (both - other @ np.linalg.lstsq(other, both, rcond=None)[0]).T
    slope = (own @ left) / max(own @ own, 1e-300)
    block = np.arange(own.size) * _BLOCKS // own.size
    scores = np.bincount(block, own * (left - slope * own))
    spread = np.sqrt((scores @ scores) * _BLOCKS / (_BLOCKS - 1))
    return float(slope * (own @ own) / max(spread, 1e-300))


def effort_lag(motion: Motion, effort: FloatArray) -> tuple[float, float]:
    """Return the lag of an effort, s or NaN, and the share of it that the motion explains."""
    smooth = motion.slowly(fill_gaps(effort))
    lag, _, share = best_lag(motion.regressors, smooth, motion.period, 0.0)
    # a fit that is best at the very edge, or poor, knows nothing of a delay
    known = lag <= LATEST - 2.0 * motion.period and share >= KNOWN
    return lag if known else math.nan, share


def backward(motion: Motion, effort: FloatArray) -> bool:
    """Whether the motion explains an effort (T,), with an inertia that is certainly negative."""
    lag, share = effort_lag(motion, effort)
    late = 0 if math.isnan(lag) else round(lag / motion.period)
    if share < KNOWN:
        return False
    columns = motion.regressors[: motion.position.size - late]
    asked = motion.slowly(fill_gaps(effort))[late:]
    return _certainty(columns[:, 0], columns[:, 1:], asked) < -_certain()
