# SPDX-License-Identifier: Apache-2.0
"""Stated numbers of the machine file, fitted beside the parameters."""

from collections.abc import Iterator
from contextlib import suppress
import math

import numpy as np

from ros2_ident.arrays import Array
from ros2_ident.errors import IdentError
from ros2_ident.gap.fits import Fits, ITERATIONS, PROMISING
from ros2_ident.gap.hypothesis import Hypothesis, Selection
from ros2_ident.gap.result import WrongConstant
from ros2_ident.gap.selection import Selector
from ros2_ident.models.registry import stated_numbers, STATED_WITHIN
from ros2_ident.search.jacobian import COARSE_STEP
from ros2_ident.search.least_squares import least_squares
from ros2_ident.search.uncertainty import intervals


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
    gains: list[tuple[float, str, _WithConstant]] = []
    for name, (stated, unit) in stated_numbers(machine).items():
        of = _WithConstant(fits, base, name, stated)
        with suppress(IdentError):
            gains.append((of.promise(), unit, of))
    gains.sort(key=lambda gain: -gain[0])
    for gain, unit, of in gains:
        if gain > PROMISING * gains[0][0] and not fits.stopped():
            yield of.fitted(unit)


class _WithConstant:
    """The fit of all parameters with a column more: the logarithm of a stated number's factor."""

    def __init__(self, fits: Fits, base: Hypothesis, name: str, stated: float) -> None:
        self.fits, self.base, self.name, self.stated = fits, base, name, stated
        joint, ends = fits.split.fit.with_effects(()), math.log(STATED_WITHIN)
        self.box = joint.box.wider(-ends, ends)

    def promise(self) -> float:
        """Return how much of the sum of squares goes, to first order."""
        step = COARSE_STEP * float(self.box.width[-1])
        moved = self._residuals(np.append(self.base.theta, step)[None])[0]
        slope = (moved - self.base.residual) / step
        if not np.isfinite(slope).all():
            return 0.0
        basis, rest = np.linalg.qr(np.column_stack([self.base.jacobian, slope]))
        own = abs(rest[-1, -1]) > 1e-6 * np.linalg.norm(slope)
        return float(basis[:, -1] @ self.base.residual) ** 2 if own else 0.0

    def fitted(self, unit: str) -> tuple[WrongConstant, Hypothesis]:
        """Return the number that fits, and the fit."""
        low, high = self.box.low, self.box.low + self.box.width
        start = np.append(self.base.theta, 0.0)
        best = least_squares(
            self._residuals, start, low, high, iterations=ITERATIONS, stopped=self.fits.stopped,
            known=self.box.known,
        )  # fmt: skip
        there = self._at(best.theta[-1])
        value, rows = self.stated * math.exp(best.theta[-1]), len(self.fits.weight)
        scale = np.append(np.ones(len(low) - 1), value)
        bounds = sorted((self.stated / STATED_WITHIN, self.stated * STATED_WITHIN))
        found = intervals(
            best.jacobian[:rows] / (self.box.width * scale),
            best.residual[:rows],
            np.append(best.theta[:-1], value),
            np.append(low[:-1], bounds[0]),
            np.append(high[:-1], bounds[1]),
            series=[int(s) for mask in self.fits.split.fit.masks for s in mask.sum(axis=1)],
            known=self.box.known,
        )
        ends = float(found.low[-1]), float(found.high[-1])
        constant = WrongConstant(self.name, self.stated, value, *ends, unit)
        return constant, there.ended_at((), best.unit[:-1])

    def _at(self, logarithm: float) -> Fits:
        value = self.stated * math.exp(logarithm)
        split = self.fits.split.stating(self.name, value)
        return Fits(split, self.fits.floor, self.fits.stopped, self.fits.missed)

    def _residuals(self, theta: Array) -> Array:
        """Return (S, R) weighted residuals of (S, N + 1) candidates."""
        out = np.empty((len(theta), len(self.base.residual)))
        for logarithm in np.unique(theta[:, -1]):
            rows, there = theta[:, -1] == logarithm, self._at(logarithm)
            out[rows] = there.evaluate(there.split.fit.with_effects(()))(theta[rows, :-1])
        return out


def factors_of_all_drives(selector: Selector, found: Selection) -> dict[str, float]:
    """Return the factor of each number that an effect scales on every drive of several.

    NaN where no factor lies in the intervals of all drives.
    """
    final, drives = found.chain[-1], selector.split.drives
    if len(final.effects) < len(drives) or len(drives) == 1:
        return {}
    (low, high, *_), _ = selector.ends(final, selector.noise_of(final).evidence)
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
