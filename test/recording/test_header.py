# SPDX-License-Identifier: Apache-2.0
"""Column maps by the names in headers, and the machine file of a joint by its table."""

import numpy as np
import pytest
import yaml

from ros2_ident.cli.main import main
from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.models import load_machine
from ros2_ident.recording import read_bag
from ros2_ident.recording.columns import drafted_columns

DEGREE = pytest.approx(np.pi / 180.0)


@pytest.mark.parametrize(
    ('text', 'joints', 'time', 'more'),
    [
        (
            'time,q1,q2,dq1,tau1,q1_ref,tau1_ref\n0,1,2,3,4,5,6\n',
            {
                'joint_1': {'position': 'q1', 'velocity': 'dq1', 'effort': 'tau1',
                            'command_position': 'q1_ref'},
                'joint_2': {'position': 'q2'},
            },
            ('time', 's'), {},
        ),
        (
            'Scope;x\n\nTime;ActPos1;ActVel1;Current1;Temp\nms;deg;deg/s;mA;C\n0;1,5;2;3;4\n1;1,5;2;;4\n',
            {
                'joint_1': {'position': {'column': 'ActPos1', 'scale': DEGREE},
                            'velocity': {'column': 'ActVel1', 'scale': DEGREE},
                            'effort': {'column': 'Current1', 'scale': 1e-3}},
            },
            ('Time', 'ms'), {'delimiter': ';', 'decimal': ',', 'skip': 2, 'skip_below': 1},
        ),
        (
            'timestamp_ns,shoulder_pan.position,shoulder_pan.effort\n0,1,2\n',
            {'shoulder_pan': {'position': 'shoulder_pan.position',
                              'effort': 'shoulder_pan.effort'}},
            ('timestamp_ns', 'ns'), {},
        ),
        (
            't [s]\ttheta [rad]\ti [A]\n0\t1\t3\n',
            {'joint_1': {'position': 'theta [rad]', 'effort': 'i [A]'}},
            ('t [s]', 's'), {'delimiter': '\t'},
        ),
        (
            'ID;7\n;Velocity averaged;Torque actual value\nms;rpm;%\n0;1;2\n',
            {'joint_1': {'velocity': {'column': 'Velocity averaged', 'scale': 0.10471975511965977},
                         'effort': 'Torque actual value'}},
            (1, 'ms'), {'delimiter': ';', 'skip': 1, 'skip_below': 1},
        ),
    ],
)  # fmt: skip
def test_a_header_says_what_its_columns_are(tmp_path, text, joints, time, more):
    (tmp_path / 'log.csv').write_text(text)
    told = yaml.safe_load(drafted_columns(tmp_path / 'log.csv'))
    expected = {'delimiter': ',', 'decimal': '.', 'skip': 0, 'skip_below': 0} | more
    assert told.pop('joints') == joints
    assert tuple(told.pop('time').values()) == time
    assert told == expected


@pytest.mark.parametrize(
    ('text', 'said'),
    [
        ('', 'no line of names'), ('0,1\n1,2\n', 'no line of names'),
        ('a,q\n0,1\n', 'named as a time: a, q'), ('t,x\n0,1\n', 'named as a position'),
    ],
)  # fmt: skip
def test_a_header_that_says_nothing_is_refused(tmp_path, text, said):
    (tmp_path / 'log.csv').write_text(text)
    with pytest.raises(IdentError, match=said) as caught:
        drafted_columns(tmp_path / 'log.csv')
    assert caught.value.code == ErrorCode.INVALID_GOAL


def test_a_table_of_one_joint_becomes_map_and_machine_file(tmp_path, capsys):
    time = 0.01 * np.arange(500)
    rows = np.stack([time, np.sin(time), 2.0 * np.cos(time)], axis=1)
    table, out = tmp_path / 'log.csv', tmp_path / 'my.yaml'
    np.savetxt(table, rows, delimiter=',', header='time,q,tau', comments='', fmt='%.6f')
    words = ['new-machine', '--kind', 'linear_axis', '--bag', str(table)]
    assert main([*words, '--out', str(out)]) == 0
    assert 'log.columns.yaml, from the names in' in capsys.readouterr().err
    assert len(out.read_text().splitlines()) == 9
    machine = load_machine(out)
    assert machine.number('cycle') == pytest.approx(0.01)
    assert machine.bounds['coulomb_friction'][1] == pytest.approx(2.0)
    np.testing.assert_allclose(read_bag(table)[0].state.position[:, 0], rows[:, 1], atol=1e-6)
    (tmp_path / 'log.columns.yaml').write_text('mine')
    assert main(words) == 2
    assert (tmp_path / 'log.columns.yaml').read_text() == 'mine'


def test_speeds_do_for_a_machine_file_and_are_not_held_against_themselves(tmp_path, capsys):
    time = 0.01 * np.arange(500)
    rows = np.stack([time, np.sin(time), np.cos(time)], axis=1)
    table, out = tmp_path / 'log.csv', tmp_path / 'my.yaml'
    np.savetxt(table, rows, delimiter=',', header='time,dq,tau [A]', comments='')
    words = ['--bag', str(table), '--out', str(out)]
    assert main(['new-machine', '--kind', 'linear_axis', *words]) == 0
    assert load_machine(out).bounds['measurement_delay'] == (0.0, pytest.approx(0.02), 's')
    assert 'effort_unit: A and' in (tmp_path / 'log.columns.yaml').read_text()
    assert main(['check', str(table), '--machine', str(out)]) == 0
    assert 'reported velocity' not in capsys.readouterr().out
