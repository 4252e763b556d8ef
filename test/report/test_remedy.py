# SPDX-License-Identifier: Apache-2.0
"""The lines for the machine file: what is pasted there is read, and is what was found."""

from dataclasses import replace

from identify_cases import axis, tripod
from report_cases import diagnosed
from values import with_bounds
import yaml

from ros2_ident.gap.result import Value
from ros2_ident.models import Machine
from ros2_ident.report.diagnosis import machine_lines


def lines(machine: Machine, effect: str, where: str, values: dict[str, Value], also=()):
    found = replace(
        diagnosed(), effect=effect, where=(where,), also=tuple(also), parameters=values
    )
    return machine_lines(found, machine)


def value(number: float, unit: str) -> Value:
    return Value(number, unit, number, number)


def test_a_constant_gets_its_new_value_on_the_drive_that_has_the_effect():
    machine = tripod()
    gain = machine.number('velocity_gain')
    said = lines(
        machine,
        'velocity_gain_error',
        'drive_2',
        {'drive_2.velocity_gain_error.factor': value(1.5, '1')},
    )
    assert said[0] == 'controller:' and said[1].endswith(f'# {gain:g} before')
    read = yaml.safe_load('\n'.join(said))
    assert read == {'controller': {'velocity_gain': [gain, 1.5 * gain, gain]}}


def test_what_the_file_does_not_know_is_searched_from_now_on():
    machine = axis()
    bounds = {name: box for name, box in machine.bounds.items() if name != 'viscous_friction'}
    said = lines(
        with_bounds(machine, bounds),
        'viscous_friction',
        'emps_axis',
        {'emps_axis.viscous_friction.torque': value(203.5, 'N s/m')},
    )
    read = yaml.safe_load('\n'.join(said))
    assert read == {'parameters': {'viscous_friction': [0.0, 410.0, 'N s/m']}}


def test_what_the_file_cannot_say_gets_no_line():
    torque = {'drive_1.stribeck.torque': value(0.1, 'N m')}
    assert lines(tripod(), 'stribeck', 'drive_1', torque) == ()
    assert lines(tripod(), 'none', '', {}) == ()
    # Already identified: the file needs no change.
    again = {'emps_axis.viscous_friction.torque': value(203.5, 'N s/m')}
    assert lines(axis(), 'viscous_friction', 'emps_axis', again) == ()
