# SPDX-License-Identifier: Apache-2.0
"""The sign of an effort: mean power where a drive passes the same positions both ways.

There what lifts a weight, strains a spring or accelerates a mass is given back: the power left is
friction's, and positive. Of a joint that others load these are passes in one posture, the others
at rest. The standard error is that of sums over blocks of the log, so that noise
and ripple of any colour are allowed for (Liang and Zeger 1986, Biometrika 73(1)).
"""

from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d
from scipy.stats import t as student

from ros2_ident.recording.motion import fill_gaps, Motion
from ros2_ident.recording.streams import FloatArray

Sign = Literal['right', 'reversed', 'unsigned', 'either', 'open']

# What is no torque of the drive as it was logged.
WRONG: frozenset[Sign] = frozenset({'reversed', 'unsigned', 'either'})
# What to say of it, with the remedy.
SAID: dict[Sign, str] = {
    'right': 'the effort overcomes friction, so it has the sign of the motion',
    'reversed': 'where the same positions are passed both ways the effort takes power from the '
    'drive instead of overcoming friction: its sign is reversed against the motion; negate the '
    'effort or the position in the driver',
    'unsigned': 'the effort never changes its sign while the drive reverses: only its size was '
    'logged; log the signed torque or current, or write "sign: velocity" in the column map of a '
    'table',
    'either': 'the effort never changes its sign while the drive reverses, and takes power from '
    'it: only its size was logged, or its sign is reversed; log the signed torque or current, or '
    'negate it in the driver',
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


def sign_of(motion: Motion, alone: bool = False) -> Sign:
    """Judge the sign of a drive's effort.

    Args:
        alone: Whether other joints load this one, so that power is judged only while they rest
            where they rest on the way back, too.

    Returns:
        `unsigned` where the effort never changes its sign while the drive reverses, though its
        friction does, `either` where it may be reversed as well; `open` where the log does not
        show it.
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
    rest = maximum_filter1d(np.abs(np.gradient(others, motion.period, axis=1)), near, axis=1)
    there = moving & (rest < slow).all(axis=0) & np.isfinite(motion.effort)
    turns = np.count_nonzero(np.diff(np.sign(motion.velocity[moving])))
    # There and back once, direction is a function of time: what drifts looks like friction.
    power = _power(motion, effort, others, there) if turns > 1 else np.nan
    certain = student.isf(_CHANCE, _BLOCKS - 1)
    top = float(np.percentile(effort, 99))
    if effort.min() >= -_PASSES * top:
        # A weight keeps away from zero; the size of an effort falls to it when its sign changes.
        falls = float(np.mean(effort[maximum_filter1d(moving, near)] < _FALLS * top)) > _OFTEN
        if falls or (abs(power) < certain and not alone):
            return 'unsigned'
        if power < -certain:
            return 'either'
    return 'right' if power > certain else 'reversed' if power < -certain else 'open'


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
    both = rows[[0, -1]].T
    own, left = (both - other @ np.linalg.lstsq(other, both, rcond=None)[0]).T
    damping = (own @ left) / max(own @ own, 1e-300)
    block = np.arange(at.size) * _BLOCKS // at.size
    scores = np.bincount(block, own * (left - damping * own))
    spread = np.sqrt((scores @ scores) * _BLOCKS / (_BLOCKS - 1))
    return float(damping * (own @ own) / max(spread, 1e-300))
