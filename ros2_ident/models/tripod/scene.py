# SPDX-License-Identifier: Apache-2.0
"""What is drawn of a tripod: rails, carriages, rods and the platform where rigid rods hold it."""

import numpy as np

from ros2_ident.arrays import Array
from ros2_ident.errors import IdentError
from ros2_ident.machine.figure import Figure
from ros2_ident.machine.machine import Machine
from ros2_ident.models.tripod.reach import meeting_point


def figure(machine: Machine, position: Array) -> Figure | None:
    """Return a tripod in space.

    Only the difference of the two circles matters to the motion; the platform's is drawn as a
    quarter of it, and the rails stand out by as much.

    Args:
        machine: A tripod.
        position: (3, F) heights of its carriages [m].

    Returns:
        What to draw; None for positions that no rod reaches, as with a wrong zero.
    """
    radius, azimuth = machine.number('rail_radius'), machine.numbers('rail_azimuth')
    rail = np.stack([np.cos(azimuth), np.sin(azimuth)], axis=1)
    lengths = np.full(3, machine.number('rod_length'))
    carriage = position.T
    try:
        tool = np.array(
            [meeting_point(np.column_stack([radius * rail, row]), lengths) for row in carriage]
        )
    except IdentError:
        return None
    corner = np.column_stack([0.25 * radius * rail, np.zeros(3)])
    foot = np.concatenate(
        [np.broadcast_to(1.25 * radius * rail, (len(carriage), 3, 2)), carriage[..., None]], axis=2
    )
    sides = np.stack([corner, np.roll(corner, -1, axis=0)], axis=1)
    spokes = np.stack([corner, np.zeros((3, 3))], axis=1)
    ends = float(carriage.min()) - 0.5 * radius, float(carriage.max()) + 0.25 * radius
    rails = [np.column_stack([1.25 * radius * rail, np.full(3, z)]) for z in ends]
    return Figure(
        size=radius,
        tool=tool,
        blocks=foot,
        links=np.stack([foot, tool[:, None] + corner], axis=2),
        body=np.concatenate([sides, spokes]),
        frame=np.stack(rails, axis=1),
    )
