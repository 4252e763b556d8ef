# SPDX-License-Identifier: Apache-2.0
"""From rounds of fits to the effects that are there: selection, elimination, rivals."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
import math
from typing import Any

import numpy as np

from ros2_ident.arrays import Array
from ros2_ident.effects import get_effect
from ros2_ident.gap.attribute import Attribution, Round
from ros2_ident.gap.case import Case
from ros2_ident.gap.fits import Explanation, TIE
from ros2_ident.gap.floor import Floor, NORMAL, predictability
from ros2_ident.gates.scale import ANOTHER, near
from ros2_ident.identify.hidden import MATERIAL
from ros2_ident.models import EffectAt
from ros2_ident.models.registry import kind_of
from ros2_ident.search import intervals
from ros2_ident.search.evidence import Evidence

# A floor that falls below this share of what it was is taken over.
_LOWER = 0.97


@dataclass(frozen=True)
class Explained:
    """Result of the forward selection.

    Attributes:
        chain: The nominal fit, then one more effect each.
        rounds: The rounds that were run.
        rivals: Models with another effect in place of the first one found, the best first; itself
            included.
        rests: For each effect found, the final model without it, fitted anew.
        remaining: Gap left, RMS of the worst drive in units of the floor.
        complete: False where time or patience ran out.
    """

    chain: tuple[Explanation, ...]
    rounds: tuple[Round, ...]
    rivals: tuple[Explanation, ...]
    rests: tuple[Explanation, ...]
    remaining: float
    complete: bool

    def nominal(self) -> 'Explained':
        """Return the same with no effect found."""
        return replace(self, chain=self.chain[:1], rivals=(), rests=())


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


class Explainer(Attribution):
    """Runs the rounds and judges their fits; further arguments as of `Attribution`.

    Args:
        case: The recordings.
        floor: The noise that they are fitted under.
        rules: When something counts.
        steps: (D,) what steps of encoders put into the floor, RMS.

    Attributes:
        shown: Effects that stay since the controllers' log shows them.
    """

    def __init__(
        self,
        case: Case,
        floor: Floor,
        rules: Rules | None = None,
        steps: Array | float = 0.0,
        **more: Any,
    ) -> None:
        super().__init__(case, floor.per_drive, **more)
        self.floor = floor
        self.rules = rules or Rules()
        self.shown: tuple[EffectAt, ...] = ()
        self.steps = steps
        self._seen: dict[frozenset[EffectAt], tuple[Explanation, Floor]] = {}
        drives = len(case.drives)
        self.fit_count = np.bincount(case.fit.drive, minlength=drives).astype(float)
        self.check_count = np.bincount(case.check.drive, minlength=drives).astype(float)

    # ------------------------------------------------------------------ criteria

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
        return self.plainest(round_.base, fitted) if fitted else None

    def plainest(self, base: Explanation, fitted: Sequence[Explanation]) -> Explanation:
        """Return the fit of the fewest numbers among those that close as much as the best.

        No law of the catalogue is exactly the machine's: one more number closes a little more.
        """
        best = min(fitted, key=self.score)
        share = self.share(base, best) - self.rules.alike
        alike = [
            e
            for e in fitted
            if self.share(base, e) >= share and self.reduced(e, best) < self.rules.step
        ]
        return min([best, *alike], key=lambda e: (len(e.theta), self.score(e)))

    def open(self, e: Explanation) -> bool:
        """Whether what is left counts, so that more may be missing."""
        return self.size(e) >= self.rules.material

    # ------------------------------------------------------------------ selection

    def explain(
        self,
        base: Explanation,
        candidates: Sequence[EffectAt],
        on_best: Callable[[Explanation], None],
        limited: Explanation | None = None,
    ) -> Explained:
        """Add effects while they are material, drop what became superfluous, look for rivals.

        Args:
            base: The nominal fit.
            candidates: Effects at places.
            on_best: Told what is found.
            limited: The fit with the limits that the control laws show; these stay.
        """
        chain, rounds = [base], list[Round]()
        if limited is not None:
            self.shown = limited.effects
            chain, rounds = self.steps_to(limited, chain), [Round(base, {}, (limited,))]
            # How far a limited drive moves hangs on each instant of its limit: what the fit leaves
            # there is taken for anything.
            places = {at.where for at in self.shown}
            candidates = [c for c in candidates if c.where not in places]
        while len(rounds) < self.rules.most and self.open(chain[-1]) and not self.stopped():
            round_ = self.round(chain[-1], candidates)
            rounds.append(round_)
            best = self.best(round_)
            if best is None or not self.counts(chain[-1], best):
                break
            further = self.refit(chain[-1].effects, best.theta[: len(chain[-1].theta)])
            if further.cost < chain[-1].cost - TIE:
                # It had not come to its end: what that closes is no merit of the effect.
                chain = [*chain[:-1], further]
                if not self.counts(further, best):
                    continue
            if self.beside(chain[-1], best) and self.closes(chain, best) < self.rules.alike:
                break
            before, chain = chain, self.pruned(chain, best)
            if self.score(chain[-1]) >= self.score(before[-1]):
                chain = before
                break
            on_best(chain[-1])
            if not self.stopped():
                chain, rounds = self.with_new_floor(chain, rounds)
        if chain[-1].effects and not self.stopped():
            chain = self.on_like_drives(chain, candidates)
        rests = self.rests(chain)
        if not self.stopped():
            chain, rests = self.with_plainer_laws(chain, rests, rounds)
            chain, rests = self.ordered(chain, rests)
        rivals = self.rivals(chain, rounds)
        return Explained(
            tuple(chain), tuple(rounds), rivals, rests, self.size(chain[-1]), not self.stopped()
        )

    def counts(self, before: Explanation, after: Explanation) -> bool:
        """Whether a step is material, and would be at the lower end of its 95 % interval.

        The interval is that of noise as slow as what is left: under it chance closes a lot, but
        never more than the noise itself.
        """
        if not self.material(before, after):
            return False
        reduced = self.reduced(before, after)
        if reduced > 1.0:
            return True
        errors = self.standing(before, after)
        return reduced * (1.0 - NORMAL / max(errors, NORMAL)) >= self.least(before)

    def on_like_drives(
        self, chain: list[Explanation], candidates: Sequence[EffectAt]
    ) -> list[Explanation]:
        """Return the chain with what was found on some drives on those that have it, too.

        Drives of one kind are built alike, so that an effect of about the same size needs no gap
        that counts by itself: it has to stand out of noise.
        """
        final, machine = chain[-1], self.case.fit.models[0].machine
        if machine is None or not kind_of(machine).alike:
            return chain
        names = {at.effect for at in final.effects if at.where in self.case.drives}
        more = [at for at in candidates if at.effect in names and at.where in self.case.drives]
        starts = [s[0] for s in self.look(final, more).values() if s[0].gain > TIE]
        while starts and not self.stopped():
            new = tuple(at for s in starts for at in s.effects)
            phi = [s.phi for s in starts]
            wide = self.refit(
                (*final.effects, *new), np.concatenate([final.theta, *phi])
            )
            kept = [s for s in starts if self.like_others(wide, s.effects[0])]
            if len(kept) == len(starts):
                better = self.score(wide) < self.score(final)
                held_out = wide.check.sum() < final.check.sum()
                return self.steps_to(wide, chain) if better and held_out else chain
            starts = kept
        return chain

    def like_others(self, e: Explanation, at: EffectAt) -> bool:
        """Whether an effect stands out of noise, and is as large as on another drive of a fit."""
        model, sizes = self.case.fit.models[0], dict[EffectAt, float]()
        for index, other in enumerate(e.effects):
            if other.effect == at.effect:
                pairs = zip(self.columns(e, index), model.scaled(other), strict=True)
                parts = [e.theta[c] - p.neutral for c, p in pairs if p.role == 'size']
                sizes[other] = math.hypot(*parts)
        own = sizes.pop(at)
        if not any(near(own / (x or math.inf), ANOTHER) for x in sizes.values()):
            return False
        less = self.without(e, e.effects.index(at))
        return self.standing(less, e) > NORMAL

    def with_new_floor(
        self, chain: list[Explanation], rounds: list[Round]
    ) -> tuple[list[Explanation], list[Round]]:
        """Look at the noise once more, now that a cause of the residual is known.

        What an effect does beyond a straight line is no noise, though it looked like it before.
        """
        floor = self.noise_of(chain[-1])
        if not (floor.per_drive < _LOWER * self.fits.floor).any():
            return chain, rounds
        self.floor = floor
        chain, rounds = self.renew(floor.per_drive, chain, rounds)
        return [*chain[:-1], self.refit(chain[-1].effects, chain[-1].theta)], rounds

    def noise_of(self, e: Explanation) -> Floor:
        """Return what can be predicted of what a fit leaves on all recordings, and what cannot.

        Known once for a set of effects: another order and other weights change no noise, and to
        first order the parameters end up where they did.
        """
        key = frozenset(e.effects)
        if key not in self._seen:
            self.on_step(1.0, 'telling noise from what the motion predicts')
            joint = self.case.whole.with_effects(e.effects)
            self.knows(e, predictability(joint, e.theta, self.stopped, self.steps))
        made, seen = self._seen[key]
        if made is e:
            return seen
        own = (self.columns(made, made.effects.index(at)) for at in e.effects)
        count = self.columns(made, 0)[0] if made.effects else len(made.theta)
        order = np.concatenate([np.arange(count), *own])
        joint = self.case.fit.with_effects(e.effects)
        moved = (made.theta[order] - e.theta) / (joint.high - joint.low)
        known = seen.evidence
        assert known is not None
        evidence = replace(
            known,
            shift=known.shift[order] + moved,
            covariance=known.covariance[np.ix_(order, order)],
        )
        return replace(seen, evidence=evidence)

    def knows(self, e: Explanation, seen: Floor) -> None:
        """Keep what was found to be predictable of what a fit leaves."""
        self._seen[frozenset(e.effects)] = e, seen

    def rests(self, chain: Sequence[Explanation]) -> tuple[Explanation, ...]:
        """For each effect of the final model, what is left when it is taken out again."""
        final = chain[-1]
        if len(final.effects) == 1:
            return (chain[0],)
        return tuple(
            chain[-2] if index == len(final.effects) - 1 else self.without(final, index)
            for index in range(len(final.effects))
        )

    def with_plainer_laws(
        self,
        chain: list[Explanation],
        rests: tuple[Explanation, ...],
        rounds: Sequence[Round],
    ) -> tuple[list[Explanation], tuple[Explanation, ...]]:
        """Put laws of fewer numbers in the place of those that now need no more.

        While another cause was missing, the numbers of a law took up part of it.
        """
        if len(chain[-1].effects) < 2:
            return chain, rests
        for at in chain[-1].effects:
            final = chain[-1]
            rest = rests[final.effects.index(at)]
            numbers = len(get_effect(at.effect).parameters)
            plainer = [
                (other, e)
                for other, e in self.instead_of(at, final, rounds)
                if other.where == at.where and len(get_effect(other.effect).parameters) < numbers
            ]
            tried = [self.swapped(final, at, *x) for x in plainer if not self.stopped()]
            best = self.plainest(rest, [final, *tried])
            if best is not final:
                chain = self.steps_to(best, chain[:1])
                rests = self.rests(chain)
        return chain, rests

    @staticmethod
    def instead_of(
        at: EffectAt, final: Explanation, rounds: Sequence[Round]
    ) -> list[tuple[EffectAt, Explanation]]:
        """Return effects, not in the final model, that closed over half as much when one led."""
        source = next((r for r in rounds if at in r.alone), None)
        if source is None:
            return []
        closes = source.base.loss - source.alone[at].loss
        return [
            (other, e)
            for other, e in source.alone.items()
            if other not in final.effects and source.base.loss - e.loss > 0.5 * closes
        ]

    def swapped(
        self, final: Explanation, at: EffectAt, other: EffectAt, e: Explanation
    ) -> Explanation:
        """Refit a model with another effect in the place of one, from a fit that ends with it."""
        index, count = final.effects.index(at), len(get_effect(other.effect).parameters)
        theta = np.delete(final.theta, self.columns(final, index))
        effects = (*final.effects[:index], *final.effects[index + 1 :], other)
        return self.refit(effects, np.concatenate([theta, e.theta[-count:]]))

    def ordered(
        self, chain: list[Explanation], rests: tuple[Explanation, ...]
    ) -> tuple[list[Explanation], tuple[Explanation, ...]]:
        """Put what the final model needs most first, so that the first is the largest."""
        final = chain[-1]
        needs = np.array([e.loss - final.loss for e in rests])
        if len(final.effects) < 2 or not needs.argmax():
            return chain, rests
        order = [int(i) for i in np.argsort(-needs, kind='stable')]
        effects = tuple(final.effects[i] for i in order)
        nominal = list(range(len(chain[0].theta)))
        columns = [nominal, *(self.columns(final, i) for i in order)]
        theta = final.theta[np.concatenate(columns)]
        steps = self.steps_to(self.refit(effects, theta), chain[:1])
        return steps, tuple(rests[i] for i in order)

    def without(self, e: Explanation, index: int) -> Explanation:
        """Refit a model with one effect taken out."""
        effects = tuple(x for i, x in enumerate(e.effects) if i != index)
        theta = np.delete(e.theta, self.columns(e, index))
        return self.refit(effects, theta)

    def columns(self, e: Explanation, index: int) -> list[int]:
        """Return the columns of theta that hold an effect's parameters."""
        sizes = [len(get_effect(x.effect).parameters) for x in e.effects]
        first = len(e.theta) - sum(sizes[index:])
        return list(range(first, first + sizes[index]))

    def pruned(self, chain: list[Explanation], best: Explanation) -> list[Explanation]:
        """Return the chain to a fit, without the effects that its last one makes superfluous."""
        kept = best
        for index in range(len(best.effects) - 2, -1, -1):
            if self.stopped():
                break
            if best.effects[index] in self.shown:
                continue
            less = self.without(kept, index)
            # Against all of them: one by one hardly anything would count.
            if not self.material(less, best):
                kept = less
        return self.steps_to(kept, chain)

    def steps_to(self, e: Explanation, chain: list[Explanation]) -> list[Explanation]:
        """Return the chain to a fit, effect by effect, as far as it can be from another chain."""
        same = e.effects[: len(chain) - 1] == chain[-1].effects
        steps = list(chain) if same else chain[:1]
        for count in range(len(steps), len(e.effects)):
            theta = e.theta[: self.columns(e, count)[0]]
            steps.append(self.refit(e.effects[:count], theta))
        return [*steps, e]

    def rivals(
        self, chain: Sequence[Explanation], rounds: Sequence[Round]
    ) -> tuple[Explanation, ...]:
        """Put the rivals of the first effect in its place in the final model.

        In another's place one may make it diverge: that is no rival.
        """
        final = chain[-1]
        if not final.effects:
            return ()
        first = final.effects[0]
        if len(final.effects) == 1:
            source = next((r for r in rounds if first in r.alone), None)
            if source is not None:
                return tuple(e for e in source.fitted if e in source.alone.values())
        near = self.instead_of(first, final, rounds)[:4]
        models = [final, *(self.swapped(final, first, *x) for x in near if not self.stopped())]
        return tuple(sorted((e for e in models if e.loss < np.inf), key=lambda e: e.loss))
