# SPDX-License-Identifier: Apache-2.0
"""Smooth ways through a space: rests, quintic moves and waves, put one after another."""

from collections.abc import Callable

import numpy as np

from ros2_ident.arrays import Array

# Largest speed and acceleration of the unit quintic 10 u^3 - 15 u^4 + 6 u^5.
QUINTIC_SPEED = 1.875
QUINTIC_ACCELERATION = 10.0 / np.sqrt(3.0)


def quintic(share: Array) -> tuple[Array, Array]:
    """Return the unit quintic and its derivative at shares of the move's time, 0 to 1."""
    u = np.clip(share, 0.0, 1.0)
    return u**3 * (10.0 - 15.0 * u + 6.0 * u**2), 30.0 * (u * (1.0 - u)) ** 2


class Path:
    """A way through a space of M dimensions, sampled at every controller cycle.

    Args:
        start: (M,) first point [m].
        cycle: Controller cycle [s].
    """

    def __init__(self, start: Array, cycle: float) -> None:
        self.cycle = cycle
        self.place: Array = np.asarray(start, dtype=float)
        self._points: list[Array] = [self.place[:, None]]
        self._speeds: list[Array] = [np.zeros((self.place.size, 1))]

    @property
    def seconds(self) -> float:
        """The path's time so far [s]."""
        return float((sum(part.shape[1] for part in self._points) - 1) * self.cycle)

    def rest(self, seconds: float) -> None:
        """Stay where the path has come to."""
        count = max(0, round(seconds / self.cycle))
        self._append(
            np.repeat(self.place[:, None], count, axis=1), np.zeros((self.place.size, count))
        )

    def jump(self, target: Array) -> None:
        """Be at a point (M,) [m] with the next cycle, without a speed."""
        point: Array = np.asarray(target, dtype=float)[:, None]
        self._append(point, np.zeros_like(point))

    def move(self, target: Array, speed: float, acceleration: float) -> None:
        """Go straight to a point by a quintic.

        Args:
            target: (M,) point [m].
            speed: Largest speed along the line [m/s].
            acceleration: Largest acceleration along the line [m/s^2].
        """
        way = np.asarray(target, dtype=float) - self.place
        length = float(np.linalg.norm(way))
        time = max(
            QUINTIC_SPEED * length / speed, np.sqrt(QUINTIC_ACCELERATION * length / acceleration)
        )
        count = max(1, int(np.ceil(time / self.cycle)))
        part, rate = quintic(np.arange(1, count + 1) / count)
        points = self.place[:, None] + way[:, None] * part
        self._append(points, way[:, None] * rate / (count * self.cycle))

    def wave(self, seconds: float, shape: Callable[[Array], tuple[Array, Array]]) -> None:
        """Add a wave about the present place, faded in and out over its first and last tenth.

        Args:
            seconds: Duration [s].
            shape: Deviation (M, T) [m] and its derivative (M, T) [m/s] at times (T,) [s].
        """
        count = max(10, round(seconds / self.cycle))
        time: Array = self.cycle * np.arange(1.0, count + 1.0)
        fade = 0.1 * count * self.cycle
        rise, rise_rate = quintic(time / fade)
        fall, fall_rate = quintic((count * self.cycle - time) / fade)
        gain = rise * fall
        gain_rate = (rise_rate * fall - rise * fall_rate) / fade
        value, rate = shape(time)
        self._append(self.place[:, None] + gain * value, gain * rate + gain_rate * value)

    def sampled(self, seconds: float) -> tuple[Array, Array]:
        """Return points and speeds, each (M, K), padded with rest or cut to a duration."""
        if self.seconds < seconds:
            self.rest(seconds - self.seconds)
        count = round(seconds / self.cycle) + 1
        points = np.concatenate(self._points, axis=1)
        speeds = np.concatenate(self._speeds, axis=1)
        return np.ascontiguousarray(points[:, :count]), np.ascontiguousarray(speeds[:, :count])

    def _append(self, points: Array, speeds: Array) -> None:
        if points.shape[1]:
            self._points.append(points)
            self._speeds.append(speeds)
            self.place = points[:, -1].copy()
