# SPDX-License-Identifier: Apache-2.0
"""Tables with a column map: the same streams as from a bag, and sentences for what is wrong."""

import csv
import re

from identify_cases import ROOT
import numpy as np
import pytest
from reader_cases import alike
import yaml

from ros2_ident.cli.main import main
from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.models import load_machine
from ros2_ident.recording import read_bag, scale_effort, table
from ros2_ident.recording.columns import load_columns, load_topics
from ros2_ident.recording.headers import header_of
from ros2_ident.recording.table import read_columns


def read(tmp_path, text, more='', joints='a: {position: q}', time='t', unit='s'):
    (tmp_path / 'log.csv').write_bytes(text if isinstance(text, bytes) else text.encode())
    where = tmp_path / 'map.yaml'
    where.write_text(f'time: {{column: {time}, unit: {unit}}}\njoints: {{{joints}}}\n{more}')
    return read_columns(tmp_path / 'log.csv', where)


def tabled(path, recording):
    columns = {'q': ('state', 'position'), 'e': ('effort', 'effort'), 'c': ('command', 'position')}
    rows = {}
    for name, (role, field) in columns.items():
        stream = recording.streams[role]
        for stamp, value in zip(stream.stamp, getattr(stream, field)[:, 0], strict=True):
            rows.setdefault(stamp, {})[name] = repr(float(value))
    lines = [','.join([str(t), *(rows[t].get(x, '') for x in columns)]) for t in sorted(rows)]
    path.write_text('\n'.join(['t,q,e,c', *lines]))
    path.with_suffix('.columns.yaml').write_text(
        'time: {column: t, unit: ns}\n'
        'joints: {emps_axis: {position: q, effort: e, command_position: c}}\n'
    )


@pytest.mark.parametrize(
    ('unit', 'time'),
    [
        ('s', '1700000000.123456789'), ('ms', '1700000000123.456789'),
        ('us', '1700000000123456.789'), ('ns', '1700000000123456789'),
    ],
)  # fmt: skip
def test_times_and_numbers_are_read_to_the_last_digit(tmp_path, unit, time):
    (found,) = read(tmp_path, f't,q\n{time},{1 / 3!r}\n', unit=unit)
    assert found.state.stamp.tolist() == [1_700_000_000_123_456_789]
    assert found.state.position.tolist() == [[1 / 3]] and found.warnings == ()


def test_semicolons_decimal_commas_and_lines_before_the_names(tmp_path):
    more = 'delimiter: ";"\ndecimal: ","\nskip: 2\n'
    (found,) = read(tmp_path, 'Scope;1\n\nt;q\n0,5;1,25\n0,51;-2\n', more)
    assert found.state.stamp.tolist() == [500_000_000, 510_000_000]
    assert found.state.position[:, 0].tolist() == [1.25, -2.0]


def test_columns_are_added_rows_chosen_and_lines_of_units_left_out(tmp_path):
    text = 't,q,joint,m,g\ns,rad,-,A,A\n0,1,2,3,5\n0.1,7,1.0,0,0\n0.2,2,2.0,1,\n0.3,4,2,4,1\n'
    joints = 'a: {position: q, effort: [m, {column: g, scale: -2}]}'
    (log,) = read(tmp_path, text, 'where: {joint: 2}\nskip_below: 1\n', joints)
    assert log.state.position[:, 0].tolist() == [1.0, 2.0, 4.0]
    assert log.effort.effort[:, 0].tolist() == [-7.0, 2.0]  # of two columns, both were measured
    with pytest.raises(IdentError, match='leave lines of units .* by `skip_below'):
        read(tmp_path, text, '', joints)
    with pytest.raises(IdentError, match='no row of values with what `where` asks for'):
        read(tmp_path, text, 'where: {joint: 3}\nskip_below: 1\n', joints)
    for key in ('skip', 'skip_below'):
        with pytest.raises(IdentError, match=f'{key} is 9223372036854775808; write'):
            read(tmp_path, text, f'{key}: {1 << 63}\n', joints)


def test_rows_without_a_time_are_even(tmp_path, monkeypatch):
    monkeypatch.setattr(table, '_BLOCK', 7)
    rows = ''.join(f'{n % 3},{0.5 * n}\n' for n in range(40))
    text = 'time: {rate: 250}\njoints: {a: {position: q}}\nwhere: {run: 1}\n'
    (tmp_path / 'log.columns.yaml').write_text(text)
    (tmp_path / 'log.csv').write_text(f'run,q\n{rows}')
    (found,) = read_bag(tmp_path / 'log.csv')
    which = np.arange(1, 40, 3)
    np.testing.assert_array_equal(found.state.stamp, which * 4_000_000)
    np.testing.assert_array_equal(found.state.position[:, 0], 0.5 * which)


def test_a_unit_is_a_factor_and_a_scale_beside_it_one_more(tmp_path):
    text = 't,q,v,g,m\n0,90,60,1000,20\n0.1,180,-30,0,10\n'
    joints = """a: {position: {column: q, unit: deg, scale: -1}, velocity: {column: v, unit: rpm},
      command_velocity: {column: v, unit: Deg/s}, command_position: {column: g, unit: mm},
      effort: [{column: m, unit: mNm}, {column: g, unit: mNm}]}"""
    (log,) = read(tmp_path, text, '', joints)
    np.testing.assert_allclose(log.state.position[:, 0], [-np.pi / 2, -np.pi])
    np.testing.assert_allclose(log.state.velocity[:, 0], [2.0 * np.pi, -np.pi])
    np.testing.assert_allclose(log.command.velocity[:, 0], [np.pi / 3, -np.pi / 6])
    np.testing.assert_allclose(log.command.position[:, 0], [1.0, 0.0])
    np.testing.assert_allclose(log.effort.effort[:, 0], [1.02, 0.01])


def test_streams_of_different_rates_stand_in_one_table_without_names(tmp_path):
    joints = 'a: {position: 2, effort: {column: 3, scale: 2.0}}, b: {effort: 4}'
    text = '0.00,1,,\n0.01,2,5,6\n0.02,,,\n0.03,3,7,\n'
    (found,) = read(tmp_path, text, 'header: false\n', joints, time=1)
    assert found.state.names == ('a',) and found.effort.names == ('a', 'b')
    assert found.state.stamp.tolist() == [0, 10_000_000, 30_000_000]
    np.testing.assert_array_equal(found.effort.effort, [[10.0, 6.0], [14.0, np.nan]])


@pytest.mark.parametrize('motion', ['velocity', 'position'])
def test_an_effort_takes_the_sign_of_the_velocity_and_keeps_it_at_rest(tmp_path, motion):
    time = 0.01 * np.arange(600)
    rate = np.where((time > 3.0) & (time < 4.0), 0.0, np.sin(2.0 * np.pi * 0.5 * time + 0.3))
    values = rate if motion == 'velocity' else 0.01 * np.cumsum(rate)
    body = ''.join(f'{t:.2f},{x},2\n' for t, x in zip(time, values, strict=True))
    joints = f'a: {{{motion}: q, effort: {{column: i, scale: 0.5, sign: velocity}}}}'
    (log,) = read(tmp_path, 't,q,i\n' + body, '', joints)
    effort = log.effort.effort[:, 0]
    moves = np.abs(rate) > 0.2
    np.testing.assert_array_equal(effort[moves], np.sign(rate[moves]))
    assert (np.abs(effort) == 1.0).all()


@pytest.mark.parametrize('block', [1, 3, 7, 1000])
def test_a_step_back_begins_a_recording_and_a_cut_line_is_left_out(tmp_path, monkeypatch, block):
    monkeypatch.setattr(table, '_BLOCK', block)
    rows = [f'{0.01 * k:.9f},{k}' for k in range(6)]
    lines = ['one', 't,q', *rows, '', ' , ', *rows, '0.06']
    one, two = read(tmp_path, '\n'.join(lines), 'skip: 1')
    assert alike(one.state, two.state) and one.state.position[:, 0].tolist() == [0, 1, 2, 3, 4, 5]
    assert one.warnings[0].endswith('log.csv: its last line 17 breaks off and is left out')


@pytest.mark.parametrize('code', ['utf-8-sig', 'latin-1'])
def test_a_table_is_read_in_any_code_and_within_bounds(tmp_path, code, monkeypatch):
    monkeypatch.setenv('ROS2_IDENT_MAX_MEMORY', '1')
    text = 't,q,Kraft \xb5\n0,1,2\n0.01,2,3\n'.encode(code)
    text += b' ' * ((1 << 17) - len(text))
    (found,) = read(tmp_path, text)
    assert found.state.stamp.size == 2
    with pytest.raises(IdentError, match='the table takes') as caught:
        read(tmp_path, text + b' ')
    assert caught.value.code is ErrorCode.BAD_VALUES


MAPS = [
    ("time is 'time'; write it as in docs", 'time: time'),
    ('its unit s, ms, us or ns', 'time: {column: time, unit: min}'),
    ("a has 'torque'; choose from position, velocity, effort", 'joints: {a: {torque: 1}}'),
    ("the map has 'sep'; choose from time, joints", 'sep: ;'),
    ("decimal is ','; write", 'decimal: ","\ndelimiter: ","'),
    ('delimiter is 5; write', 'delimiter: 5'),
    ('skip is -1; write', 'skip: -1'),
    ('joints is empty', 'joints: {}'),
    ('a value that cannot be shown, which is no text', f'joints:\n  ? 0x{"f" * 5000}\n  : {{}}'),
    ('names a joint False, which is no text; put it into quotes', 'joints: {no: {position: 2}}'),
    ('where is 3; write', 'where: 3'),
    ('a has no column', 'joints: {a: {}}'),
    ('names a joint twice', 'joints: {1: {position: 2}, "1": {position: 3}}'),
    ('header is 0; write', 'header: 0'),
    ("names the column 'time'; write the number", 'header: false'),
    *(
        (f'names the column {said}', f'joints: {{a: {{effort: {cell}}}}}')
        for cell, said in (('0', '0; write the name or the number'), ('true', 'True'),
                           ('65537', '65537'), ('{scale: 2.0}', 'None'))
    ),
    *(
        (said, f'joints: {{a: {{effort: {{column: q1, {part}}}}}}}')
        for part, said in (('scale: 0', "'scale': 0}; write it as in docs"),
                           ('scale: .nan', "'scale': nan}"), ('scale: x', "'scale': 'x'}"),
                           ('unit: m', "effort is in 'm', which is no unit of it, or none"),
                           ('unit: [n]', "in ['n'], which is"), ('unit: Inc', 'or state its'))
    ),
    ("position is in 'rpm'", 'joints: {a: {position: {column: q, unit: rpm}}}'),
]  # fmt: skip


@pytest.mark.parametrize(('said', 'line'), MAPS)
def test_maps_that_make_no_sense(tmp_path, said, line):
    given = {'time': '{column: time, unit: s}', 'joints': '{a: {position: q1}}'}
    given = {k: f'{k}: {v}' for k, v in given.items() if not line.startswith(k)}
    (tmp_path / 'map.yaml').write_text('\n'.join([*given.values(), line]))
    with pytest.raises(IdentError, match=re.escape(said)) as caught:
        load_columns(tmp_path / 'map.yaml')
    assert caught.value.code == ErrorCode.INVALID_GOAL and '\n' not in caught.value.message


@pytest.mark.parametrize(
    ('code', 'text', 'table'),
    [
        ('MISSING_STREAM', "no column 'q', its columns are t, x; cor", 't,x\n0,1\n'),
        ('BAD_VALUES', "line 3, column q: 'abc' is no number", 't,q\n0,1\n1,abc\n'),
        ('BAD_VALUES', "line 2: the time '12:30' is no number", 't,q\n12:30,1\n'),
        ('BAD_VALUES', "two columns are called 'q'", 't,q,q\n0,1,2\n'),
        ('BAD_VALUES', 'line 3 has 1 cells, the column map needs 2', 't,q\n0,1\n1\n2,3\n'),
        ('BAD_VALUES', 'line 3 has a quotation mark that is not closed', 't,q\n0,1\n1,"6\n2,7"\n'),
        (
            'BAD_VALUES',
            'the rows are 1000 s apart; correct the unit of the time in',
            't,q\n0,1\n1000,2\n',
        ),
        ('BAD_VALUES', '2 of 4 rows have the time of the row before', 't,q\n0,1\n0,2\n1,3\n1,3\n'),
        ('NO_DATA', 'holds no row of values; record again', 't,q\n'),
        ('NO_DATA', 'no measured value arrived', 't,q\n0,\n0.001,\n'),
    ],
)
def test_tables_that_make_no_sense(tmp_path, code, text, table):
    with pytest.raises(IdentError, match=re.escape(text)) as caught:
        read(tmp_path, table)
    assert caught.value.code == ErrorCode[code] and '\n' not in caught.value.message


def test_the_map_in_the_documentation_is_one(tmp_path):
    fields, table, arrays = (
        x.split('```')[0] for x in (ROOT / 'docs/logs.md').read_text().split('```yaml')[1:4]
    )
    (tmp_path / 'arrays.yaml').write_text(arrays)
    assert len(load_columns(tmp_path / 'arrays.yaml', arrays=True).columns) == 6
    (tmp_path / 'fields.yaml').write_text(fields)
    topics = load_topics(tmp_path / 'fields.yaml')
    assert {x: len(y.columns) for x, y in topics.items()} == {'/arm_state': 5, '/arm_goal': 1}
    assert (topics['/arm_state'].time, topics['/arm_state'].digits) == ('tick', 6)
    (tmp_path / 'map.yaml').write_text(table)
    found = load_columns(tmp_path / 'map.yaml')
    assert (found.time, found.digits, len(found.columns)) == ('time', 6, 10)
    assert (found.delimiter, found.decimal, found.skip, found.header) == (',', '.', 0, True)
    cells = {(x.joint, x.quantity): (x.cell, x.scale) for x in found.columns}
    assert cells['drive_1', 'effort'] == ('Current1', -1.0)
    assert cells['drive_1', 'command_position'] == ('SetPos1', 0.001)
    assert cells['drive_1', 'command_velocity'] == (9, 1.0)


def test_a_path_in_a_command_to_type_is_quoted(tmp_path, capsys):
    (tmp_path / 'my $log.csv').write_text('time,q1\n0,1\n')
    with pytest.raises(IdentError, match=r"--bag '.*/my \$log.csv'`, or give that of another"):
        read_bag(tmp_path / 'my $log.csv')
    out = tmp_path / 'my axis.yaml'
    assert main(['new-machine', '--kind', 'linear_axis', '--out', str(out)]) == 0
    assert f"ident check --machine '{out}'\n" in capsys.readouterr().out


def test_a_table_without_a_map(tmp_path):
    with pytest.raises(IdentError, match='log.csv: does not exist'):
        read_bag(tmp_path / 'log.csv')
    (tmp_path / 'log.csv').write_text('time,q1\n0,1\n')
    with pytest.raises(
        IdentError, match=r'log.columns.yaml is missing; .* docs/logs.md.* first line is: time, q1'
    ):
        read_bag(tmp_path / 'log.csv')
    with pytest.raises(IdentError, match='cannot be read'):
        load_columns(tmp_path)
    (tmp_path / 'log.columns.yaml').write_text('a: [')
    with pytest.raises(IdentError, match='is no YAML'):
        read_bag(tmp_path / 'log.csv')


def test_the_commands_take_a_table_like_a_bag(tmp_path, capsys):
    (recording,) = read_bag('bags/axis_reversals')
    tabled(tmp_path / 'log.csv', scale_effort(recording, 0.5))
    words = ['--machine', 'config/emps.yaml']
    assert main(['check', str(tmp_path / 'log.csv'), *words]) == 0
    assert 'it has the sign of the motion' in capsys.readouterr().out
    search = ['--generations', '2', '--population', '64', '--no-overlay', '--quiet', '--no-report']
    current = ['--effort-unit', 'A', '--torque-constant', '2.0']
    out = ['--out', str(tmp_path / 'out')]
    table = main(['identify', str(tmp_path / 'log.csv'), *words, *search, *current, *out])
    said = capsys.readouterr().out
    bag = main(['identify', 'bags/axis_reversals', *words[:2], *search, '--out', out[1]])
    assert table == bag
    assert [x for x in said.splitlines() if 'emps_axis' in x] == [
        x for x in capsys.readouterr().out.splitlines() if 'emps_axis' in x
    ]
    assert main(['check', str(tmp_path / 'log.csv'), *words, '--torque-constant', '2']) == 2
    assert 'add `--effort-unit A`' in capsys.readouterr().err


# ---------------------------------------------------------------------- names in headers


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
                'joint_1': {'position': {'column': 'ActPos1', 'unit': 'deg'},
                            'velocity': {'column': 'ActVel1', 'unit': 'deg'},
                            'effort': {'column': 'Current1', 'unit': 'ma'}},
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
            'ID;7\nScale:;0;True;1.5;-4.2;3.5\n;Velocity averaged;Torque actual value\nms;rpm;%\n'
            '0;1;2\n1;1;2\n',
            {'joint_1': {'velocity': {'column': 'Velocity averaged', 'unit': 'rpm'},
                         'effort': {'column': 'Torque actual value', 'unit': '%'}}},
            (1, 'ms'), {'delimiter': ';', 'skip': 2, 'skip_below': 1},
        ),
        (  # more decimal commas than marks between cells
            '"Time [s]";"q";"tau"\n0,002;1,500;2,5\n0,004;1,625;3,5\n',
            {'joint_1': {'position': 'q', 'effort': 'tau'}},
            ('Time [s]', 's'), {'delimiter': ';', 'decimal': ','},
        ),
        (
            'Time q tau\n' + '0,002 1,500 2,5\n' * 9,
            {'joint_1': {'position': 'q', 'effort': 'tau'}},
            ('Time', 's'), {'delimiter': ' ', 'decimal': ','},
        ),
    ],
)  # fmt: skip
def test_a_header_says_what_its_columns_are(tmp_path, text, joints, time, more):
    (tmp_path / 'log.csv').write_text(text)
    told = header_of(tmp_path / 'log.csv').map()
    expected = {'delimiter': ',', 'decimal': '.', 'skip': 0, 'skip_below': 0} | more
    assert told.pop('joints') == joints
    assert tuple(told.pop('time').values()) == time
    assert told == expected


@pytest.mark.parametrize(
    ('text', 'said'),
    [
        ('', 'is empty'),
        ('0\t1\n1\t2\n', 'no line of names above its numbers; say what its columns are by their '
         'numbers, as by --column 1=time --column 2=joint_1.position --column 3=joint_1.effort; '
         '--rate HZ stands for a time'),
        ('0 1 2 3\n4 5 6 7\n', '2 rows of 4 numbers, .* turn it over'),
        ('a,q\n0,1\n', 'named as a time: a, q; say which is, by --column NAME=time or --rate HZ'),
        ('a,b\n0,1\n', 'named as a time, or as a position.*=time .*, and --column NAME=JOINT.QUA'),
        ('t,a\n0,1\n', 'named as a position, .*: t, a; say which is, by --column NAME=JOINT.QUA'),
        # the letters of a textbook, if they are it
        ('t,x,v,F\n0,1,2,3\n', '--column x=joint_1.position --column v=joint_1.velocity --column '
         'F=joint_1.effort'),
        ('t,x,s\n0,1,2\n', 'say which is, by --column NAME=JOINT.QUANTITY'),
        ('t,q,i\n0 s,1 rad,2 A\n', "'0 s' below 't': write numbers alone"),
        ('t,q,i\n10:00:00,1,2\n10:00:01,1,3\n', "'10:00:00' below 't': write"),
        # of another form
        ('time,topic,value\n' + '0.1,a/pos,1\n0.1,a/vel,2\n' * 50, 'one value a row'),
        ('x:pos 2024-01-02 10:00:00.1 1\nx:vel 2024-01-02 10:00:00.2 2\n' * 50, 'one value a row'),
        ('on off\nok ok\non 2\n', "'ok' below 'on': write numbers alone"),
        ('Axis 1\nTime,data\n' + '0.1,1,2\n0.2,2,3\n' * 50,
         'has 3 columns and 2 of names, Time, data; say what its columns are by their numbers'),
        ('t,joint,pos,tau\n' + ''.join(f'{k},{j},1,2\n' for k in range(50) for j in 'ab'),
         "rows of several drives or quantities, by 'joint': a, b"),
        ('t,motor_id,pos,tau\n' + ''.join(f'{k},{k % 2 + 1},1,2\n' for k in range(50)),
         "rows of several drives or quantities, by 'motor_id': 1, 2; .* chooses one by `where`"),
        ('t,joint_idx,pos,tau\n' + ''.join(f'{k},{k % 2},1,2\n' for k in range(50)),
         "rows of several drives or quantities, by 'joint_idx': 0, 1"),
        ('Name,c1,Name,c2\nScaleFactor,1,ScaleFactor,1\n0,1,0,2\n', 'a time for each channel'),
        # without properties, the times' names as pandas marks them; trace of CODESYS
        ('Time,q,Time,tau\n0,1,0,2\n1,1,2,2\n', 'has a time for each .*, or interpolate to one'),
        ('t (s),q,tau,t (s).1,v\n0,1,2,0.1,2\n', 'has a time for each channel'),
        ('[key]; [value]\nName; Trace\n0.Variable; Main.q\n0.Data; \n' + '; 2; 25\n; 4; 25\n' * 9,
         'a block of properties above its values; export it with names and one common time$'),
        # two channels of one task behind a time, with decimal commas; one time for all
        ('Name\ta\tb\tName\tc\nUnit\t\t\tUnit\t\n' + '0,0\t1,5\t2,5\t0,0\t3,5\n' * 9,
         'a time for each channel'),
        ('Name,a,b\nData-Type,REAL64,REAL64\nSampleTime[ms],2,2\nUnit,,\n' + '0.0,1.5,2.5\n' * 9,
         'a block of properties above its values; export it with names'),
    ],
)  # fmt: skip
def test_a_header_that_says_nothing_is_refused(tmp_path, text, said):
    (tmp_path / 'log.csv').write_text(text)
    with pytest.raises(IdentError, match=said) as caught:
        header_of(tmp_path / 'log.csv').require_told(tmp_path / 'log.csv')
    assert caught.value.code == ErrorCode.INVALID_GOAL


@pytest.mark.parametrize('again', ['Time (s)', 'Time (s).1'])
def test_a_time_that_stands_there_twice_is_read_once(tmp_path, again):
    rows = ''.join(f'{k},{k + 1},{k},3\n' for k in range(9))
    (tmp_path / 'log.csv').write_text(f'Time (s),position,{again},torque\n{rows}')
    header = header_of(tmp_path / 'log.csv')
    header.require_told(tmp_path / 'log.csv')
    assert [x.quantity for x in header.columns] == ['time', 'position', '', 'effort']
    assert header.columns[2].why == 'the first column again'


@pytest.mark.parametrize(
    ('head', 'between', 'options'),
    [
        # neither names nor a time; a time of counted ms; names that say nothing, a time of words
        ('', '\t', ['--rate', '100', '--column', '2=arm.position*1e-3',
                    '--column', '3=arm.effort']),
        ('', ' ', ['--column', '1=time*1e-3', '--column', '2=arm.position*0.001',
                   '--column', '3=arm.effort']),
        ('a,b,c\n', ',', ['--rate', '100', '--column', 'b=arm.position*1e-3',
                          '--column', 'c=arm.effort']),
    ],
)  # fmt: skip
def test_options_alone_tell_a_table_that_names_nothing(tmp_path, head, between, options):
    log, out = tmp_path / 'log.dat', tmp_path / 'arm.yaml'
    place, effort = np.sin(0.1 * np.arange(300)).round(6), np.cos(0.1 * np.arange(300)).round(6)
    cells = ([10 * n, f'{1e3 * place[n]:.3f}', effort[n]] for n in range(300))
    log.write_text(head + ''.join(f'{between.join(map(str, x))}\n' for x in cells))
    words = ['new-machine', '--kind', 'linear_axis', '--bag', str(log), '--out', str(out)]
    assert main([*words, *options]) == 0
    read = read_bag(log)[0]
    assert read.state.names == load_machine(out).drives == ('arm',)
    np.testing.assert_allclose(read.state.position[:, 0], place, atol=1e-6)
    np.testing.assert_allclose(read.effort.effort[:, 0], effort)
    np.testing.assert_array_equal(np.diff(read.state.stamp), 10_000_000)


def test_a_rate_is_of_a_table_only_and_not_beside_its_map(tmp_path, capsys):
    log = tmp_path / 'log.csv'
    log.write_text('q,tau\n1,2\n2,3\n')
    words = ['new-machine', '--kind', 'linear_axis', '--rate', '100', '--bag']
    assert main([*words, str(tmp_path)]) == 2
    assert 'is of a table or of arrays, which' in capsys.readouterr().err
    assert main([*words, str(tmp_path / 'none.csv')]) == 2
    assert 'none.csv: does not exist; give' in capsys.readouterr().err
    (tmp_path / 'log.columns.yaml').write_text('')
    assert main([*words, str(log)]) == 2
    assert 'so that --column and --rate have no part in it' in capsys.readouterr().err


def test_a_column_of_words_takes_no_other_ones_place(tmp_path):
    rows = ''.join(f'2024-01-02T10:00:0{n},{n},1,OK\n' for n in range(9))
    (tmp_path / 'log.csv').write_text(f'stamp,time,position,state\n{rows}')
    assert header_of(tmp_path / 'log.csv').map()['time']['column'] == 'time'


ODD = (
    'arm: 1', 'true', 'j,1', '#x', 'no', '1e3', 'null', '[a]', "it's", '{x}', '*a', '肘', '$$',
    '"b"', 'a - b', '%a', 'Größe',
)  # fmt: skip


def test_odd_names_come_through_a_table_and_a_machine_file(tmp_path):
    times = 0.01 * np.arange(200)
    rows = np.stack([times, np.sin(times), 2.0 * np.cos(times)], axis=1).tolist()
    for number, name in enumerate(ODD):
        table, out = tmp_path / f'{number}.csv', tmp_path / f'{number}.yaml'
        with table.open('w', newline='', encoding='utf-8') as file:
            csv.writer(file).writerows([['time', f'{name}.position', f'{name}.tau'], *rows])
        words = ['new-machine', '--kind', 'linear_axis', '--bag', str(table), '--out', str(out)]
        assert main(words) == 0
        assert load_machine(out).drives == read_bag(table)[0].state.names == (name,)


def test_names_of_a_table_that_windows_wrote_are_found_again(tmp_path):
    table = tmp_path / 'log.csv'
    table.write_bytes('t,Größe_pos\n0,1\n0.01,2\n'.encode('latin-1'))
    table.with_suffix('.columns.yaml').write_text(yaml.safe_dump(header_of(table).map()))
    assert read_bag(table)[0].state.names == ('Größe',)


def test_a_table_of_one_joint_becomes_map_and_machine_file(tmp_path, capsys):
    time = 0.01 * np.arange(500)
    rows = np.stack([time, np.sin(time), 2.0 * np.cos(time)], axis=1)
    table, out = tmp_path / 'log.csv', tmp_path / 'my.yaml'
    np.savetxt(table, rows, delimiter=',', header='time,q,tau', comments='', fmt='%.6f')
    words = ['new-machine', '--kind', 'linear_axis', '--bag', str(table)]
    assert main([*words, '--out', str(out)]) == 0
    said = capsys.readouterr().err
    assert (
        '  q     joint_1.position, as it stands\n' in said and 'log.columns.yaml; correct' in said
    )
    assert len(out.read_text().splitlines()) == 9
    machine = load_machine(out)
    assert machine.number('cycle') == pytest.approx(0.01)
    assert machine.bounds['coulomb_friction'][1] == pytest.approx(2.0)
    np.testing.assert_allclose(read_bag(table)[0].state.position[:, 0], rows[:, 1], atol=1e-6)
    (tmp_path / 'log.columns.yaml').write_text('mine')
    assert main(words) == 2
    assert (tmp_path / 'log.columns.yaml').read_text() == 'mine'


@pytest.mark.parametrize('several', ['{} {}', ' {}  {} ', '[{} {}]', '"[{}, {}]"', '({} {})'])
def test_several_numbers_of_one_cell_are_columns_of_their_own(tmp_path, several):
    """As HEBI's logger and pandas write the joints of an arm."""
    log, out = tmp_path / 'log.csv', tmp_path / 'm.yaml'
    time = 0.01 * np.arange(400)
    rows = [['timestamp_us', 'positions', 'efforts', 'mode']]
    for t in time:
        pairs = (np.sin(t), np.cos(t)), (np.cos(t), -np.sin(t))
        rows.append([str(round(1e6 * t)), *(several.format(*map(float, x)) for x in pairs), 'run'])
    log.write_text('\n'.join(map(','.join, rows)))
    words = ['new-machine', '--kind', 'linear_axis', '--travel', 'm', '--bag', str(log)]
    assert main([*words, '--out', str(out)]) == 0
    read = read_bag(log)[0]
    assert read.state.names == ('joint_0', 'joint_1')
    assert read.state.duration == pytest.approx(3.99)
    np.testing.assert_allclose(read.state.position, np.stack([np.sin(time), np.cos(time)], 1))
    np.testing.assert_allclose(read.effort.effort, np.stack([np.cos(time), -np.sin(time)], 1))


@pytest.mark.parametrize('mark', ['\t', ' '])
def test_decimal_commas_are_no_cells_of_several_numbers(tmp_path, mark):
    log = tmp_path / 'log.txt'
    time = 0.01 * np.arange(400)
    lines = [mark.join(f'{x:.6f}' for x in (t, np.sin(t), np.cos(t))) for t in time]
    log.write_text('\n'.join([mark.join(['time', 'q', 'tau']), *lines]).replace('.', ','))
    assert [x.joint for x in header_of(log).columns] == ['', 'joint_1', 'joint_1']
