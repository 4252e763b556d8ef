# SPDX-License-Identifier: Apache-2.0
"""Where the platform of a tripod or a delta can be, the drives above it, and what is drawn."""

from collections.abc import Iterator

import numpy as np

from ros2_ident.arrays import Array
from ros2_ident.errors import ErrorCode
from ros2_ident.machine.kind import Figure, Remark, Space
from ros2_ident.machine.machine import Machine

# How far a delta's arm hangs below the level in the middle of the workspace, rad.
_HANGING = 0.5
_LEAVES = 'the motion leaves the reach of the rods; shrink its space'


def feet(machine: Machine, position: Array) -> Array:
    """Return (3, K, 3) upper ends of the rods [m], the platform's circle taken off.

    Args:
        machine: A tripod, or a delta, whose arms carry them.
        position: (3, K) positions of its drives [m or rad].
    """
    if not _turns(machine):
        radius, azimuth = machine.number('rail_radius'), machine.numbers('rail_azimuth')[:, None]
        level = radius * np.cos(azimuth), radius * np.sin(azimuth)
        return np.stack([*np.broadcast_arrays(*level, position)], axis=-1)
    azimuth = machine.numbers('shaft_azimuth')[:, None]
    turned = position - machine.numbers('arm_zero')[:, None]
    arm = machine.number('arm_length')
    far = machine.number('shaft_radius') + arm * np.cos(turned)
    high = sense(machine) * arm * np.sin(turned)
    return np.stack([far * np.cos(azimuth), far * np.sin(azimuth), high], axis=-1)


def _turns(machine: Machine) -> bool:
    return 'arm_length' in machine.constants


def sense(machine: Machine) -> float:
    """Return 1 where positive angles lift a delta's arms, -1 where they lower them."""
    return 1.0 if machine.text('positive') == 'up' else -1.0


def check_reach(machine: Machine, position: Array) -> Iterator[Remark]:
    """Say where the rods cannot meet at the recorded positions.

    Args:
        machine: A tripod or a delta.
        position: (3, K) of its drives [m or rad], NaN where there is no sample.
    """
    rod = machine.number('rod_length')
    # The rods meet where the circle through their upper ends is smaller than they are long.
    radius = _circle(feet(machine, position))[1]
    share = float(np.mean(radius[np.isfinite(radius)] >= rod)) if radius.size else 0.0
    if share > 0.0:
        remedy = (
            'the lengths, arm_zero, positive, or the unit of the positions (rad)'
            if _turns(machine)
            else 'rod_length, rail_radius, rail_azimuth, or the unit of the positions (m)'
        )
        yield Remark(
            ('geometry', 'rod_length'),
            f'rods of {rod:g} m do not meet in {100.0 * share:.2g} % of the recorded positions; '
            f'correct {remedy}',
        )


def _circle(feet: Array) -> tuple[Array, Array, Array]:
    """Return middle (K, 3), radius (K,) and axis (K, 3), upwards, of circles through (3, K, 3)."""
    one, other = feet[1] - feet[0], feet[2] - feet[0]
    normal = np.cross(one, other)
    size = np.linalg.norm(normal, axis=-1, keepdims=True)
    far = np.sum(one**2, axis=-1, keepdims=True), np.sum(other**2, axis=-1, keepdims=True)
    out = (far[1] * np.cross(normal, one) - far[0] * np.cross(normal, other)) / (2.0 * size**2)
    upwards = normal * np.sign(normal[..., 2:]) / size
    return feet[0] + out, np.linalg.norm(out, axis=-1), upwards


def space(machine: Machine) -> Space:
    """Return where the platform moves by default."""
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
        raise ErrorCode.BAD_VALUES.error(_LEAVES)
    rise = np.sqrt(square)
    return points[2] + rise, speeds[2] - np.sum(away * speeds[None, :2], axis=1) / rise


def space_of_delta(machine: Machine) -> Space:
    """Return where the platform moves by default."""
    arm = machine.number('arm_length')
    out = machine.number('shaft_radius') + arm * np.cos(_HANGING)
    depth = arm * np.sin(_HANGING) + np.sqrt(machine.number('rod_length') ** 2 - out**2)
    size = arm / 0.25
    return Space(
        np.array([0.0, 0.0, -depth]), np.array([0.10, 0.10, 0.05]) * size, 2.0 * size, 50.0 * size
    )


def set_points_of_delta(points: Array, speeds: Array, machine: Machine) -> tuple[Array, Array]:
    """Return angles (3, K) [rad] of arms that bend outwards, and rates; as `set_points` else."""
    azimuth = machine.numbers('shaft_azimuth')[:, None]
    arm, rod = machine.number('arm_length'), machine.number('rod_length')
    out = np.stack([np.cos(azimuth), np.sin(azimuth)])
    # In each arm's plane: the platform outwards of the shaft and above it; across it the rest.
    ahead = np.sum(out * points[:2, None], axis=0) - machine.number('shaft_radius')
    across = out[0] * points[1] - out[1] * points[0]
    square = ahead**2 + points[2] ** 2
    wanted = (square + across**2 + arm**2 - rod**2) / (2.0 * arm * np.sqrt(square))
    if not np.all(np.abs(wanted) < 1.0):
        raise ErrorCode.BAD_VALUES.error(_LEAVES)
    up = np.arctan2(points[2], ahead) + np.arccos(wanted)
    up = np.remainder(up + np.pi, 2.0 * np.pi) - np.pi
    # Along a rod nothing moves: its product with the platform's speed is that with the joint's.
    rate_ahead = np.sum(out * speeds[:2, None], axis=0)
    rate_across = out[0] * speeds[1] - out[1] * speeds[0]
    cos, sin = np.cos(up), np.sin(up)
    rod_ahead, rod_up = ahead - arm * cos, points[2] - arm * sin
    along = rod_ahead * rate_ahead + across * rate_across + rod_up * speeds[2]
    rate = along / (arm * (rod_up * cos - rod_ahead * sin))
    up, rate = sense(machine) * up, sense(machine) * rate
    return up + machine.numbers('arm_zero')[:, None], rate


def figure(machine: Machine, position: Array) -> Figure | None:
    """Return a machine in space: its frame, carriages or arms, rods and the platform.

    Only the difference of the two circles matters to the motion; the platform's is drawn as a
    quarter of it, and rails or shafts stand out by as much.

    Args:
        machine: A tripod or a delta.
        position: (3, F) of its drives [m or rad].

    Returns:
        What to draw; None for positions that no rod reaches.
    """
    turns = _turns(machine)
    of = 'shaft' if turns else 'rail'
    radius, azimuth = machine.number(f'{of}_radius'), machine.numbers(f'{of}_azimuth')
    base = radius * np.stack([np.cos(azimuth), np.sin(azimuth), np.zeros(3)], axis=1)
    corner = 0.25 * base
    foot = feet(machine, position)
    middle, around, upwards = _circle(foot)
    depth = machine.number('rod_length') ** 2 - around**2
    if not (depth > 0.0).all():  # as with a wrong zero
        return None
    tool = middle - np.sqrt(depth)[:, None] * upwards
    base, joints = base + corner, foot.swapaxes(0, 1) + corner
    links = np.stack([joints, tool[:, None] + corner], axis=2)
    if turns:
        arms = np.stack([np.broadcast_to(base, joints.shape), joints], axis=2)
        links = np.concatenate([arms, links], axis=1)
        frame = _sides(base)
    else:
        ends = float(position.min()) - 0.5 * radius, float(position.max()) + 0.25 * radius
        frame = np.stack([base + np.array([0.0, 0.0, z]) for z in ends], axis=1)
    spokes = np.stack([corner, np.zeros((3, 3))], axis=1)
    return Figure(
        size=radius + (machine.number('arm_length') if turns else 0.0),
        tool=tool,
        blocks=joints,
        links=links,
        body=np.concatenate([_sides(corner), spokes]),
        frame=frame,
    )


def _sides(corners: Array) -> Array:
    """Return (3, 2, 3) the ends of a triangle's sides."""
    return np.stack([corners, np.roll(corners, -1, axis=0)], axis=1)
