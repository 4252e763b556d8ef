# SPDX-License-Identifier: Apache-2.0
"""Where the joints of a delta's arms are, and whether its rods meet there."""

from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

from ros2_ident.machine.draft import Remark
from ros2_ident.machine.machine import Machine
from ros2_ident.models.tripod.reach import share_apart

Array = npt.NDArray[np.float64]


def joints_of(machine: Machine, angle: Array) -> Array:
    """Return (3, K, 3) places of the arms' joints [m], the platform's circle taken off.

    Args:
        machine: A delta.
        angle: (3, K) positions of its drives [rad].
    """
    azimuth = machine.numbers('shaft_azimuth')[:, None]
    turned = angle - machine.numbers('arm_zero')[:, None]
    sense = 1.0 if machine.text('positive') == 'up' else -1.0
    arm = machine.number('arm_length')
    far = machine.number('shaft_radius') + arm * np.cos(turned)
    return np.stack(
        [far * np.cos(azimuth), far * np.sin(azimuth), sense * arm * np.sin(turned)], axis=-1
    )


def check_reach(machine: Machine, angle: Array) -> Iterator[Remark]:
    """Say where the rods of a delta cannot meet at the recorded positions.

    Args:
        machine: A delta.
        angle: (3, K) positions of its drives [rad], NaN where there is no sample.
    """
    rod = machine.number('rod_length')
    share = share_apart(joints_of(machine, angle), rod)
    if share > 0.0:
        yield Remark(
            'error',
            ('geometry', 'rod_length'),
            f'rods of {rod:g} m do not meet in {100.0 * share:.2g} % of the recorded positions; '
            'correct the lengths, arm_zero, positive, or the unit of the positions (rad)',
        )
