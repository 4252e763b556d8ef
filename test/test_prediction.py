# SPDX-License-Identifier: Apache-2.0
"""Free runs: how far a model comes from a log by set-points alone."""

from dataclasses import replace
import json
from pathlib import Path

from identify_cases import (
    axis,
    axis_bag,
    axis_data,
    AXIS_FILE,
    AXIS_TRUTH,
    identified,
    QUICK,
    recording_of,
    theta_of,
)
import numpy as np
import pytest

from ros2_ident.cli.main import main
from ros2_ident.cli.predict import _picture
from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.identify.data import gather
from ros2_ident.identify.problem import problem_of
from ros2_ident.identify.run import identify
from ros2_ident.models import load_machine, make_model
from ros2_ident.prediction import (
    CHECK,
    IDENTIFIED,
    LOG,
    predicted,
    Prediction,
)
from ros2_ident.recording import Dataset
from ros2_ident.report.files import load_result, write_result
from ros2_ident.report.page.assemble import write_report
from ros2_ident.report.schema import read, to_mapping


def run_of(machine, bag, truth, **changes):
    (data,) = gather([recording_of(bag)], machine).datasets
    model = make_model(machine, replace(data, **changes))
    return model, theta_of([p.name for p in model.parameters], truth)


def test_errors_are_those_of_each_quantity_along_the_log() -> None:
    model, theta = run_of(axis(), axis_bag(), AXIS_TRUTH)
    wrong = theta * np.array([1.2, 1.0, 1.0, 1.0])
    found = predicted('log', [('true', [(model, theta)]), ('heavy', [(model, wrong)])])
    assert [row[0].quantity for row in found.rows] == ['position', 'velocity', 'effort']
    assert found.quantity == 'position'
    # of a model of its own that compares that quantity
    alone = make_model(axis(), model.data, quantities=('position',))
    there = np.isfinite(alone.measured[0])
    left = (alone.measured - alone.simulate(wrong[None])[0])[0, there]
    true, heavy = found.first[0]
    assert heavy.samples == there.sum()
    assert heavy.rmse == pytest.approx(np.sqrt(np.mean(left**2)), rel=1e-12)
    assert heavy.mae == pytest.approx(np.mean(np.abs(left)), rel=1e-12)
    assert true.rmse < 0.1 * heavy.rmse
    stages = [('_a$$', [(model, theta)]), ('heavy', [(model, wrong)])]
    legend = _picture(found, stages).axes[0].get_legend()
    assert [x.get_text() for x in legend.get_texts()] == ['measured', '_a$$', 'heavy']
    # the model that was fitted compares what it did
    assert [o.quantity for o in model.outputs] == ['effort']


def test_a_model_along_its_recorded_motion_says_what_to_log() -> None:
    model, theta = run_of(
        axis(), axis_bag(), AXIS_TRUTH, command_position=None, command_velocity=None
    )
    found = predicted('log', [('true', [(model, theta)])])
    assert not found.stages and not found.first and found.quantity == ''
    assert 'joint_command' in found.hindered


def test_a_candidate_that_diverges_is_infinitely_far_in_the_file_too() -> None:
    model, theta = run_of(axis(), axis_bag(), AXIS_TRUTH)
    found = predicted('log', [('true', [(model, theta)]), ('bad', [(model, np.nan * theta)])])
    assert np.isinf(found.first[0][1].rmse)
    problem = problem_of(axis(), axis_data())
    result = replace(identified(), prediction=found)
    assert problem.names == tuple(p.name for p in result.parameters)
    assert read(Prediction, json.loads(json.dumps(to_mapping(result)['prediction']))) == found


def test_an_identification_predicts_what_it_is_judged_on(tmp_path: Path) -> None:
    alone = identified()
    assert alone.prediction.on == LOG
    other = gather([replace(recording_of(axis_bag(3.0)), source='other')], axis())
    found = identify(axis(), axis_data(), settings=QUICK, seed=1, check=other)
    assert found.prediction.on == CHECK
    assert [s.label for s in found.prediction.stages] == [IDENTIFIED]
    assert found.prediction.first[0][0].samples < alone.prediction.first[0][0].samples
    write_result(tmp_path, found)
    assert load_result(tmp_path).prediction == found.prediction
    page = write_report(tmp_path).read_text(encoding='utf-8')
    assert page.count('Free run') == 1 and 'RMSE, identified' in page
    write_result(tmp_path, replace(found, prediction=Prediction(CHECK, hindered='no set-point')))
    assert 'No free run: no set-point.' in write_report(tmp_path).read_text(encoding='utf-8')


@pytest.fixture
def pushed(tmp_path: Path):
    """The axis, moved by its logged effort."""
    text = AXIS_FILE.read_text(encoding='utf-8').replace('law: cascade_p', 'law: effort')
    path = tmp_path / 'axis.yaml'
    lines = [line for line in text.splitlines() if '_gain:' not in line]
    path.write_text('\n'.join(lines), encoding='utf-8')
    return load_machine(path)


def test_an_effort_moves_the_axis_as_the_equation_of_motion_says(pushed) -> None:
    (data,) = gather([recording_of(axis_bag())], pushed, quantities=('position',)).datasets
    assert data.command_position is None
    model = make_model(pushed, data, quantities=('position',))
    theta = theta_of([p.name for p in model.parameters], AXIS_TRUTH)
    found = predicted('log', [('true', [(model, theta)])])
    assert [row[0].quantity for row in found.rows] == ['position', 'velocity']
    mass, viscous, coulomb, constant = theta
    effort = data.effort[0].copy()
    for k in np.flatnonzero(np.isnan(effort)):
        effort[k] = effort[k - 1] if k else effort[1]
    # Euler's steps, 1/40 of a cycle; from where the model starts
    simulated = model.simulate(theta[None])[0, 0]
    place, speed, far, step = simulated[0], 0.0, 0.0, data.cycle / 40
    for k, force in enumerate(effort):
        far = max(far, abs(place - simulated[k]))
        for _ in range(40):
            friction = coulomb * np.tanh(speed / 1e-3) + viscous * speed + constant
            speed += step * (force - friction) / mass
            place += step * speed
    assert far < 1e-3 * np.ptp(simulated)
    # and the noise of the effort leads astray no further
    assert found.first[0][0].rmse < 1e-2 * np.ptp(data.position[0][~np.isnan(data.position[0])])


def test_an_axis_whose_friction_has_no_width_moves_and_stops_as_newton_says(pushed) -> None:
    cycle, mass, coulomb = 1e-3, 95.0, 20.0
    time = cycle * np.arange(4000)
    push = np.where(time < 1.0, 0.9, np.where(time < 2.0, 2.0, np.where(time < 2.5, 0.0, -0.9)))
    still = np.zeros((1, len(time)))
    data = Dataset(pushed.drives, cycle, 0, None, None, still, None, coulomb * push[None])
    model = make_model(
        pushed.with_constants(coulomb_regularisation=0.0), data, quantities=('position',)
    )
    truth = {'moving_mass': mass, 'coulomb_friction': coulomb}
    theta = np.array([[truth.get(p.name.rpartition('.')[2], 0.0) for p in model.parameters]])
    simulated = model.simulate(theta)[0, 0]
    # It stands, slides for a second, is braked by friction, then by the effort too, and stands.
    assert np.ptp(simulated[:1000]) < 1e-12
    way = 0.5 + 0.375 + 0.125 / 1.9
    assert simulated[3000] == pytest.approx(way * coulomb / mass, rel=5e-3)
    assert np.ptp(simulated[3000:]) < 1e-12


def test_an_effort_that_moves_the_axis_is_not_compared(pushed) -> None:
    with pytest.raises(IdentError, match='--outputs position') as caught:
        make_model(pushed, axis_data().datasets[0])
    assert caught.value.code is ErrorCode.INVALID_GOAL
    lacking = replace(axis_data().datasets[0], effort=None)
    with pytest.raises(IdentError, match='none is logged') as caught:
        make_model(pushed, lacking, quantities=('position',))
    assert caught.value.code is ErrorCode.MISSING_STREAM


def test_the_command_says_what_the_result_says(tmp_path: Path, capsys) -> None:
    words = ['identify', 'bags/axis_reversals', '--machine', 'config/emps.yaml', '--quiet']
    words += ['--no-report', '--no-overlay', '--population', '64', '--generations', '4']
    assert main([*words, '--out', str(tmp_path / '$$')]) == 0
    said = capsys.readouterr().out
    assert 'free run of the log fitted on, position RMSE, identified: emps_axis ' in said
    result = load_result(tmp_path / '$$')
    out = tmp_path / 'out'
    words = ['predict', 'bags/axis_reversals', '--from', str(tmp_path / '$$'), '--out', str(out)]
    assert main([*words, '--from', str(tmp_path / '$$' / 'result.json')]) == 0
    assert (out / 'prediction.png').read_bytes().startswith(b'\x89PNG')
    found = read(Prediction, json.loads((out / 'prediction.json').read_text(encoding='utf-8')))
    first, second = found.stages
    assert first.errors == second.errors == result.prediction.stages[0].errors
    capsys.readouterr()
    assert main([*words, '--command-topic', 'none']) == 1
    assert capsys.readouterr().out.startswith('no free run: without a set-point')
