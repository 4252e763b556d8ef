# SPDX-License-Identifier: Apache-2.0
"""Effects of the user: in files of their own and in other packages."""

import os
from pathlib import Path
import re
import subprocess
import sys

import pytest

from ros2_ident.effects import (
    add_effect_files,
    CATALOGUE,
    Catalogue,
    VARIABLE,
)
from ros2_ident.errors import IdentError
from ros2_ident.kernel import rows

ROOT = Path(__file__).parents[2]
MACHINE = ROOT / 'config/emps.yaml'
PAGE = (ROOT / 'docs/extend.md').read_text(encoding='utf-8')
SOURCE = re.findall(r'^```python\n(.*?)^```$', PAGE, re.MULTILINE | re.DOTALL)[2]


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


def test_a_log_is_made_with_it_and_workers_learn_of_it(file: Path, tmp_path: Path) -> None:
    code = 'import subprocess, sys; from ros2_ident.effects import add_effect_files; '
    code += 'from ros2_ident.simulate.bag import read_effect; '
    code += f'add_effect_files(["{file.name}"]); '
    code += f'print(read_effect("{file.name}:stiffness=3e4,place=0.15"), flush=True); '
    worker = 'from ros2_ident.kernel.rows import KERNEL_EFFECTS; '
    worker += 'print("there:", "rubber_buffer" in {e.id for e in KERNEL_EFFECTS})'
    code += f'subprocess.run([sys.executable, "-c", {worker!r}], check=True)'
    here, there = run(tmp_path, '-c', code).splitlines()
    assert 'rubber_buffer' in here and there == 'there: True'


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
    with pytest.raises(IdentError, match='does not exist; name the file'):
        Catalogue('ros2_ident.effects', []).add_files([str(tmp_path / 'nowhere.py')])
    with pytest.raises(IdentError, match='/dev/zero: is no regular file or folder; name the file'):
        Catalogue('ros2_ident.effects', []).add_files(['/dev/zero'])
