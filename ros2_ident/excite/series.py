# SPDX-License-Identifier: Apache-2.0
"""Fourier series that begin and end at rest.

Source: Swevers, Ganseman, Tuekel, De Schutter, Van Brussel, Optimal robot excitation and
identification, IEEE Trans. Robotics and Automation 13(5), 1997.
"""

from collections.abc import Sequence
from dataclasses import dataclass
import functools
import math

import numpy as np

from ros2_ident.arrays import Array
from ros2_ident.errors import ErrorCode, IdentError

# A harmonic has at least so many cycles of the controller in its period.
_FINEST = 20.0


@dataclass(frozen=True)
class Series:
    """Series of M dimensions over some periods, with a rest before and after them.

    Attributes:
        period: Period, s.
        periods: How many follow one another.
        harmonics: (H,) multiples of the fundamental frequency.
        sizes: (M, H) amplitude that a coefficient of 1 stands for.
        cycle: Time between two instants, s.
        rest: Rest before and after, s.
    """

    period: float
    periods: int
    harmonics: Array
    sizes: Array
    cycle: float
    rest: float

    @property
    def dimension(self) -> int:
        """How many coefficients there are: a sine and a cosine of each harmonic and dimension."""
        return 2 * self.sizes.size

    @property
    def highest(self) -> float:
        """Highest frequency, Hz."""
        return float(self.harmonics.max()) / self.period

    @functools.cached_property
    def _waves(self) -> tuple[Array, Array]:
        """(2 H, K) sines and cosines of one period, and their derivatives."""
        count = round(self.period / self.cycle)
        rate = 2.0 * math.pi * self.harmonics[:, None] / (count * self.cycle)
        phase = rate * self.cycle * np.arange(count)
        sine, cosine = np.sin(phase), np.cos(phase)
        return np.concatenate([sine, cosine]), np.concatenate([rate * cosine, -rate * sine])

    def deviation(self, coefficients: Array) -> tuple[Array, Array]:
        """Return the way's deviation from its start (M, K), and its derivative.

        Args:
            coefficients: (2 M H,) free; what of them would not begin at rest is taken away.
        """
        sine, cosine = coefficients.reshape(2, *self.sizes.shape)
        # Neither speed nor acceleration at the start: sum h a_h = 0 and sum h^2 b_h = 0.
        sine = _without(sine, self.harmonics * self.sizes) * self.sizes
        cosine = _without(cosine, self.harmonics**2 * self.sizes) * self.sizes
        both = np.concatenate([sine, cosine], axis=1)
        waves, slopes = self._waves
        value, rate = both @ waves, both @ slopes
        return self._whole(value - value[:, :1]), self._whole(rate)

    def _whole(self, rows: Array) -> Array:
        """Return one period's values (M, K) over all the time."""
        still = np.repeat(rows[:, :1], round(self.rest / self.cycle), axis=1)
        return np.concatenate([still, *[rows] * self.periods, rows[:, :1], still], axis=1)


def _without(rows: Array, forbidden: Array) -> Array:
    """Return rows (M, H) less their part along others (M, H)."""
    along = np.sum(rows * forbidden, axis=1) / np.sum(forbidden**2, axis=1)
    out: Array = rows - along[:, None] * forbidden
    return out


def series_for(
    seconds: float,
    cycle: float,
    reach: Array,
    rates: Sequence[Array],
    harmonics: int,
    rest: float,
) -> Series:
    """Return series whose frequencies suit limits.

    The fundamental is a quarter of the frequency at which a sine over the whole reach has full
    speed, the highest that at which full acceleration has full jerk; so neither far ways nor quick
    turns are out of reach.

    Args:
        seconds: Duration with both rests, s.
        cycle: Time between two instants, s.
        reach: (M,) half the room of the way.
        rates: Largest speed, acceleration and jerk along each dimension, (M,) each.
        harmonics: How many there are; fewer where the frequencies do not lie apart.
        rest: Rest before and after, s.

    Raises:
        IdentError: INVALID_GOAL where time or harmonics do not suffice for a motion.
    """
    velocity, acceleration, jerk = rates
    moving = seconds - 2.0 * rest
    if moving < 2.0 * _FINEST * cycle or harmonics < 2:
        raise IdentError(
            ErrorCode.INVALID_GOAL,
            f'{max(moving, 0.0):g} s between two rests and {harmonics} harmonics leave no motion; '
            f'take 2 harmonics and {2.0 * (rest + _FINEST * cycle):g} s or more',
        )
    slow = float(np.min(velocity / reach)) / (2.0 * math.pi) / 4.0
    periods = max(1, round(moving * slow))
    period = moving / periods
    quick = float(np.max(jerk / acceleration)) / (2.0 * math.pi)
    highest = max(2.0, min(quick, 1.0 / (_FINEST * cycle)) * period)
    chosen = np.unique(np.round(np.geomspace(1.0, highest, harmonics)))
    rate = 2.0 * math.pi * chosen / period
    at = [x[:, None] for x in (reach, velocity, acceleration, jerk)]
    sizes = 1.0 / (1.0 / at[0] + rate / at[1] + rate**2 / at[2] + rate**3 / at[3])
    return Series(period, periods, chosen, sizes, cycle, rest)
