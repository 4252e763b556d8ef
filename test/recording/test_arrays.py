# SPDX-License-Identifier: Apache-2.0
"""Files of arrays: the same recordings to the bit as from a CSV file of the same numbers."""

import json
import struct

import numpy as np
import pytest
from reader_cases import equal
import scipy.io

from ros2_ident.cli.main import main
from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.recording import read_bag, Topics
from ros2_ident.recording.matlab import arrays_of
from ros2_ident.recording.table import array_sizes

h5py = pytest.importorskip('h5py', reason='h5py is not installed; `make setup` brings it')
pyarrow = pytest.importorskip('pyarrow', reason='pyarrow is not installed; `make setup` brings it')
from pyarrow import parquet  # noqa: E402

ROWS = 400
JOINTS = 'a, b'


def samples():
    """Return a time [s] since 1970, positions, velocities, efforts and set-points."""
    rng = np.random.default_rng(3)
    time = 1_700_000_000.0 + 0.004 * np.arange(ROWS)
    q = np.sin(3.0 * (time - time[0])[:, None] + [0.0, 1.0]) + rng.normal(size=(ROWS, 2)) * 1e-5
    tau = np.cos(3.0 * (time - time[0])[:, None]) + rng.normal(size=(ROWS, 2)) * 1e-2
    return {'time': time, 'q': q, 'dq': np.gradient(q, 0.004, axis=0), 'tau': tau, 'goal': q + 0.1}


def column_map(prefix='', time='{column: %stime, unit: s}', rest=''):
    fields = {'position': 'q', 'velocity': 'dq', 'effort': 'tau', 'command_position': 'goal'}
    lines = [f'    {x}: {json.dumps(prefix + y + "[0:2]")}' for x, y in fields.items()]
    at = time % prefix if '%s' in time else time
    return '\n'.join([f'time: {at}', rest, 'joints:', f'  {json.dumps(JOINTS)}:', *lines])


def write_csv(folder, values):
    names = ['time', *(f'{x}{n}' for x in ('q', 'dq', 'tau', 'goal') for n in (0, 1))]
    columns = [values['time'], *(y for x in ('q', 'dq', 'tau', 'goal') for y in values[x].T)]
    rows = [','.join(map(repr, map(float, row))) for row in zip(*columns, strict=True)]
    (folder / 'csv').mkdir()
    path = folder / 'csv' / 'log.csv'
    path.write_text('\n'.join([','.join(names), *rows]) + '\n')
    joints = {
        name: {
            'position': f'q{n}',
            'velocity': f'dq{n}',
            'effort': f'tau{n}',
            'command_position': f'goal{n}',
        }
        for n, name in enumerate('ab')
    }
    text = json.dumps({'time': {'column': 'time', 'unit': 's'}, 'joints': joints})
    (folder / 'csv' / 'log.columns.yaml').write_text(text)
    return path


def npz(path, values):
    np.savez_compressed(path, **values)
    return column_map()


def mat(path, values):
    scipy.io.savemat(path, {'log': {'run': values}})
    return column_map('log.run.')


def mat_packed(path, values):
    scipy.io.savemat(path, {'log': {'run': values}, 'said': 'x', 'z': 1j}, do_compression=True)
    return column_map('log.run.')


def mat_7_3(path, values):
    with h5py.File(path, 'w', userblock_size=512) as file:  # MATLAB's arrays are by column
        for name, x in values.items():
            file[f'log/{name}'] = x.T
    with path.open('r+b') as stream:
        stream.write(b'MATLAB 7.3 MAT-file, Platform: GLNXA64')
    return column_map('log.')


def hdf5(path, values):
    with h5py.File(path, 'w') as file:
        for name, x in values.items():
            file[f'observations/{name}'] = x
    return column_map('observations/')


def write_parquet(path, values):
    columns = {f'observation.{x}': y if y.ndim == 1 else list(y) for x, y in values.items()}
    parquet.write_table(pyarrow.table(columns), path)
    return column_map('observation.')


def json_lines(path, values):
    rows = [
        {'at': {x: y[k].tolist() for x, y in values.items()}, 'said': 'x'}
        for k in range(len(values['time']))
    ]
    path.write_text('\n'.join(map(json.dumps, rows)) + '\n')
    return column_map('at.')


FORMATS = {
    '.npz': npz,
    '.mat': mat,
    '.packed.mat': mat_packed,
    '.7.3.mat': mat_7_3,
    '.hdf5': hdf5,
    '.h5': hdf5,
    '.parquet': write_parquet,
    '.jsonl': json_lines,
}


@pytest.mark.parametrize('suffix', FORMATS)
def test_a_file_of_arrays_is_read_as_a_csv_file_is(tmp_path, suffix):
    values = samples()
    (expected,) = read_bag(write_csv(tmp_path, values))
    path = tmp_path / f'log{suffix}'
    path.with_name(f'{path.stem}.columns.yaml').write_text(FORMATS[suffix](path, values))
    (read,) = read_bag(path)
    assert equal([read], [expected])
    assert read.warnings == () and len(read.sha256) == 64


@pytest.mark.parametrize('suffix', FORMATS)
def test_a_map_is_written_by_the_names_of_arrays(tmp_path, capsys, suffix):
    values = samples()
    values['q_d'] = values.pop('goal')
    path, out = tmp_path / f'log{suffix}', tmp_path / 'm.yaml'
    short = {'short': np.zeros(7)} if suffix == '.npz' else {}
    FORMATS[suffix](path, values | {'temperature': values['tau'], **short})
    words = ['new-machine', '--kind', 'linear_axis', '--drives', 'joint_1', '--bag', str(path)]
    assert main([*words, '--out', str(out)]) == 0
    (read,) = read_bag(path)
    assert read.state.names == read.command.names == ('joint_0', 'joint_1')
    np.testing.assert_array_equal(read.state.position, values['q'])
    np.testing.assert_array_equal(read.state.velocity, values['dq'])
    np.testing.assert_array_equal(read.command.position, values['q_d'])
    np.testing.assert_array_equal(read.effort.effort, values['tau'])
    assert 'drives: [joint_1]' in out.read_text()
    said = capsys.readouterr().err
    assert 'temperature[0]' in said
    assert ('short           - (it has no row of numbers for each time)' in said) == bool(short)


def npy(path, values):
    np.save(path, np.column_stack([values['q'], values['tau']]))


def of_fields(path, values):
    rows = [(*q, *tau) for q, tau in zip(values['q'], values['tau'], strict=True)]
    np.save(path, np.array(rows, dtype=[(x, 'f8') for x in ('q0', 'q1', 'u0', 'u1')]))


@pytest.mark.parametrize(
    ('write', 'names'),
    [(npy, ('log[0]', 'log[1]', 'log[2]', 'log[3]')), (of_fields, ('q0', 'q1', 'u0', 'u1'))],
)
def test_an_array_without_a_name_is_told_by_options(tmp_path, write, names):
    values = samples()
    log = tmp_path / 'log.npy'
    write(log, values)
    places = ('a.position', 'b.position', 'a.effort', 'b.effort')
    told = [y for x in zip(names, places, strict=True) for y in ('--column', '='.join(x))]
    words = ['new-machine', '--kind', 'linear_axis', '--bag', str(log), '--rate', '250']
    assert main([*words, *told, '--out', str(tmp_path / 'm.yaml')]) == 0
    read = read_bag(log)[0]
    np.testing.assert_array_equal(read.state.position, values['q'])
    np.testing.assert_array_equal(read.effort.effort, values['tau'])


@pytest.mark.parametrize('suffix', ['.npy', '.mat', '.csv', '.txt'])
def test_a_folder_of_arrays_is_read_as_one_file_of_them(tmp_path, capsys, suffix):
    values, run = samples(), tmp_path / 'run'
    run.mkdir()
    for name, x in values.items():
        if suffix == '.npy':
            np.save(run / name, x)
        elif suffix != '.mat':
            np.savetxt(run / f'{name}{suffix}', x, '%.17g', ',' if suffix == '.csv' else ' ')
        else:
            scipy.io.savemat(run / f'{name}.mat', {'ans': x})
    (run / 'notes.txt').write_text('the second run')
    assert main(['check', str(run)]) == 2
    assert 'it holds dq, goal, q, tau, time' in capsys.readouterr().err
    words = ['new-machine', '--kind', 'linear_axis', '--bag', str(run)]
    assert main([*words, '--out', str(tmp_path / 'm.yaml')]) == 0
    whole = tmp_path / 'whole.npz'
    np.savez(whole, **values)
    (read,) = read_bag(run)
    assert equal(read_bag(whole, Topics(columns=str(tmp_path / 'run.columns.yaml'))), [read])
    np.testing.assert_array_equal(read.state.position, values['q'])
    # what changes in one of the files changes the log
    np.savez(run / 'more.npz', one=values['q'], two=values['tau'])
    assert read_bag(run)[0].sha256 != read.sha256
    (run / 'bag.mcap').write_bytes(b'')
    with pytest.raises(IdentError, match='is empty'):
        read_bag(run)


@pytest.mark.parametrize(
    ('first', 'second'),
    [
        ('t,pos_l,pos_r', 't,eff_l,eff_r'),  # one.csv and torque.csv, whose columns say it
        ('t,l,r', 't,l,r'),  # position.csv and torque.csv, which say it themselves
        ('l,r', 'l,r'),
    ],
)
def test_tables_that_share_a_logs_quantities_are_read_as_one(tmp_path, capsys, first, second):
    values, run = samples(), tmp_path / 'run'
    run.mkdir()
    timed = first.startswith('t')
    names = ('one.csv' if 'pos' in first else 'position.csv', first), ('torque.csv', second)

    def write(name, header, table, late=0.0):
        own = [values['time'] + late] * timed
        np.savetxt(run / name, np.column_stack([*own, table]), '%.17g', ',', header=header,
                   comments='')  # fmt: skip

    for (name, header), table in zip(names, (values['q'], values['tau']), strict=True):
        write(name, header, table)
    (run / 'README.txt').write_text('the second run')
    words = ['new-machine', '--kind', 'serial', '--bag', str(run)]
    words += [] if timed else ['--rate', '250']
    assert main([*words, '--out', str(tmp_path / 'm.yaml')]) == 0
    (read,) = read_bag(run)
    assert read.state.names == ('l', 'r')
    np.testing.assert_array_equal(read.state.position, values['q'])
    np.testing.assert_array_equal(read.effort.effort, values['tau'])
    if timed:
        write(*names[1], values['tau'], late=1e-3)
        with pytest.raises(IdentError, match='is another time than that of the other tables'):
            read_bag(run)
    # the same quantity twice is two logs
    write('torque.csv', names[0][1].replace('l,r', 'pos_l,pos_r'), values['q'])
    write(names[0][0], names[0][1].replace('l,r', 'pos_l,pos_r'), values['q'])
    with pytest.raises(IdentError, match='or one table'):
        read_bag(run)


def test_a_log_may_be_the_folder_in_which_one_is(tmp_path, monkeypatch):
    values, run = samples(), tmp_path / 'run'
    run.mkdir()
    for name in ('q', 'tau', 'time'):
        np.save(run / name, values[name])
    monkeypatch.chdir(run)
    words = ['new-machine', '--kind', 'serial', '--bag', '.', '--out', str(tmp_path / 'm.yaml')]
    assert main(words) == 0
    assert (tmp_path / 'run.columns.yaml').exists()
    assert equal(read_bag('.'), read_bag(run))


def test_arrays_with_a_row_for_each_quantity_are_to_be_turned_over(tmp_path, capsys):
    values = samples()
    rows = np.vstack([values['time'], values['q'].T])
    words = ['new-machine', '--kind', 'linear_axis', '--bag', str(tmp_path / 'log.mat')]
    scipy.io.savemat(tmp_path / 'log.mat', {'ans': rows})
    assert main(words) == 2
    said = f"holds 'ans' of {len(rows)} rows of {ROWS} numbers, as with a row for each quantity; "
    assert f'{said}turn it over' in capsys.readouterr().err
    # a scan beside joints is none
    np.savez(tmp_path / 'log.npz', scan=np.zeros((ROWS, 2 * ROWS)), **values)
    words[-1] = str(tmp_path / 'log.npz')
    assert main([*words, '--out', str(tmp_path / 'm.yaml')]) == 0


def test_arrays_without_a_time_are_refused_with_the_remedy(tmp_path, capsys):
    np.savez(tmp_path / 'log.npz', data=np.zeros((ROWS, 7)), gain=2.0)
    words = ['new-machine', '--kind', 'linear_axis', '--bag', str(tmp_path / 'log.npz')]
    assert main(words) == 2
    assert 'named as a time, or as a position, velocity or effort: data[0], d' in (
        capsys.readouterr().err
    )
    told = ['--rate', '50', '--column', 'data[1]=arm.position', '--column', 'data[6]=arm.effort']
    main([*words, *told])
    stamp = read_bag(tmp_path / 'log.npz')[0].state.stamp
    np.testing.assert_array_equal(np.diff(stamp), 20_000_000)


@pytest.mark.parametrize('packed', [False, True])
def test_matlab_arrays_are_those_that_scipy_reads(tmp_path, packed):
    rng = np.random.default_rng(1)
    held = {
        kind: rng.integers(0, 100, (4, 3)).astype(kind)
        for kind in ('float64', 'float32', 'int8', 'uint8', 'int16', 'int32', 'uint64', 'bool')
    }
    held |= {'one': np.float64(3.5), 'long_name_of_a_variable': np.arange(5.0)}
    path = tmp_path / 'log.mat'
    scipy.io.savemat(path, {**held, 'cell': np.array([[1, 'x']], object)}, do_compression=packed)
    found = dict(arrays_of(path.read_bytes()))
    expected = scipy.io.loadmat(path)
    assert found.keys() == held.keys()
    for name, values in found.items():
        np.testing.assert_array_equal(values, expected[name])


def test_episodes_in_groups_are_recordings_and_a_rate_is_a_time(tmp_path):
    values = samples()
    with h5py.File(tmp_path / 'log.hdf5', 'w') as file:
        for n in (2, 10, 1):
            for name in ('q', 'dq', 'tau', 'goal'):
                file[f'data/demo_{n}/{name}'] = n * values[name]
    text = column_map('data/*/', '{rate: 250}')
    (tmp_path / 'log.columns.yaml').write_text(text)
    found = read_bag(tmp_path / 'log.hdf5')
    assert [x.source.rpartition('/')[2] for x in found] == ['demo_1', 'demo_2', 'demo_10']
    np.testing.assert_array_equal(found[2].state.position, 10.0 * values['q'])
    assert (np.diff(found[0].state.stamp) == 4_000_000).all()


@pytest.mark.parametrize('wanted', [1, 'true'])
def test_rows_are_chosen_by_what_stands_there(tmp_path, wanted):
    values, mode = samples(), np.arange(ROWS) // 100
    np.savez(tmp_path / 'log.npz', **values, mode=mode if wanted == 1 else mode == 1)
    (tmp_path / 'log.columns.yaml').write_text(column_map(rest=f'where: {{mode: {wanted}}}'))
    (read,) = read_bag(tmp_path / 'log.npz')
    np.testing.assert_array_equal(read.state.position, values['q'][100:200])


@pytest.mark.parametrize(
    ('code', 'said', 'text'),
    [
        (
            'INVALID_GOAL',
            'needs the column map .*or by `ident new-machine --kind .*; it holds time, q, dq',
            None,
        ),
        ('MISSING_STREAM', "has no array 'x', its arrays are time, q, dq, tau", 'a: {effort: x}'),
        ('BAD_VALUES', r'q is 2 columns for 1 joints; write as NAME\[0\]', 'a: {position: q}'),
        ('BAD_VALUES', "'q' has 2 columns; correct q", "a: {position: 'q[2]'}"),
        ('BAD_VALUES', "'cube' holds float64 of 3 axes", 'a: {position: cube}'),
        ('BAD_VALUES', "'text' holds str.* of 1 axes", 'a: {position: text}'),
        ('BAD_VALUES', 'short has 7 rows, the time 400', 'a: {position: short}'),
        ('NO_DATA', 'with what `where` asks for', "a: {position: 'q[0]'}\nwhere: {time: run}"),
        ('INVALID_GOAL', 'write the name of an array', 'a: {position: 3}'),
        ('INVALID_GOAL', "the map has 'skip'; choose from time, joints, where", 'a: {}\nskip: 3'),
    ],
)
def test_a_map_that_does_not_fit_says_what_is_there(tmp_path, code, said, text):
    others = {'cube': np.zeros((2, 3, 4)), 'short': np.zeros(7), 'text': np.array(['x'])}
    np.savez(tmp_path / 'log.npz', **samples(), **others)
    if text is not None:
        body = f'time: {{column: time, unit: s}}\njoints:\n  {text}\n'
        (tmp_path / 'log.columns.yaml').write_text(body)
    with pytest.raises(IdentError, match=said) as caught:
        read_bag(tmp_path / 'log.npz')
    assert caught.value.code == ErrorCode[code]


@pytest.mark.parametrize('suffix', FORMATS)
def test_a_file_cut_off_is_refused_in_a_sentence(tmp_path, suffix):
    path = tmp_path / f'log{suffix}'
    path.with_name(f'{path.stem}.columns.yaml').write_text(FORMATS[suffix](path, samples()))
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    if suffix == '.jsonl':
        (read,) = read_bag(path)
        assert 'breaks off and is left out' in read.warnings[0]
        return
    with pytest.raises(IdentError) as caught:
        read_bag(path)
    assert caught.value.code in (ErrorCode.DAMAGED_BAG, ErrorCode.MISSING_STREAM)


def test_data_in_other_files_are_none_of_this_one(tmp_path):
    with h5py.File(tmp_path / 'other.hdf5', 'w') as file:
        file['q'] = np.zeros(3)
    with h5py.File(tmp_path / 'log.hdf5', 'w') as file:
        file['q'] = h5py.ExternalLink('other.hdf5', '/q')
        file['time'] = np.zeros(3)
    (tmp_path / 'map.yaml').write_text(
        'time: {column: time, unit: s}\njoints: {a: {position: q}}\n'
    )
    with pytest.raises(IdentError, match="has no array 'q', its arrays are time"):
        read_bag(tmp_path / 'log.hdf5', Topics(columns=str(tmp_path / 'map.yaml')))


NAMED = [
    {'Name': 'q_ref', 'Unit': ''},
    {'Name': 'q_act', 'Unit': ''},
    {'Name': 'torque', 'Unit': ''},
]
# as recorders and scopes write them: a first text that is the same, one that is empty, none
TOLD = {
    'named': ([{'Kind': 'out', **x} for x in NAMED], '.q_ref .q_act .torque'),
    'labelled': ([{'label': x['Name'], 'n': 1.0} for x in NAMED], '.q_ref .q_act .torque'),
    'alike': ([{'label': 'q'}] * 3, '[0] [1] [2]'),
    'untold': ([{'label': ''}, {'label': 'a'}, {'label': 'b'}], '[0] [1] [2]'),
    'numbers': ([{'empty': np.zeros((1, 0))}] * 3, '[0] [1] [2]'),
}


@pytest.mark.parametrize('told', TOLD)
def test_several_structures_of_matlab_are_called_by_what_tells_them_apart(tmp_path, told):
    texts, called = TOLD[told]
    wave = np.sin(0.1 * np.arange(ROWS))
    rows = [{**x, 'Data': k * wave[None]} for k, x in enumerate(texts, 1)]
    several = np.empty((1, 3), dtype=[(name, object) for name in rows[0]])
    for k, row in enumerate(rows):
        several[0, k] = tuple(row.values())
    time = {'Data': 0.02 * np.arange(ROWS)[None]}
    scipy.io.savemat(tmp_path / 'log.mat', {'rec': {'X': time, 'Y': several}}, do_compression=True)
    names = [f'rec.Y{x}.Data' for x in called.split()]
    held = dict(arrays_of((tmp_path / 'log.mat').read_bytes()))
    assert [x for x in held if x.endswith('.Data')] == ['rec.X.Data', *names]
    (tmp_path / 'log.columns.yaml').write_text(
        'time: {column: rec.X.Data, unit: s}\njoints:\n  a:\n'
        f"    command_position: '{names[0]}'\n    position: '{names[1]}'\n"
        f"    effort: '{names[2]}'\n"
    )
    (log,) = read_bag(tmp_path / 'log.mat')
    assert np.array_equal(log.state.position[:, 0], 2.0 * wave)
    assert np.array_equal(log.effort.effort[:, 0], 3.0 * wave)


@pytest.mark.parametrize('told', TOLD)
def test_structures_of_matlab_7_3_are_called_as_those_of_level_5(tmp_path, told):
    texts, called = TOLD[told]
    wave = np.sin(0.1 * np.arange(ROWS))
    with h5py.File(tmp_path / 'log.mat', 'w', userblock_size=512) as file:
        fields = {x: [] for x in (*texts[0], 'Data')}
        for k, row in enumerate(texts, 1):
            for name, value in {**row, 'Data': k * wave}.items():
                at = f'#refs#/{name}{k}'
                if isinstance(value, str):
                    codes = np.array([*map(ord, value)], dtype='u2')[:, None]
                    file[at] = codes
                    file[at].attrs['MATLAB_class'] = np.bytes_('char')
                else:
                    file[at] = np.reshape(value, (-1, 1)).astype(float)
                fields[name].append(file[at].ref)
        for name, links in fields.items():
            file.create_dataset(f'rec/Y/{name}', data=np.array(links, dtype=h5py.ref_dtype))
        file['rec/X/Data'] = 0.02 * np.arange(ROWS)[:, None]
        cell = file.create_dataset('c', data=np.array(fields['Data'][:2], dtype=h5py.ref_dtype))
        cell.attrs['MATLAB_class'] = np.bytes_('cell')
    with (tmp_path / 'log.mat').open('r+b') as stream:
        stream.write(b'MATLAB 7.3 MAT-file, Platform: GLNXA64')
    names = [f'rec.Y{x}.Data' for x in called.split()]
    sizes = array_sizes(tmp_path / 'log.mat')
    assert {x for x in sizes if x.endswith('.Data')} == {'rec.X.Data', *names}
    assert {x for x in sizes if '.' not in x} == {'c[0]', 'c[1]'}
    (tmp_path / 'log.columns.yaml').write_text(
        'time: {column: rec.X.Data, unit: s}\njoints:\n  a:\n'
        f"    position: '{names[1]}'\n    effort: '{names[2]}'\n"
    )
    (log,) = read_bag(tmp_path / 'log.mat')
    assert np.array_equal(log.state.position[:, 0], 2.0 * wave)
    assert np.array_equal(log.effort.effort[:, 0], 3.0 * wave)


def _packed(kind, payload):
    """Return a data element of a MATLAB file."""
    return struct.pack('<II', kind, len(payload)) + payload + bytes(-len(payload) % 8)


@pytest.mark.parametrize('beside', [False, True])
def test_objects_of_matlab_are_named_and_what_else_to_save(tmp_path, capsys, beside):
    path = tmp_path / 'log.mat'
    wave = np.sin(0.1 * np.arange(ROWS))
    values = {'time': 0.02 * np.arange(ROWS), 'arm_pos': wave, 'arm_tau': np.gradient(wave)}
    scipy.io.savemat(path, values if beside else {'Ts': 0.02})
    # as MATLAB writes a timeseries, and what objects hold behind all else, without a name
    flags, name = _packed(6, struct.pack('<II', 17, 0)), _packed(1, b'p1')
    held = np.zeros(3, np.uint8).tobytes()
    unnamed = _packed(6, struct.pack('<II', 9, 0)) + _packed(5, struct.pack('<ii', 1, 3))
    unnamed += _packed(1, b'') + _packed(2, held)
    texts = _packed(1, b'MCOS') + _packed(1, b'timeseries')
    with path.open('ab') as file:
        file.write(_packed(14, flags + name + texts) + _packed(14, unnamed))
    words = ['new-machine', '--kind', 'linear_axis', '--bag', str(path)]
    assert main([*words, '--out', str(tmp_path / 'm.yaml')]) == (0 if beside else 2)
    said = capsys.readouterr().err
    none = 'holds no array with a row of numbers for each time, but Ts, p1; save such: of a '
    assert ('p1       - (it has no row' in said) if beside else (f'{none}timeseries' in said)
