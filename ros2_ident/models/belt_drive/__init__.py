# SPDX-License-Identifier: Apache-2.0
"""The belt drive of the paper's section 3."""

import numpy as np

from ros2_ident.machine.keys import head, Key, of_geometry
from ros2_ident.machine.kind import Kind, later
from ros2_ident.machine.machine import Machine
from ros2_ident.machine.space import Space

_CONSTANTS = (
    of_geometry('radius', 'm', 'r of both gears', 1.0e-2, low=1e-4, high=1.0),
    of_geometry('rail_position', 'm', 'x_0 of the mass', 0.2, low=0.0, high=100.0),
    of_geometry('length_1', 'm', 'belt, driving gear to mass at x_0 = 0', 0.1875,
                low=0.0, high=100.0),
    of_geometry('length_2', 'm', 'belt, mass to driven gear at x_0 = 0', 0.7875,
                low=0.0, high=100.0),
    of_geometry('length_3', 'm', 'belt from gear to gear', 0.975, low=1e-3, high=100.0),
    Key('drive', 'rail_mass', 'kg', 'm, of what hangs on the belt', 0.948, low=0.0, high=1e4),
    Key('drive', 'axial_stiffness', 'N', 'EA of the belt', 2.0e5, low=1.0, high=1e9),
    Key('drive', 'driving_inertia', 'kg m^2', 'J_1', 2.0e-5, low=1e-9, high=10.0),
    Key('drive', 'driven_inertia', 'kg m^2', 'J_2', 2.0e-5, low=1e-9, high=10.0),
    Key('controller', 'position_gain', 'N m/rad', 'P; 0: no controller', 45.0, low=0.0, high=1e6),
)
_CYCLE = Key('controller', 'cycle', 's', 'time between two samples of the log', 2.0e-4,
             low=1e-6, high=0.05)
_SHOWN = ('axial_stiffness', 'position_gain')

def _space(machine: Machine) -> Space:
    return Space(np.zeros(1), np.full(1, np.pi / 180.0), 0.2, 20.0)


KIND = Kind(
    name='belt_drive',
    title='two gears, a belt and a mass on it',
    keys=(
        *head('belt_drive', ('driving_gear',), noise=0.0, effort=()),
        *_CONSTANTS,
        _CYCLE,
        *(key.searched(shown=key.name in _SHOWN) for key in _CONSTANTS),
    ),
    model=later('ros2_ident.models.belt_drive.model:RecordedBelt'),
    drives=1,
    travel='rad',
    compares=('effort', 'position'),
    space=_space,
)
