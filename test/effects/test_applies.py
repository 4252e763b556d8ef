# SPDX-License-Identifier: Apache-2.0
"""Where an effect can sit: by what the machine and its log offer."""

from pathlib import Path

import numpy as np
from values import with_bounds

from ros2_ident.effects import CATALOGUE
from ros2_ident.models import load_machine, Machine, make_model
from ros2_ident.recording import Dataset

ROOT = Path(__file__).parents[2]
STRUCTURE = {e.id for e in CATALOGUE.values() if e.group == 'structure'}
# Friction that motor and load make together, where both are known apart.
PRESSED = {
    'directional_load_friction',
    'quadratic_load_friction',
    'stribeck_load_friction',
}
# Of logs without a set-point only.
OF_FILES = {'effort_smoothing'}
OF_ARMS = {'hand_load', 'joint_zero_error'}
GEAR = {'backlash', 'transmission_eccentricity', 'position_dependent_stiffness'}


def machine_of(name: str) -> Machine:
    return load_machine(ROOT / f'config/{name}.yaml')


def dataset(machine: Machine, *, command: bool = True) -> Dataset:
    still = np.full((len(machine.drives), 400), 0.1)
    moved = still + 0.01 * np.sin(np.arange(400) / 50.0)
    given = (moved, 0.0 * still) if command else (None, None)
    return Dataset(machine.drives, 1e-3, 0, *given, moved, 0.0 * still, still)


def left_out(machine: Machine, *, command: bool = True) -> set[str]:
    context = make_model(machine, dataset(machine, command=command)).context
    return {e.id for e in CATALOGUE.values() if e.number == 1 and not e.applies(context)}


def test_on_a_tripod_only_what_is_nominal_is_left_out() -> None:
    nominal = {'coulomb_friction', 'viscous_friction', 'effort_delay'}
    others = {'gear_flexibility', 'payload_turns'} | OF_ARMS | OF_FILES | PRESSED
    assert left_out(machine_of('tripod')) == nominal | others


def test_on_a_rigid_axis_gear_platform_and_what_is_nominal_are_left_out() -> None:
    nominal = {'coulomb_friction', 'viscous_friction', 'constant_force', 'effort_bias'}
    single = {'integral_gain_error', 'effort_crosstalk'}
    others = GEAR | STRUCTURE | OF_ARMS | OF_FILES | PRESSED
    assert left_out(machine_of('emps')) == nominal | single | others


def test_a_parameter_of_the_machine_is_no_effect() -> None:
    emps = machine_of('emps')
    fewer = {name: box for name, box in emps.bounds.items() if name != 'viscous_friction'}
    assert left_out(emps) - left_out(with_bounds(emps, fewer)) == {'viscous_friction'}
