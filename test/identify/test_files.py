# SPDX-License-Identifier: Apache-2.0
from dataclasses import replace
import json
import math

from identify_cases import (
    axis,
    axis_bag,
    axis_data,
    identified,
    recording_of,
    tripod,
    tripod_bag,
)
import numpy as np
import pytest
from reader_cases import equal

from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.identify.data import gather
from ros2_ident.identify.problem import problem_of
from ros2_ident.recording import read_bag, Topics, write_bag
from ros2_ident.report.files import load_result, write_result
from ros2_ident.report.overlay import (
    overlay_streams,
    RESIDUAL,
    SIMULATED,
    withdraw_overlay,
    write_overlay,
)
from ros2_ident.report.schema import to_mapping
from ros2_ident.words.identification import message


@pytest.fixture
def result():
    return identified()


def strictly(text):
    def refuse(word):
        raise AssertionError(f'{word} is no JSON')

    return json.loads(text, parse_constant=refuse)


def test_the_json_file_has_what_it_promises(tmp_path, result):
    write_result(tmp_path / 'out', result)
    data = strictly((tmp_path / 'out' / 'result.json').read_text())
    assert data['version'] == 1
    assert data['outcome'] == 'identified'
    assert data['message'] == message(result)
    assert set(data['cost']) == {'ga', 'refined', 'unit'}
    assert data['cost']['unit'] == 'N'
    assert data['seed'] == 1
    assert data['evaluations'] == result.evaluations
    assert data['seconds'] > 0.0
    mass = data['parameters']['emps_axis.moving_mass']
    assert mass['unit'] == 'kg'
    assert mass['low'] < mass['value'] < mass['high']
    assert mass['at_bound'] is False
    assert mass['identifiable'] is True
    assert data['provenance']['machine_sha256'] == axis().digest


def test_a_result_comes_back_as_it_was(tmp_path, result):
    write_result(tmp_path, result)
    for path in (tmp_path, tmp_path / 'result.json'):
        back = load_result(path)
        assert back.parameters == result.parameters
        assert to_mapping(back) == to_mapping(result)
        assert back.history.candidates.tolist() == result.history.candidates.tolist()
        assert back.correlation == pytest.approx(result.correlation)


def test_what_is_no_number_becomes_null(tmp_path, result):
    lost = replace(
        result,
        parameters=tuple(replace(p, value=math.nan, low=-math.inf) for p in result.parameters),
        cost=replace(result.cost, ga=math.inf, refined=math.nan),
    )
    write_result(tmp_path, lost)
    data = strictly((tmp_path / 'result.json').read_text())
    assert data['cost']['ga'] is None
    assert data['parameters']['emps_axis.moving_mass']['low'] is None
    back = load_result(tmp_path)
    assert np.isnan(back.theta).all()
    assert back.cost.ga == math.inf


@pytest.mark.parametrize(
    ('change', 'text'),
    [
        (lambda d: d.update(version=99), 'has version 99 and this package reads 1'),
        (lambda d: d.pop('cost'), "'cost'); write it anew"),
        (lambda d: d.update(schema='x'), 'is no result of an identification'),
        (lambda d: d.update(parameters=[1]), 'is incomplete or changed'),
    ],
)
def test_a_changed_file_is_refused(tmp_path, result, change, text):
    data = to_mapping(result)
    change(data)
    (tmp_path / 'result.json').write_text(json.dumps(data))
    with pytest.raises(IdentError) as caught:
        load_result(tmp_path)
    assert caught.value.code is ErrorCode.BAD_VALUES
    assert text in caught.value.message


def test_half_a_file_and_none(tmp_path, result):
    with pytest.raises(IdentError, match='cannot be read') as caught:
        load_result(tmp_path)
    assert caught.value.code is ErrorCode.NO_DATA
    write_result(tmp_path, result)
    text = (tmp_path / 'result.json').read_text()
    (tmp_path / 'result.json').write_text(text[: len(text) // 2])
    with pytest.raises(IdentError, match='is damaged'):
        load_result(tmp_path)


def test_an_overlay_holds_the_log_and_what_the_simulation_says(tmp_path, result):
    problem = problem_of(axis(), axis_data())
    (path,) = write_overlay(tmp_path / 'overlay', problem, result.theta)
    (again,) = read_bag(path)
    log = recording_of(axis_bag())
    assert equal([again], [log])
    (pair,) = read_bag(path, Topics(RESIDUAL, SIMULATED, ''))
    assert pair.effort.names == pair.state.names == ('emps_axis',)
    assert set(pair.effort.stamp) <= set(log.effort.stamp)
    assert pair.effort.stamp.size > 0.99 * log.effort.stamp.size
    shared = np.isin(log.effort.stamp, pair.effort.stamp)
    total = pair.effort.effort + pair.state.effort
    assert total == pytest.approx(log.effort.effort[shared])
    rms = float(np.sqrt(np.mean(pair.state.effort**2)))
    assert rms == pytest.approx(result.residuals[0].rms, rel=0.01)


@pytest.mark.parametrize(
    ('machine', 'bag', 'constants'),
    [(axis, axis_bag, [2.0]), (tripod, tripod_bag, [2.0, 3.0, 4.0])],
)
def test_an_overlay_keeps_the_unit_of_the_log(machine, bag, constants):
    machine = replace(machine(), effort_unit='A', effort_scale=tuple(constants))
    data = gather([recording_of(bag())], machine)
    assert list(machine.effort_scales.values()) == constants
    problem = problem_of(machine, data)
    (streams,) = overlay_streams(problem, 0.5 * (problem.low + problem.high))
    log = recording_of(bag()).effort
    shared = np.isin(log.stamp, streams['simulated'].stamp)
    total = streams['simulated'].effort + streams['residual'].effort
    assert streams['simulated'].names == machine.drives == log.names
    assert total == pytest.approx(log.effort[shared])


def test_overlays_of_an_earlier_run_go_and_recorded_bags_stay(tmp_path):
    bag = axis_bag()
    streams = {'/joint_states': bag.streams['/joint_states']}
    for name in ('overlay', 'overlay_2'):
        write_bag(tmp_path / name, streams, mark='overlay')
    write_bag(tmp_path / 'overlay_3', streams)
    withdraw_overlay(tmp_path / 'overlay')
    assert [x.name for x in tmp_path.iterdir()] == ['overlay_3']
    withdraw_overlay(tmp_path / 'none' / 'overlay')
