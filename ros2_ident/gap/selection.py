# SPDX-License-Identifier: Apache-2.0
"""From rounds of fits to the effects that are there: selection, elimination, rivals."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from itertools import pairwise
import math
from typing import Any

import numpy as np

from ros2_ident.arrays import Array, NORMAL
from ros2_ident.effects import get_effect
from ros2_ident.gap.fits import Fits, PROMISING
from ros2_ident.gap.fitter import Fitter
from ros2_ident.gap.hypothesis import Hypothesis, Round, Selection
from ros2_ident.gap.imitation import in_place_of, noise_does
from ros2_ident.gap.noise_floor import Floor, predictability
from ros2_ident.gap.recordings import are_alike, Part, Split
from ros2_ident.gap.result import NOISE, PARAMETERS, Tie
from ros2_ident.gap.rules import Rules, TIE
from ros2_ident.gates.scale import ANOTHER, near
from ros2_ident.models import EffectAt
from ros2_ident.models.trials import turns_of
from ros2_ident.search import intervals
from ros2_ident.search.evidence import Certainty, Evidence
from ros2_ident.search.jacobian import Known
from ros2_ident.search.noise import correlation_time


class Selector(Fitter):
    """Runs the rounds and judges their fits; further arguments as of `Fitter`.

    Args:
        split: The recordings.
        floor: The noise that they are fitted under.
        rules: When something counts.
        steps: (D,) what steps of encoders put into the floor, RMS.

    Attributes:
        shown: Effects that stay since the controllers' log shows them.
        like_noise: Fit that ends with the effect in whose place noise of the recorded motion does
            as much; None where there is none.
    """

    def __init__(
        self,
        split: Split,
        floor: Floor,
        rules: Rules | None = None,
        steps: Array | float = 0.0,
        **more: Any,
    ) -> None:
        super().__init__(split, floor.per_drive, certain=_certain(floor), **more)
        self.floor = floor
        self.rules = rules or Rules()
        self.shown: tuple[EffectAt, ...] = ()
        self.like_noise: Hypothesis | None = None
        self.steps = steps
        self._seen: dict[frozenset[EffectAt], tuple[Hypothesis, Floor]] = {}

    def on_all(self, e: Hypothesis) -> tuple[Hypothesis, Fits]:
        """Return a fit made on the blocks held out as well, and those it is one of.

        As identifications are; a bag that is held out stays out.
        """
        if self.split.held_out != 'blocks':
            return e, self.fits
        fits = Fits(self.split.together(), self.fits.floor, self.stopped, self.fits.missed)
        return fits.refit(e.effects, e.theta), fits

    def ends(
        self, e: Hypothesis, evidence: Evidence | None, fits: Fits | None = None
    ) -> tuple[Array, Array]:
        """Return (4, N) ends of each parameter's 95 % interval and of that by noise alone.

        And (N, N) correlations of the estimates.

        Args:
            e: The fit.
            evidence: Of what it leaves; without it the intervals are those by noise.
            fits: Those it is one of; the present ones where None.
        """
        fits = fits or self.fits
        part, rows, masks = fits.split.fit, len(fits.weight), fits.split.fit.masks
        joint, law = part.with_effects(e.effects), e.jacobian[rows:]
        # Where efforts are compared, those that the law makes say nothing new.
        if len(law) and part.models[0].outputs[0].quantity != 'effort':
            rows, masks = len(e.residual), (*masks, *part.law_masks)
            evidence = evidence and evidence.with_rows(law / self._slow(e.residual, part))
        told = partial(
            intervals,
            e.jacobian[:rows] / (joint.high - joint.low),
            e.residual[:rows],
            e.theta,
            joint.low,
            joint.high,
            series=[int(s) for mask in masks for s in mask.sum(axis=1)],
        )
        known = joint.box.known
        found = told(known=known)
        own = enumerate(e.numbers, len(e.theta) - len(e.numbers))
        loose = [k for k, (_, p, _) in own if p.limit and math.isinf(found.high[k])]
        if loose:
            # A parameter does what the law's limit does, so any value will do: the others are
            # meant at this one, to a ten-thousandth of its box. By hand.
            held = 1e4 * np.eye(len(e.theta))[loose]
            found = told(known=Known(np.vstack([held, known.rows]) if known else held, e.unit))
            evidence = evidence and evidence.with_rows(held)
        noise = found.low, found.high
        ends = noise
        if evidence is not None:
            ends = evidence.ends(e.theta, joint.low, joint.high, *noise)
        out = np.stack([*ends, *noise])
        out[:, loose] = np.array([[-math.inf], [math.inf]] * 2)
        return out, found.correlation

    @staticmethod
    def _slow(residual: Array, part: Part) -> Array:
        """Return (L, 1) the factor on the errors of the law's rows, as they are autocorrelated."""
        ends = np.cumsum([s for mask in part.law_masks for s in mask.sum(axis=1)])
        series = np.split(residual[len(residual) - ends[-1] :], ends[:-1])
        factors = [np.full(x.size, math.sqrt(correlation_time(x))) for x in series]
        return np.concatenate(factors)[:, None]

    # ------------------------------------------------------------------ selection

    def select(
        self,
        base: Hypothesis,
        candidates: Sequence[EffectAt],
        on_best: Callable[[Hypothesis, Hypothesis], None],
        limited: Hypothesis | None = None,
    ) -> Selection:
        """Add effects while they are material, drop superfluous ones, look for rivals.

        Args:
            base: The nominal fit.
            candidates: Effects at places.
            on_best: Told the nominal fit, in units of the present floor, and what is found.
            limited: The fit with the limits that the control laws show; these stay.
        """
        chain, rounds, ties = [base], list[Round](), list[Tie]()
        if limited is not None:
            self.shown = limited.effects
            chain, rounds = self.steps_to(limited, chain), [Round(base, {}, (limited,))]
            # How far a limited drive moves hangs on each instant of its limit: what the fit leaves
            # there is taken for anything.
            places = {at.where for at in self.shown}
            candidates = [c for c in candidates if c.where not in places]
        while len(rounds) < self.rules.most and self.rules.open(chain[-1]) and not self.stopped():
            round_, tied = self.untied(self.round(chain[-1], candidates))
            rounds.append(round_)
            ties += tied
            best = self.rules.best(round_)
            if best is None or not self.counts(chain[-1], best):
                break
            further = self.refit(chain[-1].effects, best.theta[: len(chain[-1].theta)])
            if _further(further, chain[-1]):
                # It had not come to its end: what that closes is no merit of the effect.
                chain = [*chain[:-1], further]
                if not self.counts(further, best):
                    continue
            if self.rules.mends_a_form(chain, best):
                break
            before, chain = chain, self.pruned(chain, best)
            if chain[-1].bic >= before[-1].bic:
                chain = before
                break
            on_best(chain[0], chain[-1])
            if not self.stopped():
                chain, rounds = self.with_new_floor(chain, rounds)
                chain = self.settled(chain)
        if chain[-1].effects and not self.stopped():
            chain = self.on_like_drives(chain, candidates)
        rests = self.rests(chain)
        if not self.stopped():
            chain, rests = self.with_plainer_laws(chain, rests, rounds)
            chain, rests = self.ordered(chain, rests)
        shown = {at.where for at in self.shown}
        return Selection(
            self.split.drives,
            tuple(chain),
            tuple(rounds),
            self.rivals(chain, rounds),
            rests,
            not self.stopped(),
            {drive: limit for drive, limit in self.limits.items() if drive in shown},
            self.restless(),
            tuple(ties),
        )

    def settled(self, chain: list[Hypothesis]) -> list[Hypothesis]:
        """Return the chain without its last effects where the fit before had not come to its end.

        Refitted, the last may be gone: what it closed was then the end of the search before it.
        """
        final, count = chain[-1], len(chain[-2].theta)
        less = self.refit(chain[-2].effects, final.theta[:count])
        if not _further(less, chain[-2]):
            return chain
        chain = [*chain[:-2], less]
        return [*chain, final] if self.counts(less, final) else chain

    def untied(self, round_: Round) -> tuple[Round, list[Tie]]:
        """Return a round without what is refuted.

        And without leaders that something else imitates, which are returned as well.
        """
        ties, base = list[Tie](), round_.base
        allowed = tuple(e for e in round_.fitted if not self.refuted(e))
        round_ = replace(round_, fitted=allowed)
        while (best := self.rules.best(round_)) and self.rules.is_material(base, best):
            new = best.effects[len(base.effects) :]
            hidden = self.noise_hides(base, best)
            tied = [tie for at in new if (tie := self.tie(base, best, at, hidden))]
            if not tied or self.stopped():
                break
            # What follows a set-point is simulated without the recorded motion's noise.
            if self.split.fit.models[0].thinned and len(new) == 1 and NOISE in tied[0].like:
                self.like_noise = self.like_noise or best
            ties += tied
            round_ = replace(round_, fitted=tuple(e for e in round_.fitted if e is not best))
        return round_, ties

    def refuted(self, e: Hypothesis) -> bool:
        """Return whether a fit has gains that its drive's effort refutes, or one ripple as two.

        Where the log is too slow for the controllers' rows no fit sees such gains. Two orders that
        differ by less than a period over the stroke are one (Rayleigh's criterion).
        """
        orders = sorted((at.where, x) for at, p, x in e.numbers if p.role == 'order')
        model = self.split.fit.models[0]
        return any(
            p.how == 'scale' and at.where in self.laws and self.laws[at.where].refutes(p.target, x)
            for at, p, x in e.numbers
        ) or any(
            one == other and (second - first) * turns_of(model, one) < 1.0
            for (one, first), (other, second) in pairwise(orders)
        )

    def tie(self, base: Hypothesis, e: Hypothesis, at: EffectAt, hidden: bool) -> Tie | None:
        """Return what does along this motion what an effect does; None for nothing.

        It has to count beside other values of the parameters, and to have a share of its own.
        Where functions of a coordinate that its law does not read close as much, but for what
        forms of a law differ by, the motion does not tell on which a force depends.

        Args:
            base: The fit before.
            e: The fit that holds it.
            at: The effect.
            hidden: Whether noise of the motion hides it, see `noise_hides`.
        """
        own, others = in_place_of(self.fits, e, at)
        counts = self.rules.is_material(others.pop(PARAMETERS)[0], e)
        like = [] if counts and own >= self.rules.own else [PARAMETERS]
        like += [
            name
            for name, (less, both) in others.items()
            if max(e.closes(base), both.closes(base)) - less.closes(base) < self.rules.alike
        ]
        like += [NOISE] * (hidden or noise_does(self.fits, e, at))
        beside = len(e.effects) - len(base.effects) - 1
        return Tie(at.effect, at.where, e.closes(base), tuple(like), beside) if like else None

    def noise_hides(self, base: Hypothesis, e: Hypothesis) -> bool:
        """Return whether a step does not count beside an effect in whose place noise does as much.

        That effect stands for noise of the recorded motion, which no column tells of.
        """
        if self.like_noise is None or (noise := self.like_noise.effects[-1]) in e.effects:
            return False
        own = self.like_noise.theta[self.like_noise.columns(-1)]
        less, more = (
            self.refit((*x.effects, noise), np.concatenate([x.theta, own])) for x in (base, e)
        )
        return not self.rules.is_material(less, more)

    def restless(self) -> dict[str, float]:
        """Return the floors of drives that are too large and slow for noise.

        Efforts that are compared below a frequency only are slow, whatever makes them.
        """
        model = self.split.fit.models[0]
        if model.thinned:
            return {}
        stated = model.machine is None or model.machine.stated('effort_noise')
        slow = self.floor.restless(model.noise if stated else 0.0)
        every = zip(self.split.drives, self.floor.per_drive.tolist(), slow, strict=True)
        return {name: value for name, value, restless in every if restless}

    def counts(self, before: Hypothesis, after: Hypothesis) -> bool:
        """Whether a step is material, and would be at the lower end of its 95 % interval.

        The interval is that of noise as slow as what is left: under it chance closes a lot, and of
        a motion that is integrated from an effort more than the noise itself.
        """
        return self.rules.is_material(before, after) and self.rules.is_certain(
            before, after, self.standing(before, after)
        )

    def on_like_drives(
        self, chain: list[Hypothesis], candidates: Sequence[EffectAt]
    ) -> list[Hypothesis]:
        """Extend effects to sister drives on which they stand out of noise.

        Drives of one kind are built alike, so that an effect of about the same size needs no gap
        that counts by itself: it has to stand out of noise, and to close more than the forms of
        those found leave.
        """
        final = chain[-1]
        if not are_alike(self.split.fit.models[0]):
            return chain
        names = {at.effect for at in final.effects if at.where in self.split.drives}
        more = [at for at in candidates if at.effect in names and at.where in self.split.drives]
        starts = [s[0] for s in self.look(final, more).values() if s[0].gain > TIE]
        least = self.rules.alike * (chain[0].loss - final.loss)
        while starts and not self.stopped():
            new = tuple(at for s in starts for at in s.effects)
            phi = [s.phi for s in starts]
            wide = self.refit((*final.effects, *new), np.concatenate([final.theta, *phi]))
            kept = [s for s in starts if self.like_others(wide, s.effects[0], least)]
            if len(kept) == len(starts):
                better = wide.bic < final.bic
                held_out = wide.check.sum() < final.check.sum()
                return self.steps_to(wide, chain) if better and held_out else chain
            starts = kept
        return chain

    def like_others(self, e: Hypothesis, at: EffectAt, least: float) -> bool:
        """Whether an effect stands out of noise, and is as large as on another drive of a fit.

        Args:
            e: The fit.
            at: The effect.
            least: Loss that it has to take away at least.
        """
        joint = self.split.fit.with_effects(e.effects)
        sizes = {
            other: float(np.linalg.norm(e.theta - joint.without(e.theta, [other])))
            for other in e.effects
            if other.effect == at.effect
        }
        own = sizes.pop(at)
        if not any(near(own / (x or math.inf), ANOTHER) for x in sizes.values()):
            return False
        less = self.without(e, e.effects.index(at))
        return less.loss - e.loss > least and self.standing(less, e) > NORMAL

    def with_new_floor(
        self, chain: list[Hypothesis], rounds: list[Round]
    ) -> tuple[list[Hypothesis], list[Round]]:
        """Look at the noise once more, now that a cause of the residual is known.

        What an effect does beyond a straight line is no noise, though it looked like it before. A
        floor is taken over where the end of its interval is below the one before.
        """
        floor = self.noise_of(chain[-1])
        if not (floor.high < self.fits.floor).any():
            return chain, rounds
        self.floor = floor
        chain, rounds = self.renew(floor.per_drive, _certain(floor), chain, rounds)
        return [*chain[:-1], self.refit(chain[-1].effects, chain[-1].theta)], rounds

    def noise_of(self, e: Hypothesis) -> Floor:
        """Return the noise floor of a fit on all recordings.

        Known once for a set of effects: another order and other weights change no noise, and to
        first order the parameters end up where they did.
        """
        key = frozenset(e.effects)
        if key not in self._seen:
            self.on_step(1.0, 'telling noise from what the motion predicts')
            joint = self.split.whole.with_effects(e.effects)
            self.knows(e, predictability(joint, e.theta, self.stopped, self.steps))
        made, seen = self._seen[key]
        if made is e:
            return seen
        own = (made.columns(made.effects.index(at)) for at in e.effects)
        count = made.columns(0)[0] if made.effects else len(made.theta)
        order = np.concatenate([np.arange(count), *own])
        joint = self.split.fit.with_effects(e.effects)
        moved = (made.theta[order] - e.theta) / (joint.high - joint.low)
        known = seen.evidence
        assert known is not None

        def tell() -> Certainty:
            shift, covariance = known.parameters
            return Certainty(shift[order] + moved, covariance[np.ix_(order, order)])

        return replace(seen, evidence=replace(known, tell=tell))

    def knows(self, e: Hypothesis, seen: Floor) -> None:
        """Cache the noise floor of a set of effects."""
        self._seen[frozenset(e.effects)] = e, seen

    def rests(self, chain: Sequence[Hypothesis]) -> tuple[Hypothesis, ...]:
        """Return the final model without each of its effects, refitted."""
        final = chain[-1]
        if len(final.effects) == 1:
            return (chain[0],)
        return tuple(
            chain[-2] if index == len(final.effects) - 1 else self.without(final, index)
            for index in range(len(final.effects))
        )

    def with_plainer_laws(
        self,
        chain: list[Hypothesis],
        rests: tuple[Hypothesis, ...],
        rounds: Sequence[Round],
    ) -> tuple[list[Hypothesis], tuple[Hypothesis, ...]]:
        """Put laws of fewer numbers in the place of those that now need no more.

        While another cause was missing, the numbers of a law took up part of it. One that hardly
        bends any more goes where something smooth does as much.
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
            best = self.rules.plainest(rest, [final, *tried])
            ended = get_effect(at.effect).bent and final.limits(at)
            if ended and len(final.effects) > 1 and self.tie(rest, final, at, hidden=False):
                best = rest
            if best is not final:
                chain = self.steps_to(best, chain[:1])
                rests = self.rests(chain)
        return chain, rests

    @staticmethod
    def instead_of(
        at: EffectAt, final: Hypothesis, rounds: Sequence[Round]
    ) -> list[tuple[EffectAt, Hypothesis]]:
        """Return effects, not in the final model, that closed over half as much when one led."""
        source = next((r for r in rounds if at in r.alone), None)
        if source is None:
            return []
        closes = source.base.loss - source.alone[at].loss
        return [
            (other, e)
            for other, e in source.alone.items()
            if other not in final.effects and source.base.loss - e.loss > PROMISING * closes
        ]

    def swapped(
        self, final: Hypothesis, at: EffectAt, other: EffectAt, e: Hypothesis
    ) -> Hypothesis:
        """Refit a model with another effect in the place of one, from a fit that ends with it."""
        index, count = final.effects.index(at), len(get_effect(other.effect).parameters)
        theta = np.delete(final.theta, final.columns(index))
        effects = (*final.effects[:index], *final.effects[index + 1 :], other)
        return self.refit(effects, np.concatenate([theta, e.theta[-count:]]))

    def ordered(
        self, chain: list[Hypothesis], rests: tuple[Hypothesis, ...]
    ) -> tuple[list[Hypothesis], tuple[Hypothesis, ...]]:
        """Put the effect that the final model needs most first."""
        final = chain[-1]
        needs = np.array([e.loss - final.loss for e in rests])
        # Several of one effect at a place stay in their turn, where the most needed of them is.
        roots = [(_root(at), at.where) for at in final.effects]
        needs = np.array([max(needs[[r == own for r in roots]]) for own in roots])
        if len(final.effects) < 2 or not needs.argmax():
            return chain, rests
        order = [int(i) for i in np.argsort(-needs, kind='stable')]
        effects = tuple(final.effects[i] for i in order)
        nominal = list(range(len(chain[0].theta)))
        columns = [nominal, *(final.columns(i) for i in order)]
        theta = final.theta[np.concatenate(columns)]
        steps = self.steps_to(self.refit(effects, theta), chain[:1])
        return steps, tuple(rests[i] for i in order)

    def without(self, e: Hypothesis, index: int) -> Hypothesis:
        """Refit a model with one effect taken out."""
        effects = tuple(x for i, x in enumerate(e.effects) if i != index)
        theta = np.delete(e.theta, e.columns(index))
        return self.refit(effects, theta)

    def pruned(self, chain: list[Hypothesis], best: Hypothesis) -> list[Hypothesis]:
        """Return the chain to a fit, without the effects that its last one makes superfluous."""
        kept = best
        for index in range(len(best.effects) - 2, -1, -1):
            if self.stopped():
                break
            at = best.effects[index]
            if (
                at in self.shown
                or replace(at, effect=get_effect(at.effect).further) in kept.effects
            ):
                continue
            less = self.without(kept, index)
            # Against all of them: one by one hardly anything would count.
            if not self.rules.is_material(less, best):
                kept = less
        return self.steps_to(kept, chain)

    def steps_to(self, e: Hypothesis, chain: list[Hypothesis]) -> list[Hypothesis]:
        """Return the chain to a fit, effect by effect, as far as it can be from another chain."""
        same = e.effects[: len(chain) - 1] == chain[-1].effects
        steps = list(chain) if same else chain[:1]
        for count in range(len(steps), len(e.effects)):
            theta = e.theta[: e.columns(count)[0]]
            steps.append(self.refit(e.effects[:count], theta))
        return [*steps, e]

    def rivals(
        self, chain: Sequence[Hypothesis], rounds: Sequence[Round]
    ) -> tuple[Hypothesis, ...]:
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


def _root(at: EffectAt) -> str:
    """Return the id of the first of several of an effect."""
    effect = get_effect(at.effect)
    return effect.variant_of if effect.number > 1 else effect.id


def _certain(floor: Floor) -> Array:
    """Return (D,) the square of a floor over the upper end of its interval."""
    out: Array = (floor.per_drive / floor.high) ** 2
    return out


def _further(after: Hypothesis, before: Hypothesis) -> bool:
    """Whether a fit of the same effects goes on where another had not come to its end.

    What it closes on the fit part alone is chance.
    """
    return after.cost < before.cost - TIE and after.loss < before.loss
