# SPDX-License-Identifier: Apache-2.0
"""The tripod in redundant coordinates: motors, carriages and platform, held by three rods.

Equations: Ludwig and Gerstmayr (2011), section 4 and eq. 23, for all three drives at once. See
`dynamics` for the form in which they are solved.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ros2_ident.reference import layout as at
from ros2_ident.reference.plant import (
    Array,
    known_names,
    Log,
    Plant,
    read_controller,
    section,
    Unmodelled,
    value,
)
from ros2_ident.reference.simulate import simulate

PARAMETERS = (
    'measurement_delay',
    'gear_stiffness',
    'gear_damping_ratio',
    'tool_mass',
    'drive_inertia',
    'coulomb_torque',
    'viscous_torque',
)


def tripod_plant(machine: Any, parameters: Mapping[str, float]) -> Plant:
    """Build the nominal tripod.

    Args:
        machine: A `Machine`, or the mapping a machine file holds.
        parameters: `measurement_delay` [s], `gear_stiffness` [N/m], `gear_damping_ratio` [1],
            `tool_mass` [kg], `drive_inertia` [kg m^2], `coulomb_torque` [N m], `viscous_torque` [N
            m s/m]; all but the tool's mass also as `drive_1.gear_stiffness`. The friction torques
            are zero where not given.

    Returns:
        The machine, ready for effects.

    Raises:
        IdentError: UNKNOWN_PARAMETER for a name that is missing or not the tripod's.
    """
    names = tuple(map(str, section(machine, 'drives')))
    geometry = section(machine, 'geometry')
    constants = section(machine, 'drive')
    known_names(parameters, names, PARAMETERS)
    plant = Plant(names, np.zeros(at.SHARED_COLUMNS), np.zeros((3, at.DRIVE_COLUMNS)), np.zeros(3))
    shared = plant.shared
    shared[at.GRAVITY] = float(geometry['gravity'])
    shared[at.PLATFORM] = 1.0
    shared[at.TOOL_MASS] = value('tool_mass', names[0], parameters, constants)
    read_controller(plant, section(machine, 'controller'))
    for i, name in enumerate(names):
        d = plant.drive[i]
        gear = float(constants['gear_factor'])
        motor = value('drive_inertia', name, parameters, constants) * gear**2
        carriage = float(constants['rail_mass'])
        stiffness = value('gear_stiffness', name, parameters, constants)
        ratio = value('gear_damping_ratio', name, parameters, constants)
        azimuth = float(geometry['rail_azimuth'][i])
        d[at.GEAR] = gear
        d[at.MOTOR_MASS] = motor
        d[at.CARRIAGE_MASS] = carriage
        d[at.STIFFNESS] = stiffness
        d[at.DAMPING] = 2.0 * ratio * np.sqrt(stiffness * motor * carriage / (motor + carriage))
        d[at.COULOMB] = value('coulomb_torque', name, parameters, constants, 0.0)
        d[at.VISCOUS] = value('viscous_torque', name, parameters, constants, 0.0)
        d[at.SIGN_WIDTH] = float(constants.get('coulomb_regularisation', 5e-3))
        d[at.RAIL_X] = float(geometry['rail_radius']) * np.cos(azimuth)
        d[at.RAIL_Y] = float(geometry['rail_radius']) * np.sin(azimuth)
        d[at.ROD_LENGTH] = float(geometry['rod_length'])
        plant.delay[i] = value('measurement_delay', name, parameters, constants, 0.0)
    return plant


def simulate_tripod(
    machine: Any,
    parameters: Mapping[str, float],
    position: Array,
    velocity: Array,
    effects: Sequence[Unmodelled] = (),
    rtol: float = 1e-11,
    atol: float = 1e-12,
) -> Log:
    """Simulate a tripod from its set-points.

    Args:
        machine: A `Machine`, or the mapping a machine file holds.
        parameters: Parameters by name, see `tripod_plant`.
        position: (3, K) set-point at every controller cycle [m].
        velocity: (3, K) its derivative [m/s].
        effects: Effects beside the nominal physics, from `effects.draw_effect`.
        rtol: Relative tolerance of an integration step.
        atol: Absolute tolerance of an integration step.

    Returns:
        The log.
    """
    return simulate(tripod_plant(machine, parameters), position, velocity, effects, rtol, atol)
