# SPDX-License-Identifier: Apache-2.0
import os
from pathlib import Path
import re
import shlex
import subprocess
import sys
import time

from identify_cases import axis_bag, AXIS_FILE, ROOT, tripod, TRIPOD_FILE
import numpy as np
import pytest
import yaml

from ros2_ident.cli import arguments
from ros2_ident.cli.main import COMMANDS, main, make_parser
from ros2_ident.effects import CATALOGUE
from ros2_ident.models.registry import KINDS
from ros2_ident.recording import read_bag, Stream, write_bag
from ros2_ident.simulate.bag import write_simulated

# This tree first; where it is installed, its entry points lie further on.
SEARCHED = os.pathsep.join([str(ROOT), *filter(None, [os.environ.get('PYTHONPATH')])])


def child(*words, **environment):
    return subprocess.run(
        [sys.executable, '-m', 'ros2_ident.cli.main', *words],
        env={**os.environ, 'PYTHONPATH': SEARCHED, **environment},
        capture_output=True,
        text=True,
        timeout=120,
    )


def test_help_is_quick_and_loads_nothing_slow():
    times = []
    for _ in range(3):
        start = time.monotonic()
        done = child('--help')
        times.append(time.monotonic() - start)
    assert done.returncode == 0
    assert all(name in done.stdout for name in COMMANDS)
    assert min(times) < 0.5
    script = (
        'import sys; from ros2_ident.cli.main import main; main(["identify", "--help"]);'
        'print([m for m in ("numpy", "numba", "scipy", "rclpy", "rich") if m in sys.modules])'
    )
    loaded = subprocess.run(
        [sys.executable, '-c', script],
        env={**os.environ, 'PYTHONPATH': str(ROOT)},
        capture_output=True,
        text=True,
    )
    assert loaded.stdout.strip().splitlines()[-1] == '[]'


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


def test_the_help_of_ident_says_its_exit_codes(capsys):
    assert main(['--help']) == 0
    said = ' '.join(capsys.readouterr().out.split())
    assert (
        'exit codes: 0 success; 1 done, but the answer is not usable as it is; 2 wrong use'
    ) in said


def test_without_a_command_the_help_comes_with_2(capsys):
    assert main([]) == 2
    assert 'commands:' in capsys.readouterr().err


def test_an_unknown_command_ends_with_2(capsys):
    assert main(['guess']) == 2
    assert "invalid choice: 'guess'" in capsys.readouterr().err


def test_version(capsys):
    assert main(['--version']) == 0
    assert capsys.readouterr().out.startswith('ident ')


def test_kinds_on_the_command_line_are_those_of_machine_files():
    (words,) = (
        action.choices
        for action in make_parser(['new-machine'])._actions[-1].choices['new-machine']._actions
        if action.dest == 'kind'
    )
    assert tuple(words) == tuple(KINDS)


@pytest.mark.parametrize(
    ('line', 'expected'),
    [
        ('ident dia', ['diagnose']),
        ('ident identify bag --bou', ['--bounds']),
        ('ident check bags/axis_r', ['bags/axis_reversals/']),
        ('ident check --machine config/em', ['config/emps.yaml']),
        ('ident new-machine --kind t', ['tripod']),
        (
            'ident identify bag --machine config/tripod.yaml --drives drive_1,',
            ['drive_1,drive_2', 'drive_1,drive_3'],
        ),
        ('ident identify bag --machine config/tripod.yaml --fix to', ['tool_mass=']),
        ('ident diagnose bag --without stribeck,backl', ['stribeck,backlash']),
        (
            'ident simulate bag --machine config/emps.yaml --effect presl',
            ['presliding@all:', 'presliding@emps_axis:'],
        ),
        ('ident identify bag --machine config/missing.yaml --fix to', []),
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
        timeout=60,
    )
    assert sorted(answer.read_text().split()) == expected


def test_tab_knows_the_effects_without_loading_them():
    assert arguments.effects('') == sorted(CATALOGUE)


def test_check_of_a_good_bag(tmp_path, capsys):
    bag = write_simulated(tmp_path / 'axis', axis_bag())
    assert main(['check', str(bag), '--machine', str(AXIS_FILE)]) == 0
    said = capsys.readouterr().out
    assert 'emps_axis' in said
    assert 'identification: 4 parameters' in said
    assert main(['check', str(bag)]) == 0


def test_check_of_a_bag_without_effort_ends_with_1(tmp_path, capsys):
    streams = {t: s for t, s in axis_bag().streams.items() if t != '/effort'}
    bag = write_bag(tmp_path / 'silent', streams)
    assert main(['check', str(bag), '--machine', str(AXIS_FILE)]) == 1
    assert 'effort' in capsys.readouterr().out


def test_check_of_a_bag_with_the_sign_of_the_effort_reversed_ends_with_1(tmp_path):
    effort = axis_bag().streams['/effort']
    turned = Stream(effort.names, effort.stamp, effort=-np.asarray(effort.effort))
    bag = write_bag(tmp_path / 'turned', {**axis_bag().streams, '/effort': turned})
    assert main(['check', str(bag), '--machine', str(AXIS_FILE)]) == 1


def test_check_of_a_drive_that_stands_still_ends_with_1(tmp_path, capsys):
    """It was a traceback: a frozen encoder beside a set-point that moves."""
    state = axis_bag().streams['/joint_states']
    still = Stream(state.names, state.stamp, np.zeros_like(state.position))
    bag = write_bag(tmp_path / 'still', {**axis_bag().streams, '/joint_states': still})
    assert main(['check', str(bag), '--machine', str(AXIS_FILE)]) == 1
    assert 'does not move; move it through its working range' in capsys.readouterr().out


@pytest.mark.parametrize('factor', [2.0, 0.5])
def test_check_says_that_an_effort_is_not_what_the_machine_makes(tmp_path, capsys, factor):
    effort = axis_bag().streams['/effort']
    other = Stream(effort.names, effort.stamp, effort=factor * np.asarray(effort.effort))
    bag = write_bag(tmp_path / 'other', {**axis_bag().streams, '/effort': other})
    main(['check', str(bag), '--machine', str(AXIS_FILE)])
    said = capsys.readouterr().out
    found = re.search(r'warn .*the effort is logged ([\d.]+) times as large as it is', said)
    assert found and float(found[1]) == pytest.approx(factor, rel=0.03)


def test_check_of_no_bag_ends_with_2(capsys):
    assert main(['check', '/nowhere']) == 2
    assert capsys.readouterr().err.startswith('ident check: /nowhere: does not exist;')


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
        (['--effect', 'magic@drive_1:size=1'], "no effect is called 'magic'"),
        (['--effect', 'stribeck:torque=1'], 'effect stribeck needs the values torque, velocity'),
        (['--effect', 'payload_turns:size=1'], 'payload_turns has no place on all'),
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
