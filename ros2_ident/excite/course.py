# SPDX-License-Identifier: Apache-2.0
"""Set-points from the numbers of a search, as large as their limits allow."""

from dataclasses import dataclass, replace
import functools

import numpy as np

from ros2_ident.arrays import Array
from ros2_ident.errors import IdentError
from ros2_ident.excite.limits import carries, Limits, Moved, transmission
from ros2_ident.excite.series import Series, series_for
from ros2_ident.machine.machine import Machine
from ros2_ident.models.registry import set_points_of

# Rounds in which a motion grows or shrinks until it touches its first limit.
_ROUNDS = 3
# A deviation smaller than this is none, rad or m.
_STILL = 1e-12
# Steps from where a tool should be to where it is.
_NEAR = 4
# Of a platform that leaves the reach of its rods, so much is left to try again.
_SHRUNK = 0.7


@dataclass(frozen=True, eq=False)
class Courses:
    """Motions of a machine, each from a point of the unit cube.

    Attributes:
        machine: The machine.
        limits: Its limits.
        series: What the motions are made of.
    """

    machine: Machine
    limits: Limits
    series: Series

    @property
    def dimension(self) -> int:
        """Numbers of a motion: its coefficients, and where it is in the room that it leaves."""
        return self.series.dimension + len(self.limits.way_low)

    @functools.cached_property
    def _carried(self) -> bool:
        return carries(self.machine)

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
        if not self._carried:
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
        out: Array = np.max(list(kept), axis=0)
        return out

    def _moved(self, points: Array, speeds: Array) -> Moved:
        """Return the drives' motion on a way (M, K) through the room."""
        if not self._carried:
            return derived(points, speeds, self.series.cycle)
        at = set_points_of(self.machine, points, speeds)
        return replace(derived(*at, self.series.cycle), tool=points)


def tool_of(machine: Machine, back: Array, planned: Moved, position: Array) -> Array | None:
    """Return (M, K) where the tool is while drives that should follow a plan are at (D, K).

    From the plan on by Newton's method, with the slopes in the middle of the room.

    Args:
        machine: The machine.
        back: (M, D) the inverse of its `transmission`.
        planned: The plan.
        position: (D, K).
    """
    if planned.tool is None:
        return None
    place = planned.tool
    for _ in range(_NEAR):
        there = set_points_of(machine, place, np.zeros_like(place))[0]
        place = place + back @ (position - there)
    return place


def derived(position: Array, velocity: Array, cycle: float) -> Moved:
    """Return a motion (D, K) with what follows from its speeds."""
    acceleration = np.gradient(velocity, cycle, axis=1)
    return Moved(position, velocity, acceleration, np.gradient(acceleration, cycle, axis=1))


def courses_for(
    machine: Machine, limits: Limits, seconds: float, harmonics: int = 8, rest: float = 0.25
) -> Courses:
    """Return the motions of a machine within limits.

    Args:
        machine: The machine.
        limits: Its limits.
        seconds: Duration, s.
        harmonics: Frequencies that a motion has.
        rest: Rest before and after, s.
    """
    cycle = machine.number('cycle')
    reach = 0.5 * (limits.way_high - limits.way_low)
    rates = [limits.velocity, limits.acceleration, limits.jerk]
    if carries(machine):
        gear = np.abs(transmission(machine))
        slow = np.maximum(gear, 1e-9)
        rates = [np.min(x[:, None] / slow, axis=0) for x in rates]
    series = series_for(seconds, cycle, reach, rates, harmonics, rest)
    return Courses(machine, limits, series)
