# SPDX-License-Identifier: Apache-2.0
"""Verdicts without an effect: the log contradicts the machine file, or the model is another one.

Each function takes what the rounds came to and what would follow, and returns both, or what holds
in their place.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
import math
from typing import Any

import numpy as np

from ros2_ident.arrays import Array, fast_noise
from ros2_ident.effects import get_effect
from ros2_ident.gap.hypothesis import Hypothesis, Selection
from ros2_ident.gap.recordings import are_alike, Split
from ros2_ident.gap.result import Facts, Misfit, WrongConstant
from ros2_ident.gap.rules import Rules, Temperatures, TIE
from ros2_ident.gap.verdict import BOOKKEEPING, UNKNOWN, Verdict, WRONG_MODEL
from ros2_ident.gates import GateReport
from ros2_ident.gates.asked import Asked, Event
from ros2_ident.gates.scale import MOSTLY, near, STEP
from ros2_ident.models import FullModel

# Models, each with its own parameters (N,).
Fitted = Sequence[tuple[FullModel, Array]]


def of_gates(
    drives: tuple[str, ...], base: Hypothesis, report: GateReport
) -> tuple[Selection, Verdict]:
    """Return the answer where the gates leave none to physics."""
    named = [g.drive for g in report.contradictions if g.level == 'fail' and g.drive]
    where = tuple(dict.fromkeys(named)) or ('all',)
    return Selection(drives, (base,)), _without_effects(BOOKKEEPING, where)


def of_the_file(
    found: Selection,
    verdict: Verdict,
    report: GateReport,
    constants: Iterable[tuple[WrongConstant, Hypothesis]],
    factors: Mapping[str, float],
    rules: Rules,
) -> tuple[Selection, Verdict]:
    """Return the answer, or that a number of the machine file is wrong where it explains as much.

    A gain has to agree with the controllers' log. Beside a gap that does not count no other cause
    was looked for, so that a number is given and not named. Of what closes as much for all that
    counts the one with fewer numbers is taken; where as many numbers explain as much by an effect,
    its name stands, and those of the file are ties. It stands too where it is on every drive with
    a size of its own.

    Args:
        constants: Stated numbers, each with the nominal fit beside it.
        factors: Of each number that an effect scales on every drive; NaN where they differ.
    """
    base, final, drives = found.chain[0], found.chain[-1], found.drives
    least = final.closes(base) if len(found.chain) > 1 else 0.0
    seen = [(g.name, g.value) for law in report.laws for g in law.gains if g.value]
    blamed = {gate.key for gate in report.contradictions}
    others = {name for name, _ in seen} - blamed if verdict.effect == BOOKKEEPING else set()
    whole = [at for at in final.effects if at.where == 'all' or len(drives) == 1]
    named = {p.target for at in whole for p in get_effect(at.effect).parameters}
    counting = [
        replace(one, closed=closed)
        for one, fit in constants
        if one.key not in named | others
        and all(near(one.value / value) for name, value in seen if name == one.key)
        and (closed := fit.closes(base)) > max(rules.closed, least - rules.alike)
        and base.loss - fit.loss > TIE
        and rules.is_confirmed(base, fit)
    ]
    own = any(math.isnan(factor) for factor in factors.values())
    if not counting and (own or not factors):
        return found, verdict
    counting.sort(key=lambda one: -one.closed)
    wrong = tuple(one for one in counting if one.closed > counting[0].closed - rules.alike)
    small = not rules.open(base) and verdict.effect != BOOKKEEPING
    as_many = verdict.named and (len(base.theta) + 1 >= len(final.theta) or own)
    if small or (as_many and wrong[0].closed < least + rules.alike):
        return found, replace(verdict, facts=replace(verdict.facts, constants=wrong))
    wrong = wrong or tuple(WrongConstant(key, math.nan, x) for key, x in factors.items())
    where = drives if len(drives) == 1 else ('all',)
    return found.nominal(), _without_effects(BOOKKEEPING, tuple(where), constants=wrong)


def of_what_is_left(
    split: Split,
    floor: Array,
    found: Selection,
    verdict: Verdict,
    report: GateReport,
    rules: Rules,
) -> tuple[Selection, Verdict]:
    """Return the answer, or that the model is the wrong one where no effect makes it fit.

    Args:
        split: The recordings.
        floor: (D,) noise floor, in the unit of the residual.
    """
    # Where a slow log alone drives the model, it may be the log that is at fault.
    slow = report.of('rate') and (report.of('command') or report.of('gains'))
    gap = np.sqrt(np.maximum(found.chain[-1].gap, 0.0))
    left = gap * floor
    varies = np.array([_spread(split, d) for d in range(len(split.drives))])
    # Steps of an encoder, and a limit that only the law shows, are not closed by any fit. But no
    # effect is named of a model that misses more than there is.
    beyond = left > varies
    if not beyond.any() and (slow or verdict.encoders or verdict.facts.limits):
        return found, verdict
    last = found.chain[-1].check_residual * floor[split.check.drive]
    fast = np.array([fast_noise(last[split.check.drive == d]) for d in range(len(split.drives))])
    whole = np.hypot(left, floor)
    like = are_alike(split.fit.models[0])
    slow_part = (whole >= rules.floors * fast) & (whole >= rules.slow * varies) & (not like)
    lost = ((gap >= rules.floors) & (left >= rules.varies * varies)) | slow_part | beyond
    left = np.where(slow_part, whole, left)
    if not lost.any():
        return found, verdict
    names = tuple(name for name, gone in zip(split.drives, lost, strict=True) if gone)
    worst = int(np.argmax(np.where(lost, left, 0.0)))
    misfit = Misfit(
        drive=split.drives[worst],
        quantity=split.fit.models[0].outputs[worst].quantity,
        rms=float(left[worst]),
        share=float(left[worst] / varies[worst]),
        over_floor=float(gap[worst]),
        extended=len(found.chain) > 1,
    )
    return found.nominal(), _without_effects(WRONG_MODEL, names, misfit=misfit)


def unexplained(report: GateReport, without: Fitted, fitted: Fitted) -> GateReport:
    """Return the report without efforts beyond the commanded that what was found explains.

    A limited drive makes another effort than its law asks for. Events that the models miss without
    what was found are explained where most (`MOSTLY`) of that is gone.

    Args:
        report: Of some recordings.
        without: Their models with their own parameters (N,), without what was found.
        fitted: The same with it.
    """
    if not report.pushes:
        return report
    rests = [
        [(m, m.measured - m.simulate(own[None])[0]) for m, own in one] for one in (without, fitted)
    ]

    def kept(drives: tuple[Asked, ...], *both: tuple[FullModel, Array]) -> Iterator[Asked]:
        for asked in drives:
            before, left = (sum(_missed(m, rest, e) for e in asked.pushes) for m, rest in both)
            few = 1.0 - MOSTLY
            missed = before > few * sum(abs(e.effort) for e in asked.pushes)
            made = missed and left < few * before
            yield replace(asked, pushes=()) if made else asked

    told = tuple(tuple(kept(*one)) for one in zip(report.asked, *rests, strict=True))
    added = {asked.drive for drives in told for asked in drives if asked.pushes}
    return replace(report.without('not_asked', added), asked=told)


def _missed(model: FullModel, rest: Array, event: Event) -> float:
    """Return the size of a residual's mean (D, K) over an event; 0 where it has no effort."""
    drive = model.places.index(event.drive)
    if model.outputs[drive].quantity != 'effort':
        return 0.0
    until = event.time if math.isnan(event.end) else event.end
    first = max(0, int((event.time - STEP) / model.cycle))
    seen = rest[drive, first : 1 + int((until + STEP) / model.cycle)]
    seen = seen[~np.isnan(seen)]
    return abs(float(seen.mean())) if seen.size else 0.0


def of_events(verdict: Verdict, report: GateReport) -> Verdict:
    """Return the answer, or that effort was produced which was not commanded."""
    found = report.pushes
    if not found or verdict.effect == BOOKKEEPING:
        return verdict
    return replace(
        verdict,
        effect=UNKNOWN,
        where=tuple(dict.fromkeys(e.drive for e in found)),
        probability=Temperatures().sure,
        also=(),
        confusable=(),
        facts=replace(verdict.facts, events=found, misfit=None),
    )


def _without_effects(effect: str, where: tuple[str, ...], **facts: Any) -> Verdict:
    return Verdict(effect, where, Temperatures().sure, facts=Facts(**facts))


def _spread(split: Split, drive: int) -> float:
    """Return how a drive's measured effort varies, over all recordings."""
    parts = (*split.fit.measured(drive), *split.check.measured(drive))
    rows = [row - row.mean() for row in parts if row.size]
    return float(np.sqrt(np.mean(np.concatenate(rows) ** 2)))
