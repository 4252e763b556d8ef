# SPDX-License-Identifier: Apache-2.0
"""The wheel in an environment of its own: no ROS, no page, and only TMPDIR to write to."""

import os
from pathlib import Path
import re
import shutil
import stat
import subprocess
import sys
import zipfile

import pytest

ROOT = Path(__file__).parents[1]
UV = Path(sys.prefix, 'bin/uv')

if not UV.exists():
    pytest.skip('uv is not installed; `make test` brings it', allow_module_level=True)


def run(*words, good=(0,), **how):
    done = subprocess.run(words, capture_output=True, text=True, timeout=300, **how)
    assert done.returncode in good, done.stderr
    return done


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


def test_it_runs_without_ros_page_and_home(tmp_path, wheel):
    room, rest = tmp_path / 'room', tmp_path / 'venv'
    room.mkdir()
    run(UV, 'venv', '--python', sys.executable, rest)
    run(UV, 'pip', 'install', '--python', rest, wheel)
    # Root may write where others may not; where a file is in the way, nobody can.
    package = next(rest.glob('lib/python*/site-packages/ros2_ident'))
    for folder in [package, *(x for x in package.rglob('*') if x.is_dir())]:
        (folder / '__pycache__').touch()
    alone = {
        'PATH': f'{rest}/bin:/usr/bin:/bin', 'HOME': '/dev/null', 'TMPDIR': str(room),
        'OMP_NUM_THREADS': '1', 'PYTHONDONTWRITEBYTECODE': '1',
    }  # fmt: skip

    def ident(*words, good=(0,)):
        return run(rest / 'bin' / 'ros2-ident', *words, good=good, env=alone, cwd=room)

    _, *asked = ident('example').stdout.splitlines()
    (identify, diagnose) = (line.split()[1:] for line in asked)
    done = ident(*identify, '--population', '64', '--generations', '2')
    assert 'no page is written: a page needs' in done.stderr
    assert 'pip install "ros2-ident[page]"' in done.stderr
    cache = room / f'ros2_ident-{os.getuid()}'
    assert stat.S_IMODE(cache.stat().st_mode) == 0o700 and [*cache.rglob('*.nbi')]
    ident(*diagnose, '--seconds', '2', good=(0, 1))  # 1: what it had no time for
    assert (room / diagnose[-1] / 'diagnosis.json').is_file()
    run(UV, 'pip', 'install', '--python', rest, f'ros2-ident[page] @ file://{wheel}')
    ident('report', identify[-1])
    assert (room / identify[-1] / 'report.html').stat().st_size > 100_000
