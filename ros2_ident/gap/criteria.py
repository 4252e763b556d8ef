# SPDX-License-Identifier: Apache-2.0
"""Criteria by which an effect counts and the best of several explanations is chosen."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ros2_ident.arrays import Array
from ros2_ident.effects import EffectParameter
from ros2_ident.gap.attribute import Attribution, Round
from ros2_ident.gap.fits import Explanation, Fits
from ros2_ident.gap.floor import Floor
from ros2_ident.identify.hidden import MATERIAL
from ros2_ident.search import intervals
from ros2_ident.search.evidence import Evidence

# A value as near to an end of its range as this share of it lies on that end.
AT_BOUND = 1e-3


def at_bound(parameter: EffectParameter, value: float) -> bool:
    """Whether an effect's size ended at a bound of its search, other than at its neutral value.

    Args:
        parameter: The parameter with its numbers at a place, from `FullModel.scaled`.
        value: What was fitted, in its unit.
    """
    edge = AT_BOUND * (parameter.high - parameter.low)
    outside = value <= parameter.low + edge or value >= parameter.high - edge
    return parameter.role == 'size' and outside and abs(value - parameter.neutral) > edge


@dataclass(frozen=True)
class Rules:
    """Thresholds: shares, or RMS in units of the floor; see `docs/diagnosis.md`.

    Attributes:
        material: Gap of a drive, RMS, below which nothing is missing.
        step: Least RMS that the first effect has to take away from a drive's gap. For every
            further one it is `material`: the first one's real form differs from the catalogue's.
        unknown: Gap of a drive from which something is called missing though nothing closes it.
        share: Least share of the explainable gap, on held-out data, that an effect has to close.
        closed: Least share that all effects together have to close for their names to be believed:
            most of the gap is theirs.
        rival: How much less of the gap than the best an effect may close and still be taken for
            confusable.
        alike: Share of the gap by which two laws may differ and be taken for forms of one effect:
            then the one with fewer numbers is named. So much the right effect leaves, its real
            form being another one, and a further one at its place has to close more.
        most: Most effects; the same one on several drives counts once.
    """

    material: float = MATERIAL
    unknown: float = 0.8
    step: float = 0.4
    share: float = 0.10
    closed: float = 0.5
    rival: float = 0.12
    alike: float = 0.02
    most: int = 4


class Criteria:
    """Judges fits of one case.

    Args:
        attribution: The fits.
        floor: The noise they are fitted under.
        rules: When something counts.
    """

    def __init__(self, attribution: Attribution, floor: Floor, rules: Rules | None = None) -> None:
        self.attribution = attribution
        self.floor = floor
        self.rules = rules or Rules()
        self.case = case = attribution.case
        drives = len(case.drives)
        self.fit_count = np.bincount(case.fit.drive, minlength=drives).astype(float)
        self.check_count = np.bincount(case.check.drive, minlength=drives).astype(float)

    @property
    def fits(self) -> Fits:
        """The fits at the present noise floor."""
        return self.attribution.fits

    def gap(self, e: Explanation) -> Array:
        """Return (D,) mean square of each drive's gap, in units of the floor squared."""
        out: Array = (e.fit + e.check) / (self.fit_count + self.check_count) - 1.0
        return out

    def size(self, e: Explanation) -> float:
        """Return the RMS of the worst drive's gap in units of the floor."""
        return float(np.sqrt(np.maximum(self.gap(e), 0.0)).max())

    def certain_size(self, e: Explanation) -> float:
        """Return `size` where the noise is at the upper end of its 95 % interval."""
        lower = (self.gap(e) + 1.0) * (self.floor.per_drive / self.floor.high) ** 2 - 1.0
        return float(np.sqrt(np.maximum(lower, 0.0)).max())

    def share(self, before: Explanation, after: Explanation, held_out: bool = False) -> float:
        """Return the share of the gap of `before` that `after` closes; 0 where there is none.

        On all data, or on those `held_out` alone.
        """
        one, two, counts = before.check, after.check, self.check_count
        if not held_out:
            one, two, counts = before.fit + one, after.fit + two, self.fit_count + counts
        explainable = float((one - counts).sum())
        return float((one - two).sum()) / explainable if explainable > 0.0 else 0.0

    def material(self, before: Explanation, after: Explanation) -> bool:
        """Whether a step closes enough to count, on all data and on the data held out."""
        large = self.reduced(before, after) >= self.least(before)
        closes = self.share(before, after) >= self.rules.share
        return large and closes and self.confirmed(before, after)

    def reduced(self, before: Explanation, after: Explanation) -> float:
        """Return the RMS that a step takes away from the drive it helps most, in floors."""
        fall = self.gap(before) - self.gap(after)
        return float(np.sqrt(np.maximum(fall, 0.0)).max())

    def least(self, before: Explanation) -> float:
        """Return the RMS that a step has to take away at least."""
        return self.rules.material if before.effects else self.rules.step

    def confirmed(self, before: Explanation, after: Explanation) -> bool:
        """Whether the data held out speak for a step.

        Where their motion does not excite what the step explains, they cannot; then they must at
        least not speak against it.
        """
        if self.share(before, after, held_out=True) >= self.rules.share:
            return True
        drive = int((self.gap(before) - self.gap(after)).argmax())
        rest = before.check / self.check_count - 1.0
        worse = (after.check - before.check) / self.check_count
        silent = rest[drive] < self.rules.material**2
        return bool(silent and worse.max() < (0.5 * self.rules.material) ** 2)

    def closes(self, chain: Sequence[Explanation], after: Explanation) -> float:
        """Return what a step closes, as a share of the gap of the chain's first fit."""
        explainable = self.gap(chain[0]).sum()
        fall = (self.gap(chain[-1]) - self.gap(after)).sum()
        return float(fall / explainable) if explainable > 0.0 else 0.0

    @staticmethod
    def beside(before: Explanation, after: Explanation) -> bool:
        """Whether what is new sits where earlier effects do and may only mend their form."""
        earlier = {at.where for at in before.effects}
        new = {at.where for at in after.effects[len(before.effects) :]}
        return bool(earlier) and (new <= earlier or 'all' in new | earlier)

    def ends(self, e: Explanation, evidence: Evidence | None) -> tuple[Array, ...]:
        """Return (N,) both ends of each parameter's 95 % interval, and of that by noise alone.

        Args:
            e: The fit.
            evidence: Of what it leaves; without it the intervals are those by noise.
        """
        case = self.case
        joint = case.fit.with_effects(e.effects)
        rows = len(self.fits.weight)
        found = intervals(
            e.jacobian[:rows] / (joint.high - joint.low),
            e.residual[:rows],
            e.theta,
            joint.low,
            joint.high,
            series=[int(s) for mask in case.fit.masks for s in mask.sum(axis=1)],
        )
        noise = found.low, found.high
        if evidence is None:
            return *noise, *noise
        return *evidence.ends(e.theta, joint.low, joint.high, *noise), *noise

    def score(self, e: Explanation) -> float:
        """Return what is minimised over models: loss on both parts, and BIC's penalty."""
        samples = self.fit_count.sum() + self.check_count.sum()
        return e.loss + float(np.log(samples)) * len(e.theta)

    def best(self, round_: Round) -> Explanation | None:
        """Return the best fit, a simple effect before one that is hardly better.

        An effect on several drives has to count beside the same one on any of them alone.
        """
        alone, first = round_.alone, len(round_.base.effects)
        fitted = [
            e
            for e in round_.fitted
            if all(at not in alone or self.material(alone[at], e) for at in e.effects[first:])
            or len(e.effects) == first + 1
        ]
        if not fitted:
            return None
        best = min(fitted, key=self.score)
        # No law of the catalogue is exactly the machine's: one more number closes a little more.
        share = self.share(round_.base, best) - self.rules.alike
        alike = [
            e
            for e in fitted
            if self.share(round_.base, e) >= share and self.reduced(e, best) < self.rules.step
        ]
        return min([best, *alike], key=lambda e: (len(e.theta), self.score(e)))

    def open(self, e: Explanation) -> bool:
        """Whether what is left counts, so that more may be missing."""
        return self.size(e) >= self.rules.material
