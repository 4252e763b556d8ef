# SPDX-License-Identifier: Apache-2.0
"""The held-out error: what an estimate leaves of data that it was not fitted on."""

from dataclasses import replace

from identify_cases import axis, axis_bag, axis_data, AXIS_TRUTH, identified, QUICK, recording_of
import numpy as np
import pytest

from checks.reference.bag_making import simulate_bag
from ros2_ident.cli.main import main
from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.identify.data import gather
from ros2_ident.identify.hidden import missing_beside
from ros2_ident.identify.layout import Conditions
from ros2_ident.identify.problem import problem_of
from ros2_ident.identify.run import identify, QUARTERS, quarters
from ros2_ident.report.files import load_result
from ros2_ident.report.signals import load_signals
from ros2_ident.search.fit import fit
from ros2_ident.simulate.bag import nuisance_of
from ros2_ident.simulate.motions import draw_motion


@pytest.fixture
def found():
    return identified()


def another(effort: float = 1.0):
    """Return a log of another motion of the axis, its effort times a factor."""
    machine = axis()
    motion = draw_motion('reversals', machine, 3.0, 5)
    nuisance = replace(nuisance_of(machine), position_step=1e-8)
    bag = simulate_bag(machine, AXIS_TRUTH, motion, 6, nuisance)
    recording = recording_of(bag)
    stream = replace(recording.effort, effort=effort * recording.effort.effort)
    return gather([replace(recording, effort=stream, source='other')], machine)


def test_a_quarter_left_out_is_predicted_as_a_fit_of_the_others_does(found) -> None:
    problem = problem_of(axis(), axis_data())
    weighed = missing_beside(problem, found.theta)
    left = quarters(problem, weighed, found.theta)
    blocks = weighed.rows.blocks
    out = 4 * (blocks - blocks[0]) // (int(np.ptp(blocks)) + 1) == 2
    (mask,) = weighed.rows.masks
    others, own = mask.copy(), np.full_like(mask, False)
    own[0, np.flatnonzero(mask[0])[out]] = True
    others &= ~own
    # the same fit anew, without that quarter
    rest = problem_of(axis(), axis_data())
    rest.models = tuple(m.restricted(others) for m in problem.models)
    rest.series = (int(others.sum()),)
    alone = fit(rest, QUICK, 1)
    (model,) = problem.models
    truth = model.restricted(own).residuals(alone.theta[None, :])[0]
    fitted = weighed.residual[out]
    assert np.abs(left[out] - truth).max() < 0.02 * np.abs(left[out] - fitted).max()


def test_it_is_above_the_residual_of_the_fit_and_the_estimate_is_that_of_all(found) -> None:
    (inside,), (outside,) = found.residuals, found.validation
    assert found.validated_on == QUARTERS
    assert inside.rms < outside.rms < 1.02 * inside.rms
    assert outside.share / inside.share == pytest.approx(outside.rms / inside.rms)


def test_a_model_too_free_for_its_log_is_found_out() -> None:
    """The start of a log says nothing of an offset that is there only later."""
    data = axis_data()
    (dataset,) = data.datasets
    effort = dataset.effort.copy()
    effort[:, 3 * effort.shape[1] // 4 :] += 30.0
    changed = replace(data, datasets=(replace(dataset, effort=effort),))
    result = identify(axis(), changed, settings=QUICK, seed=1)
    assert result.validation[0].rms > 1.3 * result.residuals[0].rms


def test_a_check_bag_is_judged_on_and_not_fitted_to(found) -> None:
    same = identify(axis(), axis_data(), settings=QUICK, seed=1, check=another())
    off = identify(axis(), axis_data(), settings=QUICK, seed=1, check=another(1.1))
    assert same.theta.tobytes() == off.theta.tobytes() == found.theta.tobytes()
    assert same.validated_on == 'other'
    assert same.validation[0].rms == pytest.approx(found.residuals[0].rms, rel=0.1)
    assert off.validation[0].rms > 3.0 * same.validation[0].rms


def test_a_value_of_its_own_in_every_bag_predicts_no_other() -> None:
    both = gather([recording_of(axis_bag(), source=k) for k in 'ab'], axis())
    with pytest.raises(IdentError, match='moving_mass has a value of its own') as caught:
        identify(
            axis(),
            both,
            conditions=Conditions(('moving_mass',)),
            settings=QUICK,
            check=another(),
        )
    assert caught.value.code is ErrorCode.INVALID_GOAL


def test_the_command_writes_and_says_it(found, tmp_path, capsys) -> None:
    words = ['identify', 'bags/axis_reversals', '--machine', 'config/emps.yaml', '--quiet']
    words += ['--check', 'bags/axis_reversals', '--out', str(tmp_path), '--no-report']
    words += ['--no-overlay', '--population', '64', '--generations', '4']
    assert main(words) == 0
    said = capsys.readouterr().out
    result = load_result(tmp_path)
    # the same bag: nothing was left out
    assert result.validation == result.residuals
    assert f'; held out {result.validation[0].rms:.5g} N\n' in said
    left = result.residuals[0]
    share, size = 100.0 * left.share, left.rms / left.share
    whole = f'{share:.3g} % of the effort compared, {size:.3g} N RMS; held out'
    assert whole in said
    assert 'held out: bags/axis_reversals\n' in said
    titles = [r.title for r in load_signals(tmp_path / 'signals.npz').recordings]
    assert titles == ['fitted to', 'held out']
    assert result.settings['check_bags'] == ['bags/axis_reversals']
