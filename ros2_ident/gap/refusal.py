# SPDX-License-Identifier: Apache-2.0
"""Verdicts without an effect: the log contradicts the machine file, or the model is another one.

Each function takes what the rounds came to and what would follow, and returns both, or what holds
in their place.
"""

from collections.abc import Iterator
from dataclasses import replace
import math
from typing import Any

import numpy as np

from ros2_ident.arrays import Array
from ros2_ident.effects import get_effect
from ros2_ident.errors import IdentError
from ros2_ident.gap.diagnosis import Facts, Misfit, WrongConstant
from ros2_ident.gap.explain import Explainer
from ros2_ident.gap.fits import Fits, PROMISING, TIE
from ros2_ident.gap.hypothesis import Hypothesis, Selection
from ros2_ident.gap.verdict import BOOKKEEPING, UNKNOWN, Verdict, WRONG_MODEL
from ros2_ident.gates import GateReport
from ros2_ident.gates.scale import FLOORS, near
from ros2_ident.models.registry import kind_of
from ros2_ident.search.noise import fast_noise
from ros2_ident.search.uncertainty import intervals

# A model is another machine's where, with every effect found, a drive's effort is missed by this
# share of how it varies, and by far more than the floor.
LARGE = 0.1
# So much, and slow, is no noise of a log either, even where nothing predicts it; of drives of one
# make the others tell what noise is.
SLOW = 0.5
# A contradiction is found by a measure that leaves hardly any doubt.
_SURE = 0.95


def of_gates(
    drives: tuple[str, ...], base: Hypothesis, report: GateReport
) -> tuple[Selection, Verdict]:
    """Return the answer where the gates leave none to physics."""
    named = [g.drive for g in report.contradictions if g.level == 'fail' and g.drive]
    where = tuple(dict.fromkeys(named)) or ('all',)
    return Selection(drives, (base,)), _without_effects(BOOKKEEPING, where)


def of_the_file(
    explainer: Explainer, found: Selection, verdict: Verdict, report: GateReport
) -> tuple[Selection, Verdict]:
    """Return the answer, or that a number of the machine file is wrong where it explains as much.

    A gain has to agree with the controllers' log. Beside a gap that does not count no other cause
    was looked for, so that a number is given and not named. Of what closes as much for all that
    counts the one with fewer numbers is taken; where as many numbers explain as much by an effect,
    its name stands, and those of the file are ties. It stands too where it is on every drive with
    a size of its own.
    """
    base, final = found.chain[0], found.chain[-1]
    rules = explainer.rules
    least = final.closes(base) if len(found.chain) > 1 else 0.0
    seen = [(g.name, g.value) for law in report.laws for g in law.gains if g.value]
    blamed = {gate.key for gate in report.contradictions}
    others = {name for name, _ in seen} - blamed if verdict.effect == BOOKKEEPING else set()
    whole = [at for at in final.effects if at.where == 'all' or len(explainer.case.drives) == 1]
    named = {p.target for at in whole for p in get_effect(at.effect).parameters}
    counting = [
        replace(one, closed=closed)
        for one, fit in fitted_constants(explainer.fits, base)
        if one.key not in named | others
        and all(near(one.value / value) for name, value in seen if name == one.key)
        and (closed := fit.closes(base)) > max(rules.closed, least - rules.alike)
        and base.loss - fit.loss > TIE
        and rules.is_confirmed(base, fit)
    ]
    factors = _of_every_drive(explainer, found) if verdict.named else {}
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
    drives = explainer.case.drives
    where = drives if len(drives) == 1 else ('all',)
    return found.nominal(), _without_effects(BOOKKEEPING, tuple(where), constants=wrong)


def _of_every_drive(explainer: Explainer, found: Selection) -> dict[str, float]:
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
    explainer: Explainer, found: Selection, verdict: Verdict, report: GateReport
) -> tuple[Selection, Verdict]:
    """Return the answer, or that the model is the wrong one where no effect makes it fit."""
    # Where a slow log alone drives the model, it may be the log that is at fault.
    slow = report.of('rate') and report.of('command')
    # Steps of an encoder, and a limit that only the law shows, are not closed by any fit.
    if slow or verdict.readings or verdict.facts.limits:
        return found, verdict
    case = explainer.case
    gap = np.sqrt(np.maximum(found.chain[-1].gap, 0.0))
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
    found = tuple(e for recording in report.asked for asked in recording for e in asked.pushes)
    if not found or verdict.effect == BOOKKEEPING:
        return verdict
    return replace(
        verdict,
        effect=UNKNOWN,
        where=tuple(dict.fromkeys(e.drive for e in found)),
        probability=_SURE,
        also=(),
        confusable=(),
        facts=replace(verdict.facts, events=found, misfit=None),
    )


def _without_effects(effect: str, where: tuple[str, ...], **facts: Any) -> Verdict:
    return Verdict(effect, where, _SURE, (), (), (), 0.0, facts=Facts(**facts))


def _spread(explainer: Explainer, drive: int) -> float:
    """Return how a drive's measured effort varies, over all recordings."""
    case = explainer.case
    parts = (*case.fit.measured(drive), *case.check.measured(drive))
    rows = [row - row.mean() for row in parts if row.size]
    return float(np.sqrt(np.mean(np.concatenate(rows) ** 2)))


# A model's own number, and one that is the same everywhere.
_CERTAIN = frozenset({'coulomb_regularisation', 'gravity'})
# Step of the derivative by a constant's logarithm, the longest and the last step of its fit.
_STEP, _FAR, _NEAR = 0.01, 0.5, 1e-3
# Its box reaches from 0 to so many times what fits.
_WIDE = 10.0
# Steps of a fit at most.
_STEPS = 6


def fitted_constants(
    fits: Fits, base: Hypothesis
) -> Iterator[tuple[WrongConstant, Hypothesis]]:
    """Yield the stated numbers that promise most, each fitted beside the parameters, and its fit.

    Those that differ from drive to drive are left out.

    Args:
        fits: Fits of the case.
        base: The nominal fit.
    """
    machine = fits.case.fit.models[0].machine
    if machine is None:
        return
    searched = {k.name: k.unit for k in kind_of(machine).keys if k.section == 'parameters'}
    gains: list[tuple[float, str, _Fit]] = []
    for name, unit in searched.items():
        values = machine.constants.get(name, ())
        alike = len(set(values)) == 1 and isinstance(values[0], float) and values[0] != 0.0
        if not alike or not machine.stated(name) or name in _CERTAIN | {*machine.bounds}:
            continue
        of = _Fit(fits, base, name, float(values[0]))
        try:
            gains.append((of.promise(), unit, of))
        except IdentError:
            continue
    gains.sort(key=lambda gain: -gain[0])
    for gain, unit, of in gains:
        if gain > PROMISING * gains[0][0] and not fits.stopped():
            yield of.run(unit)


class _Fit:
    """Gauss-Newton steps of one number; the parameters follow it."""

    def __init__(self, fits: Fits, base: Hypothesis, name: str, stated: float) -> None:
        self.fits, self.base, self.name, self.stated = fits, base, name, stated

    def promise(self) -> float:
        """Return how much of the sum of squares goes, to first order."""
        own = self._own(self.base, 1.0)
        return float((own @ self.base.residual) ** 2 / (float(own @ own) or 1.0))

    def run(self, unit: str) -> tuple[WrongConstant, Hypothesis]:
        """Return the number that fits, and the fit."""
        best, factor = self.base, 1.0
        for _ in range(_STEPS):
            own = self._own(best, factor)
            move = float(np.clip(-(own @ best.residual) / (float(own @ own) or 1.0), -_FAR, _FAR))
            there = self._at(factor * math.exp(move))
            trial = there.refit((), best.theta)
            if trial.residual @ trial.residual >= best.residual @ best.residual:
                break
            best, factor = trial, factor * math.exp(move)
            if abs(move) < _NEAR:
                break
        value, rows = self.stated * factor, len(self.fits.weight)
        joint = self._at(factor).case.fit.with_effects(())
        slopes = np.column_stack([best.jacobian, self._slope(best, factor)])[:rows]
        span = np.append(joint.high - joint.low, value)
        found = intervals(
            slopes / span,
            best.residual[:rows],
            np.append(best.theta, value),
            np.append(joint.low, np.minimum(0.0, _WIDE * value)),
            np.append(joint.high, np.maximum(0.0, _WIDE * value)),
            series=[int(s) for mask in self.fits.case.fit.masks for s in mask.sum(axis=1)],
        )
        low, high = sorted((float(found.low[-1]), float(found.high[-1])))
        return WrongConstant(self.name, self.stated, value, low, high, unit), best

    def _at(self, factor: float) -> Fits:
        case = self.fits.case
        case = case if factor == 1.0 else case.stating(self.name, factor * self.stated)
        return Fits(case, self.fits.floor, self.fits.stopped, self.fits.missed)

    def _slope(self, e: Hypothesis, factor: float) -> Array:
        """Return (R,) the derivative of the weighted residual by the number's logarithm."""
        there = self._at(factor * (1.0 + _STEP))
        moved = there.evaluate(there.case.fit.with_effects(()))(e.theta[None])[0]
        slope: Array = (moved - e.residual) / math.log1p(_STEP)
        return slope if np.isfinite(slope).all() else np.zeros_like(slope)

    def _own(self, e: Hypothesis, factor: float) -> Array:
        """Return (R,) what of the derivative no parameter imitates."""
        basis, slope = np.linalg.qr(e.jacobian)[0], self._slope(e, factor)
        own: Array = slope - basis @ (basis.T @ slope)
        return own if own @ own > 1e-12 * (slope @ slope) else np.zeros_like(own)
