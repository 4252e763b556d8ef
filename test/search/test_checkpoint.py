# SPDX-License-Identifier: Apache-2.0
"""A fit that was cut off goes on from its checkpoint as if it had never been."""

from contextlib import suppress
from dataclasses import replace
import os
import struct
import subprocess
import sys
import zlib

from identify_cases import After, axis, axis_data, identified, QUICK, ROOT, tripod
import numpy as np
import pytest

from ros2_ident.errors import IdentError
from ros2_ident.identify.data import read_data
from ros2_ident.identify.result import Outcome
from ros2_ident.identify.run import identify
from ros2_ident.identify.setup import problem_of
from ros2_ident.search import Budget
from ros2_ident.search.journal import digest_of, Journal


@pytest.fixture
def whole():
    return identified(3)


@pytest.mark.parametrize('questions', [4, 30])
def test_a_cancelled_run_goes_on_to_the_same_bits(tmp_path, whole, questions):
    path = tmp_path / 'fit.checkpoint'
    cut = identify(
        axis(), axis_data(), settings=QUICK, seed=3, checkpoint=path, cancel=After(questions)
    )
    assert cut.outcome is Outcome.CANCELLED
    assert cut.evaluations < whole.evaluations
    assert path.exists() or not cut.generations
    again = identify(axis(), axis_data(), settings=QUICK, seed=3, checkpoint=path)
    assert again.theta.tobytes() == whole.theta.tobytes()
    assert again.evaluations == whole.evaluations
    assert again.history.best_costs.tobytes() == whole.history.best_costs.tobytes()
    assert again.history.candidates.tobytes() == whole.history.candidates.tobytes()
    assert again.history.costs.tobytes() == whole.history.costs.tobytes()


@pytest.mark.parametrize(
    'other',
    [
        {'seed': 4},
        {'fixed': {'viscous_friction': 200.0}},
        {'outputs': {'effort': 2.0}},
        {'settings': replace(QUICK, cutoff=50.0)},
    ],
)
def test_the_checkpoint_of_another_fit_is_refused(tmp_path, other):
    path = tmp_path / 'fit.checkpoint'
    few = replace(QUICK, budget=Budget(evaluations=140))
    identify(axis(), axis_data(), settings=few, seed=3, checkpoint=path)
    before = path.read_bytes() if path.exists() else b''
    assert before
    with pytest.raises(IdentError, match='belongs to a run of other data'):
        again = {'settings': QUICK, 'seed': 3, **other}
        identify(axis(), axis_data(), **again, checkpoint=path)
    assert path.read_bytes() == before


def rubbish(value):
    return 'x' if np.ndim(value) else [value, None]


def halved(value):
    return 0.5 * value if np.asarray(value).dtype == float else value


HARMS = {
    'rubbish': rubbish,
    'another shape': lambda value: np.resize(value, (3, 2)),
    'no numbers': lambda value: np.full_like(value, -np.inf) if np.ndim(value) else np.nan,
    'forged': halved,
}


def harmed(monkeypatch, harm):
    """Let runs write records that are whole and wrong."""
    real = Journal.put

    def put(self, values, *what):
        real(self, {name: harm(value) for name, value in values.items()}, *what)

    monkeypatch.setattr(Journal, 'put', put)


@pytest.mark.parametrize('harm', HARMS)
def test_a_record_that_is_whole_and_wrong_costs_time_and_no_result(
    tmp_path, monkeypatch, whole, harm
):
    def run():
        path = tmp_path / 'fit.checkpoint'
        return identify(axis(), axis_data(), settings=QUICK, seed=3, checkpoint=path)

    with monkeypatch.context() as patch:
        harmed(patch, HARMS[harm])
        with suppress(ValueError):  # of a record of its own
            run()
    again = run()
    assert again.theta.tobytes() == whole.theta.tobytes()
    assert again.cost.refined == whole.cost.refined
    assert again.cost.ga == whole.cost.ga


@pytest.mark.parametrize('head', [b'', b'[]', b'{"plain": {}, "arrays": [["value", "O", [9]]]}'])
def test_a_record_that_is_no_record_is_none(tmp_path, head):
    path = tmp_path / 'fit.checkpoint'
    Journal(path).close()
    rest = struct.pack('<II16s', len(head), 0, digest_of('a')) + head
    with path.open('ab') as file:
        file.write(struct.pack('<I', zlib.crc32(rest)) + rest)
    with Journal(path) as journal:
        assert journal.get({}, 'a') is None


def test_candidates_of_unequal_work_go_on_to_the_same_bits(tmp_path):
    machine = tripod()
    data = read_data(ROOT / 'bags/tripod_mixed', machine)
    settings, one = replace(QUICK, refine=False), ['drive_1']
    whole = identify(machine, data, drives=one, settings=settings, seed=1)
    path = tmp_path / 'fit.checkpoint'
    few = replace(settings, budget=Budget(evaluations=100))
    identify(machine, data, drives=one, settings=few, seed=1, checkpoint=path)
    assert path.exists()
    again = identify(machine, data, drives=one, settings=settings, seed=1, checkpoint=path)
    assert np.array_equal(again.theta, whole.theta)


def test_another_process_knows_the_checkpoint_for_its_own(tmp_path):
    code = (
        'from identify_cases import axis, axis_data; '
        'from ros2_ident.identify.setup import problem_of; '
        'print(problem_of(axis(), axis_data()).key)'
    )
    other = subprocess.run(
        [sys.executable, '-c', code],
        env=os.environ | {'PYTHONHASHSEED': '1', 'PYTHONPATH': os.pathsep.join(sys.path)},
        capture_output=True,
        text=True,
        check=True,
    )
    assert other.stdout.strip() == problem_of(axis(), axis_data()).key
