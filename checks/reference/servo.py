# SPDX-License-Identifier: Apache-2.0
"""Servos: motors fed with a share of a supply voltage, with an arm or an inertia as load.

u = k_p (q_ref - q) + k_d (k_ff q_ref' - q'), clipped; torque k_t (V u - k_t q') / R less friction;
inertia J_a + J + (m + m_a / 3) l^2; weight (m + m_a / 2) g l sin(q - q_0).
"""

from collections.abc import Mapping
from functools import partial

from checks.reference import layout as at
from checks.reference.plant import (
    Array,
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
from ros2_ident.machine.machine import Machine


def servo_plant(machine: Machine, parameters: Mapping[str, float], release: float = 0.0) -> Plant:
    """Build the nominal servos; their gears are rigid where no gear stiffness is given.

    Args:
        parameters: Those of the machine file, in its units, `gear_stiffness` [N m/rad],
            `gear_damping_ratio` [1], and numeric constants; of one also as `elbow.armature`.
        release: When the motors are switched off [s]; 0 for never.
    """
    elastic = any(key.endswith('gear_stiffness') for key in parameters)
    known_names(parameters, machine, (*PARAMETERS, *(ELASTIC if elastic else ())))
    true = true_machine(machine, parameters)
    plant = bare_plant(machine, elastic)
    plant.shared[at.RELEASE] = release
    inertias = {f'{name}.drive_inertia': true.number('armature', name) for name in true.drives}
    lengths = true.numbers('load_length')
    spread = (true.numbers('load_mass') + true.numbers('arm_mass') / 3.0) * lengths**2
    loads = dict(zip(true.drives, true.numbers('load_inertia') + spread, strict=True))
    masses = {f'{name}.moving_mass': load for name, load in loads.items()}
    read_drives(plant, true, {**parameters, **inertias, **masses})
    for i, name in enumerate(true.drives):
        _read_motor(plant.drive[i], true, name)
        if not elastic:
            plant.drive[i, at.MOTOR_MASS] = true.number('armature', name)
    return plant


def _read_motor(d: Array, machine: Machine, name: str) -> None:
    """Write what a servo has beside the drives of other machines."""
    constant, resistance = (
        machine.number('torque_constant', name),
        machine.number('resistance', name),
    )
    weighing = machine.number('load_mass', name) + 0.5 * machine.number('arm_mass', name)
    d[at.DRIVE_GAIN] = constant * machine.number('supply_voltage', name) / resistance
    d[at.BACK_EMF] = constant**2 / resistance
    d[at.LOAD_MOMENT] = weighing * machine.number('load_length', name) * machine.number('gravity')
    d[at.LOAD_ANGLE] = machine.number('load_angle', name)
    d[at.TORQUE_LIMIT] = machine.number('duty_limit', name)


TWIN = Twin('servo', servo_plant, partial(simulate_machine, servo_plant))
