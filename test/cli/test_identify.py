# SPDX-License-Identifier: Apache-2.0
import json
import os
import signal
import subprocess

from forked import forked
from identify_cases import axis_bag, AXIS_FILE, ROOT
import pytest

from ros2_ident.cli.main import main
from ros2_ident.cli.runs import interrupts
from ros2_ident.recording import write_bag

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


def test_identify_writes_its_files_and_ends_well(command, tmp_path, capsys):
    assert main([*command, *SMALL, '--seed', '1']) == 0
    said = capsys.readouterr()
    assert 'emps_axis.moving_mass' in said.out
    assert 'identified: All 4 parameters are identified.' in said.out
    assert 'generation 1 of 4' in said.err
    out = tmp_path / 'out'
    assert {p.name for p in out.iterdir()} == {
        'result.json',
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


def test_a_signal_keeps_the_best_so_far(command, tmp_path):
    process = spawn([*command, *SLOW])
    # On a busy machine the preparations take long enough to be told.
    told = iter(process.stderr.readline, '')
    line = next((x for x in told if not x.startswith('preparing')), '')
    if not line.startswith('generation 1 of 2'):
        process.kill()
        pytest.fail(line + process.stderr.read())
    process.send_signal(signal.SIGTERM)
    out = ''
    while 'written: ' not in out and (line := process.stdout.readline()):
        out += line
    _, err = process.communicate(timeout=300)
    assert process.returncode == 1, err
    assert (tmp_path / 'out' / 'report.html').exists()
    assert 'stopping; what is found by now is printed and written\n' in err
    assert 'cancelled: The run was cancelled' in out
    data = json.loads((tmp_path / 'out' / 'result.json').read_text())
    assert data['outcome'] == 'cancelled'
    assert data['parameters']['emps_axis.moving_mass']['value'] > 0.0


@pytest.mark.parametrize(
    ('out', 'said'), [('out', 'printed and written'), (None, 'printed; without --out nothing is')]
)
def test_a_signal_says_whether_what_is_found_is_written(out, said, capfd):
    with interrupts(out) as cancel:
        signal.raise_signal(signal.SIGINT)
        assert cancel.is_set()
    assert f'stopping; what is found by now is {said}' in capfd.readouterr().err


@pytest.mark.parametrize(
    ('options', 'text'),
    [
        (['--drives', ''], 'holds an empty name'),
        (['--fix', 'tool_mass'], 'has to be NAME=VALUE'),
        (['--bounds', 'tool_mass=1'], 'has to be NAME=LOW:HIGH'),
        (['--seed', '-1'], 'has to be a whole number of at least 0'),
        (['--generations', '0'], 'has to be a whole number of at least 1'),
        (['--seconds', 'soon'], 'has to be a number above 0'),
        (['--nonsense'], 'ident identify: error: unrecognized arguments: --nonsense'),
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
