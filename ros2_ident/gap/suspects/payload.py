# SPDX-License-Identifier: Apache-2.0
"""Instants at which a payload is taken up and put down, from the nominal residual.

A load adds to every drive's effort what the motion makes of its mass, while it is there. So the
mass that is missing, bin by bin, jumps between two levels: the nominal fit has part of it in the
tool's mass. When it jumps is found by dynamic programming, and believed where each drive tells the
same without having been asked.
"""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from ros2_ident.arrays import Array
from ros2_ident.effects import shown_by
from ros2_ident.gap.recordings import JointModel
from ros2_ident.models import EffectAt, FullModel
from ros2_ident.models.trials import TRIAL

# Length of a bin, and the shortest time that a load stays or is away, s. By hand: no gripper takes
# up and puts down faster.
_BIN, _SHORTEST = 0.04, 0.2
# Share of the missing mass's variance that a jump has to save. By hand: at Schwarz's price,
# ln(n) / n of what is left, the shortest stays are lost.
_WORTH = 0.005
# Share of the whole jump that each drive has to show at the instants that the others tell, and its
# share of what all tell of the mass from which on it counts. By hand.
_ALIKE, _TELLS = 0.5, 0.05
# By how many bins a jump is moved to look for a better place: halved steps.
_SHIFTS = (-8, 8, -4, 4, -2, 2, -1, 1)
# Quantiles of the bins' masses between which they are believed. By hand.
_MIDDLE = (0.05, 0.95)


def find_pick_ups(joint: JointModel, theta: Array, floor: Array) -> tuple[Array, ...]:
    """Return when a payload is carried on each recording, where the log shows that.

    Args:
        joint: The nominal model on all recordings.
        theta: (N,) the nominal fit.
        floor: (D,) noise of each drive.

    Returns:
        For each recording (K,) 1 at cycles with a load, 0 at those without; empty where no load
        comes more than once.
    """
    effect = shown_by('load')
    if effect is None:
        return ()
    at, loaded, seen = EffectAt(effect.id, 'all'), [], []
    for model, own in joint.each(theta):
        always = model.carrying(np.ones(model.measured.shape[1]))
        if at not in always.extensions():
            return ()
        loaded.append(always.extended([at]))
        seen.append(_missing(model, loaded[-1], at, own, floor))
    counts = [told.shape[2] for told in seen]
    told = np.concatenate(seen, axis=2)
    on = _jumps(told.sum(axis=1))
    if on is None or not _alike(told, on):
        return ()
    # A load that comes and goes once is an effect of its own.
    parts = np.split(on, np.cumsum(counts)[:-1])
    if max(np.count_nonzero(part[1:] != part[:-1]) for part in parts) < 3:
        return ()
    levels = _levels(told.sum(axis=1), on)
    return tuple(
        _cycles(_sharper(part, model, own, levels, floor), model)
        for part, model, (_, own) in zip(parts, loaded, joint.each(theta), strict=True)
    )


def _each(model: FullModel) -> int:
    """Return the cycles of a bin."""
    return max(1, round(_BIN / model.cycle))


def _cycles(bins: Array | npt.NDArray[np.bool_], model: FullModel) -> Array:
    """Return values of bins (B,) at each cycle (K,), interpolated: none is taken up at once."""
    middles = (np.arange(bins.size) + 0.5) * _each(model)
    out: Array = np.interp(np.arange(model.measured.shape[1]), middles, bins.astype(float))
    return out


def _sharper(
    on: npt.NDArray[np.bool_],
    loaded: FullModel,
    theta: Array,
    levels: tuple[float, float],
    floor: Array,
) -> npt.NDArray[np.bool_]:
    """Return the bins (B,) with a load, its jumps moved to where a simulation fits best.

    Bin by bin the mass is blurred: what a load does to the motion lasts, and friction holds it.
    """
    low, high = levels

    def missed(tried: npt.NDArray[np.bool_]) -> Array:
        carrying = loaded.carrying(_cycles(np.where(tried, high, low) / (high - low), loaded))
        left = loaded.measured - carrying.simulate(np.append(theta, high - low)[None])[0]
        total: Array = np.nansum((left / floor[:, None]) ** 2, axis=0)
        return total if np.isfinite(total).all() else np.full(total.size, np.inf)

    best, least = on, missed(on)
    while True:
        jumps = np.flatnonzero(best[1:] != best[:-1]) + 1
        # Each jump is judged by the time about it, so that one simulation moves all of them.
        starts = np.concatenate([[0], (jumps[1:] + jumps[:-1]) // 2]) * _each(loaded)
        costs = [np.add.reduceat(missed(_moved(best, jumps + s)), starts) for s in _SHIFTS]
        shift = np.array(_SHIFTS)[np.argmin(costs, axis=0)]
        shift[np.min(costs, axis=0) >= np.add.reduceat(least, starts)] = 0
        tried = _moved(best, jumps + shift)
        found = missed(tried)
        if found.sum() >= least.sum():
            return best
        best, least = tried, found


def _moved(on: npt.NDArray[np.bool_], jumps: npt.NDArray[np.intp]) -> npt.NDArray[np.bool_]:
    """Return bins (B,) that begin like others and jump at these bins."""
    flips = np.bincount(np.clip(jumps, 1, on.size - 1), minlength=on.size)
    out: npt.NDArray[np.bool_] = (np.cumsum(flips) % 2 == 1) ^ on[0]
    return out


def _missing(
    model: FullModel, whole: FullModel, at: EffectAt, theta: Array, floor: Array
) -> Array:
    """Return (2, D, B): missing mass weighted by information, and the information, by bin.

    Args:
        model: The nominal model.
        whole: The same with a load all the time.
        at: The load.
        theta: (N,) the nominal fit.
        floor: (D,) noise.
    """
    (mass,) = whole.scaled(at)
    trial = TRIAL * mass.high
    without = model.simulate(theta[None])[0]
    change = (whole.simulate(np.append(theta, trial)[None])[0] - without) / trial
    missed = model.measured - without
    known = np.isfinite(missed)
    weight = known / floor[:, None] ** 2
    parts = np.where(known, missed, 0.0) * change * weight, change**2 * weight
    starts = np.arange(0, missed.shape[1], _each(model))
    return np.stack([np.add.reduceat(part, starts, axis=1) for part in parts])


def _jumps(told: Array) -> npt.NDArray[np.bool_] | None:
    """Return (B,) at which bins the mass is at the higher one of two levels; None for no jump.

    Args:
        told: (2, B) information times mass, and information.

    Reference:
        Number of jumps: Yao (1988), Statistics & Probability Letters 6, by Schwarz's criterion.
    """
    if not told[1].any():
        return None
    mass = told[0] / (told[1] + 1e-12 * told[1].max())
    # What else the model lacks shows most where the motion is violent: no bin counts for many.
    weight = np.minimum(told[1], float(np.median(told[1][told[1] > 0.0])))
    mass = np.clip(mass, *np.quantile(mass, _MIDDLE))
    mean = float(np.average(mass, weights=weight))
    spread = float((weight * (mass - mean) ** 2).sum())
    low, high = (float(np.quantile(mass, q)) for q in (0.2, 0.8))
    on: npt.NDArray[np.bool_] | None = None
    # Each round lowers the sum of the costs, until one repeats the last.
    while True:
        costs = np.stack([weight * (mass - low) ** 2, weight * (mass - high) ** 2])
        path = _cheapest(costs, _WORTH * spread)
        if path.all() or not path.any():
            return None
        if on is not None and np.array_equal(path, on):
            break
        on = path
        low, high = (float(np.average(mass[x], weights=weight[x])) for x in (~on, on))
    left = float((weight * (mass - np.where(on, high, low)) ** 2).sum())
    stays = np.diff(np.flatnonzero(np.concatenate([[True], on[1:] != on[:-1], [True]])))
    # By Schwarz's criterion each instant is a number, and so is the second level.
    pays = left < spread * mass.size ** (-stays.size / mass.size)
    return on if pays and np.median(stays) * _BIN >= _SHORTEST else None


def _cheapest(costs: Array, jump: float) -> npt.NDArray[np.bool_]:
    """Return (B,) the path through two states whose costs (2, B) and jumps are least."""
    count = costs.shape[1]
    total = costs[:, 0].copy()
    came = np.zeros((2, count), dtype=np.int64)
    for k in range(1, count):
        over = total[::-1] + jump
        came[:, k] = np.where(over < total, [1, 0], [0, 1])
        total = np.minimum(total, over) + costs[:, k]
    path = np.empty(count, dtype=np.int64)
    path[-1] = int(total.argmin())
    for k in range(count - 1, 0, -1):
        path[k - 1] = came[path[k], k]
    return path.astype(bool)


def _alike(told: Array, on: npt.NDArray[np.bool_]) -> bool:
    """Whether each drive shows the jumps at the instants that the others tell.

    Args:
        told: (2, D, B) what each bin of each drive tells.
        on: (B,) the jumps that all tell together.
    """
    whole = _jump(told.sum(axis=1), on)
    tells = told[1].sum(axis=1)
    for drive in np.flatnonzero(tells > _TELLS * tells.sum()):
        others: Sequence[int] = [d for d in range(told.shape[1]) if d != drive]
        own = _jumps(told[:, others].sum(axis=1)) if others else on
        if own is None or _jump(told[:, drive], own) < _ALIKE * whole:
            return False
    return True


def _levels(told: Array, on: npt.NDArray[np.bool_]) -> tuple[float, float]:
    """Return the mass (2, B) tells of where it is off and where it is on."""
    off, carried = (told[0, x].sum() / max(float(told[1, x].sum()), 1e-300) for x in (~on, on))
    return float(off), float(carried)


def _jump(told: Array, on: npt.NDArray[np.bool_]) -> float:
    """Return by how much the mass (2, B) is more where it is on."""
    off, carried = _levels(told, on)
    return carried - off
