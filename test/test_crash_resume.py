# SPDX-License-Identifier: Apache-2.0
"""A run that is killed goes on, and ends with the bits it would have had.

`checks/benchmarks/kills.py` kills commands a hundred times and looks at their files.
"""

from dataclasses import replace
import subprocess
import sys

from identify_cases import axis, axis_bag, QUICK, recording_of, ROOT
import numpy as np
import pytest

from ros2_ident.effects import CATALOGUE
from ros2_ident.gap.diagnose import diagnose
from ros2_ident.identify.data import gather
from ros2_ident.identify.run import identify
from ros2_ident.report.diagnosis import to_mapping
from ros2_ident.search.journal import Journal

WITHOUT = sorted(set(CATALOGUE) - {'asymmetric_friction', 'stribeck', 'cable_spring'})


class Killed(BaseException):
    """The end of a process, as far as one process can play it."""


@pytest.fixture
def kill(monkeypatch):
    """Return a function that lets a run die at a record: before, in, or behind it."""
    real = Journal.put

    def after(count, cut=None):
        left = count

        def put(self, values, *what):
            nonlocal left
            left -= 1
            if left >= 0:
                return real(self, values, *what)
            if cut is not None:
                size = self._file.size
                real(self, values, *what)
                self._file.cut(int(size + cut * (self._file.size - size)))
            raise Killed

        monkeypatch.setattr(Journal, 'put', put)
        return lambda: monkeypatch.setattr(Journal, 'put', real)

    return after


def count_puts(monkeypatch, run):
    """Return what a run returns and how many records it writes."""
    real, count = Journal.put, 0

    def put(self, values, *what):
        nonlocal count
        count += 1
        return real(self, values, *what)

    with monkeypatch.context() as patch:
        patch.setattr(Journal, 'put', put)
        return run(), count


def gap(seconds=4.0):
    """Return data with more friction where the axis is slow: something to find."""
    (data,) = gather([recording_of(axis_bag(seconds))], axis()).datasets
    speed = data.command_velocity
    return [replace(data, effort=data.effort + 4.0 * np.sign(speed) * np.exp(-abs(speed) / 0.03))]


def bits(result):
    return (
        result.theta.tobytes(),
        result.evaluations,
        result.history.best_costs.tobytes(),
        result.history.candidates.tobytes(),
        result.history.costs.tobytes(),
        [(p.low, p.high, p.noise_low, p.noise_high) for p in result.parameters],
        result.residuals,
    )


def test_an_identification_goes_on_from_any_record(tmp_path, kill, monkeypatch):
    short = gather([recording_of(axis_bag(2.0))], axis())

    def run(path):
        return identify(axis(), short, settings=QUICK, seed=3, checkpoint=path)

    whole, records = count_puts(monkeypatch, lambda: run(tmp_path / 'whole'))
    assert records > QUICK.genetic.generations
    for count in range(0, records, 2):
        path = tmp_path / f'{count}.checkpoint'
        revive = kill(count, cut=(None, 0.3, 0.99, 1.0)[count // 2 % 4])
        with pytest.raises(Killed):
            run(path)
        revive()
        again, left = count_puts(monkeypatch, lambda path=path: run(path))
        assert bits(again) == bits(whole)
        assert left <= records - count, 'what was written is worked out again'


def diagnosed(path, **more):
    found = diagnose(axis(), gap(), without=WITHOUT, checkpoint=path, **more)
    return found, {k: v for k, v in to_mapping(found).items() if k != 'seconds'}


@pytest.fixture(scope='module')
def undisturbed(tmp_path_factory):
    """Return what is found, how many records that takes, and how often a cancel is asked for."""
    asked = 0

    def never():
        nonlocal asked
        asked += 1
        return False

    path = tmp_path_factory.mktemp('whole') / 'checkpoint'
    with pytest.MonkeyPatch.context() as patch:
        (_, whole), records = count_puts(patch, lambda: diagnosed(path, cancelled=never))
    # Along this motion acceleration does nearly what a Stribeck friction does.
    assert whole['verdict']['effect'] in ('stribeck', 'unknown')
    # Enough of them that half is in the midst of it.
    assert records > 10
    return whole, records, asked


def test_a_diagnosis_that_was_killed_goes_on(tmp_path, kill, monkeypatch, undisturbed):
    whole, records, _ = undisturbed
    revive = kill(records // 2, cut=0.5)
    with pytest.raises(Killed):
        diagnosed(tmp_path / 'checkpoint')
    revive()
    (_, again), left = count_puts(monkeypatch, lambda: diagnosed(tmp_path / 'checkpoint'))
    assert again == whole
    assert left <= records - records // 2, 'what was written is worked out again'


def test_a_command_survives_a_real_kill():
    # At records a diagnosis is stopped above; here a process ends, wherever it is.
    words = [sys.executable, str(ROOT / 'checks' / 'benchmarks' / 'kills.py'), 'identify']
    words += ['--words=--population 128 --generations 4 --no-report']
    done = subprocess.run(
        [*words, '--kills', '1', '--seed', '5'],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
