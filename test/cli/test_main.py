# SPDX-License-Identifier: Apache-2.0
import os
from pathlib import Path
import shlex
import subprocess
import sys

from identify_cases import ROOT, tripod, TRIPOD_FILE
import pytest
import yaml

from ros2_ident.cli.arguments import COMMANDS
from ros2_ident.cli.main import main, make_parser
from ros2_ident.recording import read_bag

# This tree first; where it is installed, its entry points lie further on.
SEARCHED = os.pathsep.join([str(ROOT), *filter(None, [os.environ.get('PYTHONPATH')])])


# What takes long to import, and what each command may.
HEAVY = (
    r'(asyncio|bokeh|distributed|google|h5py|jinja2|matplotlib|mcap|mujoco|numba|numpy|pinocchio)$'
)
HEAVY += r'|(pyarrow|rclpy|rich|rosbags|yaml|zstandard)$|rosbags\.typesys\.stores\.ros2_jazzy$'
HEAVY += r'|scipy\.(fft|interpolate|linalg|ndimage|optimize|signal|special|stats)$'
HEAVY += r'|ros2_ident\.(change\.find|gap\.(diagnose|result)|report\.page)$'
FILES = {'mcap', 'numpy', 'rosbags', 'yaml', 'zstandard'}
NUMBERS = {'fft', 'interpolate', 'linalg', 'ndimage', 'optimize', 'special'}
NUMBERS = {f'scipy.{name}' for name in NUMBERS}
GAP = 'ros2_ident.gap.diagnose', 'ros2_ident.gap.result'
AXIS = 'bags/axis_reversals --machine config/emps.yaml'
FITTED = f'identify {AXIS} --population 8 --generations 1 --quiet --out'


@pytest.mark.parametrize(
    ('command', 'loaded'),
    [
        ('--version', set()),
        ('--help', {'yaml'}),
        ('identify --help', {'yaml'}),
        ('example --out {}/example', {'yaml'}),
        ('new-machine --kind linear_axis', FILES),
        ('check --machine config/emps.yaml', FILES),
        (f'check {AXIS}', FILES | NUMBERS),
        (FITTED + ' {} --no-overlay --no-report', FILES | NUMBERS | {'numba'}),
        (
            FITTED + ' {} --no-overlay',
            FILES
            | NUMBERS
            | {'numba', 'jinja2', 'ros2_ident.gap.result', 'ros2_ident.report.page'},
        ),
        (f'diagnose {AXIS} --seconds 0.01 --quiet', FILES | NUMBERS | {'numba', *GAP}),
    ],
)
def test_a_command_imports_what_it_uses(command, loaded, tmp_path):
    script = (
        'import re, sys; from ros2_ident.cli.main import main; main(sys.argv[1:]);'
        f'print(*(m for m in sys.modules if re.match({HEAVY!r}, m)))'
    )
    done = subprocess.run(
        [sys.executable, '-c', script, *command.format(tmp_path).split()],
        env={**os.environ, 'PYTHONPATH': SEARCHED},
        cwd=ROOT,
        capture_output=True,
        text=True,
    )
    assert set(done.stdout.splitlines()[-1].split()) <= loaded, done.stderr


def test_help_names_all_commands(capsys):
    assert main(['--help']) == 0
    said = ' '.join(capsys.readouterr().out.split())
    assert all(name in said for name in COMMANDS)
    assert 'exit codes: 0 success; 1 done, but the answer is not usable as it is; 2' in said


@pytest.mark.parametrize('name', COMMANDS)
def test_every_command_has_help_with_examples_that_work(name, capsys):
    assert main([name, '--help']) == 0
    said = capsys.readouterr().out
    assert 'exit codes: 0 ' in said
    assert '2 wrong use or bad input' in ' '.join(said.split())
    examples = said.split('examples:\n')[1].split('\n\n')[0].replace('\\\n', ' ').splitlines()
    assert any(line.startswith(f'  ident {name} ') for line in examples)
    for line in examples:
        words = shlex.split(line)
        assert words.pop(0) == 'ident'
        assert make_parser(words).parse_args(words).command == words[0]
        for word in words:
            assert not word.startswith(('config/', 'bags/')) or (ROOT / word).exists(), word


@pytest.mark.parametrize(
    ('words', 'code', 'text'),
    [
        (['--version'], 0, 'ident '),
        ([], 2, 'commands:'),
        (['guess'], 2, "invalid choice: 'guess'"),
        (['check', '/nowhere'], 2, 'ident check: /nowhere: does not exist;'),
        (['check'], 2, 'give a bag, --machine, or both'),
    ],
)
def test_what_is_said_and_with_which_code_it_ends(words, code, text, capsys):
    assert main(words) == code
    assert text in ' '.join(''.join(capsys.readouterr()).split())


def test_an_option_that_is_given_twice_holds_all_it_was_given():
    words = ['diff', 'a', '--after', 'b', '--after', 'c', 'd', '--machine', 'm.yaml']
    assert make_parser(words).parse_args(words).after == ['b', 'c', 'd']


@pytest.mark.parametrize(
    ('line', 'expected'),
    [
        ('ident identify bag --bou', ['--bounds']),
        ('ident check --machine config/em', ['config/emps.yaml']),
        ('ident new-machine --kind t', ['tripod']),
    ],
)
def test_tab_completes(line, expected, tmp_path):
    answer = tmp_path / 'answer'
    script = tmp_path / 'run.py'
    script.write_text('from ros2_ident.cli.main import main\nmain()\n')
    subprocess.run(
        [sys.executable, str(script)],
        cwd=ROOT,
        env={
            **os.environ,
            'PYTHONPATH': str(ROOT),
            '_ARGCOMPLETE': '1',
            '_ARGCOMPLETE_STDOUT_FILENAME': str(answer),
            'COMP_LINE': line,
            'COMP_POINT': str(len(line)),
            '_ARGCOMPLETE_IFS': '\n',
        },
        timeout=300,
    )
    assert sorted(answer.read_text().split()) == expected


def test_simulate_makes_a_bag_that_says_how_it_was_made(tmp_path, capsys):
    words = ['simulate', str(tmp_path / 'bag'), '--machine', str(TRIPOD_FILE), '--seconds', '2']
    words += ['--set', 'tool_mass=1.4', '--set', 'drive_2.gear_stiffness=2e4', '--seed', '5']
    assert main([*words, '--effect', 'stribeck@drive_2:torque=0.05,velocity=0.03']) == 0
    said = capsys.readouterr().out
    assert 'tool_mass' in said
    (recording,) = read_bag(tmp_path / 'bag')
    assert recording.state is not None
    assert recording.state.names == tripod().drives
    notes = yaml.safe_load((tmp_path / 'bag' / 'metadata.yaml').read_text())
    custom = notes['rosbag2_bagfile_information']['custom_data']
    assert custom['command'].startswith('ident simulate ')
    assert '"drive_2.gear_stiffness": 20000.0' in custom['parameters']


@pytest.mark.parametrize(
    ('options', 'text'),
    [
        (['--set', 'mass=1'], "'mass' cannot be set: no such parameter; choose from measurement_"),
        (['--set', 'drive_1.tool_mass=1'], "'drive_1.tool_mass' cannot be set"),
        (['--effect', 'magic@drive_1:mass=1'], "no effect is called 'magic'"),
        (['--effect', 'stribeck:torque=1'], 'effect stribeck needs the values torque, velocity'),
        (['--effect', 'stribeck@elbow:torque=1,velocity=1'], 'stribeck has no place on elbow'),
        (['--effect', 'payload_turns:mass=1'], 'payload_turns has no place on all'),
        (['--seconds', '0.5'], 'a motion of 0.5 s is too short'),
    ],
)
def test_simulate_refuses_in_one_sentence(tmp_path, options, text, capsys):
    words = ['simulate', str(tmp_path / 'bag'), '--machine', str(TRIPOD_FILE), *options]
    assert main(words) == 2
    said = capsys.readouterr().err
    assert said.startswith('ident simulate: ')
    assert text in said
    assert not Path(tmp_path / 'bag').exists()
