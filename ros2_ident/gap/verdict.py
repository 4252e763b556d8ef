# SPDX-License-Identifier: Apache-2.0
"""Verdict, its probability, and the effects that it may be confused with."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
import math

import numpy as np
import scipy

from ros2_ident.arrays import NORMAL
from ros2_ident.effects import get_effect
from ros2_ident.gap.hypothesis import Hypothesis, Selection
from ros2_ident.gap.result import Cause, Facts
from ros2_ident.gap.rules import Rules, Temperatures
from ros2_ident.gap.suspects.encoder_steps import EncoderSteps
from ros2_ident.models import EffectAt

NONE, UNKNOWN = 'none', 'unknown'
# Log and machine file contradict each other; the model is not the machine's. Nothing physical is
# said then.
BOOKKEEPING, WRONG_MODEL = 'bookkeeping', 'model'
REFUSED = frozenset({BOOKKEEPING, WRONG_MODEL})
# Answers that name no effect.
NAMELESS = REFUSED | {NONE, UNKNOWN}


@dataclass(frozen=True)
class RankedFit:
    """One effect at one place with its probability.

    Attributes:
        at: The effect and its place.
        probability: That it is the cause.
        model: The fit that holds it.
    """

    at: EffectAt
    probability: float
    model: Hypothesis


@dataclass(frozen=True)
class Verdict:
    """The answer.

    Attributes:
        effect: Id, or one of `NAMELESS`.
        where: Place: a drive, `all`, or empty for `none`.
        probability: Of this answer.
        also: Further effects found, in order.
        confusable: What this data cannot tell from the verdict's effect.
        ranking: Every effect fitted first round, the most probable first.
        closed: Share of the explainable gap that all effects found close.
        encoders: Encoders whose steps cause what is left on their drives.
        facts: Facts behind it, as far as they are known by now.
    """

    effect: str
    where: tuple[str, ...]
    probability: float
    also: tuple[EffectAt, ...] = ()
    confusable: tuple[RankedFit, ...] = ()
    ranking: tuple[RankedFit, ...] = ()
    closed: float = 0.0
    encoders: tuple[EncoderSteps, ...] = ()
    facts: Facts = Facts()

    @property
    def named(self) -> tuple[EffectAt, ...]:
        """The effects that are named, in order; none where the answer names none."""
        if self.effect in NAMELESS:
            return ()
        return (EffectAt(self.effect, self.where[0]), *self.also)

    def cause(self, *, complete: bool) -> Cause:
        """Return the kind of answer of a diagnosis that is complete, or was cut short."""
        if self.effect == BOOKKEEPING:
            return Cause.CONSTANT if self.facts.constants else Cause.LOG
        if self.effect != UNKNOWN:
            return {NONE: Cause.NONE, WRONG_MODEL: Cause.MODEL}.get(self.effect, Cause.EFFECT)
        if self.facts.events or self.facts.slow:
            return Cause.EVENTS if self.facts.events else Cause.SLOW
        return Cause.UNKNOWN if complete else Cause.CUT_SHORT


def twins(at: EffectAt) -> list[EffectAt]:
    """Return effects that no log can tell from this one."""
    return [EffectAt(other, at.where) for other in get_effect(at.effect).twins]


def judge(
    found: Selection,
    encoders: Sequence[EncoderSteps] = (),
    rules: Rules | None = None,
    temperatures: Temperatures | None = None,
) -> Verdict:
    """Turn a selection into an answer.

    Args:
        found: The chain of hypotheses and the rivals.
        encoders: Encoders whose steps show in what their controllers miss.
        rules: When something counts.
        temperatures: How differences become probabilities.

    Returns:
        The verdict.
    """
    rules, t = rules or Rules(), temperatures or Temperatures()
    gap = np.sqrt(np.maximum(found.chain[-1].gap, 0.0))
    left = [r for r in encoders if gap[found.drives.index(r.drive)] >= rules.material]
    if left:
        return _with_encoder_steps(found, left, rules, t)
    plain = _judge(found, rules, t)
    if plain.effect != NONE or not found.complete or not found.restless:
        return plain
    # Nothing that can be predicted is left, and more than noise.
    return replace(
        plain,
        effect=UNKNOWN,
        where=_together(tuple(found.restless), found.drives),
        probability=t.restless,
        facts=Facts(slow=found.restless),
    )


def _with_encoder_steps(
    found: Selection, encoders: Sequence[EncoderSteps], rules: Rules, t: Temperatures
) -> Verdict:
    """Answer where encoders' steps leave a gap that no simulation repeats, so none closes."""
    drives = found.drives
    before, after = (np.maximum(e.gap, 0.0) for e in (found.chain[0], found.chain[-1]))
    rest = np.array([d not in {r.drive for r in encoders} for d in drives])
    strongest = max(encoders, key=lambda r: after[drives.index(r.drive)])
    coarse = tuple(r.at for r in encoders)
    plain = _judge(found, rules, t)
    chain = found.chain[-1].effects
    shaken = (rules.shaken**2) * float(after[drives.index(strongest.drive)])
    least = max(rules.unknown**2, shaken)
    unexplained = float(after[rest].max(initial=0.0)) >= least
    first = strongest.at
    closes = float((before - after).sum())
    sure = scipy.special.expit((float(np.sqrt(before.max())) - rules.material) / t.size)
    if not chain and unexplained and plain.effect == UNKNOWN:
        # Something else is missing, and more than steps.
        return plain
    if chain and closes > float(after[drives.index(strongest.drive)]):
        others = tuple(a for a in coarse if a not in chain)
        if plain.effect == UNKNOWN and not unexplained:
            plain = replace(plain, effect=chain[0].effect, where=(chain[0].where,), also=chain[1:])
        return replace(plain, also=(*plain.also, *others), encoders=tuple(encoders))
    return Verdict(
        first.effect,
        (first.where,),
        t.sure * sure,
        also=tuple(a for a in dict.fromkeys((*chain, *coarse)) if a != first),
        ranking=plain.ranking,
        closed=plain.closed,
        encoders=tuple(encoders),
    )


def _judge(found: Selection, rules: Rules, t: Temperatures) -> Verdict:
    base, final = found.chain[0], found.chain[-1]
    closed = final.closes(base) if len(found.chain) > 1 else 0.0
    # Mean over what the noise may be: three points with the mean and variance of its logarithm.
    sizes = np.array([base.size, base.certain_size, base.possible_size])
    ends = 0.5 / NORMAL**2
    over = scipy.special.expit((sizes - rules.material) / t.size)
    missing = float(over @ [1.0 - 2.0 * ends, ends, ends])
    # Where none counts, the one that comes nearest may still be it in another form.
    tried = found.rounds[0].fitted if found.rounds else ()
    alone = max((e.closes(base) for e in tried), default=0.0)
    nearest = closed if len(found.chain) > 1 else alone
    closes = scipy.special.expit((nearest - rules.closed) / t.closed)
    named = t.escaped + (1.0 - t.escaped) * closes
    # What is left may be immaterial however small the share that closes, and a limit that the
    # controllers' log shows is there however little of its course a constant one repeats.
    left = dict(zip(found.drives, np.maximum(final.gap, 0.0), strict=True))
    limits = {d: limit for d, limit in found.limits.items() if left[d] >= rules.material**2}
    believed = len(found.chain) > 1 and (found.remaining < rules.unknown or bool(found.limits))
    if believed:
        named = max(named, t.believed)
    if any(p.role == 'size' for at in final.effects for p in final.ended(at)):
        named *= t.bounded
    ranking = _weigh(found, missing * named, rules, t)
    nothing = Verdict(NONE, (), 1.0 - missing, ranking=ranking, closed=closed)
    # Where the gap is at least half the worst drive's.
    most = np.flatnonzero(final.gap >= 0.5 * final.gap.max())
    where = _together(tuple(found.drives[d] for d in most), found.drives)
    unknown = replace(nothing, effect=UNKNOWN, where=where)
    if base.size < rules.material:
        return nothing
    if len(found.chain) == 1 and not found.complete:
        # Cut short before anything was found: no answer, said with no confidence.
        return replace(unknown, probability=0.0)
    if len(found.chain) == 1 and base.certain_size < rules.unknown:
        # Too small to be sure of it, and nothing explains it: small imperfections look like this,
        # and so does noise that was slow enough to be quiet where it was measured.
        sure = scipy.special.expit((rules.unknown - base.certain_size) / t.size)
        return replace(nothing, probability=sure)
    if len(found.chain) == 1 or (closed < rules.closed and not believed):
        return replace(unknown, probability=missing * (1.0 - named))
    leader = final.effects[0]
    # Twins are one answer under two names.
    same = {leader, *twins(leader)}
    return replace(
        nothing,
        effect=leader.effect,
        where=(leader.where,),
        probability=sum(w.probability for w in ranking if w.at in same),
        also=final.effects[1:],
        confusable=_confusable(found, ranking, rules),
        facts=Facts(limits=limits),
    )


def _together(chosen: tuple[str, ...], drives: Sequence[str]) -> tuple[str, ...]:
    """Return drives as a place, `all` for every one of several."""
    return ('all',) if len(chosen) == len(drives) > 1 else chosen


def _weigh(found: Selection, mass: float, rules: Rules, t: Temperatures) -> tuple[RankedFit, ...]:
    """Return the candidates fitted, with probabilities that share `mass`."""
    if not found.rounds:
        return ()
    base, final = found.chain[0], found.chain[-1]
    best = found.rounds[0].alone
    # Beside the other effects found a candidate says more than alone.
    for e in found.rivals:
        same = len(e.effects) > 1 and e.effects[0] == final.effects[0]
        best[e.effects[0] if same else e.effects[-1]] = e
    if len(final.effects) == 1:
        # What came first may have been dropped since: the one left is fitted better than it was.
        best[final.effects[0]] = final
    weights = {}
    alike = rules.alike
    lead = best.get(final.effects[0], base) if final.effects else base
    leads = 1.0 - lead.closes(base)
    for at, e in best.items():
        left, more = 1.0 - e.closes(base), 0.0
        if abs(left - leads) <= alike and len(e.theta) > len(lead.theta) and final.effects:
            # Numbers that bring nothing speak against a law by their price in BIC, no more: what
            # such laws leave differs by their forms.
            dearer = e.bic - lead.bic
            more = min(max(0.0, dearer), dearer - e.loss + lead.loss)
        if leads - alike <= left < leads:
            # One more number closes a little more, and is no evidence.
            left = leads
        weights[at] = (max(left, 0.0) + alike) ** -t.power * math.exp(-0.5 * more)
    # Twins are one answer under two names: both stand, with half the weight each.
    for at in list(weights):
        for twin in twins(at):
            if twin in weights:
                mean = 0.5 * (weights[at] + weights[twin])
                weights[at] = weights[twin] = mean
    # What holds another's law is no less likely: numbers that it does not need are its own.
    for at in list(weights):
        held = (EffectAt(other, at.where) for other in get_effect(at.effect).holds)
        weights[at] = max(weights[at], *(weights.get(other, 0.0) for other in held), 0.0)
    total = sum(weights.values())
    rows = [RankedFit(at, mass * weights[at] / total, best[at]) for at in best]
    return tuple(sorted(rows, key=lambda w: -w.probability))


def _confusable(
    found: Selection, ranking: Sequence[RankedFit], rules: Rules
) -> tuple[RankedFit, ...]:
    """Return the verdict's effect and those that close nearly as much in its place."""
    final = found.chain[-1]
    leader = final.effects[0]
    # What the effect itself takes away from the final model, not what all of them do.
    rest = found.rests[0]
    full = rest.loss - final.loss
    near = [
        leader if leader in e.effects else e.effects[-1]
        for e in found.rivals
        if full > 0 and (rest.loss - e.loss) / full >= 1.0 - rules.rival
    ]
    known = {w.at: w for w in ranking}
    own = known.get(leader)
    places = dict.fromkeys([leader, *near, *twins(leader)])
    # One that was not fitted is as likely as the effect itself.
    rows = (known.get(at) or (own and replace(own, at=at)) for at in places)
    return tuple(row for row in rows if row)
