# SPDX-License-Identifier: Apache-2.0
"""Numbers of the machine file that the log contradicts, each fitted beside the parameters."""

from collections.abc import Iterator
from dataclasses import dataclass
import math

import numpy as np

from ros2_ident.arrays import Array
from ros2_ident.errors import IdentError
from ros2_ident.gap.diagnosis import Value
from ros2_ident.gap.facts import WrongConstant
from ros2_ident.gap.fits import Explanation, Fits, Left, PROMISING
from ros2_ident.models.registry import kind_of
from ros2_ident.search.uncertainty import intervals

# A model's own number, and one that is the same everywhere.
_CERTAIN = frozenset({'coulomb_regularisation', 'gravity'})
# Step of the derivative by a constant's logarithm, the longest and the last step of its fit.
_STEP, _FAR, _NEAR = 0.01, 0.5, 1e-3
# Its box reaches from 0 to so many times what fits.
_WIDE = 10.0
# Steps of a fit at most.
_STEPS = 6


@dataclass(frozen=True)
class Constant:
    """A stated number, fitted.

    Attributes:
        name: Its key in the machine file.
        stated: What stands there.
        found: What fits.
        fit: The fit with it; its parameters are the nominal ones.
    """

    name: str
    stated: float
    found: Value
    fit: Explanation

    def wrong(self, closed: float) -> WrongConstant:
        """Return it as a fact, with the share of the gap that it closes."""
        x = self.found
        return WrongConstant(self.name, self.stated, x.value, x.low, x.high, x.unit, closed)


def fitted_constants(fits: Fits, base: Explanation) -> Iterator[Constant]:
    """Yield the stated numbers that promise most, each fitted beside the parameters.

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

    def __init__(self, fits: Fits, base: Explanation, name: str, stated: float) -> None:
        self.fits, self.base, self.name, self.stated = fits, base, name, stated

    def promise(self) -> float:
        """Return how much of the sum of squares goes, to first order."""
        own = self._own(self.base, 1.0)
        return float((own @ self.base.residual) ** 2 / (float(own @ own) or 1.0))

    def run(self, unit: str) -> Constant:
        """Return the number that fits."""
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
        return Constant(self.name, self.stated, Value(value, unit, low, high), best)

    def _at(self, factor: float) -> Fits:
        case = self.fits.case
        case = case if factor == 1.0 else case.stating(self.name, factor * self.stated)
        there = Fits(case, self.fits.floor, self.fits.stopped)
        there.law_weight = self.fits.law_weight
        return there

    def _slope(self, e: Explanation, factor: float) -> Array:
        """Return (R,) the derivative of the weighted residual by the number's logarithm."""
        there = self._at(factor * (1.0 + _STEP))
        moved = there.evaluate(there.case.fit.with_effects(()))(e.theta[None])[0]
        slope: Array = (moved - e.residual) / math.log1p(_STEP)
        return slope if np.isfinite(slope).all() else np.zeros_like(slope)

    def _own(self, e: Explanation, factor: float) -> Array:
        """Return (R,) what of the derivative no parameter imitates."""
        basis, slope = Left.of(e.residual, e.jacobian).basis, self._slope(e, factor)
        own: Array = slope - basis @ (basis.T @ slope)
        return own if own @ own > 1e-12 * (slope @ slope) else np.zeros_like(own)
