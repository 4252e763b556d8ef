# SPDX-License-Identifier: Apache-2.0
"""Section 4 of the paper: settings, log, and numbers that are those of the trials."""

from dataclasses import replace

import numpy as np
import pytest

from checks.paper.tripod_findings import sign_test
from checks.paper.tripod_page import percent, REPORTED, spread, tripod_text, TripodFindings
from checks.paper.tripod_runs import Bench, Case, CASES, DriveTrial, LOUD, Plan, QUIET, TRUTH
from ros2_ident.search import GeneticSearch, GeneticSettings

SMALL = GeneticSettings(initial_population=128, survivors=4, children=4, generations=4)


@pytest.fixture(scope='module')
def bench():
    return Bench(Plan(seconds=2.0, close=(1.0, 1.5), genetic=SMALL))


def test_settings_are_those_of_table_4():
    genetic = Plan().genetic
    assert genetic.evaluations == 1728
    assert genetic.range_reduction == 0.5
    assert genetic.first_step == 1.0
    assert genetic.first_generation == 'uniform'
    assert {case.distance for case in CASES if not case.all_drives} == {0.0, 0.5}


def test_truth_and_box_are_the_papers(bench):
    assert {name: value[0] for name, value in REPORTED.items()} == TRUTH
    box = {name: bounds[:2] for name, bounds in bench.machine.bounds.items() if name in TRUTH}
    assert box == {
        'measurement_delay': (0.0, 0.1),
        'gear_stiffness': (1e2, 3e5),
        'gear_damping_ratio': (0.0, 2.0),
        'tool_mass': (1.0, 2.0),
        'drive_inertia': (5e-5, 15e-5),
    }


def test_the_paper_in_small_finds_the_truth(bench):
    trial = bench.trial(Case(QUIET, False, 0.0), 0)
    assert [name.split('.')[-1] for name in trial.names] == list(TRUTH)
    assert len(trial.costs) == len(trial.candidates) == trial.ga_evaluations == 128 + 3 * 16
    assert trial.costs.min() == pytest.approx(trial.ga_cost)
    assert trial.cost == pytest.approx(QUIET, rel=0.05)
    assert (np.abs(trial.error) < 2.0 * trial.half_width).all()
    assert not len(bench.trial(Case(QUIET, False, 0.5), 1).candidates)


def test_all_three_drives_have_gears_of_their_own(bench):
    trial = bench.trial(Case(QUIET, True, 0.0), 0)
    assert len(trial.names) == 11
    assert trial.columns('tool_mass').size == 1
    assert trial.columns('gear_stiffness').size == 3
    assert trial.cost == pytest.approx(QUIET, rel=0.05)


def test_the_delay_has_the_strongest_influence(bench):
    influence = bench.influence()
    assert max(influence, key=lambda name: influence[name]) == 'measurement_delay'


def test_in_eleven_dimensions_the_distance_binds_in_few_searches():
    same = 0
    for seed in range(10):
        costs = []
        for distance in (0.0, 0.5):
            settings = replace(Plan().genetic, min_distance=distance)
            search = GeneticSearch(11, settings, seed)
            while search.stop_reason is None:
                search.tell(np.sqrt(np.mean((search.ask() - 0.6) ** 2, axis=1)))
            costs.append(search.best_cost)
        same += costs[0] == costs[1]
    assert same > 5


def stand_in(case, seed, gain):
    names = list(TRUTH)
    if case.all_drives:
        own = ('gear_stiffness', 'gear_damping_ratio', 'drive_inertia')
        names = [n for n in names if n not in own]
        names += [f'drive_{d}.{n}' for n in own for d in (1, 2, 3)]
    truth = np.array([TRUTH[name.split('.')[-1]] for name in names])
    worse = gain if case.distance == 0.5 else 0.0
    return DriveTrial(
        seed=seed,
        names=tuple(names),
        truth=truth,
        ga=truth * 1.02,
        found=truth * 1.001,
        low=truth * 0.99,
        high=truth * 1.01,
        ga_cost=1.1 * case.noise + worse,
        cost=case.noise,
        ga_evaluations=1728,
        evaluations=1800,
        candidates=np.empty((0, len(truth))),
        costs=np.empty(0),
        generations=np.empty(0, dtype=np.int64),
    )


def text(gain):
    trials = {case: [stand_in(case, seed, gain) for seed in range(10)] for case in CASES}
    influence = dict.fromkeys(TRUTH, 0.01) | {'measurement_delay': 0.2}
    return tripod_text(
        TripodFindings(Plan(), np.tile([-1.8, 2.6], (3, 1)), np.ones(3), trials, influence)
    )


def test_the_findings_are_those_of_the_trials():
    kind, unkind = text(1e-3), text(-1e-3)
    for noise in (LOUD, QUIET):
        row = f'| d_min,0 = 0 better than 0.5, noise {noise:g} N m |'
        assert f'{row} 10 of 10, worse 0, p = 0.002, median 1 mN m |' in kind
        assert f'{row} 0 of 10, worse 10, p = 0.002, median -1 mN m |' in unkind
    assert 'measurement_delay | 0.2 |' in kind
    assert 'refined | 20 of 20 |' in kind
    assert '| tool mass m_t | 2.0 (2.0 to 2.0) | 2.0 (2.0 to 2.0) | 0.10 (0.10 to 0.10)' in kind


def test_numbers_in_words():
    assert [percent(x) for x in (0.123, 0.0123, 0.00123, -1e-5)] == ['12', '1.2', '0.12', '-0.001']
    assert spread(np.array([0.01, -0.02, 0.03])) == '1.0 (-2.0 to 3.0)'
    assert sign_test(10, 0) == pytest.approx(2.0 / 1024.0)
    assert sign_test(0, 0) == sign_test(5, 5) == 1.0
