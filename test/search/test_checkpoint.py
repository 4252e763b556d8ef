# SPDX-License-Identifier: Apache-2.0
"""A fit that was cut off goes on from its checkpoint as if it had never been."""

from dataclasses import replace
import os
import subprocess
import sys

from identify_cases import After, axis, axis_data, identified, QUICK
import pytest

from ros2_ident.errors import IdentError
from ros2_ident.identify.problem import problem_of
from ros2_ident.identify.result import Outcome
from ros2_ident.identify.run import identify
from ros2_ident.search import Budget


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


def test_another_process_knows_the_checkpoint_for_its_own(tmp_path):
    code = (
        'from identify_cases import axis, axis_data; '
        'from ros2_ident.identify.problem import problem_of; '
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
