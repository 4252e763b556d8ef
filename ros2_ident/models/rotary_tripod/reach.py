# SPDX-License-Identifier: Apache-2.0
"""Where a delta's platform can be, the joints of its arms, and what is drawn of both."""

from collections.abc import Iterator

import numpy as np

from ros2_ident.arrays import Array
from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.machine.draft import Remark
from ros2_ident.machine.figure import Figure
from ros2_ident.machine.machine import Machine
from ros2_ident.machine.space import Space
from ros2_ident.models.tripod.reach import check_rods, platform

# How far an arm hangs below the level in the middle of the workspace, rad.
_HANGING = 0.5


def _sense(machine: Machine) -> float:
    """Return 1 where positive angles lift the arms, -1 where they lower them."""
    return 1.0 if machine.text('positive') == 'up' else -1.0


def joints_of(machine: Machine, angle: Array) -> Array:
    """Return (3, K, 3) places of the arms' joints [m], the platform's circle taken off.

    Args:
        machine: A delta.
        angle: (3, K) positions of its drives [rad].
    """
    azimuth = machine.numbers('shaft_azimuth')[:, None]
    turned = angle - machine.numbers('arm_zero')[:, None]
    arm = machine.number('arm_length')
    far = machine.number('shaft_radius') + arm * np.cos(turned)
    high = _sense(machine) * arm * np.sin(turned)
    return np.stack([far * np.cos(azimuth), far * np.sin(azimuth), high], axis=-1)


def check_reach(machine: Machine, angle: Array) -> Iterator[Remark]:
    """Say where the rods of a delta cannot meet at the recorded positions.

    Args:
        machine: A delta.
        angle: (3, K) positions of its drives [rad], NaN where there is no sample.
    """
    remedy = 'the lengths, arm_zero, positive, or the unit of the positions (rad)'
    yield from check_rods(joints_of(machine, angle), machine.number('rod_length'), remedy)


def space(machine: Machine) -> Space:
    """Return where the platform moves when nobody says otherwise."""
    arm = machine.number('arm_length')
    out = machine.number('shaft_radius') + arm * np.cos(_HANGING)
    depth = arm * np.sin(_HANGING) + np.sqrt(machine.number('rod_length') ** 2 - out**2)
    size = arm / 0.25
    return Space(
        np.array([0.0, 0.0, -depth]), np.array([0.10, 0.10, 0.05]) * size, 2.0 * size, 50.0 * size
    )


def set_points(points: Array, speeds: Array, machine: Machine) -> tuple[Array, Array]:
    """Return the drives' set-points of a platform's way: the arms bend outwards.

    Args:
        points: (3, K) platform positions [m].
        speeds: (3, K) platform speeds [m/s].
        machine: A delta.

    Returns:
        (3, K) angles [rad] and their rates [rad/s].

    Raises:
        IdentError: BAD_VALUES where a rod would not reach.
    """
    azimuth = machine.numbers('shaft_azimuth')[:, None]
    arm, rod = machine.number('arm_length'), machine.number('rod_length')
    out = np.stack([np.cos(azimuth), np.sin(azimuth)])
    # In each arm's plane: the platform outwards of the shaft and above it; across it the rest.
    ahead = np.sum(out * points[:2, None], axis=0) - machine.number('shaft_radius')
    across = out[0] * points[1] - out[1] * points[0]
    square = ahead**2 + points[2] ** 2
    wanted = (square + across**2 + arm**2 - rod**2) / (2.0 * arm * np.sqrt(square))
    if not np.all(np.abs(wanted) < 1.0):
        raise IdentError(
            ErrorCode.BAD_VALUES, 'the motion leaves the reach of the rods; shrink its space'
        )
    up = np.arctan2(points[2], ahead) + np.arccos(wanted)
    up = np.remainder(up + np.pi, 2.0 * np.pi) - np.pi
    # Along a rod nothing moves: its product with the platform's speed is that with the joint's.
    rate_ahead = np.sum(out * speeds[:2, None], axis=0)
    rate_across = out[0] * speeds[1] - out[1] * speeds[0]
    cos, sin = np.cos(up), np.sin(up)
    rod_ahead, rod_up = ahead - arm * cos, points[2] - arm * sin
    along = rod_ahead * rate_ahead + across * rate_across + rod_up * speeds[2]
    rate = along / (arm * (rod_up * cos - rod_ahead * sin))
    sense = _sense(machine)
    return sense * up + machine.numbers('arm_zero')[:, None], sense * rate


def figure(machine: Machine, position: Array) -> Figure | None:
    """Return a delta in space: its frame, arms, rods and the platform where they hold it.

    Only the difference of the two circles matters to the motion; the platform's is drawn as a
    quarter of it, and the shafts stand out by as much.

    Args:
        machine: A delta.
        position: (3, F) angles of its drives [rad].

    Returns:
        What to draw; None for positions that no rod reaches.
    """
    radius, azimuth = machine.number('shaft_radius'), machine.numbers('shaft_azimuth')
    base = radius * np.stack([np.cos(azimuth), np.sin(azimuth), np.zeros(3)], axis=1)
    joints = joints_of(machine, position).swapaxes(0, 1)
    corner = 0.25 * base
    held = platform(joints, machine.number('rod_length'), corner)
    if held is None:
        return None
    tool, body = held
    knee = joints + corner
    base = base + corner
    arms = np.stack([np.broadcast_to(base, knee.shape), knee], axis=2)
    rods = np.stack([knee, tool[:, None] + corner], axis=2)
    return Figure(
        size=radius + machine.number('arm_length'),
        tool=tool,
        blocks=knee,
        links=np.concatenate([arms, rods], axis=1),
        body=body,
        frame=np.stack([base, np.roll(base, -1, axis=0)], axis=1),
    )
