# SPDX-License-Identifier: Apache-2.0
"""Where a tripod's platform can be, the carriages above it, and what is drawn of both."""

from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

from ros2_ident.arrays import Array
from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.machine.draft import Remark
from ros2_ident.machine.figure import Figure
from ros2_ident.machine.machine import Machine
from ros2_ident.machine.space import Space


def check_rods(corner: Array, rod: float, remedy: str) -> Iterator[Remark]:
    """Say where three rods do not meet.

    Args:
        corner: (3, K, 3) upper ends of the rods [m], NaN where they are not known.
        rod: Their length [m].
        remedy: What to correct.
    """
    # The rods meet where the circle through the three carriages is smaller than they are long.
    side = [np.linalg.norm(corner[i] - corner[i - 1], axis=-1) for i in range(3)]
    area = np.linalg.norm(np.cross(corner[1] - corner[0], corner[2] - corner[0]), axis=-1)
    circle: Array = side[0] * side[1] * side[2] / (2.0 * area)
    share = float(np.mean(circle[np.isfinite(circle)] >= rod)) if circle.size else 0.0
    if share > 0.0:
        yield Remark(
            'error',
            ('geometry', 'rod_length'),
            f'rods of {rod:g} m do not meet in {100.0 * share:.2g} % of the recorded positions; '
            f'correct {remedy}',
        )


def check_reach(machine: Machine, height: npt.NDArray[np.float64]) -> Iterator[Remark]:
    """Say where the rods of a tripod cannot meet at the recorded positions.

    Args:
        machine: A tripod.
        height: (3, K) positions of its carriages [m], NaN where there is no sample.
    """
    radius = machine.number('rail_radius')
    azimuth = machine.numbers('rail_azimuth')[:, None]
    corner = np.stack(
        [*np.broadcast_arrays(radius * np.cos(azimuth), radius * np.sin(azimuth), height)], axis=-1
    )
    remedy = 'rod_length, rail_radius, rail_azimuth, or the unit of the positions (m)'
    yield from check_rods(corner, machine.number('rod_length'), remedy)


def meeting_point(feet: Array, lengths: Array) -> Array:
    """Return the lower meeting point of three spheres (3,) [m].

    Args:
        feet: (3, 3) their middles [m].
        lengths: (3,) their radii [m].

    Raises:
        IdentError: BAD_VALUES where they do not meet.
    """
    across = feet[1:] - feet[0]
    level = 0.5 * (
        np.sum(feet[1:] ** 2, axis=1) - feet[0] @ feet[0] - lengths[1:] ** 2 + lengths[0] ** 2
    )
    normal = np.cross(across[0], across[1])
    normal *= np.sign(normal[2]) / np.linalg.norm(normal)
    base = np.linalg.solve(np.vstack([across, normal]), np.append(level, normal @ feet[0]))
    depth = lengths[0] ** 2 - np.sum((base - feet[0]) ** 2)
    if not depth > 0.0:
        raise IdentError(
            ErrorCode.BAD_VALUES,
            f'the rods do not reach from joints at {feet.tolist()}; keep closer set-points',
        )
    return np.asarray(base - np.sqrt(depth) * normal, dtype=float)


def space(machine: Machine) -> Space:
    """Return where the platform moves when nobody says otherwise."""
    size = machine.number('rod_length') / 0.6
    return Space(
        np.array([0.0, 0.0, -0.05]) * size, np.array([0.075, 0.075, 0.06]) * size, 1.0, 25.0
    )


def set_points(points: Array, speeds: Array, machine: Machine) -> tuple[Array, Array]:
    """Return the carriages' set-points of a platform's way.

    Args:
        points: (3, K) platform positions [m].
        speeds: (3, K) platform speeds [m/s].
        machine: A tripod.

    Returns:
        (3, K) carriage positions [m] and speeds [m/s].

    Raises:
        IdentError: BAD_VALUES where a rod would not reach.
    """
    azimuth = machine.numbers('rail_azimuth')
    foot = machine.number('rail_radius') * np.stack([np.cos(azimuth), np.sin(azimuth)], axis=1)
    away = points[None, :2] - foot[:, :, None]
    square = machine.number('rod_length') ** 2 - np.sum(away**2, axis=1)
    if not np.all(square > 0.0):
        raise IdentError(
            ErrorCode.BAD_VALUES, 'the motion leaves the reach of the rods; shrink its space'
        )
    rise = np.sqrt(square)
    return points[2] + rise, speeds[2] - np.sum(away * speeds[None, :2], axis=1) / rise


def platform(feet: Array, rod: float, corner: Array) -> tuple[Array, Array] | None:
    """Return (F, 3) places of the platform and what is drawn of it; None where no rod reaches.

    Args:
        feet: (F, 3, 3) upper ends of the rods [m], the platform's circle taken off.
        rod: Their length [m].
        corner: (3, 3) its corners from its middle [m].
    """
    try:
        tool = np.array([meeting_point(row, np.full(3, rod)) for row in feet])
    except IdentError:  # as with a wrong zero
        return None
    sides = np.stack([corner, np.roll(corner, -1, axis=0)], axis=1)
    spokes = np.stack([corner, np.zeros((3, 3))], axis=1)
    return tool, np.concatenate([sides, spokes])


def figure(machine: Machine, position: Array) -> Figure | None:
    """Return a tripod in space: rails, carriages, rods and the platform where they hold it.

    Only the difference of the two circles matters to the motion; the platform's is drawn as a
    quarter of it, and the rails stand out by as much.

    Args:
        machine: A tripod.
        position: (3, F) heights of its carriages [m].

    Returns:
        What to draw; None for positions that no rod reaches.
    """
    radius, azimuth = machine.number('rail_radius'), machine.numbers('rail_azimuth')
    rail = radius * np.stack([np.cos(azimuth), np.sin(azimuth), np.zeros(3)], axis=1)
    carriage = position.T[..., None] * np.array([0.0, 0.0, 1.0])
    corner = 0.25 * rail
    held = platform(rail + carriage, machine.number('rod_length'), corner)
    if held is None:
        return None
    tool, body = held
    foot = 1.25 * rail + carriage
    ends = float(position.min()) - 0.5 * radius, float(position.max()) + 0.25 * radius
    rails = [1.25 * rail + np.array([0.0, 0.0, z]) for z in ends]
    return Figure(
        size=radius,
        tool=tool,
        blocks=foot,
        links=np.stack([foot, tool[:, None] + corner], axis=2),
        body=body,
        frame=np.stack(rails, axis=1),
    )
