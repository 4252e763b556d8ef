# SPDX-License-Identifier: Apache-2.0
"""Units that a column map states, beside those of the machine file."""

import numpy as np
import pytest
import yaml

from ros2_ident.cli.main import main
from ros2_ident.errors import IdentError
from ros2_ident.identify.run import read_data
from ros2_ident.models import load_machine
from ros2_ident.models.new_file import driven_file
from ros2_ident.models.registry import KINDS
from ros2_ident.recording import read_bag
from ros2_ident.recording.columns import load_columns, stated_units
from ros2_ident.recording.headers import header_of

MACHINE = """machine: linear_axis
drives: [slide]
controller: {cycle: 0.002}
parameters:
  moving_mass: [0.0, 50.0, kg]
  coulomb_friction: [0.0, 40.0, N]
"""
MAP = """time: {{column: time, unit: s}}
joints:
  slide: {{position: {{column: pos, unit: mm}}, effort: {effort}}}
"""


def logged(folder, effort, header='time,pos,drive'):
    """Write a log of 0.4 A for 3 m/s^2, and its column map."""
    time = 0.002 * np.arange(1500)
    place = 80.0 * np.sin(3.0 * time) + 20.0 * np.sin(11.0 * time)
    rate = np.gradient(place, time)
    drive = np.gradient(rate, time) / 7.5e-3 * 1e-3 + 300.0 * np.tanh(rate / 5.0)
    rows = np.stack([time, place, drive], axis=1)
    log = folder / 'log.csv'
    np.savetxt(log, rows, delimiter=',', header=header, comments='')
    if effort:
        (folder / 'log.columns.yaml').write_text(MAP.format(effort=effort))
    return log


def machine_of(folder, more):
    path = folder / 'machine.yaml'
    path.write_text(MACHINE + more)
    return load_machine(path)


@pytest.mark.parametrize(
    ('effort', 'more'),
    [
        ('{column: drive, unit: mA}', 'effort_unit: N\n'),
        ('{column: drive, unit: percent}', 'effort_unit: N\n'),
        ('{column: drive, unit: mNm}', 'effort_unit: N\n'),
        ('{column: drive, unit: N, scale: -1}', 'effort_unit: A\ntorque_constant: 7.5\n'),
    ],
)
def test_an_effort_in_another_unit_than_the_machine_file_is_refused(tmp_path, effort, more):
    log, machine = logged(tmp_path, effort), machine_of(tmp_path, more)
    with pytest.raises(IdentError, match='states the effort of slide in .*; write `effort_unit: '):
        read_data(log, machine)
    assert read_data(log, machine, quantities=['position']).datasets


def test_an_effort_of_the_same_kind_is_converted(tmp_path):
    log = logged(tmp_path, '{column: drive, unit: mA}')
    machine = machine_of(tmp_path, 'effort_unit: A\ntorque_constant: 7.5\n')
    amps = read_bag(log)[0].effort.effort[:, 0]
    (data,) = read_data(log, machine).datasets
    assert np.nanmax(data.effort) == pytest.approx(7.5 * amps.max())
    assert amps.max() < 5.0


def test_a_scale_that_makes_another_quantity_states_no_unit(tmp_path):
    log = logged(tmp_path, '{column: drive, unit: mA, scale: 7.5}')
    assert read_data(log, machine_of(tmp_path, 'effort_unit: N\n')).datasets


def test_a_sum_of_columns_has_one_unit(tmp_path):
    logged(tmp_path, '[{column: drive, unit: mA}, {column: drive, unit: N}]')
    columns = load_columns(tmp_path / 'log.columns.yaml').columns
    with pytest.raises(IdentError, match='slide.effort adds columns in A and N'):
        stated_units('map', columns)


def new_machine(log, out, *more):
    kind = ['--kind', 'linear_axis']
    return main(['new-machine', *kind, '--bag', str(log), '--out', str(out), *more])


def test_bounds_of_one_joint_are_asked_for_where_the_map_states_a_current(tmp_path, capsys):
    log, out = logged(tmp_path, '{column: drive, unit: mA}'), tmp_path / 'm.yaml'
    assert new_machine(log, out) == 2
    said = capsys.readouterr().err
    assert 'the effort of slide is in A, and bounds of what slides are in N;' in said
    assert 'in place of the unit: of an ampere the motor constant, or 1 where it is not' in said


def test_a_file_of_several_drives_states_the_unit_of_the_log(tmp_path, capsys):
    time = 0.01 * np.arange(200)
    rows = np.stack([time, np.sin(time), np.cos(time), np.sin(time), np.cos(time)], axis=1)
    log, out = tmp_path / 'log.csv', tmp_path / 'm.yaml'
    header = 'time,a_pos [rad],a_current [mA],b_pos [rad],b_current [mA]'
    np.savetxt(log, rows, delimiter=',', header=header, comments='')
    words = ['new-machine', '--kind', 'serial', '--bag', str(log), '--out', str(out)]
    assert main(words) == 0
    machine = load_machine(out)
    assert machine.effort_unit == 'A' and machine.drives == ('a', 'b')
    assert (
        '; state its torque_constant, as efforts are in A, state its geom'
        in capsys.readouterr().out
    )


def test_the_torque_constant_of_a_servo_is_a_parameter_of_its_own(tmp_path, capsys):
    log, out = logged(tmp_path, '', 'time,pos [deg],current [A]'), tmp_path / 'm.yaml'
    assert main(['new-machine', '--kind', 'servo', '--bag', str(log), '--out', str(out)]) == 0
    assert load_machine(out).effort_unit == 'A'
    assert 'torque_constant: [0.1, 1.0, N m/A]' in out.read_text()
    assert 'state its torque_constant' not in capsys.readouterr().out


def test_the_file_of_a_carriage_says_that_its_effort_is_a_force(tmp_path, capsys):
    log, out = logged(tmp_path, '', 'time,pos,effort'), tmp_path / 'm.yaml'
    assert new_machine(log, out, '--travel', 'm') == 0
    assert 'effort_unit: N\n' in out.read_text()
    assert main(['check', '--machine', str(out)]) == 0
    assert 'every key is known and plausible' in capsys.readouterr().out


@pytest.mark.parametrize(
    ('header', 'said'),
    [
        ('time,pos [mm],torque [Nm]', 'are in N; .* 2 pi over the travel of a turn'),
        ('time,pos [deg],force [N]', 'are in N m; .* the lever in m'),
    ],
)
def test_a_torque_of_what_slides_and_a_force_of_what_turns_are_asked_about(tmp_path, header, said):
    log = logged(tmp_path, '', header)
    with pytest.raises(IdentError, match=said):
        driven_file(KINDS['linear_axis'], (), _by_header(log))


def test_a_force_alone_is_one_of_what_slides(tmp_path):
    log = logged(tmp_path, '', 'time,pos,force [N]')
    text = driven_file(KINDS['linear_axis'], (), _by_header(log))
    assert 'effort_unit: N\n' in text and ', kg]' in text


def _by_header(log):
    where = log.with_suffix('.columns.yaml')
    where.write_text(yaml.safe_dump(header_of(log).map()))
    return read_bag(log)[0]


def test_a_file_of_several_drives_holds_what_the_log_says_and_no_example(tmp_path, capsys):
    time = 0.002 * np.arange(2000)
    rows, sizes = [time], ((0.3, 1.0), (0.02, 0.4))  # kg m^2, N m
    for (inertia, friction), rate in zip(sizes, (3.0, 5.0), strict=True):
        speed = np.cos(rate * time)
        effort = -inertia * rate * np.sin(rate * time) + friction * np.sign(speed)
        rows += [np.sin(rate * time) / rate, np.sin(rate * time) / rate, effort]
    rows += [0.1 * np.ones(time.size), np.zeros(time.size), np.zeros(time.size)]
    # What holds a drive that gives way a little follows its position, and is no weight.
    given = 1e-3 * (np.sin(2.0 * time) + np.sin(5.0 * time))
    rows += [given, np.zeros(time.size), 0.3 + 40.0 * given]
    names = ['time', *(f'{x}_{y}' for x in 'abcd' for y in ('pos', 'goal_pos', 'torque'))]
    log, out = tmp_path / 'log.csv', tmp_path / 'm.yaml'
    np.savetxt(log, np.stack(rows, 1), delimiter=',', header=','.join(names), comments='')
    assert new_machine(log, out) == 0
    stated = yaml.safe_load(out.read_text())
    assert stated['drives'] == ['a', 'b', 'd']
    assert '# c: no motion or effort' in out.read_text()
    assert [*stated['controller']] == ['cycle'] and 'drive' not in stated
    for key, found in ('moving_mass', 0), ('coulomb_friction', 1):
        for box, values in zip(stated['parameters'][key], sizes, strict=False):
            assert box[0] <= values[found] < box[1]


def test_a_command_may_be_given_again_with_what_it_asked_for(tmp_path, capsys):
    log, out = logged(tmp_path, '', 'time,x,F'), tmp_path / 'm.yaml'
    words = ['new-machine', '--bag', str(log), '--out', str(out)]
    words += ['--column', 'x=cart.position', '--column', 'F=cart.effort']
    assert main(words) == 2
    assert 'say of what kind the machine is' in capsys.readouterr().err
    assert main([*words, '--kind', 'linear_axis']) == 0
    out.unlink()
    assert main([*words[:-1], 'F=cart.velocity', '--kind', 'linear_axis']) == 2
    assert 'log.columns.yaml says what the columns are' in capsys.readouterr().err
