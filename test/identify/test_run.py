# SPDX-License-Identifier: Apache-2.0
from dataclasses import replace
import math
import threading

from identify_cases import (
    axis,
    axis_bag,
    axis_data,
    AXIS_FILE,
    AXIS_TRUTH,
    identified,
    QUICK,
    recording_of,
    SHARED,
    tripod,
    tripod_bag,
    TRIPOD_TRUTH,
)
import numpy as np
import pytest
from values import parameter

from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.identify.data import gather
from ros2_ident.identify.result import Outcome
from ros2_ident.identify.run import identify, IdentifyProgress, read_data
from ros2_ident.models import load_machine
from ros2_ident.search import Budget, GeneticSettings
from ros2_ident.words.identification import message


def test_axis_is_identified_within_its_intervals():
    result = identified()
    assert result.outcome is Outcome.IDENTIFIED
    assert message(result) == 'All 4 parameters are identified.'
    for estimate in result.parameters:
        truth = AXIS_TRUTH[estimate.name.rpartition('.')[2]]
        half = 0.5 * (estimate.high - estimate.low)
        assert abs(estimate.value - truth) < 2.0 * half, estimate.name
        assert estimate.identifiable
        assert not estimate.at_bound
        assert estimate.note == ''
    assert result.cost.refined <= result.cost.ga
    assert result.cost.refined == pytest.approx(axis().effort_noise, rel=0.1)
    assert result.residuals[0].drive == 'emps_axis'
    assert 0.0 < result.residuals[0].share < 0.05
    assert result.evaluations >= len(result.history.costs) == 64 + 3 * 32
    assert result.provenance.machine_sha256 == axis().digest
    assert result.quality.missing['effort'] < 0.01
    assert result.quality.warnings == () and {g.level for g in result.gates} == {'ok'}


def test_same_seed_gives_the_same_bits_on_one_and_two_threads():
    runs = [
        identify(axis(), axis_data(), settings=replace(QUICK, threads=threads), seed=3)
        for threads in (1, 2)
    ]
    for other in (runs[1], identified(3)):
        assert other.theta.tobytes() == runs[0].theta.tobytes()
        assert other.parameters == runs[0].parameters
        assert other.cost == runs[0].cost
        assert other.history.costs.tolist() == runs[0].history.costs.tolist()


def test_tripod_drive_alone_takes_the_others_from_their_recorded_motion():
    data = gather([recording_of(tripod_bag())], tripod(), ['drive_2'])
    settings = replace(QUICK, genetic=GeneticSettings(initial_population=256, generations=6))
    result = identify(tripod(), data, drives=['drive_2'], settings=settings, seed=1)
    assert result.drives == ('drive_2',)
    assert result.cost.refined == pytest.approx(0.01, rel=0.1)
    assert parameter(result, 'tool_mass').value == pytest.approx(
        TRIPOD_TRUTH['tool_mass'], rel=0.02
    )
    stiffness = parameter(result, 'drive_2.gear_stiffness').value
    assert stiffness == pytest.approx(TRIPOD_TRUTH['gear_stiffness'], rel=0.02)


def test_without_a_command_the_recorded_motion_drives_the_axis():
    data = gather([recording_of(axis_bag(), command=None)], axis())
    result = identify(axis(), data, settings=QUICK, seed=1)
    assert parameter(result, 'emps_axis.moving_mass').value == pytest.approx(95.0, rel=0.02)
    assert result.outcome is Outcome.IDENTIFIED
    assert [w for w in result.quality.warnings if w.startswith('no command is used')]


def test_two_segments_are_one_problem():
    one = recording_of(axis_bag())
    result = identify(axis(), [one, one], settings=QUICK, seed=1)
    single = identify(axis(), [one], settings=QUICK, seed=1)
    assert result.quality.segments == 2
    assert result.residuals[0].samples == 2 * single.residuals[0].samples
    assert result.theta == pytest.approx(single.theta, rel=1e-6)
    mass = [parameter(r, 'emps_axis.moving_mass') for r in (result, single)]
    # Of noise alone: noise that comes twice is no noise.
    narrower = (mass[0].noise_high - mass[0].noise_low) / (mass[1].noise_high - mass[1].noise_low)
    assert narrower == pytest.approx(math.sqrt(0.5), rel=0.05)


def test_an_estimate_at_its_bound_is_said():
    result = identify(
        axis(), axis_data(), bounds={'viscous_friction': (0.0, 100.0)}, settings=QUICK
    )
    estimate = parameter(result, 'emps_axis.viscous_friction')
    assert estimate.value == 100.0
    assert estimate.at_bound
    assert 'at its upper bound' in estimate.note
    assert 'N s/m) lies at a bound: the true value can lie beyond' in message(result)


def test_a_parameter_that_the_data_do_not_determine_is_said():
    result = identify(
        axis(), axis_data(), bounds={'moving_mass': (94.9999, 95.0001)}, settings=QUICK
    )
    assert result.outcome is Outcome.NOT_IDENTIFIABLE
    estimate = parameter(result, 'emps_axis.moving_mass')
    assert not estimate.identifiable
    assert 'not identifiable from this data' in estimate.note
    assert 'does not determine 1 of 4 parameters: emps_axis.moving_mass;' in message(result)
    assert result.outcome.error_code is ErrorCode.NOT_IDENTIFIABLE


def test_where_everything_diverges_there_is_no_estimate():
    machine = axis().with_constants(velocity_gain=1e300, torque_limit=math.inf)
    result = identify(machine, axis_data(), settings=QUICK)
    assert result.outcome is Outcome.DIVERGED
    assert np.isnan(result.theta).all()
    assert result.residuals == ()
    assert 'narrow the bounds' in message(result)


def test_cancel_keeps_the_best_so_far_and_ends_the_generation():
    cancel = threading.Event()

    def watch(progress: IdentifyProgress) -> None:
        if progress.evaluations >= 100 and not cancel.is_set():
            cancel.set()

    settings = replace(QUICK, genetic=GeneticSettings(initial_population=100_000))
    result = identify(
        axis(), axis_data(), settings=settings, cancel=cancel, on_progress=watch, seed=5
    )
    assert result.outcome is Outcome.CANCELLED
    assert result.evaluations < 10_000, 'a tenth of the first generation'
    assert result.outcome.error_code is ErrorCode.CANCELLED
    assert np.isfinite(result.theta).all()
    assert math.isfinite(result.cost.ga)
    assert math.isnan(result.cost.refined)
    assert result.parameters[0].note == 'interval not computed: the run was cut short'


@pytest.mark.parametrize('evaluations', [50, 150, 400])
def test_the_budget_of_evaluations_holds_for_both_phases(evaluations):
    settings = replace(QUICK, budget=Budget(evaluations=evaluations))
    result = identify(axis(), axis_data(), settings=settings)
    assert result.evaluations <= evaluations
    enough = evaluations >= 400
    assert result.outcome is (Outcome.IDENTIFIED if enough else Outcome.BUDGET_SPENT)


def test_the_budget_of_seconds_is_kept():
    settings = replace(
        QUICK, genetic=GeneticSettings(initial_population=100_000), budget=Budget(seconds=1.0)
    )
    result = identify(axis(), axis_data(), settings=settings)
    assert result.outcome is Outcome.BUDGET_SPENT
    assert result.evaluations < 100_000


def test_without_refinement_there_are_intervals_all_the_same():
    result = identify(axis(), axis_data(), settings=replace(QUICK, refine=False))
    assert math.isnan(result.cost.refined)
    assert result.best_cost == result.cost.ga
    assert [p.value for p in result.parameters] == [p.ga_value for p in result.parameters]
    assert np.isfinite([p.low for p in result.parameters]).all()


def test_progress_tells_both_phases():
    seen: list[IdentifyProgress] = []
    settings = replace(QUICK, genetic=GeneticSettings(initial_population=512, generations=3))
    identify(axis(), axis_data(), settings=settings, on_progress=seen.append)
    assert seen[0].phase == 'search'
    assert all(p.evaluations <= p.budget for p in seen)
    assert all(len(p.names) == len(p.best_theta) for p in seen)
    assert [p.best_cost for p in seen] == sorted((p.best_cost for p in seen), reverse=True)
    *fitted, last = seen
    assert last.phase == 'intervals' and last.eta > 0.0
    assert {p.phase for p in fitted} <= {'search', 'refinement'}
    assert all(math.isnan(p.eta) or p.eta > 0.0 for p in fitted)


@pytest.mark.parametrize(
    ('arguments', 'code', 'text'),
    [
        (
            {'drives': []},
            ErrorCode.INVALID_GOAL,
            'no drive is chosen; name at least one of emps_axis',
        ),
        ({'drives': ['x']}, ErrorCode.INVALID_GOAL, "drive 'x' is not in the machine file"),
        ({'drives': ['emps_axis'] * 2}, ErrorCode.INVALID_GOAL, 'name each only once'),
        ({'fixed': {'mass': 1.0}}, ErrorCode.UNKNOWN_PARAMETER, "'mass' cannot be fixed: no such"),
        ({'fixed': {'moving_mass': math.nan}}, ErrorCode.INVALID_GOAL, 'give a finite number'),
        ({'fixed': AXIS_TRUTH}, ErrorCode.INVALID_GOAL, 'every parameter is fixed'),
        ({'bounds': {'q': (0, 1)}}, ErrorCode.UNKNOWN_PARAMETER, "'q' cannot be bounded"),
        (
            {'bounds': {'moving_mass': (2.0, 1.0)}},
            ErrorCode.INVALID_GOAL,
            'has the bounds 2 to 1;',
        ),
        (
            {'bounds': {'moving_mass': (1.0, 2.0)}, 'fixed': {'moving_mass': 1.0}},
            ErrorCode.INVALID_GOAL,
            'is both fixed and bounded',
        ),
        ({'seed': -1}, ErrorCode.INVALID_GOAL, 'seed is -1; give a whole number'),
    ],
)
def test_wrong_use_is_refused_before_anything_is_simulated(arguments, code, text):
    with pytest.raises(IdentError) as caught:
        identify(axis(), axis_data(), settings=QUICK, **arguments)
    assert caught.value.code is code
    assert text in caught.value.message


@pytest.mark.skipif(not (SHARED / 'data' / 'emps_train').exists(), reason='no ../shared/data here')
def test_emps_comes_out_as_published():
    machine = load_machine(AXIS_FILE)
    result = identify(machine, read_data(SHARED / 'data' / 'emps_train', machine), seed=1)
    published = {
        'moving_mass': (95.1089, 0.01),
        'viscous_friction': (203.5034, 0.04),
        'coulomb_friction': (20.3935, 0.04),
        'constant_force': (-3.1648, 0.05),
    }
    for name, (value, tolerance) in published.items():
        found = parameter(result, f'emps_axis.{name}')
        assert found.value == pytest.approx(value, rel=tolerance)
        assert found.low < value < found.high
    # It trades with what the model lacks, but by no more than half.
    friction = parameter(result, 'emps_axis.coulomb_friction')
    assert friction.low < 16.0 < friction.noise_low
    assert friction.high - friction.low < friction.value and friction.hidden
    assert result.residuals[0].share < 0.045


def test_what_the_model_leaves_out_is_pointed_at():
    (first,) = axis_data().datasets
    rate = first.command_velocity
    stribeck = 4.0 * np.exp(-((rate / 0.05) ** 2)) * np.tanh(rate / 0.002)
    data = replace(axis_data(), datasets=(replace(first, effort=first.effort + stribeck),))
    warnings = identify(axis(), data, settings=QUICK).quality.warnings
    (warning,) = [w for w in warnings if 'catalogue' in w]
    assert warning.startswith('emps_axis: effects of the catalogue predict 0.')
    assert '`ident diagnose`' in warning


def test_noise_that_is_stated_wrongly_is_told():
    machine = replace(axis(), effort_noise=0.1)
    warnings = identify(machine, axis_data(), settings=QUICK).quality.warnings
    assert warnings == (
        'emps_axis: the noise of the log is 0.3 N, and the machine file states 0.1 N '
        '(effort_noise); the log decides',
    )
    machine = replace(machine, given=machine.given - {'effort_noise'})
    assert identify(machine, axis_data(), settings=QUICK).quality.warnings == ()
