# SPDX-License-Identifier: Apache-2.0
"""A machine with some effects as a value: its fit, and the numbers that judge it."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from ros2_ident.arrays import Array
from ros2_ident.effects import EffectParameter, get_effect
from ros2_ident.gap.result import Tie
from ros2_ident.models import EffectAt


@dataclass(frozen=True)
class Samples:
    """Data that the fits of one split are judged on.

    Attributes:
        fit: (D,) samples of each drive in the fit part.
        check: (D,) samples in the part held out.
        certain: (D,) square of the noise floor over the upper end of its 95 % interval.
    """

    fit: Array
    check: Array
    certain: Array


@dataclass(frozen=True)
class Hypothesis:
    """The machine with some effects, fitted on the fit part and judged on both.

    Attributes:
        effects: Effects in the order they came in.
        theta: (N,) parameters, those of the effects last.
        fit: (D,) sum of squared residuals on the fit part, in units of the floor.
        check: (D,) the same on the part held out.
        samples: How many there are of these.
        jacobian: (R, N) of the weighted residual by the parameters' shares of their box.
        residual: (R,) weighted residual of the fit part: the outputs', then the controllers'.
        check_residual: (R',) weighted residual of the outputs on the part held out.
        unit: (N,) the parameters in shares of their box, as the fit ended.
    """

    effects: tuple[EffectAt, ...]
    theta: Array
    fit: Array
    check: Array
    samples: Samples
    jacobian: Array = field(repr=False)
    residual: Array = field(repr=False)
    check_residual: Array = field(repr=False)
    unit: Array = field(repr=False)

    @property
    def loss(self) -> float:
        """Sum of squared weighted residuals of the outputs on both parts."""
        return float(self.fit.sum() + self.check.sum())

    @property
    def cost(self) -> float:
        """Sum of squared weighted residuals of the outputs on the fit part."""
        return float(self.fit.sum())

    @cached_property
    def gap(self) -> Array:
        """(D,) mean square of each drive's gap beyond the noise, in units of the floor squared."""
        out: Array = (self.fit + self.check) / (self.samples.fit + self.samples.check) - 1.0
        return out

    @cached_property
    def held_out(self) -> Array:
        """(D,) `gap` on the part held out alone."""
        out: Array = self.check / self.samples.check - 1.0
        return out

    @cached_property
    def size(self) -> float:
        """RMS of the worst drive's gap in units of the floor."""
        return float(np.sqrt(np.maximum(self.gap, 0.0)).max())

    @property
    def certain_size(self) -> float:
        """`size` where the noise is at the upper end of its 95 % interval."""
        return self._size_at(self.samples.certain)

    @property
    def possible_size(self) -> float:
        """`size` where the noise is at the lower end, which is as far from it as a factor."""
        return self._size_at(1.0 / self.samples.certain)

    def _size_at(self, factor: Array) -> float:
        gap = (self.gap + 1.0) * factor - 1.0
        return float(np.sqrt(np.maximum(gap, 0.0)).max())

    @cached_property
    def bic(self) -> float:
        """Loss on both parts and the price of the parameters (Schwarz 1978, Ann. Statist. 6)."""
        samples = self.samples.fit.sum() + self.samples.check.sum()
        return self.loss + float(np.log(samples)) * len(self.theta)

    def closes(self, before: 'Hypothesis', held_out: bool = False) -> float:
        """Return the share of the gap of `before` that is closed here; 0 where there is none.

        On all data, or on those `held_out` alone.
        """
        one, two, counts = before.check, self.check, self.samples.check
        if not held_out:
            one, two, counts = before.fit + one, self.fit + two, self.samples.fit + counts
        explainable = float((one - counts).sum())
        return float((one - two).sum()) / explainable if explainable > 0.0 else 0.0

    def reduces(self, before: 'Hypothesis') -> float:
        """Return the RMS that is taken away from the drive helped most, in floors."""
        return float(np.sqrt(np.maximum(before.gap - self.gap, 0.0)).max())

    @cached_property
    def numbers(self) -> list[tuple[EffectAt, EffectParameter, float]]:
        """The numbers of its effects, those of one after the other."""
        own = [(at, p) for at in self.effects for p in get_effect(at.effect).parameters]
        values = self.theta[len(self.theta) - len(own) :].tolist()
        return [(*one, x) for one, x in zip(own, values, strict=True)]

    def ended(self, at: EffectAt) -> list[EffectParameter]:
        """Return the numbers of one of its effects that ended at bounds, but for nothing."""
        shares = self.unit[self.columns(self.effects.index(at))]
        return get_effect(at.effect).ended(shares.tolist())

    def limits(self, at: EffectAt) -> set[EffectAt]:
        """Return what one of its effects comes to by numbers that ended at a bound."""
        return {EffectAt(p.limit, at.where) for p in self.ended(at) if p.limit}

    def columns(self, index: int) -> list[int]:
        """Return the columns of theta that hold an effect's parameters."""
        own, first = self.effects[index], len(self.theta) - len(self.numbers)
        return [k for k, (at, _, _) in enumerate(self.numbers, first) if at == own]


@dataclass(frozen=True)
class Round:
    """One round of the search for an effect.

    Attributes:
        base: What was there before.
        visible: For every candidate what the log would show of it, see `fits.Start`.
        fitted: The joint fits, the best first.
    """

    base: Hypothesis
    visible: dict[EffectAt, float]
    fitted: tuple[Hypothesis, ...]

    @property
    def alone(self) -> dict[EffectAt, Hypothesis]:
        """The fits with one effect more than the base, by that effect."""
        more = len(self.base.effects) + 1
        return {e.effects[-1]: e for e in self.fitted if len(e.effects) == more}


@dataclass(frozen=True)
class Selection:
    """Result of the forward selection.

    Attributes:
        drives: (D,) names of the drives.
        chain: The nominal fit, then one more effect each.
        rounds: The rounds that were run.
        rivals: Models with another effect in place of the first one found, the best first; itself
            included.
        rests: For each effect found, the final model without it, fitted anew.
        complete: False where time or patience ran out.
        limits: Size of the effort at which the controllers' log shows drives to be limited, for
            those among the effects.
        restless: Floors of drives, in the unit of the residual, that are too large and slow for
            noise.
        ties: Effects that were left out, for something else does along this motion what they do.
    """

    drives: tuple[str, ...]
    chain: tuple[Hypothesis, ...]
    rounds: tuple[Round, ...] = ()
    rivals: tuple[Hypothesis, ...] = ()
    rests: tuple[Hypothesis, ...] = ()
    complete: bool = True
    limits: Mapping[str, float] = field(default_factory=dict)
    restless: Mapping[str, float] = field(default_factory=dict)
    ties: tuple[Tie, ...] = ()

    @property
    def remaining(self) -> float:
        """Gap left, RMS of the worst drive in units of the floor."""
        return self.chain[-1].size

    def nominal(self) -> 'Selection':
        """Return the same with no effect found."""
        return replace(self, chain=self.chain[:1], rivals=(), rests=())
