# SPDX-License-Identifier: Apache-2.0
"""What is said of one drive's motion and effort, each rule at its edge."""

from dataclasses import replace
import math

import numpy as np
import pytest

from ros2_ident.recording import Recording, Stream
from ros2_ident.recording.motion import (
    best_lag,
    count_reversals,
    fill_gaps,
    fill_smoothly,
    LATEST,
    Motion,
    motion_of,
)
from ros2_ident.recording.plausibility import (
    _judge_effort,
    _judge_gravity,
    _judge_motion,
    _judge_velocity,
    _kind,
)

PERIOD = 0.01
TIME = PERIOD * np.arange(3000)


def motion(effort=None, reported=None):
    """Return a motion of three slow waves."""
    parts = [(0.3, 1.1, 0.0), (0.1, 3.3, 0.7), (0.02, 9.0, 0.2)]
    place = sum(a * np.sin(w * TIME + p) for a, w, p in parts)
    speed = sum(a * w * np.cos(w * TIME + p) for a, w, p in parts)
    change = sum(-a * w * w * np.sin(w * TIME + p) for a, w, p in parts)
    return Motion(PERIOD, place, speed, change, reported, effort)


FREE = motion()


# ---------------------------------------------------------------------- motion


def test_an_effort_is_taken_as_it_is_logged_unless_a_factor_is_given():
    stamp = (1e9 * TIME).astype(np.int64) + 10**18
    place = FREE.position[:, None]
    recording = Recording(Stream(('a',), stamp, place, effort=3.0 * place))
    for factor, found in ((1.0, motion_of(recording, 'a')), (2.0, motion_of(recording, 'a', 2.0))):
        np.testing.assert_allclose(found.effort, 3.0 * factor * FREE.position, atol=1e-9)


def test_reversals_are_counted_between_stretches_of_real_motion():
    def counted(*speeds):
        values = np.repeat(np.array(speeds, dtype=float), 10)
        return count_reversals(replace(FREE, velocity=values))

    assert counted(1.0, -1.0, 1.0) == 2
    assert counted(1.0, 0.06, 1.0) == 0
    assert counted(1.0, -0.06, 1.0) == 2
    assert counted(1.0, -0.04, 1.0) == 0
    assert counted(1.0, 0.0, -1.0) == 1


def test_a_drive_rests_below_a_hundredth_of_its_top_speed():
    slow = replace(FREE, velocity=np.array([0.0, 0.0199, -0.0199, 0.0201, -2.0]))
    assert slow.resting.tolist() == [True, True, True, False, False]


@pytest.mark.parametrize(
    ('reversals', 'code', 'said'),
    [
        (0, 'one_way', 'in one direction only'),
        (1, 'few_reversals', 'reverses only once'),
        (2, 'few_reversals', 'reverses only twice'),
        (3, 'excitation', 'stroke 0.5, top speed 2, 3 reversals, 25 % of the time at rest'),
    ],
)
def test_how_often_a_drive_reverses(reversals, code, said):
    moved = replace(FREE, velocity=np.array([0.0, 1.0, 2.0, -2.0]))
    found = _judge_motion('a', moved, 0.5, reversals)
    assert found.code == code and said in found.sentence
    assert found.level == ('ok' if reversals == 3 else 'warn')


def test_gaps_are_filled_by_lines_and_smoothly():
    hole = np.array([0.0, 1.0, np.nan, 3.0, np.nan])
    np.testing.assert_allclose(fill_gaps(hole), [0.0, 1.0, 2.0, 3.0, 3.0])
    whole = np.arange(4.0)
    assert fill_gaps(whole) is whole and fill_smoothly(whole) is whole
    cubic = np.arange(9.0) ** 3
    cubic[[0, 4, 8]] = np.nan
    filled = fill_smoothly(cubic)
    np.testing.assert_allclose(filled, [1.0, *np.arange(1.0, 8.0) ** 3, 343.0])
    few = np.array([0.0, np.nan, 4.0, 9.0, np.nan])
    np.testing.assert_allclose(fill_smoothly(few), [0.0, 2.0, 4.0, 9.0, 9.0])
    four = np.array([0.0, 1.0, np.nan, 27.0, 64.0])
    np.testing.assert_allclose(fill_smoothly(four), [0.0, 1.0, 8.0, 27.0, 64.0])


# ---------------------------------------------------------------------- lags


@pytest.mark.parametrize('lag', [0.004, 0.03, 0.0333, 0.113])
@pytest.mark.parametrize('gain', [2.0, -3.0])
def test_a_lag_is_found_to_a_fraction_of_a_sample(lag, gain):
    columns = np.stack([np.sin(2.0 * TIME), np.cos(5.0 * TIME)], axis=1)
    late = TIME - lag
    target = gain * np.sin(2.0 * late) + 0.5 * np.cos(5.0 * late)
    found, solution, share = best_lag(columns, target, PERIOD, -0.02)
    assert found == pytest.approx(lag, abs=3e-4)
    np.testing.assert_allclose(solution, [gain, 0.5], rtol=0.02)
    assert share > 0.999


def test_a_lag_is_looked_for_between_its_ends():
    columns = np.sin(2.0 * TIME)[:, None]

    def found(lag, earliest):
        return best_lag(columns, np.sin(2.0 * (TIME - lag)), PERIOD, earliest)[0]

    assert found(-0.013, -0.02) == pytest.approx(-0.013, abs=3e-4)
    assert found(-0.013, 0.0) == found(0.0, 0.0) == 0.0
    assert found(-0.04, -0.02) == pytest.approx(-0.02)
    assert found(0.2, 0.0) == pytest.approx(LATEST)
    # Of a short log at most a quarter.
    short = slice(0, 20)
    got = best_lag(columns[short], np.sin(2.0 * (TIME - 0.1))[short], PERIOD, 0.0)[0]
    assert got == pytest.approx(0.05)


def test_what_is_explained_is_a_share_of_the_variance():
    rng = np.random.default_rng(0)
    columns = rng.normal(size=(3000, 1))
    target = columns[:, 0] + rng.normal(size=3000)
    assert best_lag(columns, target, PERIOD, 0.0)[2] == pytest.approx(0.5, abs=0.05)
    assert best_lag(columns, np.ones(3000), PERIOD, 0.0)[2] <= 1.0
    deaf = np.column_stack([columns, np.zeros(3000)])
    _, solution, _ = best_lag(deaf, 2.0 * columns[:, 0], PERIOD, 0.0)
    np.testing.assert_allclose(solution, [2.0, 0.0], atol=1e-12)


# ---------------------------------------------------------------------- reported velocity


def late(lag):
    there = np.clip(TIME - lag, 0.0, TIME[-1])
    return np.interp(there, TIME, FREE.velocity)


@pytest.mark.parametrize(
    ('reported', 'code', 'said'),
    [
        (FREE.velocity, 'velocity', 'is the derivative of the position'),
        (1.08 * FREE.velocity, 'velocity', 'is the derivative of the position'),
        (0.92 * FREE.velocity, 'velocity', 'is the derivative of the position'),
        (1.12 * FREE.velocity, 'velocity', '1.12 times the derivative'),
        (0.88 * FREE.velocity, 'velocity', '0.88 times the derivative'),
        (-FREE.velocity, 'velocity', '-1 times the derivative'),
        (late(0.005), 'velocity', 'is the derivative of the position'),
        (late(0.008), 'velocity_lag', '8 ms late'),
        (late(-0.008), 'velocity_lag', '8 ms early'),
    ],
)
def test_a_reported_velocity_is_held_against_the_derivative(reported, code, said):
    (found,) = _judge_velocity('a', motion(reported=reported))
    assert found.code == code and said in found.sentence
    assert (found.level == 'ok') is ('is the derivative' in said)


@pytest.mark.parametrize(('noise', 'told'), [(0.8, False), (1.2, True)])
def test_a_velocity_that_explains_less_than_half_is_told(noise, told):
    wave = np.cos(4.0 * TIME + 0.3 * TIME**1.5)  # another motion, as slow
    reported = FREE.velocity + noise * np.std(FREE.velocity) * math.sqrt(2.0) * wave
    (found,) = _judge_velocity('a', motion(reported=reported))
    assert ('% of the derivative' in found.sentence) is told


def test_a_few_reported_velocities_say_nothing():
    few = np.full(TIME.size, np.nan)
    few[:19] = 1.0
    assert _judge_velocity('a', motion(reported=few)) == []
    few[19] = 1.0
    assert len(_judge_velocity('a', motion(reported=few))) == 1


# ---------------------------------------------------------------------- effort


def judged(effort):
    return _judge_effort('a', motion(effort))


def pull(inertia=1.0, drag=0.5, friction=0.3, offset=0.1):
    speed = np.abs(FREE.velocity).max()
    rubbing = np.tanh(FREE.velocity / (0.02 * speed))
    return inertia * FREE.acceleration + drag * FREE.velocity + friction * rubbing + offset


def test_an_effort_of_the_motion_is_explained_with_its_lag():
    lag, share, (sign, found) = judged(pull())
    assert share > 0.99 and abs(lag) < 1e-3
    assert (sign.level, sign.code) == ('ok', 'effort_sign')
    assert (found.level, found.code) == ('ok', 'effort')
    assert found.sentence == 'a: inertia, friction and offset explain 100 % of the effort'
    shifted = np.interp(TIME - 0.03, TIME, pull())
    lag, _, (_, found) = judged(shifted)
    assert lag == pytest.approx(0.03, abs=1e-3)
    assert 'about 30 ms late' in found.sentence
    assert 'late' not in judged(np.interp(TIME - 0.008, TIME, pull()))[2][1].sentence


def test_a_lag_that_is_best_at_the_edge_or_a_poor_fit_is_none():
    assert math.isnan(judged(np.interp(TIME - 0.115, TIME, pull()))[0])
    assert not math.isnan(judged(np.interp(TIME - 0.09, TIME, pull()))[0])
    wave = np.cos(4.0 * TIME + 0.3 * TIME**1.5)
    size = math.sqrt(2.0) * np.std(pull())
    for noise, known in ((0.35, True), (0.5, False)):
        lag, share, _ = judged(pull() + noise * size * wave)
        assert (share > 0.85) is known and math.isnan(lag) is not known


@pytest.mark.parametrize(('noise', 'code'), [(1.4, 'effort'), (1.8, 'effort_unexplained')])
def test_an_effort_of_other_joints_is_not_explained(noise, code):
    wave = np.cos(4.0 * TIME + 0.3 * TIME**1.5)
    effort = pull() + noise * math.sqrt(2.0) * np.std(pull()) * wave
    _, share, (_, found) = judged(effort)
    assert found.code == code and (share < 0.3) is (code != 'effort')
    if code != 'effort':
        assert f'explain {100.0 * share:.0f} % of its effort' in found.sentence


@pytest.mark.parametrize(
    ('values', 'said'),
    [
        (np.array([1.0, 2.0, 3.0, 4.0]), None),
        (np.array([1.0, 2.0, 3.0, 4.0, 4.5]), None),
        (np.array([1.0, 2.0, 3.0, 4.0, np.nan, 300.0]), 'up to 300, which looks like percent'),
        (np.array([1.0, 2.0, 3.0, 4.0, -301.0]), 'up to 301, which looks like milliamperes'),
    ],
)
def test_whole_numbers_are_no_torques(values, said):
    found = _kind('a', values)
    assert (found is None) if said is None else (said in found.sentence)


@pytest.mark.parametrize(
    ('at_rest', 'gravity', 'level', 'said'),
    [
        (0.48, 9.81, 'warn', 'the effort at rest is 0.48; log the whole torque'),
        (-0.48, 9.81, 'warn', 'log the whole torque'),
        (0.52, 9.81, 'ok', 'holds 0.52 at rest'),
        (-0.52, 9.81, 'warn', 'it pulls downwards'),
        (-0.52, -9.81, 'ok', 'holds -0.52'),
        (0.52, 0.1, 'ok', 'holds 0.52'),
        (-0.52, 0.1, 'warn', 'it pulls downwards'),
    ],
)
def test_the_weight_is_looked_for_in_the_effort_at_rest(at_rest, gravity, level, said):
    effort = np.tile([-10.0, 10.0, np.nan], 50)  # a spread of ten: half of one is nothing
    (found,) = _judge_gravity('a', at_rest, effort, gravity)
    assert found.level == level and said in found.sentence
    assert _judge_gravity('a', at_rest, effort, 0.0) == []
    assert _judge_gravity('a', math.nan, effort, gravity) == []
