# SPDX-License-Identifier: Apache-2.0
"""From rounds of fits to the effects that are there: selection, elimination, rivals."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from ros2_ident.effects import EffectParameter, get_effect
from ros2_ident.gap.attribute import Attribution, Round
from ros2_ident.gap.fits import Explanation
from ros2_ident.gap.floor import Floor
from ros2_ident.gap.predictability import Predictability, predictability
from ros2_ident.identify.hidden import MATERIAL
from ros2_ident.models import EffectAt

Array = npt.NDArray[np.float64]

# Sum of squares, in units of the noise's, that two fits of one model may differ by chance.
_TIE = 20.0
# A floor that falls below this share of what it was is taken over.
_LOWER = 0.97
# Share of what controllers miss of the log that an effect may leave and be vouched for by it.
_MISSED = 0.05
# The same where the noise is small beside it: another form of the same effect leaves that much.
_NEARLY = 0.002
# Outputs that a fit misses by so many floors may be too violent to be repeated by any.
_VIOLENT = 3.0
# So may those of which so much is taken for noise, and as slow as no noise is.
_LOST = 20.0
# An effect that the final model needs so many times as much as the first one found comes first.
_NEEDED = 2.0
# Share of the gap that the best effect closes from which another one is near it.
_NEAR = 0.6
# Noise is slow where its samples, known those before, scatter so many times less.
_SLOW = 2.0


def at_bound(parameter: EffectParameter, value: float) -> bool:
    """Whether an effect's size ended at a bound of its search, other than at its neutral value.

    Args:
        parameter: The parameter with its numbers at a place, from `FullModel.scaled`.
        value: What was fitted, in its unit.
    """
    edge = 1e-3 * (parameter.high - parameter.low)
    outside = value <= parameter.low + edge or value >= parameter.high - edge
    return parameter.role == 'size' and outside and abs(value - parameter.neutral) > edge


@dataclass(frozen=True)
class Rules:
    """When something counts: shares, or RMS in units of the floor; see `docs/diagnosis.md`.

    Attributes:
        material: Gap of a drive, RMS, below which nothing is missing.
        unknown: Gap of a drive from which something is called missing though nothing closes it.
        step: Least RMS that the first effect has to take away from a drive's gap.
        later: The same for every further effect: the first one's real form differs from the
            catalogue's, and that difference is no effect of its own.
        share: Least share of the explainable gap, on held-out data, that an effect has to close.
        part: Least share of the nominal fit's gap that a further effect has to close.
        closed: Least share that all effects together have to close for their names to be believed.
        rival: How much less of the gap than the best an effect may close and still be taken for
            confusable.
        contradicted: RMS by which an explanation has to miss the controllers' log more than
            another one does to be taken as contradicted by it.
        instead: Least share of the best's gain that one has to close which the controllers' log
            prefers to be taken instead.
        most: Most effects.
    """

    material: float = MATERIAL
    unknown: float = 0.8
    step: float = 0.4
    later: float = 0.5
    share: float = 0.10
    part: float = 0.025
    closed: float = 0.62
    rival: float = 0.12
    contradicted: float = 0.3
    instead: float = 0.7
    most: int = 4


@dataclass(frozen=True)
class Explained:
    """What came of the search for effects.

    Attributes:
        chain: The nominal fit, then one more effect each.
        rounds: The rounds that were run.
        rivals: For each effect found, models with another effect in its place, the best first;
            itself included.
        rests: For each effect found, the final model without it, fitted anew.
        remaining: Gap left, RMS of the worst drive in units of the floor.
        complete: False where time or patience ran out.
    """

    chain: tuple[Explanation, ...]
    rounds: tuple[Round, ...]
    rivals: tuple[tuple[Explanation, ...], ...]
    rests: tuple[Explanation, ...]
    remaining: float
    complete: bool


class Explainer:
    """Runs the rounds.

    Args:
        attribution: The fits.
        floor: The noise they are fitted under.
        rules: When something counts.
    """

    def __init__(self, attribution: Attribution, floor: Floor, rules: Rules) -> None:
        self.attribution = attribution
        self.floor = floor
        self._seen: tuple[Array, Predictability] | None = None
        self.rules = rules
        case = attribution.case
        drives = len(case.drives)
        self.fit_count = np.bincount(case.fit.drive, minlength=drives).astype(float)
        self.check_count = np.bincount(case.check.drive, minlength=drives).astype(float)

    def gap(self, e: Explanation) -> Array:
        """Return (D,) mean square of each drive's gap, in units of the floor squared."""
        out: Array = (e.fit + e.check) / (self.fit_count + self.check_count) - 1.0
        return out

    def size(self, e: Explanation) -> float:
        """Return the RMS of the worst drive's gap in units of the floor."""
        return float(np.sqrt(np.maximum(self.gap(e), 0.0)).max())

    def share(self, before: Explanation, after: Explanation, part: str = 'both') -> float:
        """Return the share of the gap of `before` that `after` closes; 0 where there is none."""
        counts = {'fit': self.fit_count, 'check': self.check_count}.get(
            part, self.fit_count + self.check_count
        )
        pick: Callable[[Explanation], Array] = {
            'fit': lambda e: e.fit,
            'check': lambda e: e.check,
        }.get(part, lambda e: e.fit + e.check)
        explainable = float((pick(before) - counts).sum())
        return (
            float((pick(before) - pick(after)).sum()) / explainable if explainable > 0.0 else 0.0
        )

    def material(self, before: Explanation, after: Explanation) -> bool:
        """Whether a step closes enough to count, on all data and on the data held out."""
        if not before.effects and self.vouched(before, after):
            return True
        fall = self.gap(before) - self.gap(after)
        reduced = float(np.sqrt(np.maximum(fall, 0.0)).max())
        least = self.rules.step if not before.effects else self.rules.later
        if reduced < least or self.share(before, after) < self.rules.share:
            return False
        return self.confirmed(before, after, int(fall.argmax()))

    def confirmed(self, before: Explanation, after: Explanation, drive: int) -> bool:
        """Whether the data held out speak for a step that gains most on a drive.

        Where their motion does not excite what the step explains, they cannot; then they must at
        least not speak against it.
        """
        if self.share(before, after, 'check') >= self.rules.share:
            return True
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
    def beside(e: Explanation) -> bool:
        """Whether the newest effect sits where an earlier one does and may only mend its form."""
        *earlier, newest = (at.where for at in e.effects)
        return bool(earlier) and (newest in earlier or 'all' in (newest, *earlier))

    def vouched(self, before: Explanation, after: Explanation) -> bool:
        """Whether the controllers' log was far from the stated law and now agrees with it.

        It knows nothing of the machine, so this holds also where the outputs are too violent to
        be repeated: these must only not become much worse. A gain that is a little off shows
        there, too, and hardly in the outputs.
        """
        worst = int(before.law.argmax())
        excess = float(before.law[worst]) - 1.0
        if excess <= 1.0:
            return False
        left = float(after.law[worst]) - 1.0
        agrees = left < max(min(1.0, _MISSED * excess), _NEARLY * excess)
        share = self.share(before, after)
        noise = self.floor.noise[worst]
        lost = self.size(before) > _VIOLENT or noise.variance > _LOST**2 * noise.innovation
        return agrees and ((lost and share > -0.5) or share >= self.rules.share)

    def score(self, e: Explanation) -> float:
        """Return what is minimised over models: loss on both parts, and BIC's penalty."""
        samples = self.fit_count.sum() + self.check_count.sum()
        return e.loss + float(np.log(samples)) * len(e.theta)

    def contradicted(self, e: Explanation, other: Explanation) -> bool:
        """Whether the controllers' log speaks against an explanation and for another one.

        The recorded effort, beside what controllers make of the recorded motion, knows nothing of
        the machine: an effect in a controller or a sensor that is not there makes them disagree,
        and one that is there and left out keeps them disagreeing.
        """
        more = e.law - other.law
        # An explanation that agrees better on the whole is not refuted by a trifle on one drive.
        if more.sum() <= 0.0:
            return False
        worst = int(more.argmax())
        clearly = more[worst] > 0.5 * max(float(e.law[worst]) - 1.0, 0.0)
        return bool(np.sqrt(more[worst]) > self.rules.contradicted and clearly)

    def plausible(self, e: Explanation) -> bool:
        """Whether the newest effect's sizes stay inside their bounds."""
        parameters = self.attribution.case.fit.models[0].scaled(e.effects[-1])
        values = e.theta[-len(parameters) :]
        return not any(at_bound(p, v) for p, v in zip(parameters, values, strict=True))

    def best(self, round_: Round) -> Explanation | None:
        """Return the best fit, a simple effect before one that is hardly better."""
        if not round_.fitted:
            return None
        best = min(round_.fitted, key=self.score)
        if not round_.base.effects and self.share(round_.base, best) < self.rules.closed:
            vouched = [e for e in round_.fitted if self.vouched(round_.base, e)]
            if vouched:
                return min(vouched, key=self.score)
        inside = [e for e in round_.fitted if self.plausible(e)]
        if inside:
            # A size at its bound is a reason to doubt, unless nothing else comes near.
            usable = min(inside, key=self.score)
            close = self.share(round_.base, usable) > 0.5 * self.share(round_.base, best)
            best = usable if close else best
        # So is the controllers' log.
        least = self.rules.instead * self.share(round_.base, best)
        rivals = [
            e
            for e in inside
            if self.contradicted(best, e) and self.share(round_.base, e) >= least
        ]
        return min(rivals, key=self.score) if rivals else best

    def explain(
        self,
        base: Explanation,
        candidates: Sequence[EffectAt],
        on_best: Callable[[Explanation], None],
    ) -> Explained:
        """Add effects while they are material, drop what became superfluous, look for rivals."""
        chain, rounds = [base], []
        stopped = self.attribution.stopped
        while len(chain) <= self.rules.most and self.open(chain[-1]) and not stopped():
            round_ = self.attribution.round(
                chain[-1], candidates, fits=12 if len(chain) == 1 else 8
            )
            rounds.append(round_)
            best = self.best(round_)
            if best is None:
                break
            if not self.material(chain[-1], best):
                again = None if stopped() else self.less_noise(chain, rounds, best)
                again = again or self.confirmed_one(chain, rounds, best)
                if again is None:
                    break
                chain, rounds, best = again
            if self.beside(best) and self.closes(chain, best) < self.rules.part:
                break
            if len(chain) == 1 and not stopped():
                plain = self.freed(base, best)
                if plain is not base:
                    return self.explain(plain, candidates, on_best)
            chain.append(best)
            if len(chain) > 2 and not stopped():
                chain = self.prune(chain)
            on_best(chain[-1])
            if not stopped():
                chain, rounds = self.looked_again(chain, rounds)
        rests = self.rests(chain)
        if not stopped():
            chain, rests = self.ordered(chain, rests)
        rivals = self.rivals(chain, rounds)
        return Explained(
            tuple(chain), tuple(rounds), rivals, rests, self.size(chain[-1]), not stopped()
        )

    def open(self, e: Explanation) -> bool:
        """Whether more may be missing: by what is left, or by how slow what is called noise is.

        What a large effect does is no straight line in it, and can look like slow noise.
        """
        if self.size(e) >= self.rules.material:
            return True
        slow = [m.variance > _SLOW**2 * m.innovation for m in self.floor.noise]
        return not e.effects and any(slow)

    def less_noise(
        self, chain: list[Explanation], rounds: list[Round], best: Explanation
    ) -> tuple[list[Explanation], list[Round], Explanation] | None:
        """Return chain, rounds and best fit at the noise that is left with the best effect.

        None where that noise is the same, or the effect does not count even so.
        """
        seen = self.noise_of(best)
        attribution, floor, fits = self.attribution, self.floor, self.attribution.fits
        if not (seen.floor.per_drive < _LOWER * attribution.floor).any():
            return None
        self.floor = seen.floor
        (*renewed, best), rounds = attribution.renew(
            seen.floor.per_drive, [*chain, best], rounds
        )
        best = attribution.refit(best.effects, best.theta)
        if self.material(renewed[-1], best):
            return renewed, rounds, best
        self.floor, attribution.fits = floor, fits
        return None

    def confirmed_one(
        self, chain: list[Explanation], rounds: list[Round], best: Explanation
    ) -> tuple[list[Explanation], list[Round], Explanation] | None:
        """Return chain, rounds and the best fit that counts where the data held out refute `best`.

        None where none comes near it.
        """
        base = chain[-1]
        least = _NEAR * self.share(base, best)
        counts = [
            e
            for e in rounds[-1].fitted
            if self.share(base, e) >= least and self.plausible(e) and self.material(base, e)
        ]
        return (chain, rounds, min(counts, key=self.score)) if counts else None

    def looked_again(
        self, chain: list[Explanation], rounds: list[Round]
    ) -> tuple[list[Explanation], list[Round]]:
        """Look at the noise once more, now that a cause of the residual is known.

        What an effect does beyond a straight line is no noise, though it looked like it before.
        """
        attribution = self.attribution
        seen = self.noise_of(chain[-1])
        if not (seen.floor.per_drive < _LOWER * attribution.floor).any():
            return chain, rounds
        self.floor = seen.floor
        chain, rounds = attribution.renew(seen.floor.per_drive, chain, rounds)
        return [*chain[:-1], attribution.refit(chain[-1].effects, chain[-1].theta)], rounds

    def noise_of(self, e: Explanation) -> Predictability:
        """Return what can be predicted of what a fit leaves on all recordings, and what cannot."""
        if self._seen is None or self._seen[0] is not e.theta:
            joint = self.attribution.case.whole.with_effects(e.effects)
            seen = predictability(joint, e.theta, self.attribution.stopped)
            self._seen = (e.theta, seen)
        return self._seen[1]

    def freed(self, base: Explanation, best: Explanation) -> Explanation:
        """Return the nominal fit, or a better one that was found from a fit with an effect.

        Where a motion hardly excites a parameter, the nominal fit may have ended at a value that
        the recording held out refutes, and any effect that lets the fit go on from there would
        look like the cause.
        """
        plain = self.attribution.refit((), best.theta[: len(base.theta)])
        as_good = plain.cost < base.cost + _TIE
        if not as_good or self.share(base, plain) < self.rules.part:
            return base
        return replace(plain, law=np.minimum(base.law, plain.law))

    def rests(self, chain: Sequence[Explanation]) -> tuple[Explanation, ...]:
        """For each effect of the final model, what is left when it is taken out again."""
        final = chain[-1]
        if len(final.effects) == 1:
            return (chain[0],)
        return tuple(
            chain[-2] if index == len(final.effects) - 1 else self.without(final, index)
            for index in range(len(final.effects))
        )

    def ordered(
        self, chain: list[Explanation], rests: tuple[Explanation, ...]
    ) -> tuple[list[Explanation], tuple[Explanation, ...]]:
        """Put first what the final model needs most, where that is not what came first."""
        final = chain[-1]
        needs = np.array([e.loss - final.loss for e in rests])
        if len(final.effects) < 2 or needs.max() < _NEEDED * max(float(needs[0]), 0.0):
            return chain, rests
        order = [int(i) for i in np.argsort(-needs, kind='stable')]
        effects = tuple(final.effects[i] for i in order)
        nominal = len(chain[0].theta)
        columns = [list(range(nominal)), *(self.columns(final, i) for i in order)]
        theta = final.theta[np.concatenate(columns)]
        steps, end = [chain[0]], nominal
        for count in range(1, len(effects)):
            end += len(columns[count])
            steps.append(self.attribution.refit(effects[:count], theta[:end]))
        steps.append(self.attribution.refit(effects, theta))
        return steps, tuple(rests[i] for i in order)

    def without(self, e: Explanation, index: int) -> Explanation:
        """Refit a model with one effect taken out."""
        effects = tuple(x for i, x in enumerate(e.effects) if i != index)
        theta = np.delete(e.theta, self.columns(e, index))
        return self.attribution.refit(effects, theta)

    def columns(self, e: Explanation, index: int) -> list[int]:
        """Return the columns of theta that hold an effect's parameters."""
        sizes = [len(get_effect(x.effect).parameters) for x in e.effects]
        first = len(e.theta) - sum(sizes[index:])
        return list(range(first, first + sizes[index]))

    def prune(self, chain: list[Explanation]) -> list[Explanation]:
        """Drop earlier effects that a later one has made superfluous."""
        full = chain[-1]
        kept = full
        for index in range(len(full.effects) - 2, -1, -1):
            less = self.without(kept, index)
            if not self.material(less, kept):
                kept = less
        if len(kept.effects) == len(full.effects):
            return chain
        steps = [chain[0]]
        for count in range(1, len(kept.effects)):
            part = self.attribution.refit(
                kept.effects[:count], kept.theta[: self.columns(kept, count)[0]]
            )
            steps.append(part)
        return [*steps, kept]

    def rivals(
        self, chain: Sequence[Explanation], rounds: Sequence[Round]
    ) -> tuple[tuple[Explanation, ...], ...]:
        """For each effect found, put its rivals in its place in the final model."""
        final = chain[-1]
        out: list[tuple[Explanation, ...]] = []
        for index, effect in enumerate(final.effects):
            source = next(
                (r for r in rounds if any(e.effects[-1] == effect for e in r.fitted)), None
            )
            if source is None:
                out.append((final,))
                continue
            leader = next(e for e in source.fitted if e.effects[-1] == effect)
            if len(final.effects) == 1:
                out.append(tuple(source.fitted))
                continue
            closes = source.base.loss - leader.loss
            near = [
                e
                for e in source.fitted
                if e.effects[-1] not in final.effects and source.base.loss - e.loss > 0.5 * closes
            ][:4]
            models = [final]
            for other in near:
                if self.attribution.stopped():
                    break
                columns = self.columns(final, index)
                count = len(get_effect(other.effects[-1].effect).parameters)
                theta = np.concatenate([np.delete(final.theta, columns), other.theta[-count:]])
                rest = tuple(x for i, x in enumerate(final.effects) if i != index)
                models.append(self.attribution.refit((*rest, other.effects[-1]), theta))
            out.append(tuple(sorted(models, key=lambda e: e.loss)))
        return tuple(out)
