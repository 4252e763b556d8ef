# SPDX-License-Identifier: Apache-2.0
"""Whether the rods of a tripod meet at recorded positions."""

from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

from ros2_ident.machine.draft import Remark
from ros2_ident.machine.machine import Machine

Array = npt.NDArray[np.float64]


def share_apart(corner: Array, rod: float) -> float:
    """Return the share of instants at which three rods do not meet.

    Args:
        corner: (3, K, 3) upper ends of the rods [m], NaN where they are not known.
        rod: Their length [m].
    """
    # The rods meet where the circle through the three carriages is smaller than they are long.
    side = [np.linalg.norm(corner[i] - corner[i - 1], axis=-1) for i in range(3)]
    area = np.linalg.norm(np.cross(corner[1] - corner[0], corner[2] - corner[0]), axis=-1)
    circle: Array = side[0] * side[1] * side[2] / (2.0 * area)
    return float(np.mean(circle[np.isfinite(circle)] >= rod)) if circle.size else 0.0


def check_reach(machine: Machine, height: npt.NDArray[np.float64]) -> Iterator[Remark]:
    """Say where the rods of a tripod cannot meet at the recorded positions.

    Args:
        machine: A tripod.
        height: (3, K) positions of its carriages [m], NaN where there is no sample.
    """
    rod = machine.number('rod_length')
    radius = machine.number('rail_radius')
    azimuth = machine.numbers('rail_azimuth')[:, None]
    corner = np.stack(
        [*np.broadcast_arrays(radius * np.cos(azimuth), radius * np.sin(azimuth), height)], axis=-1
    )
    share = share_apart(corner, rod)
    if share > 0.0:
        yield Remark(
            'error',
            ('geometry', 'rod_length'),
            f'rods of {rod:g} m do not meet in {100.0 * share:.2g} % of the recorded positions; '
            'correct rod_length, rail_radius, rail_azimuth, or the unit of the positions (m)',
        )
