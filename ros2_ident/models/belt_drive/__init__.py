# SPDX-License-Identifier: Apache-2.0
"""The belt drive of the paper's section 3."""

import numpy as np

from ros2_ident.machine.keys import keys_of
from ros2_ident.machine.kind import Kind, later
from ros2_ident.machine.machine import Machine
from ros2_ident.machine.space import Space


def _space(machine: Machine) -> Space:
    return Space(np.zeros(1), np.full(1, np.pi / 180.0), 0.2, 20.0)


KIND = Kind(
    name='belt_drive',
    title='two gears, a belt and a mass on it',
    keys=keys_of('belt_drive'),
    model=later('ros2_ident.models.belt_drive.model:RecordedBelt'),
    drives=1,
    travel='rad',
    compares=('effort', 'position'),
    space=_space,
)
