# SPDX-License-Identifier: Apache-2.0
"""Where an effect can sit: by what the machine and its log offer."""

from pathlib import Path

import numpy as np
import pytest
from values import with_bounds

from checks.blind.forms.form import twins
from ros2_ident.effects import CATALOGUE, Context
from ros2_ident.errors import IdentError
from ros2_ident.models import EffectAt, load_machine, Machine, make_model
from ros2_ident.recording import Dataset

ROOT = Path(__file__).parents[2]
STRUCTURE = {e.id for e in CATALOGUE.values() if e.group == 'structure'}
CONTROLLER = {e.id for e in CATALOGUE.values() if e.group == 'controller'}
# Friction that motor and load make together, where both are known apart.
PRESSED = {
    'directional_load_friction',
    'quadratic_load_friction',
    'stribeck_load_friction',
}
# Of logs without a set-point only.
OF_FILES = {'effort_smoothing'}
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
    return {e.id for e in CATALOGUE.values() if not e.applies(context)}


def test_on_a_tripod_only_what_is_nominal_is_left_out() -> None:
    nominal = {'coulomb_friction', 'viscous_friction', 'effort_delay'}
    others = {'gear_flexibility', 'payload_turns'} | OF_FILES | PRESSED
    assert left_out(machine_of('tripod')) == nominal | others


def test_on_a_rigid_axis_gear_platform_and_what_is_nominal_are_left_out() -> None:
    nominal = {'coulomb_friction', 'viscous_friction', 'constant_force', 'effort_bias'}
    single = {'integral_gain_error', 'effort_crosstalk'}
    others = GEAR | STRUCTURE | OF_FILES | PRESSED
    assert left_out(machine_of('emps')) == nominal | single | others


def test_recorded_motion_knows_no_controller() -> None:
    emps = machine_of('emps')
    more = left_out(emps, command=False) - left_out(emps)
    assert more == CONTROLLER - {'integral_gain_error'}


def test_a_weight_does_not_hang_behind_a_spring() -> None:
    standing = machine_of('emps').with_constants(gravity=9.81)
    assert left_out(standing) - left_out(machine_of('emps')) == {'gear_flexibility'}


def test_a_parameter_of_the_machine_is_no_effect() -> None:
    emps = machine_of('emps')
    fewer = {name: box for name, box in emps.bounds.items() if name != 'viscous_friction'}
    assert left_out(emps) - left_out(with_bounds(emps, fewer)) == {'viscous_friction'}


def test_one_of_two_sizes_is_still_an_effect() -> None:
    effect = CATALOGUE['torque_constant_error']
    assert effect.applies(Context(identified=frozenset({'log_gain'})))
    both = frozenset({'mass_per_rod'})
    assert not CATALOGUE['rod_mass'].applies(Context(identified=both, features={'platform'}))


def test_a_flexible_load_has_no_place_behind_an_elastic_gear() -> None:
    tripod = machine_of('tripod')
    with pytest.raises(IdentError, match='gear_flexibility has no place .* gear_stiffness'):
        make_model(tripod, dataset(tripod), effects=[EffectAt('gear_flexibility', 'drive_1')])


def test_a_flexible_load_takes_as_many_steps_however_light_it_is() -> None:
    emps = machine_of('emps')
    data = dataset(emps, command=False)
    model = make_model(emps, data, effects=[EffectAt('gear_flexibility', emps.drives[0])])
    of_mass = np.array(['Hz' != p.unit != '1' for p in model.parameters])
    theta = np.array([[95.0, 200.0, 20.0, 0.0, 0.3, 150.0, 0.05]])
    assert model.work(theta)[0] > 1
    for small in (1e-12, 1e-24):
        assert model.work(np.where(of_mass, small, 1.0) * theta) == model.work(theta)


def test_twins_are_one_answer() -> None:
    assert twins('effort_bias') == twins('constant_force') == {'effort_bias', 'constant_force'}
    assert twins('supply_sag') == {'supply_sag'}
