# SPDX-License-Identifier: Apache-2.0
"""Verdicts without an effect: the log contradicts the machine file, or the model is another one.

Each function takes what the rounds came to and what would follow, and returns both, or what holds
in their place.
"""

from dataclasses import replace
from functools import partial
import math
from typing import Any

import numpy as np

from ros2_ident.effects import get_effect
from ros2_ident.gap.constants import fitted_constants
from ros2_ident.gap.explain import Explained, Explainer
from ros2_ident.gap.facts import Event, Misfit, WrongConstant
from ros2_ident.gap.fits import Explanation, TIE
from ros2_ident.gap.verdict import BOOKKEEPING, UNKNOWN, Verdict, WRONG_MODEL
from ros2_ident.gates import GateReport
from ros2_ident.gates.scale import FLOORS
from ros2_ident.models.registry import kind_of
from ros2_ident.search.noise import fast_noise

# A model is another machine's where, with every effect found, a drive's effort is missed by this
# share of how it varies, and by far more than the floor.
LARGE = 0.1
# So much, and slow, is no noise of a log either, even where nothing predicts it; of drives of one
# make the others tell what noise is.
SLOW = 0.5
# A contradiction is found by a measure that leaves hardly any doubt.
_SURE = 0.95


def of_gates(
    explainer: Explainer, base: Explanation, report: GateReport
) -> tuple[Explained, Verdict]:
    """Return the answer where the gates leave none to physics."""
    worst = report.contradictions[0]
    effect = WRONG_MODEL if worst.gate == 'coupling' else BOOKKEEPING
    drives = [g.drive for g in report.contradictions if g.level == 'fail' and g.drive]
    where = tuple(dict.fromkeys(drives)) or ('all',)
    found = Explained((base,), (), (), (), explainer.size(base), True)
    return found, _without_effects(effect, where)


def of_the_file(
    explainer: Explainer, found: Explained, verdict: Verdict
) -> tuple[Explained, Verdict]:
    """Return the answer, or that a number of the machine file is wrong where it explains as much.

    Beside a gap that does not count no other cause was looked for, so that a number is given and
    not named. Of what closes as much for all that counts the one with fewer numbers is taken;
    where as many numbers explain as much by an effect, its name stands, and those of the file are
    ties. It stands too where it is on every drive with a size of its own.
    """
    base, final = found.chain[0], found.chain[-1]
    share, rules = partial(explainer.share, base), explainer.rules
    least = share(final) if len(found.chain) > 1 else 0.0
    places = 'all', *(explainer.case.drives if len(explainer.case.drives) == 1 else ())
    named = {
        p.target
        for at in final.effects
        if at.where in places
        for p in get_effect(at.effect).parameters
    }
    counting = [
        one
        for one in fitted_constants(explainer.fits, base)
        if one.name not in named
        and share(one.fit) > max(rules.closed, least - rules.alike)
        and base.loss - one.fit.loss > TIE
        and explainer.confirmed(base, one.fit)
    ]
    factors = _of_every_drive(explainer, found) if verdict.named else {}
    own = any(math.isnan(factor) for factor in factors.values())
    if not counting and (own or not factors):
        return found, verdict
    counting.sort(key=lambda one: -share(one.fit))
    wrong = tuple(
        one.wrong(share(one.fit))
        for one in counting
        if share(one.fit) > share(counting[0].fit) - rules.alike
    )
    if not explainer.open(base) and verdict.effect != BOOKKEEPING:
        return found, replace(verdict, constants=wrong)
    as_many = len(base.theta) + 1 >= len(final.theta) or own
    if as_many and verdict.named and wrong[0].closed < least + rules.alike:
        return found, replace(verdict, constants=wrong)
    wrong = wrong or tuple(WrongConstant(key, math.nan, x) for key, x in factors.items())
    drives = explainer.case.drives
    where = drives if len(drives) == 1 else ('all',)
    return found.nominal(), _without_effects(BOOKKEEPING, tuple(where), constants=wrong)


def _of_every_drive(explainer: Explainer, found: Explained) -> dict[str, float]:
    """Return the factor of each number that an effect scales on every drive of several.

    NaN where no factor lies in the intervals of all drives.
    """
    final, drives = found.chain[-1], explainer.case.drives
    if len(final.effects) < len(drives) or len(drives) == 1:
        return {}
    low, high, *_ = explainer.ends(final, explainer.noise_of(final).evidence)
    sizes: dict[str, list[int]] = {}
    column = len(found.chain[0].theta)
    for at in final.effects:
        parameters = explainer.case.fit.models[0].scaled(at)
        if parameters[0].how == 'scale' and parameters[0].neutral == 1.0:
            sizes.setdefault(parameters[0].target, []).append(column)
        column += len(parameters)
    out = {}
    for target, own in sizes.items():
        if len(own) == len(drives):
            shared = low[own].max() <= high[own].min()
            weights = (high[own] - low[own]) ** -2.0
            out[target] = float(np.average(final.theta[own], weights=weights))
            out[target] = out[target] if shared else math.nan
    return out


def of_what_is_left(
    explainer: Explainer, found: Explained, verdict: Verdict, report: GateReport
) -> tuple[Explained, Verdict]:
    """Return the answer, or that the model is the wrong one where no effect makes it fit."""
    # Where a slow log alone drives the model, it may be the log that is at fault.
    slow = report.of('rate') and report.of('command')
    # Steps of an encoder, and a limit that only the law shows, are not closed by any fit.
    if slow or verdict.readings or verdict.limits:
        return found, verdict
    case = explainer.case
    gap = np.sqrt(np.maximum(explainer.gap(found.chain[-1]), 0.0))
    left = gap * explainer.fits.floor
    varies = np.array([_spread(explainer, d) for d in range(len(case.drives))])
    last = found.chain[-1].check_residual / explainer.fits.check_weight
    fast = np.array([fast_noise(last[case.check.drive == d]) for d in range(len(case.drives))])
    whole = np.hypot(left, explainer.fits.floor)
    machine = case.fit.models[0].machine
    like = machine is not None and kind_of(machine).alike
    slow_part = (whole >= FLOORS * fast) & (whole >= SLOW * varies) & (not like)
    lost = ((gap >= FLOORS) & (left >= LARGE * varies)) | slow_part
    left = np.where(slow_part, whole, left)
    if not lost.any():
        return found, verdict
    names = tuple(name for name, gone in zip(case.drives, lost, strict=True) if gone)
    worst = int(np.argmax(np.where(lost, left, 0.0)))
    misfit = Misfit(
        drive=case.drives[worst],
        quantity=case.fit.models[0].outputs[worst].quantity,
        rms=float(left[worst]),
        share=float(left[worst] / varies[worst]),
        over_floor=float(gap[worst]),
        extended=len(found.chain) > 1,
    )
    return found.nominal(), _without_effects(WRONG_MODEL, names, misfit=misfit)


def of_events(verdict: Verdict, report: GateReport) -> Verdict:
    """Return the answer, or that effort was produced which was not commanded."""
    found = tuple(
        Event(asked.drive, number, push.time, push.effort)
        for number, recording in enumerate(report.asked, 1)
        for asked in recording
        for push in asked.pushes
    )
    if not found or verdict.effect == BOOKKEEPING:
        return verdict
    return replace(
        verdict,
        effect=UNKNOWN,
        where=tuple(dict.fromkeys(e.drive for e in found)),
        probability=_SURE,
        also=(),
        confusable=(),
        events=found,
        misfit=None,
    )


def _without_effects(effect: str, where: tuple[str, ...], **facts: Any) -> Verdict:
    return Verdict(effect, where, _SURE, (), (), (), 0.0, **facts)


def _spread(explainer: Explainer, drive: int) -> float:
    """Return how a drive's measured effort varies, over all recordings."""
    case = explainer.case
    parts = (*case.fit.measured(drive), *case.check.measured(drive))
    rows = [row - row.mean() for row in parts if row.size]
    return float(np.sqrt(np.mean(np.concatenate(rows) ** 2)))
