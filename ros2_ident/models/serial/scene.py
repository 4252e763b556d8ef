# SPDX-License-Identifier: Apache-2.0
"""What is drawn of an arm: a line from joint to joint and on to the tool, on a square as base."""

import numpy as np

from ros2_ident.arrays import Array
from ros2_ident.machine.figure import Figure
from ros2_ident.machine.machine import Machine
from ros2_ident.models.serial.arm import arm_of, base_turn

# Half the side of the base, as a share of how far the arm reaches.
_BASE = 0.12


def figure(machine: Machine, position: Array) -> Figure | None:
    """Return an arm in space, z upwards however its base is tilted.

    Args:
        machine: An arm.
        position: (D, F) of its joints [rad or m].

    Returns:
        What to draw; None where all of it is at one place, as in a table without lengths.
    """
    arm = arm_of(machine)
    turn = base_turn(machine)
    joints, tool = arm.stations(position)
    joints, tool = joints @ turn.T, tool @ turn.T
    reach = float(np.linalg.norm(np.concatenate([joints, tool[:, None]], axis=1), axis=2).max())
    if reach <= 0.0:
        return None
    # -1, the base, is the last of these
    carriers = np.concatenate([joints, np.zeros((len(joints), 1, 3))], axis=1)
    bones = np.stack([carriers[:, arm.parents], joints], axis=2)
    hand = np.stack([joints[:, arm.last], tool], axis=1)[:, None]
    corner = _BASE * reach * np.array([[1, 1, 0], [-1, 1, 0], [-1, -1, 0], [1, -1, 0]]) @ turn.T
    return Figure(
        size=reach,
        tool=tool,
        blocks=joints,
        links=np.concatenate([bones, hand], axis=1),
        body=np.empty((0, 2, 3)),
        frame=np.stack([corner, np.roll(corner, -1, axis=0)], axis=1),
    )
