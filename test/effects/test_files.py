# SPDX-License-Identifier: Apache-2.0
"""Effects of the user: in files of their own and in other packages."""

from dataclasses import replace
import os
from pathlib import Path
import re
import subprocess
import sys

import numpy as np
import pytest

from ros2_ident.effects import (
    add_effect_files,
    CATALOGUE,
    Catalogue,
    VARIABLE,
)
from ros2_ident.errors import IdentError
from ros2_ident.kernel import rows
from ros2_ident.recording import read_bag, write_bag

ROOT = Path(__file__).parents[2]
MACHINE = ROOT / 'config/emps.yaml'
PAGE = (ROOT / 'docs/extend.md').read_text(encoding='utf-8')
SOURCE = re.findall(r'^```python\n(.*?)^```$', PAGE, re.MULTILINE | re.DOTALL)[2]
SPAWNED = '''
from concurrent.futures import ProcessPoolExecutor
import multiprocessing
from ros2_ident.cli.main import main
from ros2_ident.effects import add_effect_files

def known(name):
    from ros2_ident.kernel.hooks import sources_digest
    from ros2_ident.kernel.rows import KERNEL_EFFECTS
    return name in {e.id for e in KERNEL_EFFECTS}, sources_digest()

if __name__ == '__main__':
    add_effect_files(['rubber_buffer.py'])
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context('spawn')) as pool:
        there = pool.submit(known, 'rubber_buffer').result()
    print(there == known('rubber_buffer'), there[0])
'''


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / 'rubber_buffer.py'
    path.write_text(SOURCE, encoding='utf-8')
    return path


def run(folder: Path, *words: str, path: str = '', **variables: str) -> str:
    """Run Python in a process of its own; return what it prints."""
    search = os.pathsep.join(filter(None, [path, str(ROOT), os.environ.get('PYTHONPATH', '')]))
    done = subprocess.run(
        [sys.executable, *words],
        cwd=folder,
        env={**os.environ, 'PYTHONPATH': search, **variables},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def bag(folder: Path) -> str:
    """Write the log of an axis whose carriage runs into a soft pad at 0.05 m."""
    (recording,) = read_bag(ROOT / 'bags/axis_reversals')
    state, effort = recording.state, recording.effort
    depth = np.maximum(np.interp(effort.stamp, state.stamp, state.position[:, 0]) - 0.05, 0.0)
    pushed = replace(effort, effort=effort.effort + 3e4 * depth[:, None] ** 2)
    write_bag(folder / 'bag', replace(recording, effort=pushed))
    return str(folder / 'bag')


def test_a_log_is_made_with_it(file: Path, tmp_path: Path) -> None:
    code = 'from ros2_ident.effects import add_effect_files; '
    code += 'from ros2_ident.simulate.bag import read_effect; '
    code += f'add_effect_files(["{file.name}"]); '
    code += f'print(read_effect("{file.name}:stiffness=3e4,place=0.15"))'
    assert 'rubber_buffer' in run(tmp_path, '-c', code)


def test_workers_learn_of_the_file(file: Path, tmp_path: Path) -> None:
    (tmp_path / 'spawned.py').write_text(SPAWNED, encoding='utf-8')
    assert run(tmp_path, 'spawned.py') == 'True True\n'


def test_the_digest_of_the_kernels_covers_the_file(file: Path, tmp_path: Path) -> None:
    code = 'from ros2_ident.kernel.hooks import sources_digest; print(sources_digest())'
    plain = run(tmp_path, '-c', code)
    first = run(tmp_path, '-c', code, **{VARIABLE: str(file)})
    file.write_text(SOURCE.replace('depth * depth', 'depth'), encoding='utf-8')
    changed = run(tmp_path, '-c', code, **{VARIABLE: str(file)})
    assert len({plain, first, changed}) == 3


@pytest.mark.parametrize('value', ['other_effects:EFFECT', 'other_effects'])
def test_another_package_brings_an_effect(value: str, tmp_path: Path) -> None:
    (tmp_path / 'other_effects.py').write_text(SOURCE, encoding='utf-8')
    about = tmp_path / 'other_effects-1.0.dist-info'
    about.mkdir()
    about.joinpath('METADATA').write_text('Metadata-Version: 2.1\nName: other_effects\n')
    about.joinpath('entry_points.txt').write_text(f'[ros2_ident.effects]\nbuffer = {value}\n')
    code = 'from ros2_ident.effects import CATALOGUE, SOURCES; '
    code += "print(CATALOGUE['rubber_buffer'].title, [p.name for p in SOURCES])"
    assert run(tmp_path, '-c', code, path=str(tmp_path)) == "rubber buffer ['other_effects.py']\n"


def test_a_file_that_comes_too_late_is_refused(file: Path) -> None:
    assert rows.KERNEL_EFFECTS
    with pytest.raises(IdentError, match=f'compiled without it already; .* {VARIABLE}'):
        add_effect_files([str(file)])
    assert 'rubber_buffer' not in CATALOGUE


@pytest.mark.parametrize(
    ('source', 'message'),
    [
        ('', 'defines no EFFECT; write EFFECT'),
        ('EFFECT = 3', 'defines no EFFECT'),
        ('import nothing_of_this_name', 'cannot be imported, ModuleNotFoundError'),
        (SOURCE.replace("id='rubber_buffer'", "id='stribeck'"), 'has an effect stribeck already'),
        (SOURCE.replace("id='rubber_buffer'", "id='Rubber buffer'"), 'is no id; write it like'),
        (SOURCE.replace('kernel=_kernel', 'kernel=_kernel, keeps=_kernel'), 'has no memory'),
    ],
)
def test_what_is_wrong_with_a_file_is_said(
    source: str, message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv(VARIABLE, raising=False)
    path = tmp_path / 'mine.py'
    path.write_text(source, encoding='utf-8')
    with pytest.raises(IdentError, match=message):
        Catalogue('ros2_ident.effects', [str(ROOT / 'ros2_ident/effects')]).add_files([str(path)])
    assert VARIABLE not in os.environ
    with pytest.raises(IdentError, match='there is no file .*; name the file'):
        Catalogue('ros2_ident.effects', []).add_files([str(tmp_path / 'nowhere.py')])
