# SPDX-License-Identifier: Apache-2.0
"""The tripod in redundant coordinates: motors, carriages and platform, held by three rods.

Equations: Ludwig and Gerstmayr (2011), section 4 and eq. 23, for all three drives at once. See
`dynamics` for the form in which they are solved.
"""

from collections.abc import Mapping
from functools import partial

import numpy as np

from checks.reference import layout as at
from checks.reference.plant import Plant, platform_plant, read_drives
from checks.reference.simulate import simulate_machine
from checks.reference.twin import Twin
from ros2_ident.machine.machine import Machine


def tripod_plant(machine: Machine, parameters: Mapping[str, float]) -> Plant:
    """Build the nominal tripod.

    Args:
        parameters: Those of the machine file, in its units, and its numeric constants; of one
            drive as `drive_1.gear_stiffness`. The friction torques are zero where not given.
    """
    true, plant = platform_plant(machine, parameters)
    read_drives(plant, true, parameters)
    azimuth = true.numbers('rail_azimuth')
    plant.drive[:, at.RAIL_X] = true.number('rail_radius') * np.cos(azimuth)
    plant.drive[:, at.RAIL_Y] = true.number('rail_radius') * np.sin(azimuth)
    plant.drive[:, at.ROD_LENGTH] = true.number('rod_length')
    return plant


simulate_tripod = partial(simulate_machine, tripod_plant)


# Parameters as published, first column of table 5, d_min,0 = 0; and with friction, of which the
# paper prints no values: N m and N m s/m.
PUBLISHED = {
    'measurement_delay': 0.024903,
    'gear_stiffness': 232139.0,
    'gear_damping_ratio': 0.396306,
    'tool_mass': 1.762440,
    'drive_inertia': 89.0817e-6,
}
TABLE_5 = {**PUBLISHED, 'coulomb_torque': 0.05, 'viscous_torque': 0.05}
TWIN = Twin('tripod', tripod_plant, simulate_tripod)
