# SPDX-License-Identifier: Apache-2.0
"""The tripod in redundant coordinates: motors, carriages and platform, held by three rods.

Equations: Ludwig and Gerstmayr (2011), section 4 and eq. 23, for all three drives at once. See
`dynamics` for the form in which they are solved.
"""

from collections.abc import Mapping
from functools import partial

import numpy as np

from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.machine.machine import Machine
from ros2_ident.reference import layout as at
from ros2_ident.reference.plant import Array, Plant, platform_plant, read_drives
from ros2_ident.reference.simulate import simulate_machine
from ros2_ident.reference.space import Space
from ros2_ident.reference.twin import Twin


def tripod_plant(machine: Machine, parameters: Mapping[str, float]) -> Plant:
    """Build the nominal tripod.

    Args:
        machine: A tripod.
        parameters: `measurement_delay` [s], `gear_stiffness` [N/m], `gear_damping_ratio` [1],
            `tool_mass` [kg], `drive_inertia` [kg m^2], `coulomb_torque` [N m], `viscous_torque` [N
            m s/m], and numeric constants of the machine file; all of a drive also as
            `drive_1.gear_stiffness`. The friction torques are zero where not given.

    Returns:
        The machine, ready for effects.

    Raises:
        IdentError: UNKNOWN_PARAMETER for a name that is missing or not the tripod's,
        BAD_MACHINE_FILE for a gain that is missing.
    """
    true, plant = platform_plant(machine, parameters)
    read_drives(plant, true, parameters)
    azimuth = true.numbers('rail_azimuth')
    plant.drive[:, at.RAIL_X] = true.number('rail_radius') * np.cos(azimuth)
    plant.drive[:, at.RAIL_Y] = true.number('rail_radius') * np.sin(azimuth)
    plant.drive[:, at.ROD_LENGTH] = true.number('rod_length')
    return plant


simulate_tripod = partial(simulate_machine, tripod_plant)


def _space(machine: Machine) -> Space:
    size = machine.number('rod_length') / 0.6
    return Space(
        np.array([0.0, 0.0, -0.05]) * size, np.array([0.075, 0.075, 0.06]) * size, 1.0, 25.0
    )


def rails_of(points: Array, speeds: Array, machine: Machine) -> tuple[Array, Array]:
    """Return the carriages' set-points of a platform's way.

    Args:
        points: (3, K) platform positions [m].
        speeds: (3, K) platform speeds [m/s].
        machine: A tripod.

    Returns:
        (3, K) carriage positions [m] and speeds [m/s].

    Raises:
        IdentError: BAD_VALUES where a rod would not reach.
    """
    azimuth = machine.numbers('rail_azimuth')
    foot = machine.number('rail_radius') * np.stack([np.cos(azimuth), np.sin(azimuth)], axis=1)
    away = points[None, :2] - foot[:, :, None]
    square = machine.number('rod_length') ** 2 - np.sum(away**2, axis=1)
    if not np.all(square > 0.0):
        raise IdentError(
            ErrorCode.BAD_VALUES, 'the motion leaves the reach of the rods; shrink its space'
        )
    rise = np.sqrt(square)
    return points[2] + rise, speeds[2] - np.sum(away * speeds[None, :2], axis=1) / rise


TWIN = Twin('tripod', tripod_plant, simulate_tripod, _space, rails_of, platform=True)
