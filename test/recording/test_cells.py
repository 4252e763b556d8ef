# SPDX-License-Identifier: Apache-2.0
"""Cells of a table: times to the nanosecond, numbers, lines, each rule at its edge."""


import numpy as np
import pytest
from reader_cases import make_recording

from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.recording import Recording, Stream, table
from ros2_ident.recording.columns import Column, load_columns
from ros2_ident.recording.limits import Limits
from ros2_ident.recording.table import read_table
from ros2_ident.recording.table_write import write_table


def map_of(tmp_path, text):
    path = tmp_path / 'map.yaml'
    path.write_text(text)
    return path


def read(tmp_path, text, more='', joints='  a: {position: q}\n', **limits):
    (tmp_path / 'log.csv').write_bytes(text if isinstance(text, bytes) else text.encode())
    where = map_of(tmp_path, f'time: {{column: t, unit: s}}\njoints:\n{joints}{more}')
    return read_table(tmp_path / 'log.csv', where, Limits(**limits))


def test_columns_are_added_rows_chosen_and_lines_of_units_left_out(tmp_path):
    text = 't,q,joint,m,g\ns,rad,-,A,A\n0,1,2,3,5\n0.1,7,1.0,0,0\n0.2,2,2.0,1,\n0.3,4,2,4,1\n'
    joints = '  a: {position: q, effort: [m, {column: g, scale: -2}]}\n'
    (log,) = read(tmp_path, text, 'where: {joint: 2}\nskip_below: 1\n', joints)
    assert log.state.position[:, 0].tolist() == [1.0, 2.0, 4.0]
    assert log.effort.effort[:, 0].tolist() == [-7.0, 2.0]  # of two columns, both were measured
    with pytest.raises(IdentError, match='leave lines of units .* by `skip_below'):
        read(tmp_path, text, '', joints)
    with pytest.raises(IdentError, match='no row of values with what `where` asks for'):
        read(tmp_path, text, 'where: {joint: 3}\nskip_below: 1\n', joints)


@pytest.mark.parametrize('motion', ['velocity', 'position'])
def test_an_effort_takes_the_sign_of_the_velocity_and_keeps_it_at_rest(tmp_path, motion):
    time = 0.01 * np.arange(600)
    rate = np.where((time > 3.0) & (time < 4.0), 0.0, np.sin(2.0 * np.pi * 0.5 * time + 0.3))
    values = rate if motion == 'velocity' else 0.01 * np.cumsum(rate)
    body = ''.join(f'{t:.2f},{x},2\n' for t, x in zip(time, values, strict=True))
    joints = f'  a: {{{motion}: q, effort: {{column: i, scale: 0.5, sign: velocity}}}}\n'
    (log,) = read(tmp_path, 't,q,i\n' + body, '', joints)
    effort = log.effort.effort[:, 0]
    moves = np.abs(rate) > 0.2
    np.testing.assert_array_equal(effort[moves], np.sign(rate[moves]))
    assert (np.abs(effort) == 1.0).all()


def rows(count, step=0.01, head='t,q\n'):
    return head + ''.join(f'{step * k:.9f},{k}\n' for k in range(count))


def test_lines_are_counted_from_the_first_of_the_file(tmp_path):
    good = rows(5)
    with pytest.raises(IdentError, match="line 10, column q: 'x' is no number"):
        read(tmp_path, 'one\ntwo\n' + good + '\n0.05,x\n', 'skip: 2\n')
    with pytest.raises(IdentError, match='line 8 has 1 cells, the column map needs 2'):
        read(tmp_path, 'one\n' + good + '0.05\n0.06,6\n', 'skip: 1\n')
    with pytest.raises(IdentError, match='line 7 has a quotation mark that is not closed there'):
        read(tmp_path, good + '0.05,"6\n0.06,7"\n')
    (found,) = read(tmp_path, 'one\n' + good + '\n , \n0.05', 'skip: 1\n')
    (said,) = found.warnings
    assert said.endswith('log.csv: its last line 10 breaks off and is left out')
    assert found.state.position[:, 0].tolist() == [0.0, 1.0, 2.0, 3.0, 4.0]
    with pytest.raises(IdentError, match="has no column 't', its columns are ; correct"):
        read(tmp_path, 'one\n', 'skip: 3\n')


@pytest.mark.parametrize('block', [1, 2, 3, 5, 7])
def test_blocks_of_rows_leave_no_seam(tmp_path, monkeypatch, block):
    monkeypatch.setattr(table, '_BLOCK', block)
    (found,) = read(tmp_path, rows(6) + '0.06')
    assert found.state.position[:, 0].tolist() == [0.0, 1.0, 2.0, 3.0, 4.0, 5.0]
    assert 'last line 8 breaks off' in found.warnings[0]


def test_streams_of_different_rates_stand_in_one_table(tmp_path):
    joints = '  a: {position: 2, effort: {column: 3, scale: 2.0}}\n  b: {effort: 4}\n'
    text = 't,q,e,f\n0.00,1,,\n0.01,2,5,6\n0.02,,,\n0.03,3,7,\n'
    (found,) = read(tmp_path, text, joints=joints)
    assert found.state.names == ('a',) and found.effort.names == ('a', 'b')
    assert found.state.stamp.tolist() == [0, 10_000_000, 30_000_000]
    assert found.effort.stamp.tolist() == [10_000_000, 30_000_000]
    np.testing.assert_array_equal(found.effort.effort, [[10.0, 6.0], [14.0, np.nan]])
    assert found.command is None


def test_a_table_is_read_in_any_of_its_codes(tmp_path):
    (found,) = read(tmp_path, b'\xef\xbb\xbft,q\n0,1\n0.01,2\n')
    assert found.state.stamp.size == 2
    (found,) = read(tmp_path, 't,q,Kraft µ\n0,1,2\n0.01,2,3\n'.encode('latin-1'))
    assert found.state.stamp.size == 2
    text = rows(20)
    needed = 8 * len(text)
    assert read(tmp_path, text, memory=needed)
    with pytest.raises(IdentError, match='the table takes') as caught:
        read(tmp_path, text, memory=needed - 1)
    assert caught.value.code is ErrorCode.BAD_VALUES


@pytest.mark.parametrize(
    ('text', 'said'),
    [
        ('1.5', 'names the column 1.5'),
        ('true', 'names the column True'),
        ('0', 'names the column 0'),
        ('65537', 'names the column 65537'),
        ("''", "names the column ''"),
        ('{column: q, scale: .nan}', 'scale is nan'),
        ('{column: q, scale: x}', "scale is 'x'"),
        ('{column: q, scale: .inf}', 'scale is inf'),
        ('{column: q, unit: m}', "has 'unit'; choose from column, scale"),
        ('{scale: 2.0}', 'names the column None'),
    ],
)
def test_columns_that_are_none(tmp_path, text, said):
    where = map_of(tmp_path, f'time: {{column: t, unit: s}}\njoints:\n  a: {{position: {text}}}\n')
    with pytest.raises(IdentError) as caught:
        load_columns(where)
    assert said in caught.value.message and caught.value.code is ErrorCode.INVALID_GOAL


def test_columns_that_are_some(tmp_path):
    where = map_of(
        tmp_path,
        'time: {column: 1, unit: ms}\nskip: 3\nheader: true\ndelimiter: "\\t"\ndecimal: ","\n'
        'joints:\n  1: {position: 65536}\n  a: {effort: {column: " e ", scale: "2"}}\n',
    )
    found = load_columns(where)
    assert (found.time, found.digits, found.skip, found.header) == (1, 6, 3, True)
    assert (found.delimiter, found.decimal) == ('\t', ',')
    assert found.columns == (Column('1', 'position', 65536), Column('a', 'effort', 'e', 2.0))
    for text, said in (
        ('skip: true', 'skip is True'),
        ('delimiter: "ab"', "delimiter is 'ab'"),
        ('delimiter: "\\n"', 'delimiter is'),
        ('decimal: ";"', "decimal is ';'"),
    ):
        kept = 'time: {column: 1, unit: ms}\njoints:\n  a: {position: 2}\n'
        with pytest.raises(IdentError, match=said):
            load_columns(map_of(tmp_path, kept + text + '\n'))
    with pytest.raises(IdentError, match='names a joint twice'):
        load_columns(map_of(tmp_path, 'time: {column: 1, unit: s}\njoints:\n  1: {position: 2}\n'
                                      '  "1": {position: 3}\n'))  # fmt: skip


def test_what_is_written_as_a_table_comes_back(tmp_path):
    first = make_recording(30)
    slow = first.state.stamp[::3] + 7
    second = Recording(
        Stream(
            ('drive_1',), slow, first.state.position[::3, :1], None, first.effort.effort[::3, :1]
        )
    )
    log, where = write_table(tmp_path / 'new' / 'log.csv', [first, second])
    assert (log, where) == (tmp_path / 'new/log.csv', tmp_path / 'new/log.columns.yaml')
    lines = log.read_text().splitlines()
    assert lines[0].split(',')[:3] == ['time', 'drive_1.position', 'drive_2.position']
    assert len(lines) == 1 + 30 + 10
    assert lines[1].startswith('1700000000.000000000,')
    one, two = read_table(log)
    assert (one.state, one.effort, one.command) == (first.state, first.effort, first.command)
    assert two.state.stamp.tolist() == slow.tolist()
    np.testing.assert_array_equal(two.state.position[:, 0], second.state.position[:, 0])
    # Efforts of the joint states come back as efforts.
    np.testing.assert_array_equal(two.effort.effort[:, 0], second.state.effort[:, 0])
