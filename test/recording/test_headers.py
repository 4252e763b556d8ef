# SPDX-License-Identifier: Apache-2.0
"""Headers as drivers, scopes and loggers write them, and what is read of each.

Names of franka_ros, ur_rtde, ODrive, moteus, Dynamixel, Feetech, LeRobot, PlotJuggler, rostopic,
CiA 402 (Elmo, maxon), TwinCAT, SINAMICS and of loggers in public repositories.
"""

import math
from pathlib import Path
import re
import shlex

import numpy as np
import pytest
import yaml

from ros2_ident.cli.main import main
from ros2_ident.errors import IdentError
from ros2_ident.identify.run import problem_of, read_data, solve
from ros2_ident.identify.settings import IdentifySettings
from ros2_ident.models import load_machine, make_model
from ros2_ident.recording import align, read_bag
from ros2_ident.recording.headers import header_of
from ros2_ident.recording.names import meanings

DEGREE, TURN = math.pi / 180.0, 2.0 * math.pi
HEADERS = Path(__file__).with_name('headers.txt').read_text(encoding='utf-8').split('\n\n')


@pytest.mark.parametrize('header', HEADERS, ids=range(len(HEADERS)))
def test_each_column_is_read_as_what_its_name_says(header):
    expected = [tuple(re.split('  +', line)) for line in header.strip().splitlines()]
    found = meanings([name for name, _ in expected])
    read = [(x.name, f'{x.joint}.{x.quantity}'.lstrip('.') or '-') for x in found]
    assert read == expected
    assert all(x.why for x in found if not x.quantity)


@pytest.mark.parametrize(
    ('name', 'scale'),
    [
        ('pos [mm]', 1e-3), ('vel_deg_s', DEGREE), ('speed [rpm]', TURN / 60.0),
        ('vel [Hz]', TURN), ('speed_hz', TURN), ('vel [min^-1]', TURN / 60.0),
        ('pos (turns)', TURN),
        ('torque [mNm]', 1e-3), ('torque [permil]', 0.1), ('torque %', 1.0), ('tau [N m]', 1.0),
        ('Position [inc]', math.nan), ('Present Position (counts)', math.nan),
        ('pos [%]', math.nan), ('Angle in deg', DEGREE), ('Weg in mm', 1e-3),
        ('torque / mNm', 1e-3), ('motor position, counts', math.nan), ('speed in deg/s', DEGREE),
        ('speed_dps', DEGREE), ('vel_rps', TURN), ('velDegPerSec', DEGREE),
        ('speedRpm', TURN / 60.0),
        ('velocity (mm/min)', 1e-3 / 60.0), ('speed_kmh', 1 / 3.6), ('speed km/h', 1 / 3.6),
        ('Speed rpm', TURN / 60.0), ('speed m/s', 1.0), ('torque mNm', 1e-3),
        ('vel_rev_per_min', TURN / 60.0), ('speed_mps', 1.0), ('vel_rad_sec', 1.0),
        ('speed [m/min]', 1 / 60.0), ('pos [inch]', 0.0254), ('speed_meters_per_sec', 1.0),
        ('Torque (shaft)', math.nan), ('Position [user unit]', math.nan),
        ('Speed [r/min]', TURN / 60.0), ('current [Arms]', 1.0),
        ('velocity_degrees_per_second', DEGREE), ('current_milliamps', 1e-3), ('posMm', 1e-3),
    ],
)  # fmt: skip
def test_a_unit_is_a_factor_or_has_to_be_asked_for(name, scale):
    (found,) = meanings([name])
    assert found.scale == pytest.approx(scale, nan_ok=True)
    assert found.joint in ('joint_1', 'motor')  # no unit is a joint


@pytest.mark.parametrize(
    ('name', 'unit'),
    [
        ('time (millisec)', 'ms'), ('time [msec]', 'ms'), ('t_usec', 'us'), ('timeMs', 'ms'),
        ('Zeit/ms', 'ms'), ('time_milliseconds', 'ms'), ('header.stamp.nanosec', 'ns'),
        ('millis()', 'ms'), ('elapsed_ms', 'ms'), ('us', 'us'), ('Tiempo (s)', 's'), ('t', 's'),
        # of no unit that is read, or of one that is not known
        ('time (min)', ''), ('time [ticks]', ''), ('Time [0.1ms]', ''), ('time [hh:mm:ss]', ''),
        ('latency_ms', ''), ('s', ''), ('delay ms', ''),
    ],
)  # fmt: skip
def test_the_unit_of_a_time_is_told_or_asked_for(tmp_path, name, unit):
    rows(tmp_path / 'log.csv', f'{name},position,torque', '{t},{a},{b}')
    header = header_of(tmp_path / 'log.csv')
    if unit:
        assert header.map()['time'] == {'column': name, 'unit': unit}
    else:
        with pytest.raises(IdentError, match='no column is named as a time'):
            header.require_told(tmp_path / 'log.csv')


def rows(path, header, row, count=200):
    lines = [
        row.format(t=0.01 * k, a=math.sin(0.1 * k), b=math.cos(0.1 * k)) for k in range(count)
    ]
    path.write_text('\n'.join([header, *lines, '']))


@pytest.mark.parametrize('mark', [',', ';', '\t', ' '])
@pytest.mark.parametrize('end', ['\r\r\n', '\n\n'])
def test_lines_may_be_blank_between_the_rows(tmp_path, mark, end):
    # as Python on Windows writes them without newline=''
    log = tmp_path / 'log.csv'
    cells = [mark.join(str(x / 100) for x in (k, 2 * k, 3 * k)) for k in range(200)]
    log.write_bytes(end.join([f'time{mark}q{mark}tau', *cells, '']).encode())
    main(['new-machine', '--kind', 'linear_axis', '--bag', str(log)])
    read = read_bag(log)[0]
    assert read.state.position[:, 0] == pytest.approx(np.arange(200) / 50)
    assert read.effort.effort[:, 0] == pytest.approx(3 * np.arange(200) / 100)


@pytest.mark.parametrize(
    'lines',
    [
        ['Time ,Extension ,Load ', '(s),(mm),(kN)'],
        ['Time,Extension,Load', 's,mm,kN', 'a0,a1,a2'],
        ['Serial,No.,5a', 'Time,Extension,Load', 'sec,mm,kN', ''],
        ['No.,CH1,CH2', 'Time [s],Extension [mm],Load [kN]'],
        ['Time [s],Extension [mm],Load [kN]', 'No.,CH1,CH2'],
    ],
)
def test_names_and_units_stand_in_any_of_several_lines(tmp_path, lines):
    log = tmp_path / 'log.csv'
    rows(log, '\n'.join(lines), '{t},{a},{b}')
    out = str(tmp_path / 'm.yaml')
    assert main(['new-machine', '--kind', 'linear_axis', '--bag', str(log), '--out', out]) == 0
    read = read_bag(log)[0]
    times = np.arange(200) / 10
    assert read.state.position[:, 0] == pytest.approx(1e-3 * np.sin(times))
    assert read.effort.effort[:, 0] == pytest.approx(1e3 * np.cos(times))


def test_a_scale_that_only_the_owner_knows_is_asked_for_and_taken(tmp_path, capsys):
    log = tmp_path / 'log.csv'
    rows(log, 'time,Position [inc],Torque [Nm]', '{t},{a},{b}')
    out = str(tmp_path / 'm.yaml')
    command = ['new-machine', '--kind', 'linear_axis', '--bag', str(log), '--out', out]
    assert main(command) == 2
    said = capsys.readouterr().err
    assert "--column 'Position [inc]=joint_1.position*SCALE'" in said
    assert not (tmp_path / 'log.columns.yaml').exists()
    assert main([*command, '--column', 'Position [inc]=arm.position*0.5']) == 0
    read = read_bag(log)[0]
    assert read.state.position[15, 0] == pytest.approx(0.5 * math.sin(1.5))
    assert read.state.names == read.effort.names == ('arm',)


@pytest.mark.parametrize(
    ('drives', 'read'), [('hip,knee', ['hip', 'knee']), ('hip', ['joint_1', 'joint_2'])]
)
def test_joints_that_have_numbers_only_are_called_as_the_drives(tmp_path, capsys, drives, read):
    log = tmp_path / 'log.csv'
    names = 'time,q2 speed [deg/s],q1 [rad],q2 [deg],q1 torque [Nm],q2 torque [Nm]'
    rows(log, names, '{t},{b},{a},{b},{a},{b}')
    out = str(tmp_path / 'm.yaml')
    main(['new-machine', '--kind', 'serial', '--drives', drives, '--bag', str(log), '--out', out])
    assert f'{read[1]}.velocity, in deg/s, times' in capsys.readouterr().err
    assert sorted(read_bag(log)[0].state.names) == sorted(read)


def test_bounds_come_from_an_effort_in_newton_metres(tmp_path, capsys):
    # A share of the rated torque would give inertias in percent.
    rows(tmp_path / 'log.csv', 'time,pos [rad],Torque [%]', '{t},{a},{b}')
    out = tmp_path / 'm.yaml'
    command = ['new-machine', '--kind', 'linear_axis', '--bag', str(tmp_path / 'log.csv')]
    command += ['--out', str(out)]
    assert main(command) == 2
    assert "one is: --column 'Torque [%]=joint_1.effort*SCALE'" in capsys.readouterr().err
    assert main([*command, '--column', 'Torque [%]=joint_1.effort*0.002']) == 0
    assert 'coulomb_friction: [0.0, 0.002, N m]' in out.read_text()


@pytest.mark.parametrize(
    'given', ['pos', 'pos=arm.mass', 'pos=arm.position*nan', 'x=arm.position']
)
def test_a_column_that_is_given_wrongly_is_refused(tmp_path, given):
    rows(tmp_path / 'log.csv', 'time,pos', '{t},{a}')
    with pytest.raises(IdentError, match='write NAME=JOINT.QUANTITY'):
        header_of(tmp_path / 'log.csv').assigned([given])


def test_a_scale_of_one_is_a_scale_that_is_stated(tmp_path):
    rows(tmp_path / 'log.csv', 'time,pos,i [A]', '{t},{a},{b}')
    header = header_of(tmp_path / 'log.csv')
    with pytest.raises(IdentError, match='say how many N m or N one is'):
        header.require_scales(effort=True)
    header = header.assigned(['i [A]=joint_1.effort*1'])
    header.require_scales(effort=True)
    assert header.map()['joints'] == {'joint_1': {'position': 'pos', 'effort': 'i [A]'}}


@pytest.mark.parametrize(
    ('name', 'unit'),
    [
        *[(x, 'A') for x in ('Iq', 'Present Current', 'axis0.motor.foc.Iq_measured', 'Strom X')],
        *[(x, 'A') for x in ('i_measured', 'motorCurrentAmps', 'cur2')],
        ('current_milliamps', 'milliamps'), ('i [%]', '%'),
        *[(x, '') for x in ('current_torque', 'torque', 't_actual', 'current_position', 'load')],
    ],
)  # fmt: skip
def test_a_current_is_in_ampere_where_no_unit_is_stated(name, unit):
    (found,) = meanings([name])
    assert (found.unit, found.quantity) == (unit, 'position' if 'pos' in name else 'effort')


def test_a_current_is_no_torque_of_a_drive_until_its_owner_says_so(tmp_path, capsys):
    rows(tmp_path / 'log.csv', 'Time,Position,Iq', '{t},{a},{b}')
    words = ['new-machine', '--kind', 'linear_axis', '--bag', str(tmp_path / 'log.csv')]
    assert main(words) == 2
    said = capsys.readouterr().err
    assert 'say how many N m or N one is: --column' in said
    assert 'by 1 masses and friction come divided by it' in said
    words += ['--column', 'Iq=joint_1.effort*0.025', '--out', str(tmp_path / 'm.yaml')]
    assert main(words) == 0


def test_an_effort_of_a_joint_that_no_column_moves_is_refused(tmp_path):
    rows(tmp_path / 'log.csv', 'time,q11,Im1 (A)', '{t},{a},{b}')
    with pytest.raises(IdentError, match="effort of 'joint_1', which no .* one of joint_11"):
        header_of(tmp_path / 'log.csv').assigned(['Im1 (A)=joint_1.effort*2'])


def test_an_effort_that_no_option_names_and_no_column_moves_is_left_out(tmp_path):
    rows(tmp_path / 'log.csv', 'time,X_RIst,weld_amps,motor_amps', '{t},{a},{b},{b}')
    told = ['X_RIst=x.position', 'motor_amps=x.effort']
    header = header_of(tmp_path / 'log.csv').assigned(told)
    effort = {'column': 'motor_amps', 'unit': 'a'}
    assert header.map()['joints'] == {'x': {'position': 'X_RIst', 'effort': effort}}
    assert header.columns[2].why == "no column says how 'weld' moves"


@pytest.mark.parametrize(
    ('header', 'row'),
    [
        ('# time q tau', '{t} {a} {b}'),  # numpy.savetxt
        ('time   q   tau', '{t}   {a}   {b}'),
        (',time,q,tau', '0,{t},{a},{b}'),  # the index of pandas
        ('time,mode,q,tau', '{t},moving,{a},{b}'),
        ('time\tq\ttau', '{t}\t{a}\t{b}'),
    ],
)
def test_tables_as_programs_write_them_are_read(tmp_path, header, row):
    log = tmp_path / 'log.csv'
    rows(log, header, row)
    out = str(tmp_path / 'm.yaml')
    assert main(['new-machine', '--kind', 'linear_axis', '--bag', str(log), '--out', out]) == 0
    recording = read_bag(log)[0]
    assert recording.state.position[15, 0] == pytest.approx(math.sin(1.5))
    assert recording.effort.effort[15, 0] == pytest.approx(math.cos(1.5))


def test_a_log_with_set_points_gives_a_file_without_a_controller(tmp_path, capsys):
    log, out = tmp_path / 'log.csv', tmp_path / 'm.yaml'
    rows(log, 'time,position [mm],target position [mm],force [N]', '{t},{a},{a},{b}')
    assert (
        main(['new-machine', '--kind', 'linear_axis', '--bag', str(log), '--out', str(out)]) == 0
    )
    text = out.read_text()
    assert 'gain' not in text and 'moving_mass: [0.0, ' in text and ', kg]' in text
    assert main(['check', str(log), '--machine', str(out)]) == 0
    assert 'the machine file states no gains' in capsys.readouterr().out


def test_what_has_no_effort_beside_others_is_no_drive(tmp_path, capsys):
    log, out = tmp_path / 'log.csv', tmp_path / 'm.yaml'
    names = 'time,q1,q2,tau1,tau2,pos_x,vel_wx,gripper_pos,goal_lift,lift_pos'
    rows(log, names, '{t},{a},{b},{b},{a},{a},{b},{b},{a},{b}')
    words = ['new-machine', '--kind', 'serial', '--bag', str(log), '--out', str(out)]
    given = ['--drives', 'hip,knee,lift', '--column', 'gripper_pos=hand.position']
    assert main([*words, *given]) == 0
    said = capsys.readouterr().err
    assert "pos_x        - (no effort and no set-point of 'x')" in said
    assert "vel_wx       - (no effort and no set-point of 'wx')" in said
    read = read_bag(log)[0].state.names
    assert sorted(read) == ['hand', 'joint_1', 'joint_2', 'lift']


def test_an_axis_without_effort_is_refused_and_no_file_of_example_values_written(tmp_path, capsys):
    log, out = tmp_path / 'log.csv', tmp_path / 'm.yaml'
    rows(log, 'timestamp,target_q_0,target_q_1,actual_q_0,actual_q_1', '{t},{a},{b},{a},{b}')
    words = ['new-machine', '--bag', str(log), '--out', str(out), '--kind']
    assert main([*words, 'linear_axis']) == 2
    assert 'holds no effort of joint_0, joint_1, from which masses' in capsys.readouterr().err
    assert not out.exists()
    assert main([*words, 'servo']) == 0


def test_a_map_by_names_alone_gives_way_to_options(tmp_path, capsys):
    log, out, chart = (tmp_path / x for x in ('log.csv', 'm.yaml', 'log.columns.yaml'))
    rows(log, 'time,q1,q2,tau1,tau2', '{t},{a},{b},{b},{a}')
    words = ['new-machine', '--bag', str(log), '--out', str(out)]
    assert main(words) == 2  # of what kind is it?
    assert [*yaml.safe_load(chart.read_text())['joints']] == ['joint_1', 'joint_2']
    words += ['--kind', 'linear_axis', '--drives', 'hip,knee']
    assert main(words) == 0
    assert load_machine(out).drives == ('hip', 'knee')
    assert read_bag(log)[0].state.names == ('hip', 'knee')
    # what its owner has changed stays
    chart.write_text(chart.read_text().replace('hip', 'x').replace('knee', 'y'))
    out.unlink()
    main([*words[:-1], 'x,y'])
    assert read_bag(log)[0].state.names == ('x', 'y')
    assert main([*words, '--column', 'q1=z.position']) == 2
    assert 'log.columns.yaml says what the columns are, so' in capsys.readouterr().err


def test_what_has_no_set_point_beside_others_is_no_servo(tmp_path, capsys):
    log, out = tmp_path / 'log.csv', tmp_path / 'm.yaml'
    rows(log, 'time,hip_q_target,hip_q_measured,hip_q_delta', '{t},{a},{b},{b}')
    assert main(['new-machine', '--kind', 'servo', '--bag', str(log), '--out', str(out)]) == 0
    assert "- (no effort and no set-point of 'hip_delta')" in capsys.readouterr().err
    assert read_bag(log)[0].state.names == ('hip',)


def test_joints_of_options_are_in_the_order_of_these(tmp_path, capsys):
    log, out = tmp_path / 'log.csv', tmp_path / 'm.yaml'
    rows(log, 'time,q_up,q_base,tau_base,tau_up', '{t},{a},{b},{b},{a}')
    words = ['new-machine', '--kind', 'serial', '--bag', str(log), '--out', str(out)]
    assert main([*words, '--column', 'q_base=base.position', '--column', 'q_up=up.position']) == 0
    assert load_machine(out).drives == read_bag(log)[0].state.names == ('base', 'up')
    assert "state its geometry, which is an example's, change" in capsys.readouterr().out


def test_joints_with_numbers_are_offered_the_names_of_the_description(tmp_path, capsys):
    log, out, arm = tmp_path / 'log.csv', tmp_path / 'm.yaml', tmp_path / 'arm.urdf'
    rows(log, 'time,q1,q2,tau1,tau2', '{t},{a},{b},{b},{a}')
    link = '<link name="l{}"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" '
    link += 'ixz="0" iyz="0"/></inertial></link>'
    joint = '<joint name="{0}" type="continuous"><parent link="l{1}"/><child link="l{2}"/></joint>'
    names = ('left hip', 'knee')
    parts = [*(link.format(n) for n in range(3)), *map(joint.format, names, (0, 1), (1, 2))]
    arm.write_text(f'<robot name="leg">{"".join(parts)}</robot>')
    words = ['new-machine', '--description', str(arm), '--bag', str(log), '--out', str(out)]
    assert main([*words, '--kind', 'serial']) == 2
    said = capsys.readouterr().err.partition('in the order of the joints? if so, give ')[2]
    assert main([*words, '--kind', 'serial', *shlex.split(said.splitlines()[0])]) == 0
    assert load_machine(out).drives == names


@pytest.mark.parametrize(
    ('units', 'stands'), [('[mm] [deg]', False), ('[mm] [mm]', True), ('[deg] [deg]', True)]
)
def test_strokes_of_different_units_are_not_compared(tmp_path, capsys, units, stands):
    # a table's 57 mm beside its spindle's fourteen turns
    log = tmp_path / 'log.csv'
    first, second = units.split()
    time = 0.01 * np.arange(500)
    table = np.stack([time, 28.5 * np.sin(time), np.cos(time), 4977 * time, np.sin(time)], axis=1)
    header = f'time,x_pos {first},x_torque [Nm],spindle_pos {second},spindle_torque [Nm]'
    np.savetxt(log, table, delimiter=',', header=header, comments='')
    chart = yaml.safe_dump(header_of(log).map(), sort_keys=False)
    (tmp_path / 'log.columns.yaml').write_text(chart)
    main(['check', str(log)])
    assert ('x: stood still' in capsys.readouterr().out) == stands


def test_a_motion_alone_is_refused(tmp_path, capsys):
    rows(tmp_path / 'log.csv', 'time,Angle in deg', '{t},{a}')
    words = ['new-machine', '--kind', 'linear_axis', '--bag', str(tmp_path / 'log.csv')]
    assert main(words) == 2
    assert 'log.csv holds motion only, and a motion alone tells no' in capsys.readouterr().err


@pytest.mark.parametrize('motion', ['{}_pos', '{}'])
def test_the_order_of_columns_is_asked_for_where_their_names_do_not_pair(tmp_path, capsys, motion):
    log, out, chart = (tmp_path / x for x in ('log.csv', 'm.yaml', 'log.columns.yaml'))
    names = [*map(motion.format, ('A1', 'A2')), 'tau_0', 'tau_1']
    rows(log, ','.join(['time', *names]), '{t},{a},{b},{b},{a}')
    words = ['new-machine', '--kind', 'serial', '--bag', str(log), '--out', str(out)]
    main(words)
    said = capsys.readouterr().err
    assert 'are these in the order of the joints? if so, give --column' in said
    assert len(yaml.safe_load(chart.read_text())['joints'].get('A1', {})) < 2
    options = shlex.split(said.partition('if so, give ')[2].splitlines()[0])
    out.unlink(missing_ok=True)
    assert main([*words, *options]) == 0
    assert '?' not in capsys.readouterr().err
    recording = read_bag(log)[0]
    assert recording.state.names == recording.effort.names == ('A1', 'A2')
    np.testing.assert_array_equal(recording.effort.effort[:, ::-1], recording.state.position)


def test_numbers_from_0_and_from_1_are_asked_for_as_a_whole():
    found = meanings(['t', 'q_1', 'q_2', 'tau_0', 'tau_1'])
    assert [x.perhaps for x in found[3:]] == ['joint_1.effort', 'joint_2.effort']


def test_columns_of_other_numbers_are_not_paired_by_their_order():
    assert not any(x.perhaps for x in meanings(['t', 'A1_pos', 'A2_pos', 'tau_0']))
    assert not any(x.perhaps for x in meanings(['t', 'q_1', 'tau_1', 'tau_2', 'mode']))


def test_a_joint_under_gravity_is_found_and_gets_a_kind_that_has_it(tmp_path):
    time = 0.002 * np.arange(5000)
    place = 1.2 * np.sin(1.1 * time) + 0.5 * np.sin(3.3 * time) + 0.2 * np.sin(9.0 * time)
    speed = np.gradient(place, 0.002)
    effort = 0.05 * np.gradient(speed, 0.002) + 0.3 * np.tanh(speed / 0.01) + 3.0 * np.sin(place)
    log, out = tmp_path / 'log.csv', tmp_path / 'm.yaml'
    columns = np.stack([time, place, effort], axis=1)
    np.savetxt(log, columns, delimiter=',', header='t,q [rad],tau [Nm]', comments='')
    words = ['new-machine', '--bag', str(log), '--out', str(out), '--kind']
    assert main([*words, 'linear_axis']) == 2
    assert main([*words, 'serial']) == 0
    machine = load_machine(out)
    problem = problem_of(machine, read_data(log, machine), fixed={'measurement_delay': 0.0})
    found = solve(problem, IdentifySettings(method='algebraic'), 0)
    values = {p.name.removeprefix('joint_1.'): p.value for p in found.parameters}
    moment = math.hypot(values['link_moment_x'], values['link_moment_y'])
    assert moment * 9.81 == pytest.approx(3.0, rel=0.01)
    assert values['drive_inertia'] == pytest.approx(0.05, rel=0.02)


@pytest.mark.parametrize(('still', 'row'), [('position', '{t},1,{b}'), ('effort', '{t},{a},1')])
def test_a_log_of_a_drive_that_stands_still_is_refused(tmp_path, capsys, still, row):
    rows(tmp_path / 'log.csv', 'time,position,effort', row)
    words = ['new-machine', '--kind', 'linear_axis', '--bag', str(tmp_path / 'log.csv')]
    assert main(words) == 2
    said = f'the {still} of joint_1 stays the same, so that the log tells nothing'
    assert said in capsys.readouterr().err


def test_what_no_option_names_and_no_effort_drives_is_left_out(tmp_path, capsys):
    log, out = tmp_path / 'log.csv', tmp_path / 'm.yaml'
    rows(log, 'time,theta,phidot,i_mot', '{t},{a},{b},{a}')
    words = ['new-machine', '--kind', 'linear_axis', '--bag', str(log), '--out', str(out)]
    told = ['--column', 'phidot=wheel.velocity', '--column', 'i_mot=wheel.effort*0.3']
    assert main([*words, *told]) == 0
    assert "theta   - (no effort and no set-point of 'joint_1')" in capsys.readouterr().err
    assert read_bag(log)[0].state.names == load_machine(out).drives == ('wheel',)


def swing(tmp_path, rate):
    """Write a log of a pendulum and its machine file: J 0.2 kg m^2, M g 2 N m, little friction."""
    time = np.arange(0.0, 20.0, 0.01)
    # about its own frequency, weight and inertia need little effort
    place = 0.1 * np.sin(0.9 * np.sqrt(2.0 / 0.2) * time) + 0.05 * np.sin(rate * time)
    speed = np.gradient(place, time)
    effort = 0.2 * np.gradient(speed, time) + 2.0 * np.sin(place) + 0.02 * speed
    log, out = tmp_path / 'log.csv', tmp_path / 'm.yaml'
    np.savetxt(log, np.column_stack([time, place, effort]), '%.7g', ',', header='t,pos,tau')
    main(['new-machine', '--kind', 'serial', '--bag', str(log), '--out', str(out)])
    return log, out


@pytest.mark.parametrize('rate', [3.0, 4.0, 5.0])
def test_bounds_hold_weight_and_inertia_of_a_swing_near_its_own_frequency(tmp_path, rate):
    log, out = swing(tmp_path, rate)
    bounds = yaml.safe_load(out.read_text())['parameters']
    words = ['--kind', 'linear_axis', '--bag', str(log), '--out', str(tmp_path / 'axis.yaml')]
    # so small a swing tells its weight from no spring, but the kind that has neither is refused
    assert main(['new-machine', *words]) == 2
    # the largest effort alone would be far less than what it is the weight of
    assert np.abs(read_bag(log)[0].effort.effort).max() < 0.5 * 2.0
    assert bounds['link_moment'][0] < -2.0 / 9.81 and bounds['link_moment'][1] > 2.0 / 9.81
    assert bounds['drive_inertia'][1] > 0.2


@pytest.mark.parametrize('measured', [True, False])
def test_an_integral_of_a_speed_shows_nothing_of_places(tmp_path, measured):
    log, out = tmp_path / 'log.csv', tmp_path / 'm.yaml'
    names = ['time', 'pos', 'vel', 'tau']
    rows(log, ','.join(x for x in names if measured or x != 'pos'), '{t},{a},{b},{b}'
         if measured else '{t},{b},{b}')  # fmt: skip
    main(['new-machine', '--kind', 'linear_axis', '--bag', str(log), '--out', str(out)])
    machine = load_machine(out)
    model = make_model(machine, align(read_bag(log)[0], machine.drives, 0.01))
    offered = {at.effect for at in model.extensions()}
    assert 'stribeck' in offered
    assert ('end_stop' in offered) is ('cable_spring' in offered) is measured


def test_columns_of_one_name_are_told_apart_by_their_number(tmp_path, capsys):
    log, out = tmp_path / 'log.csv', tmp_path / 'm.yaml'
    rows(log, 'Position [0x6064],,Torque [0x6077],\nX,Y,X,Y', '{t},{a},{t},{b}')
    words = ['new-machine', '--kind', 'linear_axis', '--bag', str(log), '--out', str(out)]
    assert main([*words, '--column', '1=time', '--column', 'Y=arm.position']) == 2
    assert 'by its number where several are called alike' in capsys.readouterr().err
    told = ['1=time', '2=arm.position', '4=arm.effort']
    assert main([*words, *(y for x in told for y in ('--column', x))]) == 0
    recording = read_bag(log)[0]
    assert recording.state.position[15, 0] == pytest.approx(math.sin(1.5))
    assert recording.effort.effort[15, 0] == pytest.approx(math.cos(1.5))
