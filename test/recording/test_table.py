# SPDX-License-Identifier: Apache-2.0
"""Tables with a column map: the same streams as from a bag, and sentences for what is wrong."""

from dataclasses import replace
import re

from identify_cases import ROOT
import numpy as np
import pytest
import yaml

from ros2_ident.cli.main import main
from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.models import load_machine
from ros2_ident.recording import read_bag, Stream, Topics
from ros2_ident.recording.columns import load_columns

NAMES = ('drive_1', 'drive_2')
START = 1_700_000_000_123_456_789
COUNT = 40_000
QUANTITIES = {
    'position': 'q',
    'velocity': 'v',
    'effort': 'tau',
    'command_position': 'q_ref',
    'command_velocity': 'v_ref',
}
DIGITS = {'s': 9, 'ms': 6, 'us': 3, 'ns': 0}


@pytest.fixture(scope='module')
def samples():
    """Return what a table of 40 000 rows holds; the effort at every fourth row."""
    rng = np.random.default_rng(0)
    stamp = START + np.arange(COUNT) * 1_000_000 + rng.integers(-9999, 9999, COUNT)
    values = {key: rng.normal(size=(COUNT, 2)) for key in QUANTITIES}
    values['effort'][np.arange(COUNT) % 4 != 0] = np.nan
    values['position'][7, 1] = np.nan
    return stamp, values


def time_text(stamp, unit):
    digits = DIGITS[unit]
    text = str(stamp)
    return text if not digits else f'{text[:-digits]}.{text[-digits:]}'


def write_table(path, samples, unit='s', rows=COUNT, delimiter=',', decimal='.', before=''):
    stamp, values = samples
    header = ['time', *(f'{short}{d + 1}' for short in QUANTITIES.values() for d in range(2))]
    lines = [delimiter.join(header)]
    for k in range(rows):
        row = [time_text(stamp[k], unit)]
        for key in QUANTITIES:
            row += ['' if np.isnan(x) else repr(float(x)) for x in values[key][k]]
        lines.append(delimiter.join(x.replace('.', decimal) for x in row))
    path.write_text(before + '\n'.join(lines) + '\n')
    return path


def column_map(**changes):
    joints = {
        name: {key: f'{short}{d + 1}' for key, short in QUANTITIES.items()}
        for d, name in enumerate(NAMES)
    }
    return {'time': {'column': 'time', 'unit': 's'}, 'joints': joints} | changes


def write_map(path, **changes):
    path.write_text(yaml.safe_dump(column_map(**changes)))
    return str(path)


def expected(samples, rows=COUNT):
    stamp, values = samples[0][:rows], {k: v[:rows] for k, v in samples[1].items()}
    told = np.arange(rows) % 4 == 0
    return (
        Stream(NAMES, stamp, values['position'], values['velocity']),
        Stream(NAMES, stamp[told], effort=values['effort'][told]),
        Stream(NAMES, stamp, values['command_position'], values['command_velocity']),
    )


@pytest.mark.parametrize('unit', DIGITS)
def test_a_table_gives_the_streams_bit_for_bit(samples, tmp_path, unit):
    rows = 20_000 if unit == 's' else 50
    path = write_table(tmp_path / 'log.csv', samples, unit, rows)
    write_map(tmp_path / 'log.columns.yaml', time={'column': 'time', 'unit': unit})
    (read,) = read_bag(path)
    assert (read.state, read.effort, read.command) == expected(samples, rows)
    assert read.source == str(path)
    assert len(read.sha256) == 64
    assert read.warnings == ()


def test_semicolons_decimal_commas_and_lines_before_the_names(samples, tmp_path):
    path = write_table(
        tmp_path / 'log.csv', samples, rows=30, delimiter=';', decimal=',', before='Scope;1\n\n'
    )
    where = write_map(tmp_path / 'map.yaml', delimiter=';', decimal=',', skip=2)
    (read,) = read_bag(path, Topics(columns=where))
    assert (read.state, read.effort, read.command) == expected(samples, 30)


def test_columns_by_number_with_scale_and_without_names(tmp_path):
    (tmp_path / 'log.csv').write_text('0,1.5,7,-2\n0.001,2.5,7,4\n\n')
    where = write_map(
        tmp_path / 'map.yaml',
        header=False,
        time={'column': 1, 'unit': 's'},
        joints={'a': {'position': {'column': 2, 'scale': 0.001}, 'effort': 4}},
    )
    (read,) = read_bag(tmp_path / 'log.csv', Topics(columns=where))
    np.testing.assert_array_equal(read.state.position[:, 0], [0.0015, 0.0025])
    np.testing.assert_array_equal(read.effort.effort[:, 0], [-2.0, 4.0])
    np.testing.assert_array_equal(read.state.stamp, [0, 1_000_000])


def test_a_step_back_begins_a_recording_and_a_cut_line_is_left_out(samples, tmp_path):
    path = write_table(tmp_path / 'log.csv', samples, rows=50)
    lines = path.read_text().splitlines()
    path.write_text('\n'.join([*lines, *lines[1:], lines[1][:40]]))
    where = write_map(tmp_path / 'map.yaml')
    one, two = read_bag(path, Topics(columns=where))
    assert (one.state, two.state) == (expected(samples, 50)[0],) * 2
    assert 'its last line 102 breaks off and is left out' in one.warnings[0]


def fails(tmp_path, code, text, table='time,q1\n0,1\n0.001,2\n', **changes):
    (tmp_path / 'log.csv').write_text(table)
    given = {'joints': {'a': {'position': 'q1'}}} | changes
    where = write_map(tmp_path / 'map.yaml', **given)
    with pytest.raises(IdentError, match=text) as caught:
        read_bag(tmp_path / 'log.csv', Topics(columns=where))
    assert caught.value.code == code
    assert '\n' not in caught.value.message


@pytest.mark.parametrize(
    ('text', 'changes'),
    [
        ("time is 'time'; write {column: NAME, unit: s}", {'time': 'time'}),
        ('the unit s, ms, us or ns', {'time': {'column': 'time', 'unit': 'min'}}),
        (
            "a has 'torque'; choose from position, velocity, effort",
            {'joints': {'a': {'torque': 1}}},
        ),
        ("the map has 'sep'; choose from time, joints", {'sep': ';'}),
        ("decimal is ','; write", {'decimal': ',', 'delimiter': ','}),
        ('delimiter is 5; write one character', {'delimiter': 5}),
        ('skip is -1; write the number of lines', {'skip': -1}),
        ('joints is empty', {'joints': {}}),
        ('a has no column', {'joints': {'a': {}}}),
        ('header is 0; write true or false', {'header': 0}),
        ('names the column 0; write the name or the number', {'joints': {'a': {'effort': 0}}}),
        (
            "names the column 'time'; write the number",
            {'header': False},
        ),
        (
            'scale is 0; write a number other than 0',
            {'joints': {'a': {'effort': {'column': 'q1', 'scale': 0}}}},
        ),
    ],
)
def test_maps_that_make_no_sense(tmp_path, text, changes):
    fails(tmp_path, ErrorCode.INVALID_GOAL, re.escape(text), **changes)


@pytest.mark.parametrize(
    ('code', 'text', 'table'),
    [
        (
            ErrorCode.MISSING_STREAM,
            "no column 'q1', its columns are time, x; cor",
            'time,x\n0,1\n',
        ),
        (ErrorCode.BAD_VALUES, "line 3, column q1: 'abc' is no number", 'time,q1\n0,1\n1,abc\n'),
        (ErrorCode.BAD_VALUES, "line 2: the time '12:30' is no number", 'time,q1\n12:30,1\n'),
        (ErrorCode.BAD_VALUES, "two columns are called 'q1'", 'time,q1,q1\n0,1,2\n'),
        (
            ErrorCode.BAD_VALUES,
            'line 3 has 1 cells, the column map needs 2',
            'time,q1\n0,1\n1\n2,3\n',
        ),
        (
            ErrorCode.BAD_VALUES,
            'the rows are 1000 s apart; correct the unit',
            'time,q1\n0,1\n1000,2\n',
        ),
        (
            ErrorCode.BAD_VALUES,
            '2 of 4 rows have the time of the row before',
            'time,q1\n0,1\n0,2\n1,3\n1,3\n',
        ),
        (ErrorCode.NO_DATA, 'holds no row of values; record again', 'time,q1\n'),
        (ErrorCode.NO_DATA, 'no measured value arrived', 'time,q1\n0,\n0.001,\n'),
    ],
)
def test_tables_that_make_no_sense(tmp_path, code, text, table):
    fails(tmp_path, code, re.escape(text), table)


def test_the_map_in_the_documentation_is_one(tmp_path):
    page = (ROOT / 'docs/logs.md').read_text()
    (tmp_path / 'map.yaml').write_text(page.split('```yaml')[1].split('```')[0])
    found = load_columns(tmp_path / 'map.yaml')
    assert (found.time, found.digits, len(found.columns)) == ('time', 6, 10)
    assert (found.delimiter, found.decimal, found.skip, found.header) == (',', '.', 0, True)
    cells = {(x.joint, x.quantity): (x.cell, x.scale) for x in found.columns}
    assert cells['drive_1', 'effort'] == ('Current1', -1.0)
    assert cells['drive_1', 'command_position'] == ('SetPos1', 0.001)
    assert cells['drive_1', 'command_velocity'] == (9, 1.0)


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


def test_units_of_the_effort():
    machine = load_machine('config/tripod.yaml')
    assert machine.with_effort_unit('A', 0.25).effort_scale == 0.25
    assert machine.with_effort_unit('percent', None, 6.0).effort_scale == pytest.approx(0.06)
    assert machine.with_effort_unit('percent', None, 6.0).model_unit == 'N m'
    linear = replace(load_machine('config/emps.yaml'), effort_unit='A')
    assert linear.model_unit == 'N'
    with pytest.raises(IdentError, match='needs torque_constant .* or give --torque-constant'):
        machine.with_effort_unit('A')


def bag_as_table(bag, path, effort=1.0):
    """Write a bundled bag as a table of the merged times of its streams."""
    (recording,) = read_bag(bag)
    stamps = np.unique(np.concatenate([x.stamp for x in recording.streams.values()]))
    columns, joints = {'t': stamps}, {}
    for role, short in (('state', ''), ('effort', ''), ('command', 'command_')):
        stream = recording.streams.get(role)
        for field in ('position', 'velocity', 'effort'):
            values = None if stream is None else stream.values(field)
            if values is None:
                continue
            for d, name in enumerate(stream.names):
                cells = np.full(stamps.size, np.nan)
                cells[np.searchsorted(stamps, stream.stamp)] = values[:, d] * (
                    effort if field == 'effort' else 1.0
                )
                columns[f'{short}{field}_{name}'] = cells
                joints.setdefault(name, {})[short + field] = f'{short}{field}_{name}'
    rows = zip(*columns.values(), strict=True)
    text = [','.join(columns)]
    text += [
        ','.join([str(stamp), *('' if np.isnan(x) else repr(float(x)) for x in row)])
        for stamp, *row in rows
    ]
    path.write_text('\n'.join(text))
    write_map(path.with_name('map.yaml'), time={'column': 't', 'unit': 'ns'}, joints=joints)


def test_the_commands_take_a_table_like_a_bag(tmp_path, capsys):
    bag_as_table('bags/axis_reversals', tmp_path / 'log.csv', effort=0.5)
    words = ['--machine', 'config/emps.yaml', '--columns', str(tmp_path / 'map.yaml')]
    assert main(['check', str(tmp_path / 'log.csv'), *words]) == 0
    assert 'it has the sign of the motion' in capsys.readouterr().out
    search = ['--generations', '2', '--population', '64', '--no-overlay', '--quiet']
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
