# SPDX-License-Identifier: Apache-2.0
"""Set-points between their samples, and those that follow a trajectory."""

import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline, make_interp_spline

from ros2_ident.errors import IdentError
from ros2_ident.recording.limits import Limits
from ros2_ident.recording.setpoint import find_steps, interpolate_setpoint
from ros2_ident.recording.smooth import allowed_cutoff, low_pass
from ros2_ident.recording.trajectory import set_points, Trajectory

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


# ---------------------------------------------------------------------- trajectories


def trajectory(start, time, knots, names=('a',)):
    return Trajectory(start, names, np.array(time), np.array(knots, dtype=float))


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
