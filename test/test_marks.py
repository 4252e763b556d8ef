# SPDX-License-Identifier: Apache-2.0
"""Which tests are marked slow, and what a run makes of those that are not, or are skipped."""

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


@pytest.fixture
def suite(pytester: pytest.Pytester, monkeypatch: pytest.MonkeyPatch) -> pytest.Pytester:
    text = (ROOT / 'conftest.py').read_text(encoding='utf-8')
    pytester.makeconftest(text.replace('LIMIT = 15.0', 'LIMIT = 0.2'))
    listed = pytester.mkdir('test') / 'slow.txt'
    listed.write_text('test_it.py::test_listed\n', encoding='utf-8')
    pytester.makeini('[pytest]\nmarkers =\n  slow: slow\n  ros: ros\n')
    monkeypatch.setenv('PYTHONPATH', str(HERE), prepend=os.pathsep)
    monkeypatch.delenv('CI', raising=False)
    return pytester


def test_a_slow_test_that_is_not_listed_is_told(
    suite: pytest.Pytester, monkeypatch: pytest.MonkeyPatch
) -> None:
    sleep = 'import time\n\ndef test_listed(): time.sleep(0.4)\n'
    suite.makepyfile(test_it=sleep)
    assert suite.runpytest_inprocess().ret == 0
    suite.runpytest_inprocess('-m', 'not slow').assert_outcomes(deselected=1)
    suite.makepyfile(test_it=f'{sleep}\ndef test_other(): time.sleep(0.4)\n')
    ran = suite.runpytest_inprocess()
    assert ran.ret == 0
    ran.stdout.fnmatch_lines(['AMISS test_it.py::test_other took 0 s and is not marked slow*'])
    # What compiles takes so long only once, and is not meant.
    monkeypatch.setenv('NUMBA_CACHE_DIR', str(suite.path))
    suite.makepyfile(
        test_it='from pathlib import Path\nimport time\n\n'
        'def test_other():\n    time.sleep(0.4)\n    Path("kernel.nbc").touch()\n'
    )
    assert 'AMISS' not in suite.runpytest_inprocess().stdout.str()


def test_in_ci_nothing_is_skipped(
    suite: pytest.Pytester, monkeypatch: pytest.MonkeyPatch
) -> None:
    suite.makepyfile(
        test_it='import pytest\n\ndef test_a(): pytest.skip("no zsh")\n\ndef test_b(): pass\n',
        test_whole='import pytest\npytest.importorskip("no_such_module", reason="no MuJoCo")\n',
    )
    assert suite.runpytest_inprocess().ret == 0
    monkeypatch.setenv('CI', 'true')
    ran = suite.runpytest_inprocess()
    ran.assert_outcomes(failed=1, passed=1, skipped=1)
    assert 'With CI=true nothing may be skipped. Skipped: no zsh' in ran.stdout.str()
    ran.stdout.fnmatch_lines(['AMISS test_whole.py is skipped with CI=true: *no MuJoCo'])
    suite.path.joinpath('test_it.py').unlink()
    assert suite.runpytest_inprocess().ret != 0
