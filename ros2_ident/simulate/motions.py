# SPDX-License-Identifier: Apache-2.0
"""Set-points for a machine: what users let their drives do, drawn by seed within the workspace.

A tripod's motions are planned for the platform and brought to the rails by
s_i = p_z + sqrt(L^2 - |p_xy - rho e_i|^2) with the machine file's geometry.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from ros2_ident.arrays import Array
from ros2_ident.errors import ErrorCode
from ros2_ident.machine.kind import Space
from ros2_ident.machine.machine import Machine
from ros2_ident.models.registry import set_points_of, space_of

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
        points = np.repeat(self.place[:, None], count, axis=1)
        self._append(points, np.zeros_like(points))

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

    def go(self, target: Array, space: Space, pace: float) -> None:
        """Go straight to a point (M,) [m] at a share of what a space allows."""
        self.move(target, pace * space.speed, pace * space.acceleration)

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


@dataclass(frozen=True)
class Motion:
    """Set-points of the drives at every controller cycle.

    Attributes:
        kind: What sort of motion.
        cycle: Controller cycle [s].
        position: (D, K) set-point [m].
        velocity: (D, K) its derivative [m/s].
    """

    kind: str
    cycle: float
    position: Array
    velocity: Array

    @property
    def seconds(self) -> float:
        """Duration [s]."""
        return float((self.position.shape[1] - 1) * self.cycle)


def _pick_and_place(path: Path, space: Space, rng: np.random.Generator, seconds: float) -> None:
    """Lower, wait, lift, carry, lower, wait: between a few places."""
    lift = np.zeros(space.centre.size)
    lift[-1] = 0.7 * space.reach[-1]
    floor = space.centre.copy()
    floor[-1] -= space.reach[-1]
    while path.seconds < seconds:
        pace = rng.uniform(0.5, 1.0)
        place = space.point(rng, 0.95)
        if space.centre.size > 1:
            place[-1] = floor[-1] + 0.2 * space.reach[-1] * rng.random()
            path.go(place + lift, space, pace)
        path.go(place, space, 0.5 * pace)
        path.rest(rng.uniform(0.08, 0.25))
        if space.centre.size > 1:
            path.go(place + lift, space, 0.6 * pace)


def _multi_point(path: Path, space: Space, rng: np.random.Generator, seconds: float) -> None:
    """Quintic moves from point to point, at full pace."""
    while path.seconds < seconds:
        pace = rng.uniform(0.4, 1.0)
        path.go(space.point(rng), space, pace)
        if rng.random() < 0.3:
            path.rest(rng.uniform(0.02, 0.15))


def _creep(path: Path, space: Space, rng: np.random.Generator, seconds: float) -> None:
    """Slow moves there and back, at 5 to 30 mm/s of the tripod's scale."""
    slow = space.speed / 1.0
    while path.seconds < seconds:
        speed = slow * rng.uniform(0.005, 0.03)
        way = 0.15 * space.reach * rng.uniform(-1.0, 1.0, space.centre.size)
        target = np.clip(path.place + way, space.centre - space.reach, space.centre + space.reach)
        back = path.place.copy()
        path.move(target, speed, 0.1 * space.acceleration)
        path.move(back + 0.2 * (target - back), speed, 0.1 * space.acceleration)


def _chirp(path: Path, space: Space, rng: np.random.Generator, seconds: float) -> None:
    """A sine from 0.3 to 8 Hz whose amplitude keeps speed and acceleration within limits."""
    duration = max(1.0, seconds - path.seconds)
    low, high = 0.3, 8.0
    size = space.centre.size
    direction = rng.uniform(0.4, 1.0, size) * rng.choice([-1.0, 1.0], size)
    direction /= np.linalg.norm(direction)

    def shape(time: Array) -> tuple[Array, Array]:
        growth = np.log(high / low) / duration
        rate = 2.0 * np.pi * low * np.exp(growth * time)
        phase = (rate - 2.0 * np.pi * low) / growth
        soft = 1.0 / (0.7 * np.min(space.reach)) + rate / (0.7 * space.speed)
        size = 1.0 / (soft + rate**2 / (0.7 * space.acceleration))
        # Derivative of the size: rate' = growth rate.
        slope = -(size**2) * growth * rate / (0.7 * space.speed)
        slope -= size**2 * 2.0 * growth * rate**2 / (0.7 * space.acceleration)
        value = size * np.sin(phase)
        speed = size * rate * np.cos(phase) + slope * np.sin(phase)
        return direction[:, None] * value, direction[:, None] * speed

    path.wave(duration, shape)


def _multisine(path: Path, space: Space, rng: np.random.Generator, seconds: float) -> None:
    """Sines of random phase on a grid of 0.2 Hz up to 5 Hz, differently in every direction."""
    duration = max(1.0, seconds - path.seconds)
    size = space.centre.size
    frequency = 0.2 * rng.choice(np.arange(1, 26), size=(size, 8), replace=True)
    phase = rng.uniform(0.0, 2.0 * np.pi, (size, 8))
    rate = 2.0 * np.pi * frequency
    soft = 1.0 / np.min(space.reach) + rate / space.speed + rate**2 / space.acceleration
    amplitude = 1.0 / soft * 0.35

    def shape(time: Array) -> tuple[Array, Array]:
        angle = rate[:, :, None] * time + phase[:, :, None]
        value = np.sum(amplitude[:, :, None] * np.sin(angle), axis=1)
        return value, np.sum((amplitude * rate)[:, :, None] * np.cos(angle), axis=1)

    path.wave(duration, shape)


def _reversals(path: Path, space: Space, rng: np.random.Generator, seconds: float) -> None:
    """There and back without a rest, the way growing from a hundredth of the reach."""
    share, size = 0.01, space.centre.size
    while path.seconds < seconds:
        middle = path.place.copy()
        direction = rng.choice([-1.0, 1.0], size) * rng.uniform(0.5, 1.0, size)
        pace = rng.uniform(0.1, 0.5)
        for sign in (1.0, -1.0, 0.0):
            path.go(middle + sign * share * space.reach * direction, space, pace)
        share = 0.01 if share > 0.4 else 1.8 * share


def _dwell(path: Path, space: Space, rng: np.random.Generator, seconds: float) -> None:
    """Moves with rests of 0.1 to 1.5 s between them."""
    while path.seconds < seconds:
        pace = rng.uniform(0.1, 0.6)
        path.go(space.point(rng), space, pace)
        path.rest(float(np.exp(rng.uniform(np.log(0.1), np.log(1.5)))))


def _steps(path: Path, space: Space, rng: np.random.Generator, seconds: float) -> None:
    """Small steps one way, a tenth of the time apart, as in fig. 5 of Ludwig and Gerstmayr."""
    begin = path.seconds
    way = 0.1 * space.reach * rng.choice([-1.0, 1.0], space.centre.size)
    for number in range(1, 10):
        # At instants that a log of any usual rate holds.
        at = round(begin + 0.1 * number * (seconds - begin), 2)
        path.rest(at - path.seconds - path.cycle)
        path.jump(path.place + way)


def _mixed(path: Path, space: Space, rng: np.random.Generator, seconds: float) -> None:
    """Fast moves, slow ones, fast ones: an ordinary working log."""
    begin = path.seconds
    part = (seconds - begin) / 3.0
    _multi_point(path, space, rng, begin + part)
    slow = Space(space.centre, space.reach, 0.12 * space.speed, 0.05 * space.acceleration)
    _multi_point(path, slow, rng, begin + 2.0 * part)
    _multi_point(path, space, rng, seconds)


KINDS: Mapping[str, Callable[[Path, Space, np.random.Generator, float], None]] = {
    'pick_and_place': _pick_and_place, 'multi_point': _multi_point, 'creep': _creep,
    'chirp': _chirp, 'multisine': _multisine, 'reversals': _reversals, 'dwell': _dwell,
    'mixed': _mixed, 'steps': _steps,
}  # fmt: skip


def draw_motion(
    kind: str,
    machine: Machine,
    seconds: float,
    seed: int | np.random.Generator,
    space: Space | None = None,
) -> Motion:
    """Draw a motion that starts at rest in the middle of the workspace.

    Args:
        kind: One of `KINDS`.
        seconds: Duration [s].
        seed: Seed, or source of chance.
        space: Workspace and limits; the machine's usual ones where not given.

    Returns:
        The motion.

    Raises:
        IdentError: INVALID_GOAL for an unknown kind or a duration that is too short.
    """
    if kind not in KINDS:
        raise ErrorCode.INVALID_GOAL.error(
            f'no motion is called {kind}; choose from {", ".join(KINDS)}'
        )
    if not seconds >= 1.0:
        raise ErrorCode.INVALID_GOAL.error(
            f'a motion of {seconds} s is too short; take 1 s or more'
        )
    rng = np.random.default_rng(seed)
    space = space or space_of(machine)
    cycle = machine.number('cycle')
    path = Path(space.centre, cycle)
    path.rest(rng.uniform(0.25, 0.5))
    KINDS[kind](path, space, rng, seconds)
    points, speeds = path.sampled(seconds)
    return Motion(kind, cycle, *set_points_of(machine, points, speeds))
