# SPDX-License-Identifier: Apache-2.0
from dataclasses import replace

from identify_cases import (
    axis,
    axis_bag,
    axis_data,
    recording_of,
    ROOT,
    tripod,
    tripod_bag,
)
import numpy as np
import pytest

from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.identify.data import gather
from ros2_ident.identify.problem import problem_of
from ros2_ident.recording import read_bag, Recording


def test_short_segments_are_left_out_with_a_warning():
    whole = recording_of(axis_bag())
    begin = whole.begin
    scrap = whole.between(begin + 1_000_000_000, begin + 1_200_000_000)
    data = gather([whole, scrap], axis())
    assert len(data.datasets) == 1
    assert data.recordings == (whole,)
    assert data.warnings[0].startswith('segment 2 of 2 is left out: test: lasts 0.199 s;')


def test_a_single_short_segment_is_an_error():
    whole = recording_of(axis_bag())
    begin = whole.begin + 1_000_000_000
    scrap = whole.between(begin, begin + 200_000_000)
    with pytest.raises(IdentError, match='record a motion of several seconds') as caught:
        gather([scrap], axis())
    assert caught.value.code is ErrorCode.NO_DATA


def test_a_segment_that_starts_in_motion_is_compared_later():
    whole = recording_of(axis_bag())
    command = whole.command
    assert command is not None
    speed = np.gradient(command.position[:, 0], 1e-3)
    fast = int(np.argmax(np.abs(speed[:2000])))
    moving = replace(whole.between(int(command.stamp[fast]), whole.end + 1), state=None)
    data = gather([moving], axis())
    assert np.isnan(data.datasets[0].effort[:, :299]).all()
    assert np.isfinite(data.datasets[0].effort[:, 301:]).any()
    assert 'segment 1 of 1 starts in motion: its first 0.3 s' in data.warnings[0]


@pytest.mark.parametrize('kind', ['linear_axis', 'tripod'])
def test_a_step_of_the_set_point_before_the_log_is_a_motion_where_a_model_begins_there(kind):
    tripods = kind == 'tripod'
    whole = recording_of((tripod_bag if tripods else axis_bag)())
    assert whole.command is not None
    still = np.zeros_like(whole.command.position)
    command = replace(whole.command, position=still, velocity=still)
    stepped, machine = replace(whole, command=command), (tripod if tripods else axis)()
    if tripods:  # it begins at its set-point
        with pytest.raises(IdentError, match='no drive moves'):
            gather([stepped], machine)
    else:
        assert gather([stepped], machine).datasets
        with pytest.raises(IdentError, match='no drive moves'):
            resting = replace(whole.state, position=np.zeros_like(whole.state.position))
            gather([replace(stepped, state=resting)], machine)


def test_only_the_chosen_drives_need_an_effort():
    whole = recording_of(tripod_bag())
    assert whole.effort is not None
    partial = whole.effort.effort.copy()
    partial[:, 0] = np.nan
    recording = replace(whole, effort=replace(whole.effort, effort=partial))
    assert gather([recording], tripod(), ['drive_2', 'drive_3']).datasets
    with pytest.raises(IdentError, match='no effort of drive_1') as caught:
        gather([recording], tripod(), ['drive_1'])
    assert caught.value.code is ErrorCode.MISSING_STREAM


def test_a_name_without_a_drive_means_every_drive():
    data = gather([recording_of(tripod_bag())], tripod())
    fixed = {'gear_stiffness': 1e4, 'drive_2.gear_stiffness': 2e4}
    problem = problem_of(tripod(), data, fixed=fixed, bounds={'drive_inertia': (8e-5, 1e-4)})
    assert problem.fixed == {
        'drive_1.gear_stiffness': 1e4,
        'drive_2.gear_stiffness': 2e4,
        'drive_3.gear_stiffness': 1e4,
    }
    boxes = {p.name: (p.low, p.high) for p in problem.parameters}
    assert boxes['drive_3.drive_inertia'] == (8e-5, 1e-4)
    assert boxes['tool_mass'] == (1.0, 2.0)


def test_data_of_other_drives_do_not_fit_the_machine():
    with pytest.raises(IdentError, match='the data hold emps_axis and not drive_1') as caught:
        problem_of(tripod(), axis_data())
    assert caught.value.code is ErrorCode.MISSING_STREAM


# ---------------------------------------------------------------------- a late set-point


def taken(late: float) -> Recording:
    """Return a log whose controller took its set-point `late` s after it was logged."""
    (log,) = read_bag(ROOT / 'bags/axis_reversals')
    assert log.command is not None
    command = replace(log.command, stamp=log.command.stamp - round(late * 1e9))
    return replace(log, command=command)


@pytest.mark.parametrize('late', [0.08, 0.25])
def test_a_set_point_that_is_taken_late_is_not_used(late: float) -> None:
    data = gather([taken(late)], axis())
    assert data.datasets[0].command_position is None
    (said,) = (text for text in data.warnings if 'behind' in text)
    assert said.startswith('emps_axis: the position follows its set-point ')
    assert 'the stated gains make 6.2 ms' in said


def test_a_set_point_within_a_command_delay_is_used() -> None:
    for late in (0.0, 0.02):
        assert gather([taken(late)], axis()).datasets[0].command_position is not None
