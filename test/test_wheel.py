# SPDX-License-Identifier: Apache-2.0
"""The wheel in an environment of its own: no ROS, no page, and only TMPDIR to write to."""

from dataclasses import replace
import json
import os
from pathlib import Path
import re
import shutil
import stat
import subprocess
import sys
import zipfile

from effects.test_files import MACHINE, SOURCE
import numpy as np
import pytest

from ros2_ident.effects import CATALOGUE, VARIABLE
from ros2_ident.recording import read_bag, write_bag

ROOT = Path(__file__).parents[1]
UV = Path(sys.prefix, 'bin/uv')

if not UV.exists():
    pytest.skip('uv is not installed; `make test` brings it', allow_module_level=True)


def run(*words, **how):
    done = subprocess.run(words, capture_output=True, text=True, timeout=300, **how)
    assert done.returncode == 0, done.stderr
    return done


def bag(folder: Path) -> str:
    """Write the log of an axis whose carriage runs into a soft pad at 0.05 m."""
    (recording,) = read_bag(ROOT / 'bags/axis_reversals')
    state, effort = recording.state, recording.effort
    depth = np.maximum(np.interp(effort.stamp, state.stamp, state.position[:, 0]) - 0.05, 0.0)
    pushed = replace(effort, effort=effort.effort + 3e4 * depth[:, None] ** 2)
    write_bag(folder / 'bag', replace(recording, effort=pushed))
    return str(folder / 'bag')


@pytest.fixture(scope='module')
def wheel(tmp_path_factory):
    tree = tmp_path_factory.mktemp('tree')
    for name in ('bags', 'config', 'ros2_ident', 'tools'):
        shutil.copytree(ROOT / name, tree / name, ignore=shutil.ignore_patterns('__pycache__'))
    for name in ('LICENSE', 'MANIFEST.in', 'README.md', 'pyproject.toml', 'setup.cfg', 'setup.py'):
        shutil.copyfile(ROOT / name, tree / name)
    run(UV, 'build', '--wheel', '--no-build-isolation', '--python', sys.executable, cwd=tree)
    (made,) = tree.glob('dist/*.whl')
    return made


def test_it_is_small_and_holds_what_runs_without_ros(wheel):
    assert wheel.stat().st_size <= 1.5e6
    with zipfile.ZipFile(wheel) as file:
        names = file.namelist()
        about = file.read(next(x for x in names if x.endswith('METADATA'))).decode()
        scripts = file.read(next(x for x in names if x.endswith('entry_points.txt'))).decode()
    tops = {name.split('/')[1] for name in names if name.startswith('ros2_ident/')}
    assert tops >= {'cli', 'examples', 'gap'} and 'ros' not in tops
    assert {name.split('/')[0] for name in names} == {'ros2_ident', 'ros2_ident-0.1.0.dist-info'}
    assert re.findall(r'^(.+) = ', scripts, re.MULTILINE) == ['ident', 'ros2-ident']
    extras = re.findall(r'^Provides-Extra: (.+)$', about, re.MULTILINE)
    assert {'arms', 'dask', 'mujoco', 'page'} <= set(extras)


def test_it_runs_without_ros_page_and_home_and_diagnoses_an_effect_of_the_users(tmp_path, wheel):
    room, rest = tmp_path / 'room', tmp_path / 'venv'
    room.mkdir()
    run(UV, 'venv', '--python', sys.executable, rest)
    run(UV, 'pip', 'install', '--python', rest, wheel)
    # Root may write where others may not; where a file is in the way, nobody can.
    package = next(rest.glob('lib/python*/site-packages/ros2_ident'))
    for folder in [package, *(x for x in package.rglob('*') if x.is_dir())]:
        (folder / '__pycache__').touch()
    file = room / 'rubber_buffer.py'
    file.write_text(SOURCE, encoding='utf-8')
    alone = {
        'PATH': f'{rest}/bin:/usr/bin:/bin', 'HOME': '/dev/null', 'TMPDIR': str(room),
        'OMP_NUM_THREADS': '1', 'PYTHONDONTWRITEBYTECODE': '1',
    }  # fmt: skip

    def ident(*words, **more):
        return run(rest / 'bin' / 'ros2-ident', *words, env=alone | more, cwd=room)

    _, asked, _ = ident('example').stdout.splitlines()
    identify = asked.split()[1:]
    # With the user's effect from the beginning: what is compiled once serves the diagnosis, too.
    done = ident(*identify, '--population', '64', '--generations', '2', **{VARIABLE: str(file)})
    assert 'no page is written: a page needs' in done.stderr
    assert 'pip install "ros2-ident[page]"' in done.stderr
    cache = room / f'ros2_ident-{os.getuid()}'
    assert stat.S_IMODE(cache.stat().st_mode) == 0o700 and [*cache.rglob('*.nbi')]

    words = ['diagnose', bag(room), '--machine', str(MACHINE), '--quiet', '--out', 'gap']
    others = set(CATALOGUE) - {'cable_spring', 'constant_force', 'stribeck'}
    words += ['--no-overlay', '--without', ','.join(sorted(others)), '--effect', file.name]
    ident(*words)
    found = json.loads((room / 'gap/diagnosis.json').read_text(encoding='utf-8'))
    verdict, parameters = found['verdict'], found['parameters']
    assert (verdict['effect'], verdict['where']) == ('rubber_buffer', ['emps_axis'])
    place, stiffness = (parameters[f'emps_axis.rubber_buffer.{x}'] for x in ('place', 'stiffness'))
    assert place['value'] == pytest.approx(0.05, abs=2e-3)
    assert stiffness['value'] == pytest.approx(3e4, rel=0.1)

    run(UV, 'pip', 'install', '--python', rest, f'ros2-ident[page] @ file://{wheel}')
    ident('report', identify[-1])
    assert (room / identify[-1] / 'report.html').stat().st_size > 100_000
