# SPDX-License-Identifier: Apache-2.0
"""Where the joints of an arm move when nobody says otherwise."""

import numpy as np

from ros2_ident.arrays import Array
from ros2_ident.machine.machine import Machine
from ros2_ident.machine.space import Space
from ros2_ident.models.serial.arm import arm_of

# A joint without limits, or with wide ones, turns by so much to either side, rad; one that slides
# by so much, m. Speeds and accelerations of a way through all of them together.
_TURN, _SLIDE, _SPEED, _ACCELERATION = 1.2, 0.3, 2.5, 6.0
# What turns farther has no ends, rad.
_ENDLESS = 100.0


def space(machine: Machine) -> Space:
    """Return the space about the middle of the joints' limits, where the description has any."""
    arm = arm_of(machine)
    low, high = np.clip([arm.limits['low'], arm.limits['high']], -np.pi, np.pi)
    most = np.where(arm.prismatic, _SLIDE, _TURN)
    return Space(
        0.5 * (low + high), np.minimum(0.45 * (high - low), most), _SPEED, _ACCELERATION
    )


def ends(machine: Machine) -> tuple[Array, Array]:
    """Return low and high ends (D,) of the joints that turn, rad, infinite for others."""
    arm = arm_of(machine)
    low, high = arm.limits['low'], arm.limits['high']
    # A description writes a limit of none as a large one.
    none = arm.prismatic | (high - low > _ENDLESS)
    return np.where(none, -np.inf, low), np.where(none, np.inf, high)
