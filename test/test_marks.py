# SPDX-License-Identifier: Apache-2.0
"""Tests that are marked slow are there, and none is skipped in CI."""

import os
from pathlib import Path
import re

import pytest

import conftest

pytest_plugins = ['pytester']

HERE = Path(__file__).parent
ROOT = HERE.parent


def test_what_the_list_names_is_there() -> None:
    assert conftest.listed()
    for name in conftest.listed():
        file, _, test = name.partition('::')
        (path,) = (p for at in ('test', 'checks/test') if (p := ROOT / at / file).is_file())
        text = path.read_text(encoding='utf-8')
        assert not test or re.search(rf'^def {test}\(', text, re.MULTILINE), name


def test_in_ci_nothing_is_skipped(
    pytester: pytest.Pytester, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytester.makeconftest((ROOT / 'conftest.py').read_text(encoding='utf-8'))
    (pytester.mkdir('test') / 'slow.txt').touch()
    pytester.makeini('[pytest]\nmarkers =\n  slow: slow\n  ros: ros\n')
    monkeypatch.setenv('PYTHONPATH', str(HERE), prepend=os.pathsep)
    monkeypatch.delenv('CI', raising=False)
    pytester.makepyfile(
        test_it='import pytest\n\ndef test_a(): pytest.skip("no zsh")\n\ndef test_b(): pass\n',
        test_whole='import pytest\npytest.importorskip("no_such_module", reason="no MuJoCo")\n',
    )
    assert pytester.runpytest_inprocess().ret == 0
    monkeypatch.setenv('CI', 'true')
    ran = pytester.runpytest_inprocess()
    ran.assert_outcomes(failed=1, passed=1, skipped=1)
    assert 'With CI=true nothing may be skipped. Skipped: no zsh' in ran.stdout.str()
    ran.stdout.fnmatch_lines(['AMISS test_whole.py is skipped with CI=true: *no MuJoCo'])
    pytester.path.joinpath('test_it.py').unlink()
    assert pytester.runpytest_inprocess().ret != 0
