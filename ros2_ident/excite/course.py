# SPDX-License-Identifier: Apache-2.0
"""Set-points from the numbers of a search, as large as their limits allow.

Fourier series that begin and end at rest: Swevers, Ganseman, Tuekel, De Schutter, Van Brussel,
Optimal robot excitation and identification, IEEE Trans. Robotics and Automation 13(5), 1997.
"""

from dataclasses import dataclass, replace
import functools
import math

import numpy as np

from ros2_ident.arrays import Array
from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.excite.limits import carries, Limits, Moved, transmission
from ros2_ident.machine.machine import Machine
from ros2_ident.models.registry import set_points_of

# A harmonic has at least so many cycles of the controller in its period.
_FINEST = 20.0
# Rounds in which a motion grows or shrinks until it touches its first limit.
_ROUNDS = 3
# A deviation smaller than this is none, rad or m.
_STILL = 1e-12
# Of a platform that leaves the reach of its rods, so much is left to try again.
_SHRUNK = 0.7


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
    return np.asarray(rows - along[:, None] * forbidden)


@dataclass(frozen=True, eq=False)
class Courses:
    """Motions of a machine, each from a point of the unit cube."""

    machine: Machine
    limits: Limits
    series: Series

    @property
    def dimension(self) -> int:
        """Numbers of a motion: its coefficients, and where it is in the room that it leaves."""
        return self.series.dimension + len(self.limits.way_low)

    def motion(self, point: Array, share: float = 1.0) -> Moved:
        """Return the set-points of a point (N,) of the unit cube, scaled to their limits.

        Args:
            point: (N,).
            share: What of the largest motion, and of the room that it uses, is wanted, 0 to 1.
        """
        value, rate = self.series.deviation(2.0 * point[: self.series.dimension] - 1.0)
        middle = 0.5 * (self.limits.way_high + self.limits.way_low)
        bottom, span = value.min(axis=1), np.ptp(value, axis=1)
        place = point[self.series.dimension :]

        def at(size: Array, share: float = 1.0) -> Moved:
            free = share * (self.limits.way_high - self.limits.way_low)
            size = share * size
            begin = middle - 0.5 * free - size * bottom + place * (free - size * span)
            return self._moved(begin[:, None] + size[:, None] * value, size[:, None] * rate)

        room = (self.limits.way_high - self.limits.way_low) / np.maximum(span, _STILL)
        if not carries(self.machine):
            return at(room / np.maximum(1.0, self._rates(at(room))), share)
        most = room.min()
        size = np.full(len(room), most)
        for _ in range(_ROUNDS):
            try:
                size = np.minimum(size / self._rates(at(size)).max(), most)
            except IdentError:
                size = _SHRUNK * size
        return at(size, share)

    def _rates(self, moved: Moved) -> Array:
        """Return (D,) the largest share of a limit that each drive takes."""
        loads = self.limits.loads(moved)
        # The room is minded already.
        kept = (row for name, row in loads.items() if name not in ('position', 'workspace'))
        return np.asarray(np.max(list(kept), axis=0))

    def _moved(self, points: Array, speeds: Array) -> Moved:
        """Return the drives' motion on a way (M, K) through the room."""
        if not carries(self.machine):
            return derived(points, speeds, self.series.cycle)
        at = set_points_of(self.machine, points, speeds)
        return replace(derived(*at, self.series.cycle), tool=points)


def derived(position: Array, velocity: Array, cycle: float) -> Moved:
    """Return a motion (D, K) with what follows from its speeds."""
    acceleration = np.gradient(velocity, cycle, axis=1)
    return Moved(position, velocity, acceleration, np.gradient(acceleration, cycle, axis=1))


def courses_for(
    machine: Machine, limits: Limits, seconds: float, harmonics: int = 8, rest: float = 0.25
) -> Courses:
    """Return the motions of a machine within limits, their frequencies to suit these.

    The fundamental is a quarter of the frequency at which a sine over the whole reach has full
    speed, the highest that at which full acceleration has full jerk; so neither far ways nor quick
    turns are out of reach.

    Args:
        seconds: Duration with both rests, s.
        harmonics: Frequencies that a motion has; fewer where they do not lie apart.
        rest: Rest before and after, s.

    Raises:
        IdentError: INVALID_GOAL where time or harmonics do not suffice for a motion.
    """
    cycle = machine.number('cycle')
    reach = 0.5 * (limits.way_high - limits.way_low)
    rates = [limits.velocity, limits.acceleration, limits.jerk]
    if carries(machine):
        gear = np.abs(transmission(machine))
        slow = np.maximum(gear, 1e-9)
        rates = [np.min(x[:, None] / slow, axis=0) for x in rates]
    velocity, acceleration, jerk = rates
    moving = seconds - 2.0 * rest
    if moving < 2.0 * _FINEST * cycle or harmonics < 2:
        raise ErrorCode.INVALID_GOAL.error(
            f'{max(moving, 0.0):g} s between two rests and {harmonics} harmonics leave no motion; '
            f'take 2 harmonics and {2.0 * (rest + _FINEST * cycle):g} s or more'
        )
    lowest = float(np.min(velocity / reach)) / (2.0 * math.pi) / 4.0
    periods = max(1, round(moving * lowest))
    period = moving / periods
    quick = float(np.max(jerk / acceleration)) / (2.0 * math.pi)
    highest = max(2.0, min(quick, 1.0 / (_FINEST * cycle)) * period)
    chosen = np.unique(np.round(np.geomspace(1.0, highest, harmonics)))
    rate = 2.0 * math.pi * chosen / period
    at = [x[:, None] for x in (reach, velocity, acceleration, jerk)]
    sizes = 1.0 / (1.0 / at[0] + rate / at[1] + rate**2 / at[2] + rate**3 / at[3])
    return Courses(machine, limits, Series(period, periods, chosen, sizes, cycle, rest))
