# SPDX-License-Identifier: Apache-2.0
"""Smoothing without delay, and derivatives."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
import scipy.signal

from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.recording import Dataset, motion, smooth_motion
from ros2_ident.recording.motion import standing, told_band
from ros2_ident.recording.sections import follow

CYCLE = 5e-4
TIME = np.arange(6000) * CYCLE


def rest_to_rest(time, at=1.0, width=0.8, stroke=0.2):
    """Return position, velocity, acceleration of a smooth motion between two rests."""
    x = ((time - at) / width).clip(0.0, 1.0)
    inside = (x > 0.0) & (x < 1.0)
    position = x**4 * (35 - 84 * x + 70 * x**2 - 20 * x**3)
    velocity = np.where(inside, 140 * x**3 * (1 - x) ** 3, 0.0) / width
    acceleration = np.where(inside, 420 * x**2 * (1 - x) ** 2 * (1 - 2 * x), 0.0) / width**2
    return stroke * position, stroke * velocity, stroke * acceleration


def test_smooth_motion_passes_to_its_ends():
    truth = np.stack([rest_to_rest(TIME), rest_to_rest(TIME, 0.5, 1.9)], axis=1)
    position = truth[0].copy()
    position[:, 1::2] = np.nan
    position[0, 100:108] = np.nan
    found = smooth_motion(position, CYCLE, 60.0)
    for values, expected, bound in zip(found, truth, (1e-6, 2e-5, 1e-2), strict=True):
        assert values.shape == expected.shape
        np.testing.assert_allclose(values, expected, atol=bound)


def test_noise_beyond_the_cutoff_goes_and_nothing_is_delayed():
    rng = np.random.default_rng(0)
    truth = rest_to_rest(TIME)
    noisy = truth[0] + rng.normal(0.0, 1e-5, TIME.size)
    _, velocity, _ = smooth_motion(noisy[None], CYCLE, 20.0)
    assert np.std(velocity[0] - truth[1]) < 0.02 * np.std(np.gradient(noisy, CYCLE) - truth[1])
    lags = np.arange(-20, 21)
    inner = slice(1000, -1000)
    match = [np.sum(velocity[0][inner] * np.roll(truth[1], lag)[inner]) for lag in lags]
    assert lags[int(np.argmax(match))] == 0


@pytest.mark.parametrize(
    ('position', 'cutoff', 'text'),
    [
        ([[np.nan] * 10], 5.0, 'drive 1 of 1 has 0 position samples, at least 4 are needed'),
        (
            [np.arange(10.0)],
            60.0,
            'cutoff is 60 Hz but positions come at 100 Hz; choose one between',
        ),
        ([np.arange(10.0)], 0.0, 'cutoff is 0 Hz'),
    ],
)
def test_errors_name_the_remedy(position, cutoff, text):
    with pytest.raises(IdentError, match=text) as caught:
        smooth_motion(np.array(position), 0.01, cutoff)
    assert caught.value.code == ErrorCode.BAD_VALUES


@pytest.mark.parametrize('loaded', [True, False])
@pytest.mark.parametrize('order', [2, 4])
@pytest.mark.parametrize('share', [0.003, 0.1, 0.6, 0.95])
def test_the_filter_is_that_of_scipy(order, share, loaded, monkeypatch):
    poles, sections = motion.butterworth(order, share)
    np.testing.assert_array_equal(poles, scipy.signal.butter(order, share, output='zpk')[1])
    np.testing.assert_array_equal(sections, scipy.signal.butter(order, share, output='sos'))
    known = {'numba': None} if loaded else {}
    monkeypatch.setattr(motion, 'sys', SimpleNamespace(modules=known))
    for shape in ((900,), (3, 400), (5, 30, 70), (1, 2), (1, 1)):
        rows = np.random.default_rng(0).normal(size=shape).cumsum(axis=-1)
        reach = min(shape[-1] - 1, 300)
        found = motion.forwards_and_backwards(sections, rows, reach)
        expected = scipy.signal.sosfiltfilt(sections, rows, padlen=reach)
        np.testing.assert_allclose(found, expected, rtol=1e-11, atol=1e-11)


def test_a_lag_is_that_of_scipy():
    row = np.random.default_rng(0).normal(size=900).cumsum()
    for keep in (0.2, 0.9, 0.999):
        expected, _ = scipy.signal.lfilter([1.0 - keep], [1.0, -keep], row, zi=[keep * row[0]])
        np.testing.assert_array_equal(follow(keep, row), expected)


# ---------------------------------------------------------------------- bands

RATE, INERTIA, NOISE = 250.0, 8.0, 1.0
LONG = np.arange(0.0, 20.0, 1.0 / RATE)


def log(step: float, inertia: float = INERTIA, **parts: None) -> Dataset:
    """Return a joint's log, its encoder with steps, its effort with noise."""
    random = np.random.default_rng(2)
    place = 0.8 * np.sin(2.1 * LONG) + 0.2 * np.sin(7.3 * LONG)
    change = -0.8 * 2.1**2 * np.sin(2.1 * LONG) - 0.2 * 7.3**2 * np.sin(7.3 * LONG)
    effort = inertia * change + 3.0 + random.normal(0.0, NOISE, LONG.size)
    seen = step * np.round(place / step) if step else place
    fields = {'position': seen[None], 'effort': effort[None], **parts}
    nothing = dict.fromkeys(('command_position', 'command_velocity', 'velocity'))
    return Dataset(('hip',), 1.0 / RATE, 0, **fields, **nothing)


def test_readings_ask_for_less_than_the_noise() -> None:
    step = 2e-5
    wrong = step / math.sqrt(12.0)
    wanted = math.sqrt(math.sqrt(5.0) * NOISE / (3.0 * INERTIA * wrong)) / (2.0 * math.pi)
    assert told_band(log(step)) == pytest.approx(wanted, rel=0.08)
    assert told_band(log(2.0 * step)) < 0.8 * wanted


def test_no_log_is_compared_above_a_tenth_of_its_rate() -> None:
    assert told_band(log(0.0)) == pytest.approx(0.1 * RATE)
    assert told_band(log(2e-5, effort=None)) == pytest.approx(0.1 * RATE)
    assert told_band(log(2e-5, position=None)) == pytest.approx(0.1 * RATE)


@pytest.mark.parametrize('noise', [0.0, 1.0, 3.0])
def test_a_joint_stands_where_its_readings_hardly_differ(noise: float) -> None:
    step = 1e-4
    moves = np.where(LONG % 4.0 < 2.0, 1.0, 0.0)
    place = np.cumsum(0.5 * moves) / RATE
    random = np.random.default_rng(3)
    place = step * np.round((place + noise * step * random.normal(size=LONG.size)) / step)
    seen = np.stack([place, np.zeros_like(place)])
    speed = np.ones_like(seen)
    still, never = standing(seen, speed, 1.0 / RATE, 20.0)
    assert (still == (moves == 0.0)).mean() > 0.97
    assert not never.any()  # what never moves has no friction to be spoiled
    assert standing(seen, speed, 1.0 / RATE, 20.0, np.array([0.6, 0.0])).sum() == 0
    # Between two readings nothing tells when friction turned over.
    speed[0, LONG > 5.0] = -1.0
    turned = standing(seen, speed, 1.0 / RATE, 20.0)[0] & ~still
    np.testing.assert_allclose(LONG[turned], 5.0, atol=3.5 / RATE)
    assert turned.sum() > 5
