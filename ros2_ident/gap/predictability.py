# SPDX-License-Identifier: Apache-2.0
"""The noise floor of a case: what neither effects nor motion, position and time predict.

Noise of any size and colour is what no function of the motion predicts on data that were left out
(`search.evidence`); where the command repeats, what differs between the repeats tells, too.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import chi2

from ros2_ident.arrays import Array
from ros2_ident.gap.case import Joint
from ros2_ident.gap.coordinates import Coordinate, coordinates, Motion, motion_of, places
from ros2_ident.gap.floor import Floor, Method, NORMAL, repeated
from ros2_ident.gap.spectrum import lines
from ros2_ident.gates.signals import step_of
from ros2_ident.identify.hidden import OTHER_NOISE, runs_of, weigh_fit, Weighed
from ros2_ident.models import FullModel
from ros2_ident.models.registry import kind_of
from ros2_ident.search.evidence import Evidence, weigh
from ros2_ident.search.noise import NoiseModel, Whitening

# Regions are compared where they hold so many samples that tell, and differ by more than chance
# makes them with this probability; noise is what the quietest of this share of the samples have,
# where that is less than this share of the rest.
_FEWEST, _CERTAIN, _PART, _QUIET = 20.0, 1e-6, 0.2, 0.85


@dataclass(frozen=True)
class Predictability:
    """What can be predicted of what a fit leaves, and what cannot.

    Attributes:
        floor: What cannot: the noise.
        evidence: Where it comes from, and how far the parameters may be off.
    """

    floor: Floor
    evidence: Evidence


def predictability(
    joint: Joint, theta: Array, stopped: Callable[[], bool] = lambda: False
) -> Predictability:
    """Tell noise from what the motion predicts.

    Args:
        joint: The models of all recordings.
        theta: (N,) their fitted parameters.
        stopped: Asked often; True leaves the rest of the catalogue out.
    """
    first = joint.models[0]
    weighed = weigh_fit(joint, theta, stopped)
    evidence = weighed.evidence
    seen = _by_motion(joint, theta, weighed)
    found = [e for e, _ in seen]
    noise = tuple(e.noise[0] for e in found)
    # A function of time can follow any noise: it counts only on blocks left out.
    further = np.array([float(e.rms[0] ** 2 - e.unseen[0] ** 2) for e in found])
    least = np.array([float(e.unseen[0]) for e in found])
    value = np.maximum(np.sqrt(np.maximum(evidence.floor**2 - further, 0.0)), least)
    value = value * np.array([quiet for _, quiet in seen])
    # Rounding is noise, and is gone where nothing moves.
    rows = zip(*(m.measured for m in joint.models), strict=True)
    rounding = np.array([step_of(np.concatenate(row)) for row in rows]) / np.sqrt(12.0)
    value = np.maximum(value, np.minimum(evidence.rms, rounding))
    residuals = [
        m.measured - m.simulate(joint.own(number, theta))[0]
        for number, m in enumerate(joint.models)
    ]
    again = repeated(residuals, [m.data for m in joint.models])
    if again is not None:
        value = np.minimum(value, np.maximum(again, rounding))
    spread = np.exp(NORMAL * _uncertainty(noise))
    usual = float(np.median(value))
    # Drives of one make have one noise: what one leaves beyond a factor of theirs is none.
    apart = _alike(first) & (value > OTHER_NOISE * usual * spread)
    value = np.where(apart, usual, value)
    scaled = tuple(
        m.scaled(float(v / np.sqrt(m.variance))) for m, v in zip(noise, value, strict=True)
    )
    method: Method = 'prediction' if again is None else 'repeats'
    return Predictability(Floor(value, value / spread, value * spread, method, scaled), evidence)


def _by_motion(joint: Joint, theta: Array, weighed: Weighed) -> list[tuple[Evidence, float]]:
    """Return for each drive what functions of motion and time predict of what effects leave.

    And the share of what is left where the motion leaves least, see `_quiet`.
    """
    evidence, rows = weighed.evidence, weighed.rows
    data = joint.models[0].data
    unknown = data.position is None and data.command_position is None
    motions = [
        motion_of(model, joint.own(number, theta)[0]) for number, model in enumerate(joint.models)
    ]
    whole = _side_by_side(motions)
    starts = np.cumsum([0, *(m.position.shape[1] for m in motions)])
    counts = np.array([mask.sum(axis=1) for mask in rows.masks])
    ends = np.cumsum(counts).reshape(counts.shape)
    found = []
    for drive in range(len(whole.drives)):
        masks = [mask[drive : drive + 1] for mask in rows.masks]
        at = [start + np.flatnonzero(m) for start, m in zip(starts, masks, strict=False)]
        here = np.concatenate(
            [np.arange(e - c, e) for e, c in zip(ends[:, drive], counts[:, drive], strict=True)]
        )
        when, runs, left = np.concatenate(at), runs_of(masks), evidence.left[here]
        columns = [c.columns for c in coordinates(whole, drive, when)]
        whiten = Whitening(runs, [evidence.noise[drive]])
        for place in (when.astype(np.float64), whole.position[drive, when]):
            # The strongest in the residual, and the strongest beside noise of its colour.
            columns += [lines(left, place), lines(whiten(left), place, 2)]
        if unknown:
            columns.append(_functions_of(weighed.slopes[here]))
        seen = weigh(
            left,
            np.empty((here.size, 0)),
            np.hstack(columns),
            runs,
            rows.blocks[here],
            share=rows.share,
        )
        # What a recorded motion has of noise follows the motion, friction's turn above all.
        even = unknown or joint.models[0].thinned
        found.append((seen, 1.0 if even else _quiet(seen, places(whole, drive, when))))
    return found


def _quiet(seen: Evidence, regions: Sequence[Coordinate]) -> float:
    """Return how large what is left is where it is least, over how large it is everywhere.

    Noise of a log knows nothing of the motion. Where the size of what is left follows it (speed,
    position, load), the rest is no noise, though no function predicts its course.
    """
    square = seen.left**2
    # By neighbours alone: where loud stretches are a gap, their memory is not that of the noise.
    rho = seen.noise[0].correlation ** 2
    told = (1.0 - rho) / (1.0 + rho)
    best = 1.0
    for region in regions:
        if region.name == 'time':
            continue
        count = region.columns.sum(axis=0)
        keep = count * told >= _FEWEST
        if keep.sum() < 2:
            continue
        mean = (square @ region.columns)[keep] / count[keep]
        weight = 0.5 * told * count[keep]
        level = np.log(np.maximum(mean, 1e-300))
        spread = float(weight @ (level - np.average(level, weights=weight)) ** 2)
        if chi2.sf(spread, keep.sum() - 1) > _CERTAIN:
            continue
        order = np.argsort(mean)
        gathered = np.cumsum(count[keep][order])
        lowest = order[: 1 + int(np.searchsorted(gathered, _PART * gathered[-1]))]
        quiet = np.average(mean[lowest], weights=count[keep][lowest])
        best = min(best, float(np.sqrt(quiet / square.mean())))
    return best if best < _QUIET else 1.0


def _functions_of(slopes: Array) -> Array:
    """Return (R, C) functions of what parameters act by (R, N), where no motion is known."""
    size = np.sqrt(np.mean(slopes**2, axis=0))
    unit = slopes[:, size > 0.0] / size[size > 0.0]
    return np.hstack([unit, unit**2, unit**3, unit * np.abs(unit), np.sign(unit)])


def _side_by_side(motions: Sequence[Motion]) -> Motion:
    """Return the motions of several recordings as one."""
    first = motions[0]
    if len(motions) == 1:
        return first
    return replace(
        first,
        position=np.hstack([m.position for m in motions]),
        velocity=np.hstack([m.velocity for m in motions]),
        acceleration=np.hstack([m.acceleration for m in motions]),
        jerk=np.hstack([m.jerk for m in motions]),
        torque=np.hstack([m.torque for m in motions]),
        load=np.hstack([m.load for m in motions]),
        output=np.hstack([m.output for m in motions]),
    )


def _alike(model: FullModel) -> bool:
    """Whether one noise is that of all drives, and most of them tell which it is."""
    machine = model.machine
    return machine is not None and kind_of(machine).alike and len(model.places) > 2


def _uncertainty(noise: Sequence[NoiseModel]) -> Array:
    """Return (P,) relative standard errors of the noise's standard deviation."""
    samples = np.array([model.samples * model.independent_squares for model in noise])
    out: Array = 1.0 / np.sqrt(2.0 * np.maximum(2.0, samples))
    return out
