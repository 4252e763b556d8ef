# SPDX-License-Identifier: Apache-2.0
"""Whether an arm's joints can have moved as recorded."""

from collections.abc import Iterator
import math

import numpy as np
import numpy.typing as npt

from ros2_ident.machine.draft import Remark
from ros2_ident.machine.machine import Machine
from ros2_ident.models.serial.arm import arm_of

# Speeds are means over so long, s: no larger than the largest, and free of an encoder's steps.
_WHILE = 0.1
# What is beyond its limit by more is nearer to the limit in degrees than to that in rad.
_NEARER = math.sqrt(180.0 / math.pi)
# An angle that is taken back at every turn stays below in rad, and is fast there.
_A_TURN = 1.1 * math.tau


def check_reach(machine: Machine, position: npt.NDArray[np.float64]) -> Iterator[Remark]:
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
                yield Remark('error', (), text)
                return
