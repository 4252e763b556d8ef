# SPDX-License-Identifier: Apache-2.0
import json
import os
import signal
import subprocess
import time

from forked import forked
from identify_cases import axis_bag, AXIS_FILE, ROOT
import numpy as np
import pytest
from ros2_control_bags import as_ros2_control_records, Maker

from ros2_ident.cli.main import main
from ros2_ident.recording import read_bag, Recording, Stream, write_bag
from ros2_ident.recording.streams import FIELDS

SMALL = ['--population', '64', '--survivors', '4', '--generations', '4']
SLOW = ['--population', '1000000', '--generations', '2']


@pytest.fixture(scope='module')
def bag(tmp_path_factory):
    return write_bag(tmp_path_factory.mktemp('bags') / 'axis', axis_bag().streams)


@pytest.fixture
def command(bag, tmp_path):
    return ['identify', str(bag), '--machine', str(AXIS_FILE), '--out', str(tmp_path / 'out')]


def spawn(words):
    return subprocess.Popen(
        [*forked(), '-m', 'ros2_ident.cli.main', *words],
        env={**os.environ, 'PYTHONPATH': str(ROOT)},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def refused(words, capsys):
    """Return the one line on standard error of a command that has to end with 2."""
    assert main(words) == 2
    said = capsys.readouterr()
    assert said.out == ''
    lines = said.err.strip().splitlines()
    assert len(lines) == 1, said.err
    assert 'Traceback' not in said.err
    return lines[0]


def resampled(stream, field, stamp):
    """Return a field at other stamps, None where it is not there."""
    values = stream.values(field)
    if values is None:
        return None
    return np.stack([np.interp(stamp, stream.stamp, column) for column in values.T], axis=1)


def test_a_bag_of_ros2_control_is_identified_without_options(command, bag, tmp_path, capsys):
    (recording,) = read_bag(bag)
    # controllers and broadcasters run in one cycle and stamp by its time
    stamp = recording.state.stamp
    recording = Recording(
        **{
            role: Stream(x.names, stamp, *(resampled(x, y, stamp) for y in FIELDS))
            for role, x in recording.streams.items()
        }
    )
    maker = Maker()
    twin = maker.write(tmp_path / 'ros2_control', as_ros2_control_records(maker, recording))
    found = []
    for path in (write_bag(tmp_path / 'plain', recording), twin):
        # what interpolation does to the effort leaves the sign of the constant force open
        assert main([command[0], str(path), *command[2:], *SMALL, '--quiet']) == 1
        result = json.loads((tmp_path / 'out/result.json').read_text())
        found.append({name: x['value'] for name, x in result['parameters'].items()})
    assert found[0] == found[1]
    capsys.readouterr()
    assert main(['check', str(twin), '--machine', str(AXIS_FILE)]) == 0
    said = capsys.readouterr().out
    assert 'no /joint_command, /joint_trajectory_controller/controller_state is taken' in said


def test_identify_writes_its_files_and_ends_well(command, tmp_path, capsys):
    assert main([*command, *SMALL, '--seed', '1']) == 0
    said = capsys.readouterr()
    assert 'emps_axis.moving_mass' in said.out
    assert 'identified: All 4 parameters are identified.' in said.out
    assert 'generation 1 of 4' in said.err
    out = tmp_path / 'out'
    assert {p.name for p in out.iterdir()} == {
        'result.json',
        'result.yaml',
        'history.npz',
        'signals.npz',
        'overlay',
        'report.html',
    }
    data = json.loads((out / 'result.json').read_text())
    mass = data['parameters']['emps_axis.moving_mass']['value']
    assert mass == pytest.approx(95.0, rel=0.01)
    assert data['provenance']['sha256']
    # A second run replaces the first.
    assert main([*command, *SMALL, '--seed', '1', '--quiet']) == 0
    again = json.loads((out / 'result.json').read_text())
    assert again['parameters'] == data['parameters']
    assert capsys.readouterr().err == ''


def test_a_damaged_neighbour_costs_the_page_and_no_more(command, tmp_path, capsys):
    (tmp_path / 'out').mkdir()
    (tmp_path / 'out' / 'diagnosis.json').write_text('{')
    assert main([*command, *SMALL, '--seed', '1', '--quiet']) == 0
    assert 'no page is written' in capsys.readouterr().err
    assert not (tmp_path / 'out' / 'report.html').exists()
    assert main([*command, *SMALL, '--seed', '1', '--quiet', '--no-report']) == 0
    assert capsys.readouterr().err == ''


def test_options_reach_the_search(command, tmp_path):
    words = [*SMALL, '--no-refine', '--no-overlay', '--quiet', '--fix', 'moving_mass=95']
    words += ['--bounds', 'coulomb_friction=10:30', '--seed', '4', '--drives', 'emps_axis']
    # The search alone, as small as this, is far from the optimum: intervals are wide.
    assert main([*command, *words]) == 1
    data = json.loads((tmp_path / 'out' / 'result.json').read_text())
    assert data['cost']['refined'] is None
    assert data['fixed'] == {'emps_axis.moving_mass': 95.0}
    coulomb = data['parameters']['emps_axis.coulomb_friction']
    assert (coulomb['lower_bound'], coulomb['upper_bound']) == (10.0, 30.0)
    assert data['seed'] == 4
    assert data['settings']['genetic']['initial_population'] == 64
    assert not (tmp_path / 'out' / 'overlay').exists()


def test_a_spent_budget_ends_with_1(command, tmp_path, capsys):
    assert main([*command, '--evaluations', '40', '--quiet']) == 1
    assert 'budget spent: The budget of evaluations is spent' in capsys.readouterr().out
    assert json.loads((tmp_path / 'out' / 'result.json').read_text())['outcome'] == 'budget spent'


def test_a_signal_keeps_the_best_so_far(command, tmp_path):
    process = spawn([*command, *SLOW])
    line = process.stderr.readline()
    if not line.startswith('generation 1 of 2'):
        process.kill()
        pytest.fail(line + process.stderr.read())
    process.send_signal(signal.SIGTERM)
    asked = time.monotonic()
    out = ''
    while 'written: ' not in out and (line := process.stdout.readline()):
        out += line
    assert time.monotonic() - asked < 5.0
    _, err = process.communicate(timeout=60)
    assert process.returncode == 1, err
    assert (tmp_path / 'out' / 'report.html').exists()
    assert 'stopping; the best so far is kept' in err
    assert 'cancelled: The run was cancelled' in out
    data = json.loads((tmp_path / 'out' / 'result.json').read_text())
    assert data['outcome'] == 'cancelled'
    assert data['parameters']['emps_axis.moving_mass']['value'] > 0.0


@pytest.mark.parametrize(
    ('options', 'text'),
    [
        (['--drives', 'drive_9'], "drive 'drive_9' is not in the machine file; choose from emps"),
        (['--fix', 'mass=1'], "'mass' cannot be fixed: no such parameter; choose from"),
        (['--fix', 'moving_mass=1', '--fix', 'moving_mass=2'], '--fix names moving_mass twice'),
        (['--bounds', 'moving_mass=3:2'], 'moving_mass has the bounds 3 to 2;'),
        (['--state-topic', '/x', '--effort-topic', '/x'], '/x is given as state and as effort'),
        (
            ['--state-topic', '/joint_state'],
            'holds no message of /joint_state, named as its state topic, only /effort (sens',
        ),
    ],
)
def test_wrong_use_is_one_sentence_and_2(command, options, text, capsys):
    line = refused([*command, *options], capsys)
    assert line.startswith('ident identify: ')
    assert text in line


@pytest.mark.parametrize(
    ('options', 'text'),
    [
        (['--drives', ''], 'holds an empty name'),
        (['--fix', 'tool_mass'], 'has to be NAME=VALUE'),
        (['--bounds', 'tool_mass=1'], 'has to be NAME=LOW:HIGH'),
        (['--seed', '-1'], 'has to be a whole number of at least 0'),
        (['--generations', '0'], 'has to be a whole number of at least 1'),
        (['--seconds', 'soon'], 'has to be a number above 0'),
        (['--nonsense'], 'unrecognized arguments: --nonsense'),
    ],
)
def test_malformed_options_end_with_2(command, options, text, capsys):
    assert main([*command, *options]) == 2
    assert text in capsys.readouterr().err


@pytest.mark.parametrize(
    ('name', 'more', 'written'),
    [
        ('identify', SMALL, ('result.json', 'signals.npz', 'report.html')),
        ('diagnose', ['--seconds', '1'], ('diagnosis.json', 'diagnosis.npz', 'report.html')),
    ],
)
def test_files_are_written_before_anything_is_printed(bag, tmp_path, name, more, written):
    """So `| head` costs no file."""
    out = tmp_path / 'out'
    words = [name, str(bag), '--machine', str(AXIS_FILE), '--out', str(out), '--quiet', *more]
    process = spawn(words)
    process.stdout.close()
    assert process.wait(120) == 1, 'nobody is there to read'
    assert 'Traceback' not in process.stderr.read()
    assert {*written, 'overlay'} <= {path.name for path in out.iterdir()}
