# SPDX-License-Identifier: Apache-2.0
"""One carriage on one motor, elastic or rigid, along an axis that may lie or stand.

Elastic: the tripod's drive without rods. Rigid: F = m v' + F_V v + F_C tanh(v / v_eps) + offset,
the model of the EMPS benchmark (Janot, Gautier, Brunot 2019) with the force as effort.
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

ELASTIC = (
    'measurement_delay',
    'gear_stiffness',
    'gear_damping_ratio',
    'moving_mass',
    'drive_inertia',
    'coulomb_torque',
    'viscous_torque',
    'constant_force',
)
RIGID = (
    'measurement_delay',
    'moving_mass',
    'coulomb_friction',
    'viscous_friction',
    'constant_force',
)


def axis_plant(machine: Any, parameters: Mapping[str, float]) -> Plant:
    """Build the nominal axis; it is rigid where no gear stiffness is given.

    Args:
        machine: A `Machine`, or the mapping a machine file holds. Without `drive.gear_factor` the
            effort is a force [N].
        parameters: Elastic: `gear_stiffness` [N/m], `gear_damping_ratio` [1], `drive_inertia` [kg
            m^2], `moving_mass` [kg] (or `drive.rail_mass`), `coulomb_torque` [N m],
            `viscous_torque` [N m s/m]. Rigid: `moving_mass` [kg], `coulomb_friction` [N],
            `viscous_friction` [N s/m]. Both: `measurement_delay` [s], `constant_force` [N], the
            load against the positive direction.

    Returns:
        The machine, ready for effects.

    Raises:
        IdentError: UNKNOWN_PARAMETER for a name that is missing or not this axis's.
    """
    names = tuple(map(str, section(machine, 'drives')))
    geometry = section(machine, 'geometry')
    constants = section(machine, 'drive')
    name = names[0]
    elastic = any(key.endswith('gear_stiffness') for key in (*parameters, *constants))
    known_names(parameters, names, ELASTIC if elastic else RIGID)
    plant = Plant(names, np.zeros(at.SHARED_COLUMNS), np.zeros((1, at.DRIVE_COLUMNS)), np.zeros(1))
    plant.shared[at.GRAVITY] = float(geometry.get('gravity', 0.0))
    plant.shared[at.RIGID] = 0.0 if elastic else 1.0
    read_controller(plant, section(machine, 'controller'))
    d = plant.drive[0]
    gear = float(constants.get('gear_factor', 1.0))
    rail = float(constants['rail_mass']) if 'rail_mass' in constants else None
    d[at.GEAR] = gear
    d[at.CARRIAGE_MASS] = value('moving_mass', name, parameters, constants, rail)
    d[at.SIGN_WIDTH] = float(constants.get('coulomb_regularisation', 5e-3))
    d[at.CONSTANT_FORCE] = value('constant_force', name, parameters, constants, 0.0)
    plant.delay[0] = value('measurement_delay', name, parameters, constants, 0.0)
    if not elastic:
        d[at.COULOMB] = value('coulomb_friction', name, parameters, constants, 0.0) / gear
        d[at.VISCOUS] = value('viscous_friction', name, parameters, constants, 0.0) / gear
        return plant
    motor = value('drive_inertia', name, parameters, constants) * gear**2
    stiffness = value('gear_stiffness', name, parameters, constants)
    ratio = value('gear_damping_ratio', name, parameters, constants)
    reduced = motor * d[at.CARRIAGE_MASS] / (motor + d[at.CARRIAGE_MASS])
    d[at.MOTOR_MASS] = motor
    d[at.STIFFNESS] = stiffness
    d[at.DAMPING] = 2.0 * ratio * np.sqrt(stiffness * reduced)
    d[at.COULOMB] = value('coulomb_torque', name, parameters, constants, 0.0)
    d[at.VISCOUS] = value('viscous_torque', name, parameters, constants, 0.0)
    return plant


def simulate_axis(
    machine: Any,
    parameters: Mapping[str, float],
    position: Array,
    velocity: Array,
    effects: Sequence[Unmodelled] = (),
    rtol: float = 1e-11,
    atol: float = 1e-12,
    start: tuple[Array, Array] | None = None,
) -> Log:
    """Simulate an axis from its set-points.

    Args:
        machine: A `Machine`, or the mapping a machine file holds.
        parameters: Parameters by name, see `axis_plant`.
        position: (1, K) set-point at every controller cycle [m].
        velocity: (1, K) its derivative [m/s]; not read by a P controller on velocity.
        effects: Effects beside the nominal physics, from `effects.draw_effect`.
        rtol: Relative tolerance of an integration step.
        atol: Absolute tolerance of an integration step.
        start: Position [m] and speed [m/s], each (1,), where the log begins in motion.

    Returns:
        The log; `effort` is a force where the machine has no gear factor.
    """
    return simulate(
        axis_plant(machine, parameters), position, velocity, effects, rtol, atol, start
    )
