# SPDX-License-Identifier: Apache-2.0
"""A run of the worker: needs no rclpy."""

from dataclasses import replace

from identify_cases import AXIS_FILE, ROOT
import numpy as np
import pytest

from ros2_ident.identify.settings import IdentifyProgress, IdentifySettings
from ros2_ident.models import load_machine
from ros2_ident.recording import read_bag
from ros2_ident.ros.run import Preview, PREVIEW_SAMPLES, Request, run
from ros2_ident.search import GeneticSettings

BAG = ROOT / 'bags/axis_reversals'


@pytest.fixture(scope='module')
def request_():
    return Request(
        machine=load_machine(AXIS_FILE),
        machine_text='',
        drives=('emps_axis',),
        bag_paths=(str(BAG),),
        settings=IdentifySettings(
            genetic=GeneticSettings(initial_population=64, generations=4), refine=False
        ),
    )


def test_better_and_better_candidates_are_shown_during_a_run(request_):
    shown, heard = [], []

    def preview(simulated, residual):
        shown.append((heard[-1].best_cost, simulated, residual))

    finished = run(
        request_, None, on_progress=heard.append, on_preview=preview, preview_period=0.0
    )
    (log,) = read_bag(BAG)
    costs = [cost for cost, _, _ in shown]
    assert costs and costs == sorted(set(costs), reverse=True)
    assert costs[-1] >= finished.identification.cost.ga
    for cost, (simulated,), (residual,) in shown:
        assert 0.5 * PREVIEW_SAMPLES < simulated.stamp.size <= PREVIEW_SAMPLES
        row = np.searchsorted(log.effort.stamp, simulated.stamp)
        np.testing.assert_array_equal(log.effort.stamp[row], simulated.stamp)
        total = simulated.effort + residual.effort
        assert total == pytest.approx(log.effort.effort[row])
        # the samples are a fair choice: their RMS is about the candidate's cost
        assert np.sqrt(np.mean(residual.effort**2)) == pytest.approx(cost, rel=0.3)


def test_previews_leave_the_result_as_it_is(request_):
    with_previews = run(request_, None, on_preview=lambda *_: None, preview_period=0.0)
    without = run(request_, None)
    np.testing.assert_array_equal(with_previews.identification.theta, without.identification.theta)


def progress(cost, theta):
    return IdentifyProgress('search', 1, 1, 1, 1, cost, 'N', (), theta, 0.0, 0.0, 0.0)


def test_a_preview_waits_for_its_period_and_for_something_better(request_, monkeypatch):
    monkeypatch.setattr('ros2_ident.ros.run.PREVIEW_SHARE', np.inf)
    data = run(request_, None).data
    problem = request_.problem(data)
    theta = 0.5 * (problem.low + problem.high)
    shown = []
    soon = Preview(problem, lambda *x: shown.append(x), 0.0)
    soon(progress(np.inf, theta))
    assert not shown
    soon(progress(2.0, theta))
    soon(progress(2.0, theta))
    assert len(shown) == 1
    soon(progress(1.0, theta))
    assert len(shown) == 2
    late = Preview(problem, lambda *x: shown.append(x), 1e6)
    late(progress(2.0, theta))
    late(progress(1.0, theta))
    assert len(shown) == 3


def test_a_run_without_previews_and_progress(request_):
    assert run(replace(request_, seed=5), None).identification.seed == 5
