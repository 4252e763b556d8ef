# SPDX-License-Identifier: Apache-2.0
"""The noise floor of a split: what neither effects nor motion, position and time predict.

Noise of any size and colour is what no function of the motion predicts on data that were left out
(`search.evidence`). Where the command repeats, what repeats is the model's fault and what does not
is noise: half the mean square difference of successive repeats is never below its variance.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt
import scipy

from ros2_ident.arrays import Array, NORMAL
from ros2_ident.gap.coordinates import coordinates, joined, motion_of
from ros2_ident.gap.recordings import are_alike, JointModel
from ros2_ident.gap.spectrum import lines
from ros2_ident.gates.scale import OTHER_NOISE
from ros2_ident.gates.signals import step_of
from ros2_ident.identify.data import SHORTEST
from ros2_ident.identify.hidden import Missing, missing_beside, runs_of
from ros2_ident.recording import Dataset
from ros2_ident.recording.motion import correlation
from ros2_ident.search.evidence import Evidence, weigh
from ros2_ident.search.noise import NoiseModel, Whitening

Method = Literal['repeats', 'prediction']

# Two stretches of command are one motion where they differ by less than this share in the
# square. By hand: 3 % of the amplitude.
_SAME = 1e-3
# Squares beyond so many standard deviations are clipped: impacts do not count. By hand.
_CLIP = 2.0
# Noise is slow whose samples hang together so that their own past leaves only this part of them
# open. Beyond so many times what is stated it is something that moves; where none is stated, from
# the last on. By hand.
_OPEN, _BEYOND, _SLOWEST = 0.5, 4.0, 0.05


@dataclass(frozen=True)
class Floor:
    """Standard deviation of the part of a residual that no model can explain.

    Attributes:
        per_drive: (D,) floor, in the unit of the residual.
        low: (D,) lower end of its 95 % interval.
        high: (D,) upper end.
        method: What it was estimated from.
        noise: (D,) size and colour of the noise.
        evidence: What it comes from, and how far the parameters may be off.
    """

    per_drive: Array
    low: Array
    high: Array
    method: Method
    noise: tuple[NoiseModel, ...]
    evidence: Evidence | None = None

    @property
    def together(self) -> float:
        """Root mean square over the drives, in the unit of the residual."""
        return float(np.sqrt(np.mean(self.per_drive**2)))

    def restless(self, stated: float) -> npt.NDArray[np.bool_]:
        """Return (D,) whether a floor is too large and too slow to be noise.

        Args:
            stated: Noise stated, in the unit of the residual; 0 for none.
        """
        least = (_OPEN if stated else _SLOWEST) ** 2
        slow = [model.innovation < least * model.variance for model in self.noise]
        return (self.per_drive > _BEYOND * stated) & slow

    def draw(self, count: int, generator: np.random.Generator) -> Array:
        """Return (count, D) floors as uncertain as the estimate, for a bootstrap."""
        spread = np.log(np.maximum(self.high, 1e-300) / np.maximum(self.low, 1e-300))
        normal = generator.standard_normal((count, self.per_drive.size))
        drawn: Array = self.per_drive * np.exp(0.5 / NORMAL * spread * normal)
        return drawn


def repeated(residuals: Sequence[Array], datasets: Sequence[Dataset]) -> Array | None:
    """Return (D,) the noise by the recordings whose command repeats; None where none does.

    Args:
        residuals: For each recording (D, K) measured less simulated output; NaN at cycles without
            a sample.
        datasets: The recordings.

    Reference:
        von Neumann (1941), Annals of Mathematical Statistics 12(4); ASME V&V 20-2009 for what is
        made of it.
    """
    differences = []
    for residual, dataset in zip(residuals, datasets, strict=True):
        period = find_repeats(dataset)
        if period is not None:
            # Successive ones, so that slow drift stays out.
            differences.append(residual[:, period:] - residual[:, :-period])
    if not differences:
        return None
    square = np.hstack(differences) ** 2
    if not np.isfinite(square).any(axis=1).all():
        return None
    most = _CLIP**2 * np.nanmedian(square, axis=1) / (2.0 * scipy.special.gammaincinv(0.5, 0.5))
    clipped = np.nanmean(np.minimum(square, most[:, None]), axis=1)
    # Mean of min(x^2, c^2) for a normal x.
    kept = scipy.special.chdtr(3, _CLIP**2) + _CLIP**2 * scipy.special.chdtrc(1, _CLIP**2)
    out: Array = np.sqrt(0.5 * clipped / kept)
    return out


def find_repeats(dataset: Dataset) -> int | None:
    """Find the shortest motion that the whole command consists of.

    Args:
        dataset: The recording.

    Returns:
        Cycles from one start to the next; None where there is no command or nothing repeats.
    """
    if dataset.command_velocity is None:
        return None
    velocity = dataset.command_velocity
    scale = np.sqrt(np.mean(velocity**2, axis=1, keepdims=True))
    velocity = velocity[scale[:, 0] > 0.0] / scale[scale[:, 0] > 0.0]
    size = velocity.shape[1]
    if not velocity.size or size < 8:
        return None
    # Mean square difference of the command and itself, later by each lag, against their squares.
    product = np.sum([correlation(row, row)[size - 1 :] for row in velocity], axis=0)
    square = np.concatenate([[0.0], np.cumsum((velocity**2).sum(axis=0))])
    both = square[size:0:-1] + (square[size] - square[:size])
    different = 1.0 - 2.0 * product / np.maximum(both, 1e-9 * square[-1])
    # Beyond the command's own smoothness, with at least half of its motion in the overlap.
    apart = int(np.argmax(different > 0.5)) if (different > 0.5).any() else size
    lags = np.arange(size)
    fits = (
        (lags > max(apart, SHORTEST / dataset.cycle))
        & (different < 10.0 * _SAME)
        & (both > square[-1])
    )
    if not fits.any():
        return None
    first = int(np.argmax(fits))
    end = first + int(np.argmin(np.append(fits[first:], False)))
    best = first + int(np.argmin(different[first:end]))
    return best if different[best] < _SAME else None


def predictability(
    joint: JointModel,
    theta: Array,
    stopped: Callable[[], bool] = lambda: False,
    steps: Array | float = 0.0,
) -> Floor:
    """Tell noise from the part of a residual that the motion predicts.

    Args:
        joint: The models of all recordings.
        theta: (N,) their fitted parameters.
        stopped: Asked often; True leaves the rest of the catalogue out.
        steps: (D,) RMS of what steps of encoders make, whose course nothing predicts.
    """
    first = joint.models[0]
    weighed = missing_beside(joint, theta, stopped=stopped)
    evidence = weighed.evidence
    found = _by_motion(joint, theta, weighed)
    noise = tuple(e.noise[0] for e in found)
    # A function of time can follow any noise: it counts only on blocks left out.
    further = np.array([float(e.rms[0] ** 2 - e.unseen[0] ** 2) for e in found])
    least = np.array([float(e.unseen[0]) for e in found])
    value = np.maximum(np.sqrt(np.maximum(evidence.floor**2 - further, 0.0)), least)
    # Their square is not the noise's. The model knows about how large it is; no more than all.
    value = value / np.sqrt(1.0 + np.minimum(steps / np.maximum(value, 1e-300), 1.0) ** 2)
    # Rounding is noise, and is gone where nothing moves.
    rows = zip(*(m.measured for m in joint.models), strict=True)
    rounding = np.array([step_of(np.concatenate(row)) for row in rows]) / np.sqrt(12.0)
    value = np.maximum(value, np.minimum(evidence.rms, rounding))
    residuals = [m.measured - m.simulate(own[None])[0] for m, own in joint.each(theta)]
    again = repeated(residuals, [m.data for m in joint.models])
    if again is not None:
        value = np.minimum(value, np.maximum(again, rounding))
    samples = np.array([m.samples * m.independent_squares for m in noise])
    spread = np.exp(NORMAL / np.sqrt(2.0 * np.maximum(2.0, samples)))
    usual = float(np.median(value))
    # Drives of one make have one noise: what one leaves beyond a factor of theirs is none, where
    # most of them tell which it is.
    alike = are_alike(first) and len(first.places) > 2
    apart = alike & (value > OTHER_NOISE * usual * spread)
    value = np.where(apart, usual, value)
    scaled = tuple(
        m.scaled(float(v / np.sqrt(m.variance))) for m, v in zip(noise, value, strict=True)
    )
    method: Method = 'prediction' if again is None else 'repeats'
    return Floor(value, value / spread, value * spread, method, scaled, evidence)


def _by_motion(joint: JointModel, theta: Array, weighed: Missing) -> list[Evidence]:
    """Return each drive's evidence of functions of motion and time beside the effects."""
    evidence, masks = weighed.evidence, weighed.rows.masks
    data = joint.models[0].data
    unknown = data.position is None and data.command_position is None
    motions = [motion_of(model, own) for model, own in joint.each(theta)]
    whole = joined(motions)
    starts = np.cumsum([0, *(m.position.shape[1] for m in motions)])
    counts = np.array([mask.sum(axis=1) for mask in masks])
    ends = np.cumsum(counts).reshape(counts.shape)
    found = []
    for drive in range(len(whole.drives)):
        own = [mask[drive : drive + 1] for mask in masks]
        at = [start + np.flatnonzero(m) for start, m in zip(starts, own, strict=False)]
        here = np.concatenate(
            [np.arange(e - c, e) for e, c in zip(ends[:, drive], counts[:, drive], strict=True)]
        )
        when, runs, left = np.concatenate(at), runs_of(own), evidence.left[here]
        columns = [c.columns for c in coordinates(whole, drive, when)]
        whiten = Whitening(runs, [evidence.noise[drive]])
        for place in (when.astype(np.float64), whole.position[drive, when]):
            # The strongest in the residual, and the strongest beside noise of its colour.
            columns += [lines(left, place), lines(whiten(left), place, 2)]
        if unknown:
            # Functions of what parameters act by.
            slopes = weighed.slopes[here]
            size = np.sqrt(np.mean(slopes**2, axis=0))
            x = slopes[:, size > 0.0] / size[size > 0.0]
            columns += [x, x**2, x**3, x * np.abs(x), np.sign(x)]
        alone = np.empty((here.size, 0))
        missing, blocks = np.hstack(columns), weighed.rows.blocks[here]
        found.append(weigh(left, alone, missing, runs, blocks, share=weighed.rows.share))
    return found
