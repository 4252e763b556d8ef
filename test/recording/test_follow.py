# SPDX-License-Identifier: Apache-2.0
"""Set-points between their samples, and those that follow a trajectory."""

import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline, make_interp_spline

from ros2_ident.errors import IdentError
from ros2_ident.recording import smooth_motion
from ros2_ident.recording.limits import Limits
from ros2_ident.recording.setpoint import _fill_holds, _smooth, find_steps, interpolate_setpoint
from ros2_ident.recording.smooth import allowed_cutoff, low_pass
from ros2_ident.recording.trajectory import _run_through, set_points, Trajectory

MS = 1_000_000
TIME = 0.01 * np.arange(40)
GRID = 0.001 * np.arange(-20, 420)


def wave(time):
    return np.sin(7.0 * time) + 0.2 * time


# ---------------------------------------------------------------------- steps


def steps_of(*values, time=None):
    values = np.array(values, dtype=float)
    return find_steps(np.arange(values.size) * 1.0 if time is None else time, values).tolist()


def test_a_step_changes_more_than_eight_times_what_its_neighbours_do():
    assert steps_of(0, 0, 0, 5, 5, 5) == [2]
    assert steps_of(0, 1, 2, 10.1, 11, 12) == [2]
    assert steps_of(0, 1, 2, 9.9, 11, 12) == []
    # Two on each side count, not three.
    assert steps_of(0, 2, 4, 4, 14, 14, 14) == []
    assert steps_of(0, 2, 4, 4, 4, 14, 14, 14) == [4]
    assert steps_of(0, 0, 0, 10, 10, 8, 8) == []
    assert steps_of(0, 0, 0, 10, 10, 10, 8) == [2, 5]
    assert steps_of(0, 5, 5, 5) == [0] and steps_of(0, 0, 0, 5) == [2]
    assert steps_of(0, 0, 5) == []


def test_a_step_is_one_per_time_and_of_some_size():
    # The same change over a time ten times as long is none.
    assert steps_of(0, 1, 2, 12, 13, 14, time=np.array([0, 1, 2, 3, 4, 5.0])) == [2]
    assert steps_of(0, 1, 2, 12, 13, 14, time=np.array([0, 1, 2, 12, 13, 14.0])) == []
    assert steps_of(0, 0, 0, 0.9e-3, 0.9e-3, 0.9e-3, 0.9e-3, 1, 1, 1) == [6]
    assert steps_of(0, 0, 0, 1.1e-3, 1.1e-3, 1.1e-3, 1.1e-3, 1, 1, 1) == [2, 6]


# ---------------------------------------------------------------------- between samples


def test_even_samples_are_joined_by_a_quintic_and_uneven_ones_by_a_cubic():
    rng = np.random.default_rng(0)
    uneven = TIME + np.where(rng.random(40) < 0.3, 2e-3, 0.0)
    for time, degree in ((TIME, 5), (uneven, 3)):
        found, rate = interpolate_setpoint(time, wave(time), None, GRID)
        inside = np.clip(GRID, time[0], time[-1])
        spline = make_interp_spline(time, wave(time), k=degree)
        np.testing.assert_allclose(found, spline(inside), atol=1e-12)
        there = np.abs(GRID - inside) < 1e-9
        np.testing.assert_allclose(rate[there], spline(inside, 1)[there], atol=1e-9)
        assert (rate[~there] == 0.0).all()


@pytest.mark.parametrize(('size', 'degree'), [(1, 0), (2, 1), (3, 1), (4, 3), (5, 3), (6, 5)])
def test_few_samples_are_joined_as_far_as_they_go(size, degree):
    time, values = TIME[:size], wave(TIME[:size])
    fit, slope = _smooth(time, values, None)
    at = np.linspace(time[0], time[-1], 7)
    if degree == 0:
        assert fit(at).tolist() == [values[0]] * 7 and slope(at).tolist() == [0.0] * 7
        fit, slope = _smooth(time, values, np.array([2.5]))
        assert slope(at).tolist() == [2.5] * 7
        return
    spline = make_interp_spline(time, values, k=degree)
    np.testing.assert_allclose(fit(at), spline(at), atol=1e-14)
    np.testing.assert_allclose(slope(at), spline(at, 1), atol=1e-12)


def test_mostly_even_samples_count_as_even():
    for moved, degree in ((1, 5), (3, 3)):
        time = TIME.copy()
        time[10 : 10 + 4 * moved : 4] += 1e-4
        fit, _ = _smooth(time, wave(time), None)
        expected = make_interp_spline(time, wave(time), k=degree)
        np.testing.assert_allclose(fit(GRID[30:60]), expected(GRID[30:60]), atol=1e-13)


def test_a_logged_velocity_is_met():
    speed = 7.0 * np.cos(7.0 * TIME) + 0.2
    found, rate = interpolate_setpoint(TIME, wave(TIME), speed, GRID)
    spline = CubicHermiteSpline(TIME, wave(TIME), speed)
    inside = np.clip(GRID, 0.0, TIME[-1])
    np.testing.assert_allclose(found, spline(inside))
    np.testing.assert_allclose(rate[21:400], spline(inside, 1)[21:400], atol=1e-9)


def test_a_step_is_held_to_the_cycle_that_shows_it():
    values = np.where(TIME < 0.2, 0.0, 1.0)
    found, rate = interpolate_setpoint(TIME, values, None, GRID)
    assert found[GRID < 0.2 - 1e-9].tolist() == [0.0] * int((GRID < 0.2 - 1e-9).sum())
    np.testing.assert_allclose(found[GRID > 0.2 - 1e-9], 1.0)
    np.testing.assert_allclose(rate, 0.0, atol=1e-9)
    # Rounding of the times is no cycle.
    late = TIME + 3e-10
    again, _ = interpolate_setpoint(late, values, None, GRID)
    np.testing.assert_allclose(again, found, atol=1e-6)
    single, speed = interpolate_setpoint(TIME[:1], np.array([2.0]), None, GRID[:1])
    assert (single.tolist(), speed.tolist()) == ([2.0], [0.0])


def test_a_set_point_that_is_sent_when_it_changes_is_repeated():
    time = np.array([0.0, 1.0, 2.0, 3.0, 7.0, 8.0, 10.0, 11.0])
    value = np.array([0.0, 1.0, 2.0, 3.0, 3.0, 4.0, 4.0, 5.0])
    speed = np.arange(8.0)
    when, what, fast = _fill_holds(time, value, speed)
    assert when.tolist() == [0, 1, 2, 3, 4, 5, 6, 7, 8, 10, 11]
    assert what.tolist() == [0, 1, 2, 3, 3, 3, 3, 3, 4, 4, 5]
    assert fast.tolist() == [0, 1, 2, 3, 0, 0, 0, 4, 5, 6, 7]
    for pause, added in ((2.4, 0), (2.6, 2)):
        time[4:] += pause - (time[4] - time[3])
        assert _fill_holds(time, value, None)[0].size == 8 + added
    time[4:] += 4.0
    value[4:] += 0.1  # it moved meanwhile
    assert _fill_holds(time, value, None)[0] is time
    assert _fill_holds(time[:1], value[:1], None)[0].size == 1


# ---------------------------------------------------------------------- trajectories


def trajectory(start, time, knots, names=('a',)):
    return Trajectory(start, names, np.array(time), np.array(knots, dtype=float))


def test_a_trajectory_is_run_through_by_all_that_it_states():
    after = np.linspace(0.0, 2.0, 21)
    for depth in (1, 2, 3):
        knots = np.array([[[0.0], [0.0], [0.0]], [[1.0], [0.5], [0.2]], [[3.0], [0.0], [0.0]]])
        one = trajectory(0, [0.0, 1.0, 2.0], knots[:, :depth])
        place, speed = _run_through(one, None, after)
        np.testing.assert_allclose(place[[0, 10, 20], 0], [0.0, 1.0, 3.0], atol=1e-12)
        if depth > 1:
            np.testing.assert_allclose(speed[[0, 10, 20], 0], [0.0, 0.5, 0.0], atol=1e-9)
        half = {1: 0.5, 2: 0.5 - 0.125 * 0.5, 3: 0.5 - 0.5 * 5.0 / 32.0 + 0.2 / 64.0}[depth]
        assert place[5, 0] == pytest.approx(half)


def test_before_and_after_it_stands():
    one = trajectory(0, [0.5, 1.0], [[[2.0]], [[4.0]]])
    after = np.array([-0.2, 0.0, 0.25, 0.5, 0.75, 1.0, 1.5])
    place, speed = _run_through(one, None, after)
    assert place[:, 0].tolist() == [2.0, 2.0, 2.0, 2.0, 3.0, 4.0, 4.0]
    assert speed[:, 0].tolist() == [0.0, 0.0, 0.0, 4.0, 4.0, 4.0, 0.0]
    # From the set-point before it goes to its first point.
    place, speed = _run_through(one, np.array([0.0]), after)
    assert place[:, 0].tolist() == [0.0, 0.0, 1.0, 2.0, 3.0, 4.0, 4.0]
    assert speed[2, 0] == 4.0 and speed[0, 0] == speed[-1, 0] == 0.0
    now = trajectory(0, [0.0, 1.0], [[[2.0]], [[4.0]]])
    assert _run_through(now, np.array([0.0]), after)[0][1, 0] == 2.0
    single = trajectory(0, [0.0], [[[7.0]]])
    place, speed = _run_through(single, np.array([1.0]), after)
    assert set(place[:, 0]) == {7.0} and set(speed[:, 0]) == {0.0}


def test_a_later_trajectory_takes_over_from_its_start():
    first = trajectory(0, [0.0, 1.0], [[[0.0]], [[1.0]]])
    second = trajectory(500 * MS, [0.1, 0.2], [[[0.0]], [[0.0]]])
    (block,) = set_points([first, second], Limits())
    assert block.stamp.tolist() == list(range(0, 1000 * MS + 1, MS))
    place, speed, effort = block.fields
    assert effort is None and block.names == ('a',)
    np.testing.assert_allclose(place[:500, 0], 1e-3 * np.arange(500), atol=1e-12)
    assert place[500, 0] == pytest.approx(0.499)  # from the last set-point before
    assert place[550, 0] == pytest.approx(0.2495)
    np.testing.assert_allclose(place[600:, 0], 0.0, atol=1e-12)
    np.testing.assert_allclose(speed[100, 0], 1.0)
    np.testing.assert_allclose(speed[550, 0], -4.99)
    assert (speed[701:] == 0.0).all()
    assert block.rows.tolist() == list(range(1001))
    # One that begins after all is over changes nothing; other joints are another block.
    late = trajectory(2000 * MS, [0.0], [[[9.0]]])
    other = trajectory(100 * MS, [0.2, 0.3], [[[1.0, 2.0]], [[3.0, 4.0]]], ('b', 'c'))
    one, two = set_points([first, late, other], Limits())
    assert one.stamp[-1] == 2000 * MS and one.fields[0][-1, 0] == 9.0
    assert (two.names, two.stamp[0], two.stamp[-1]) == (('b', 'c'), 300 * MS, 400 * MS)
    np.testing.assert_allclose(two.fields[0][-1], [3.0, 4.0])


def test_a_trajectory_that_would_fill_the_memory_is_refused():
    long = trajectory(0, [0.0, 10.0], [[[0.0]], [[1.0]]])
    needed = 3 * 16 * 10_000
    assert len(set_points([long], Limits(memory=needed))) == 1
    with pytest.raises(IdentError, match='the set-point of the trajectories takes'):
        set_points([long], Limits(memory=needed - 1))


# ---------------------------------------------------------------------- smoothing


def test_a_low_pass_leaves_what_is_above_the_rate_and_passes_both_ways():
    rng = np.random.default_rng(0)
    rows = rng.normal(size=(2, 500))
    np.testing.assert_array_equal(low_pass(rows, 0.01, 49.91), rows)
    assert (low_pass(rows, 0.01, 49.8) != rows).any()
    turned = low_pass(rows[:, ::-1], 0.01, 5.0)[:, ::-1]
    np.testing.assert_allclose(
        low_pass(rows, 0.01, 5.0)[:, 150:350], turned[:, 150:350], atol=1e-6
    )
    level = low_pass(np.full((1, 300), 3.0), 0.01, 5.0)
    np.testing.assert_allclose(level, 3.0)


def test_a_cutoff_leaves_room_below_half_the_rate_of_the_slowest():
    whole = np.zeros((2, 100))
    assert allowed_cutoff(whole, 0.01, 10.0) == 10.0
    assert allowed_cutoff(whole, 0.01, 50.0) == pytest.approx(20.0)
    rare = whole.copy()
    rare[1, np.arange(100) % 4 != 0] = np.nan
    assert allowed_cutoff(rare, 0.01, 10.0) == pytest.approx(5.0)
    rare[1, 1:] = np.nan  # a single sample has no rate
    assert allowed_cutoff(rare, 0.01, 50.0) == pytest.approx(20.0)
    assert allowed_cutoff(rare[1], 0.01, 50.0) == pytest.approx(20.0)


@pytest.mark.parametrize('size', [4, 5, 6, 7, 40])
def test_short_motions_have_derivatives(size):
    cycle = 0.01
    time = cycle * np.arange(size)
    place, speed, change = smooth_motion((2.0 + 3.0 * time)[None], cycle, 49.95)
    np.testing.assert_allclose(place[0], 2.0 + 3.0 * time, atol=1e-6)
    np.testing.assert_allclose(speed[0], 3.0, atol=1e-3)
    np.testing.assert_allclose(change[0], 0.0, atol=0.5)


def test_of_six_samples_the_derivatives_are_a_quintics():
    cycle = 0.5
    for size, power in ((6, 5), (5, 3), (4, 3)):
        time = cycle * np.arange(size)
        place, speed, change = smooth_motion((time**power)[None], cycle, 0.9999)
        np.testing.assert_allclose(place[0], time**power)
        np.testing.assert_allclose(speed[0], power * time ** (power - 1), atol=1e-9)
        np.testing.assert_allclose(change[0], power * (power - 1) * time ** (power - 2), atol=1e-8)
