# SPDX-License-Identifier: Apache-2.0
"""What is drawn of a delta: its frame, arms, rods and the platform where rigid rods hold it."""

import numpy as np

from ros2_ident.arrays import Array
from ros2_ident.errors import IdentError
from ros2_ident.machine.figure import Figure
from ros2_ident.machine.machine import Machine
from ros2_ident.models.rotary_tripod.reach import joints_of
from ros2_ident.models.tripod.reach import meeting_point


def figure(machine: Machine, position: Array) -> Figure | None:
    """Return a delta in space.

    Only the difference of the two circles matters to the motion; the platform's is drawn as a
    quarter of it, and the shafts stand out by as much.

    Args:
        machine: A delta.
        position: (3, F) angles of its drives [rad].

    Returns:
        What to draw; None for positions that no rod reaches, as with a wrong zero.
    """
    radius, azimuth = machine.number('shaft_radius'), machine.numbers('shaft_azimuth')
    out = np.stack([np.cos(azimuth), np.sin(azimuth), np.zeros(3)], axis=1)
    joints = joints_of(machine, position).swapaxes(0, 1)
    lengths = np.full(3, machine.number('rod_length'))
    try:
        tool = np.array([meeting_point(feet, lengths) for feet in joints])
    except IdentError:
        return None
    size = radius + machine.number('arm_length')
    corner = 0.25 * radius * out
    knee = joints + corner
    shaft = np.broadcast_to(1.25 * radius * out, knee.shape)
    arms = np.stack([shaft, knee], axis=2)
    rods = np.stack([knee, tool[:, None] + corner], axis=2)
    sides = np.stack([corner, np.roll(corner, -1, axis=0)], axis=1)
    spokes = np.stack([corner, np.zeros((3, 3))], axis=1)
    base = 1.25 * radius * out
    return Figure(
        size=size,
        tool=tool,
        blocks=knee,
        links=np.concatenate([arms, rods], axis=1),
        body=np.concatenate([sides, spokes]),
        frame=np.stack([base, np.roll(base, -1, axis=0)], axis=1),
    )
