# SPDX-License-Identifier: Apache-2.0
"""Carriages on a motor each, elastic or rigid, along axes that may lie or stand.

Elastic: the tripod's drive without rods. Rigid: F = m v' + F_V v + F_C tanh(v / v_eps) + offset,
the model of the EMPS benchmark (Janot, Gautier, Brunot 2019) with the force as effort.
"""

from collections.abc import Mapping
from functools import partial

from checks.reference import layout as at
from checks.reference.plant import (
    bare_plant,
    ELASTIC,
    known_names,
    PARAMETERS,
    Plant,
    read_drives,
    true_machine,
)
from checks.reference.simulate import simulate_machine
from checks.reference.twin import Twin
from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.machine.machine import Machine


def axis_plant(machine: Machine, parameters: Mapping[str, float]) -> Plant:
    """Build the nominal axes; they are rigid where no gear stiffness is given.

    Args:
        machine: A linear axis. Without `drive.gear_factor` the effort is a force [N].
        parameters: Elastic: `gear_stiffness` [N/m], `gear_damping_ratio` [1], `drive_inertia` [kg
            m^2]. Both: `moving_mass` [kg] (or `drive.rail_mass`), `coulomb_torque` [N m] or
            `coulomb_friction` [N], `viscous_torque` [N m s/m] or `viscous_friction` [N s/m],
            `measurement_delay` [s], `constant_force` [N m, or N where the effort is a force], the
            load against the positive direction, and numeric constants of the machine file. Each
            also as `x_axis.moving_mass`.
    """
    elastic = any(key.endswith('gear_stiffness') for key in parameters)
    known_names(parameters, machine, (*PARAMETERS, 'moving_mass', *(ELASTIC if elastic else ())))
    true = true_machine(machine, parameters)
    plant = bare_plant(machine, elastic)
    plant.shared[at.GRAVITY] = true.number('gravity')
    read_drives(plant, true, parameters)
    if not (plant.drive[:, at.CARRIAGE_MASS] > 0.0).all():
        raise IdentError(
            ErrorCode.UNKNOWN_PARAMETER,
            'the reference needs a mass of every drive; give moving_mass or rail_mass',
        )
    return plant


simulate_axis = partial(simulate_machine, axis_plant)


TWIN = Twin('linear_axis', axis_plant, simulate_axis)
