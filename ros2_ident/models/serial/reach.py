# SPDX-License-Identifier: Apache-2.0
"""Where an arm's joints can be, where they move by default, and how it is drawn."""

from collections.abc import Iterator
import math

import numpy as np

from ros2_ident.arrays import Array
from ros2_ident.machine.draft import Remark
from ros2_ident.machine.kind import Figure, Space
from ros2_ident.machine.machine import Machine
from ros2_ident.models.serial.arm import arm_of, base_turn

# Speeds are means over so long, s: no larger than the largest, and free of an encoder's steps.
_WHILE = 0.1
# What is beyond its limit by more is nearer to the limit in degrees than to that in rad.
_NEARER = math.sqrt(180.0 / math.pi)
# An angle that is taken back at every turn stays below in rad, and is fast there.
_A_TURN = 1.1 * math.tau
# A joint without limits, or with wide ones, turns by so much to either side, rad; one that slides
# by so much, m. Speeds and accelerations of a way through all of them together.
_TURN, _SLIDE, _SPEED, _ACCELERATION = 1.2, 0.3, 2.5, 6.0
# What turns farther has no ends, rad.
_ENDLESS = 100.0
# Half the side of the base, as a share of how far the arm reaches.
_BASE = 0.12


def check_reach(machine: Machine, position: Array) -> Iterator[Remark]:
    """Say of the first joint that is so far, or so fast, that its log is not in rad.

    Args:
        machine: An arm.
        position: (D, K) of its drives [rad or m], NaN where there is no sample.
    """
    arm, cycle = arm_of(machine), machine.number('cycle')
    limits, apart = arm.limits, max(1, round(_WHILE / cycle))
    ways = np.abs(position[:, apart:] - position[:, :-apart])
    found = [np.fmax.reduce(np.abs(x), axis=1, initial=0.0) for x in (position, ways)]
    found[1] /= apart * cycle
    most = np.maximum(np.abs(limits['low']), np.abs(limits['high'])), limits['velocity']
    for d in np.flatnonzero(~arm.prismatic & (found[0] > _A_TURN)):
        for what, size, limit in zip(('position', 'speed'), found, most, strict=True):
            if size[d] > _NEARER * limit[d] > 0.0:
                text = (
                    f'{machine.drives[d]}: its {what} reaches {size[d]:.3g}, the description '
                    f'allows {limit[d]:.3g} in rad and s, so the log looks like degrees; log rad, '
                    'or write `scale: 0.0174533` in the column map'
                )
                yield Remark((), text)
                return


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
    none = arm.prismatic | (0.5 * high - 0.5 * low > 0.5 * _ENDLESS)
    return np.where(none, -np.inf, low), np.where(none, np.inf, high)


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
