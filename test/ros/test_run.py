# SPDX-License-Identifier: Apache-2.0
"""A run of the worker: needs no rclpy."""

from dataclasses import replace
from functools import partial
import os

from identify_cases import After, AXIS_FILE, ROOT
import numpy as np
import pytest

from ros2_ident.errors import IdentError
from ros2_ident.identify.problem import Problem
from ros2_ident.identify.settings import IdentifySettings
from ros2_ident.models import load_machine
from ros2_ident.recording import read_bag
from ros2_ident.report.overlay import SAMPLES
from ros2_ident.ros.run import allowed, carry_out, checkpoint_of, MOST, save, Wanted
from ros2_ident.search import GeneticSettings
from ros2_ident.search.journal import Journal

BAG = ROOT / 'bags/axis_reversals'
identify, diagnose = partial(carry_out, 'identify'), partial(carry_out, 'diagnose')


def test_a_pipe_in_a_goal_is_told_from_nothing(tmp_path):
    os.mkfifo(tmp_path / 'pipe')
    for name, said in (('pipe', 'is no regular file or folder'), ('none', 'does not exist')):
        with pytest.raises(IdentError, match=f"{name}: {said} on the node's machine; give"):
            allowed(str(tmp_path / name), '')


@pytest.fixture(scope='module')
def wanted():
    genetic = GeneticSettings(initial_population=64, generations=4)
    return Wanted(
        load_machine(AXIS_FILE),
        bags=(str(BAG),),
        settings=IdentifySettings(genetic=genetic, refine=False),
        preview_rate=np.inf,
    )


def test_better_and_better_candidates_are_shown_during_a_run(wanted):
    shown, heard = [], []

    def preview(simulated, residual):
        shown.append((heard[-1].best_cost, simulated, residual))

    finished = identify(wanted, None, on_progress=heard.append, on_preview=preview)
    (log,) = read_bag(BAG)
    costs = [cost for cost, _, _ in shown]
    assert costs and costs == sorted(set(costs), reverse=True)
    assert costs[-1] >= finished.result.cost.ga
    for cost, (simulated,), (residual,) in shown:
        assert 0.5 * SAMPLES < simulated.stamp.size <= SAMPLES
        row = np.searchsorted(log.effort.stamp, simulated.stamp)
        np.testing.assert_array_equal(log.effort.stamp[row], simulated.stamp)
        total = simulated.effort + residual.effort
        assert total == pytest.approx(log.effort.effort[row])
        # the samples are a fair choice: their RMS is about the candidate's cost
        assert np.sqrt(np.mean(residual.effort**2)) == pytest.approx(cost, rel=0.3)


def test_previews_leave_the_result_as_it_is(wanted):
    with_previews = identify(wanted, None, on_preview=lambda *_: None)
    without = identify(wanted, None)
    np.testing.assert_array_equal(with_previews.result.theta, without.result.theta)


class Killed(BaseException):
    """The end of the process."""


def left_in(directory):
    return sorted(x.name for x in (directory / 'unfinished').iterdir())


def test_a_goal_that_is_sent_again_after_a_kill_goes_on(wanted, tmp_path, monkeypatch):
    wanted = replace(wanted, output_directory=str(tmp_path))
    whole = identify(replace(wanted, output_directory=''), None).result
    put, records = Journal.put, iter(range(3))

    def dying(self, *what):
        if next(records, None) is None:
            raise Killed
        put(self, *what)

    with monkeypatch.context() as patch, pytest.raises(Killed):
        patch.setattr(Journal, 'put', dying)
        identify(wanted, None)
    assert len(left_in(tmp_path)) == 1
    simulated = 0
    real = Problem.costs

    def costs(self, theta, *rest):
        nonlocal simulated
        simulated += len(theta)
        return real(self, theta, *rest)

    monkeypatch.setattr(Problem, 'costs', costs)
    finished = identify(wanted, None)
    assert simulated < 0.8 * whole.evaluations, 'generations were kept'
    assert finished.result.theta.tobytes() == whole.theta.tobytes()
    save(finished)
    assert left_in(tmp_path) == []


def test_a_cancelled_goal_keeps_its_checkpoint(wanted, tmp_path):
    wanted = replace(wanted, output_directory=str(tmp_path))
    save(identify(wanted, None, cancel=After(9)))
    assert len(left_in(tmp_path)) == 1


def test_a_directory_that_cannot_be_written_costs_the_checkpoint_only(wanted, tmp_path):
    (tmp_path / 'file').write_text('in the way')
    wanted = replace(wanted, output_directory=str(tmp_path / 'file'))
    finished = identify(wanted, None)
    assert finished.checkpoint is None
    assert np.isfinite(finished.result.theta).all()


def test_checkpoints_do_not_pile_up_and_none_is_shared(tmp_path):
    for k in range(2 * MOST):
        path = checkpoint_of(str(tmp_path), f'goal {k}')
        os.utime(path, (k, k))
    assert len(left_in(tmp_path)) == MOST
    with Journal(path := checkpoint_of(str(tmp_path), 'goal'), 'key'):
        assert checkpoint_of(str(tmp_path), 'goal') is None
    assert checkpoint_of(str(tmp_path), 'goal') == path
    assert checkpoint_of('', 'goal') is None
