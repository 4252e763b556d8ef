# SPDX-License-Identifier: Apache-2.0
"""When no effect is named: the log contradicts the machine file, or the model is another one."""

from dataclasses import replace

import numpy as np

from ros2_ident.gap.explain import Explained, Explainer
from ros2_ident.gap.fits import Explanation
from ros2_ident.gap.verdict import BOOKKEEPING, Verdict, WRONG_MODEL
from ros2_ident.gates import GateReport
from ros2_ident.search.noise import fast_noise

# A model is another machine's where, with every effect found, a drive's effort is missed by this
# share of how it varies, and by so many times the floor.
LARGE, FLOORS = 0.1, 20.0
# A contradiction is found by a measure that leaves hardly any doubt.
_SURE = 0.95


def of_gates(
    explainer: Explainer, base: Explanation, report: GateReport
) -> tuple[Explained, Verdict]:
    """Return the answer where the gates leave none to physics.

    Args:
        explainer: Holds the rules and the counts.
        base: The nominal fit.
        report: What the gates found, a contradiction among it.
    """
    worst = report.contradictions[0]
    effect = WRONG_MODEL if worst.gate == 'coupling' else BOOKKEEPING
    drives = [g.drive for g in report.contradictions if g.level == 'fail' and g.drive]
    where = tuple(dict.fromkeys(drives)) or ('all',)
    found = Explained((base,), (), (), (), explainer.size(base), True)
    return found, _without_effects(effect, where, report.headline)


def of_what_is_left(
    explainer: Explainer, found: Explained, verdict: Verdict, report: GateReport
) -> tuple[Explained, Verdict]:
    """Return the answer, or that the model is the wrong one where no effect makes it carry.

    Args:
        explainer: Holds the rules and the counts.
        found: What the rounds came to.
        verdict: What would follow.
        report: What the gates found: where a slow log alone drives the model, it may be the log
            that is at fault.
    """
    slow = report.of('rate') and report.of('command')
    # Steps of an encoder, and what only the controllers' log shows, are not closed by any fit.
    known = verdict.readings or explainer.vouched(found.chain[0], found.chain[-1])
    if slow or known:
        return found, verdict
    case = explainer.attribution.case
    gap = np.sqrt(np.maximum(explainer.gap(found.chain[-1]), 0.0))
    left = gap * explainer.attribution.floor
    varies = np.array([_spread(explainer, d) for d in range(len(case.drives))])
    fast = np.array([_fast(explainer, found.chain[-1], d) for d in range(len(case.drives))])
    whole = np.hypot(left, explainer.attribution.floor)
    # What is slow and that large is no noise of a log, even where nothing predicts it.
    slow_part = (whole >= FLOORS * fast) & (whole >= LARGE * varies)
    lost = ((gap >= FLOORS) & (left >= LARGE * varies)) | slow_part
    left = np.where(slow_part, whole, left)
    if not lost.any():
        return found, verdict
    names = tuple(name for name, gone in zip(case.drives, lost, strict=True) if gone)
    worst = int(np.argmax(np.where(lost, gap, 0.0)))
    unit = case.fit.models[0].unit
    tried = 'with the effects that close most' if len(found.chain) > 1 else 'with every effect'
    first = (
        f'The model is not the one of this machine: {tried} it still misses '
        f'{100.0 * left[worst] / varies[worst]:.0f} % of what varies in the effort of '
        f'{case.drives[worst]} ({left[worst]:.3g} {unit}, {gap[worst]:.3g} times the noise floor).'
    )
    plain = replace(found, chain=found.chain[:1], rivals=(), rests=())
    return plain, _without_effects(WRONG_MODEL, names, first)


def ahead(verdict: Verdict, report: GateReport) -> Verdict:
    """Return a verdict behind what the gates have to say first."""
    return verdict if verdict.first else replace(verdict, first=report.headline)


def _without_effects(effect: str, where: tuple[str, ...], first: str) -> Verdict:
    return Verdict(effect, where, _SURE, (), (), (), 0.0, (), first)


def _fast(explainer: Explainer, e: Explanation, drive: int) -> float:
    """Return the noise of what a drive's fit leaves as neighbouring samples show it."""
    attribution = explainer.attribution
    own = attribution.case.check.drive == drive
    return fast_noise((e.check_residual / attribution.fits.check_weight)[own])


def _spread(explainer: Explainer, drive: int) -> float:
    """Return how a drive's measured effort varies, over all recordings."""
    case = explainer.attribution.case
    parts = []
    for part in (case.fit, case.check):
        for model, mask in zip(part.models, part.masks, strict=True):
            row = model.measured[drive, mask[drive]]
            parts.append(row - row.mean() if row.size else row)
    return float(np.sqrt(np.mean(np.concatenate(parts) ** 2)))
