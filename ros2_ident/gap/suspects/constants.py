# SPDX-License-Identifier: Apache-2.0
"""Stated numbers of the machine file, fitted beside the parameters."""

from collections.abc import Iterator
import math

import numpy as np

from ros2_ident.arrays import Array
from ros2_ident.errors import IdentError
from ros2_ident.gap.fits import Fits, PROMISING
from ros2_ident.gap.hypothesis import Hypothesis, Selection
from ros2_ident.gap.result import WrongConstant
from ros2_ident.gap.selection import Selector
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


def fitted_constants(fits: Fits, base: Hypothesis) -> Iterator[tuple[WrongConstant, Hypothesis]]:
    """Yield the stated numbers that promise most, each fitted beside the parameters, and its fit.

    Those that differ from drive to drive are left out.

    Args:
        fits: Fits of the split.
        base: The nominal fit.
    """
    machine = fits.split.fit.models[0].machine
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
        joint = self._at(factor).split.fit.with_effects(())
        slopes = np.column_stack([best.jacobian, self._slope(best, factor)])[:rows]
        span = np.append(joint.high - joint.low, value)
        found = intervals(
            slopes / span,
            best.residual[:rows],
            np.append(best.theta, value),
            np.append(joint.low, np.minimum(0.0, _WIDE * value)),
            np.append(joint.high, np.maximum(0.0, _WIDE * value)),
            series=[int(s) for mask in self.fits.split.fit.masks for s in mask.sum(axis=1)],
        )
        low, high = sorted((float(found.low[-1]), float(found.high[-1])))
        return WrongConstant(self.name, self.stated, value, low, high, unit), best

    def _at(self, factor: float) -> Fits:
        split = self.fits.split
        split = split if factor == 1.0 else split.stating(self.name, factor * self.stated)
        return Fits(split, self.fits.floor, self.fits.stopped, self.fits.missed)

    def _slope(self, e: Hypothesis, factor: float) -> Array:
        """Return (R,) the derivative of the weighted residual by the number's logarithm."""
        there = self._at(factor * (1.0 + _STEP))
        moved = there.evaluate(there.split.fit.with_effects(()))(e.theta[None])[0]
        slope: Array = (moved - e.residual) / math.log1p(_STEP)
        return slope if np.isfinite(slope).all() else np.zeros_like(slope)

    def _own(self, e: Hypothesis, factor: float) -> Array:
        """Return (R,) what of the derivative no parameter imitates."""
        basis, slope = np.linalg.qr(e.jacobian)[0], self._slope(e, factor)
        own: Array = slope - basis @ (basis.T @ slope)
        return own if own @ own > 1e-12 * (slope @ slope) else np.zeros_like(own)


def factors_of_all_drives(selector: Selector, found: Selection) -> dict[str, float]:
    """Return the factor of each number that an effect scales on every drive of several.

    NaN where no factor lies in the intervals of all drives.
    """
    final, drives = found.chain[-1], selector.split.drives
    if len(final.effects) < len(drives) or len(drives) == 1:
        return {}
    low, high, *_ = selector.ends(final, selector.noise_of(final).evidence)
    sizes: dict[str, list[int]] = {}
    column = len(found.chain[0].theta)
    for at in final.effects:
        parameters = selector.split.fit.models[0].scaled(at)
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
