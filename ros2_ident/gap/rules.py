# SPDX-License-Identifier: Apache-2.0
"""When an effect counts: every threshold of the selection and of the verdict, and its origin."""

from collections.abc import Sequence
from dataclasses import dataclass

import scipy

from ros2_ident.arrays import NORMAL
from ros2_ident.effects import get_effect
from ros2_ident.gap.hypothesis import Hypothesis, Round
from ros2_ident.gates.scale import FLOORS
from ros2_ident.identify.hidden import MATERIAL
from ros2_ident.search.evidence import OWN

# Sum of squares, in units of the noise's, that two fits of one model may differ by chance: the
# quantile of chi-square of one number, at which one in a thousand diagnoses of a hundred fits sees
# more.
TIE = float(scipy.special.chdtri(1, 1e-3 / 100))


@dataclass(frozen=True)
class Rules:
    """Thresholds: shares, or RMS in units of the floor; see `docs/diagnosis.md`.

    Where each is from stands behind it: practice cases of another simulator (labelled, none of
    the blind ones), with the date, or by hand.

    Attributes:
        material: Gap of a drive, RMS, below which nothing is missing: imperfections of any real
            machine. Practice cases, 2026-11-22.
        step: Least RMS that the first effect has to take away from a drive's gap. For every
            further one it is `material`: the first one's real form differs from the catalogue's.
            Practice cases, 2026-11-22.
        unknown: Gap of a drive from which something is called missing though nothing closes it.
            Practice cases, 2026-11-21.
        share: Least share of the explainable gap, on held-out data, that an effect has to close.
            By hand.
        closed: Least share that all effects together have to close for their names to be believed:
            most of the gap is theirs. By its meaning.
        rival: How much less of the gap than the best an effect may close and still be taken for
            confusable. Practice cases, 2026-11-21.
        alike: Share of the gap by which two laws may differ and be taken for forms of one effect:
            then the one with fewer numbers is named. So much the right effect leaves, its real
            form being another one, and a further one at its place has to close more; so has an
            effect beside functions of another coordinate. Practice cases, 2026-11-23.
        own: Least RMS of what an effect changes and nothing else does, as a share of the RMS of
            all that it changes: the forms of the parameters' laws, which do the rest, may be off
            by as much. By hand.
        most: Most effects; the same one on several drives counts once. By hand.
        shaken: RMS that a drive shaken by its encoder's steps puts on the others, as a share of
            its own. By hand.
        floors: Gap from which, with every effect found, a model is another machine's. By hand.
        varies: The same as a share of how the drive's effort varies. By hand.
        slow: Share of that variation from which what is left, and slow, is no noise of a log even
            where nothing predicts it; of drives of one make the others tell what noise is. By
            hand.
    """

    material: float = MATERIAL
    unknown: float = 0.8
    step: float = 0.4
    share: float = 0.10
    closed: float = 0.5
    rival: float = 0.12
    alike: float = 0.02
    own: float = OWN
    most: int = 4
    shaken: float = 0.25
    floors: float = FLOORS
    varies: float = 0.1
    slow: float = 0.5

    def open(self, e: Hypothesis) -> bool:
        """Whether the gap left counts, so that more may be missing."""
        return e.size >= self.material

    def least(self, before: Hypothesis) -> float:
        """Return the RMS that a step has to take away at least."""
        return self.material if before.effects else self.step

    def is_material(self, before: Hypothesis, after: Hypothesis) -> bool:
        """Whether a step closes enough to count, on all data and on the data held out."""
        large = after.reduces(before) >= self.least(before)
        return large and after.closes(before) >= self.share and self.is_confirmed(before, after)

    def is_confirmed(self, before: Hypothesis, after: Hypothesis) -> bool:
        """Whether the data held out speak for a step.

        Where their motion does not excite what the step explains, they cannot; then they must at
        least not speak against it.
        """
        if after.closes(before, held_out=True) >= self.share:
            return True
        drive = int((before.gap - after.gap).argmax())
        worse = (after.check - before.check) / before.samples.check
        silent = before.held_out[drive] < self.material**2
        return bool(silent and worse.max() < (0.5 * self.material) ** 2)

    def is_certain(self, before: Hypothesis, after: Hypothesis, errors: float) -> bool:
        """Whether a step would count at the lower end of its 95 % interval.

        Args:
            errors: How many standard errors of noise it stands out.
        """
        return after.reduces(before) * (1.0 - NORMAL / max(errors, NORMAL)) >= self.least(before)

    def mends_a_form(self, chain: Sequence[Hypothesis], after: Hypothesis) -> bool:
        """Whether the new effects sit where earlier ones do, and close as little as their forms.

        A share of the gap of the chain's first fit. A further order of a ripple mends none.
        """
        earlier = {at.where for at in chain[-1].effects}
        added = after.effects[len(chain[-1].effects) :]
        if all(get_effect(at.effect).number > 1 for at in added):
            return False
        new = {at.where for at in added}
        if not (earlier and (new <= earlier or 'all' in new | earlier)):
            return False
        explainable = chain[0].gap.sum()
        fall = (chain[-1].gap - after.gap).sum()
        return (float(fall / explainable) if explainable > 0.0 else 0.0) < self.alike

    def best(self, round_: Round) -> Hypothesis | None:
        """Return the best fit, a simple effect before one that is hardly better.

        An effect on several drives has to count beside the same one on any of them alone.
        """
        alone, first = round_.alone, len(round_.base.effects)
        fitted = [
            e
            for e in round_.fitted
            if all(at not in alone or self.is_material(alone[at], e) for at in e.effects[first:])
            or len(e.effects) == first + 1
        ]
        return self.plainest(round_.base, fitted) if fitted else None

    def plainest(self, base: Hypothesis, fitted: Sequence[Hypothesis]) -> Hypothesis:
        """Return the fit of the fewest numbers among those that close as much as the best.

        No law of the catalogue is exactly the machine's: one more number closes a little more,
        and one that ended at a bound tells nothing beside the law that it comes to there.
        """
        best = min(fitted, key=lambda e: e.bic)
        share = best.closes(base) - self.alike
        limits = set().union(*map(best.limits, best.effects))
        plainer = limits and limits.union(best.effects)
        alike = [
            e
            for e in fitted
            if e.closes(base) >= share
            and (best.reduces(e) < self.step or plainer.issuperset(e.effects))
        ]
        return min([best, *alike], key=lambda e: (len(e.theta), e.bic))


@dataclass(frozen=True)
class Temperatures:
    """How differences become probabilities; from blind cases (`docs/blind.md`).

    Attributes:
        size: Difference of the gap's size from the material one that divides the odds of `none` by
            e.
        closed: Difference of the share closed from the one required that divides the odds of
            `unknown` by e.
        escaped: Probability that an effect of the catalogue is there though none was found that
            explains the gap.
        believed: Probability of the names where little is left, however small a share closes.
        power: Exponent of the share that a candidate leaves open: half as much weighs 2^power
            times.
        restless: Probability that something moves where the floor is too large and slow for noise.
        bounded: Share of the probability that is left to names of which a size ended at a bound of
            its search: it is larger, or in place of another cause. Evenly, by hand.
        sure: Probability of what a measure shows by itself, with hardly any doubt: steps of an
            encoder, a contradiction of log and machine file. By hand.
    """

    size: float = 0.04
    closed: float = 0.1
    escaped: float = 0.12
    believed: float = 0.9
    power: float = 5.0
    restless: float = 0.7
    bounded: float = 0.5
    sure: float = 0.95
