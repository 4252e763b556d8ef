# SPDX-License-Identifier: Apache-2.0
"""Compiled functions are made anew when one they call changes; what libraries are asked for."""

import os
from pathlib import Path
import stat
import subprocess
import sys
import tempfile

import pytest

from ros2_ident.compiled import _own_folder
from ros2_ident.threads import ONE_THREAD

CALLEE = """
from pathlib import Path
from ros2_ident.compiled import compiled, digest_of
SOURCES = digest_of(Path(__file__).parent)
def inner(x):
    return {} * x
inner = compiled(inner, SOURCES)
"""
CALLER = """
from callee import inner, SOURCES
from ros2_ident.compiled import compiled
def outer(x):
    return inner(x) + 1.0
outer = compiled(outer, SOURCES)
print(outer(1.0), outer.stats.cache_hits)
"""


def test_a_changed_callee_is_never_served_from_the_cache(tmp_path):
    (tmp_path / 'caller.py').write_text(CALLER)

    def run(factor: float) -> list[str]:
        (tmp_path / 'callee.py').write_text(CALLEE.format(factor))
        # Python takes byte-code of the same second and size for that of a changed source.
        words = [sys.executable, '-B', 'caller.py']
        done = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, check=True)
        return done.stdout.split()

    assert run(2.0) == ['3.0', 'Counter()']
    value, hits = run(2.0)[0], run(2.0)[1:]
    assert value == '3.0' and '1})' in hits, 'what has not changed comes from the cache'
    assert run(5.0) == ['6.0', 'Counter()']


def test_a_cache_for_want_of_another_place_is_its_users_alone(tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, 'tempdir', str(tmp_path))
    found = _own_folder()
    assert Path(found).parent == tmp_path and stat.S_IMODE(os.stat(found).st_mode) == 0o700
    assert _own_folder() == found
    os.chmod(found, 0o770)
    assert _own_folder() == '', 'others may have put there what would be run'
    os.rename(found, tmp_path / 'elsewhere')
    os.symlink(tmp_path / 'elsewhere', found)
    assert _own_folder() == ''


@pytest.mark.parametrize(('stated', 'found'), [(None, '1'), ('3', '3')])
def test_the_command_takes_one_thread_unless_told_otherwise(stated, found):
    environment = {k: v for k, v in os.environ.items() if k not in ONE_THREAD}
    if stated is not None:
        environment['OPENBLAS_NUM_THREADS'] = stated
    code = (
        'import os, sys; import ros2_ident.cli.main as m; assert "numpy" not in sys.modules; '
        'm.main(["new-machine", "--kind", "linear_axis"]); '
        'print(os.environ["OPENBLAS_NUM_THREADS"])'
    )
    run = subprocess.run(
        [sys.executable, '-c', code], env=environment, capture_output=True, text=True, check=True
    )
    assert run.stdout.splitlines()[-1] == found
