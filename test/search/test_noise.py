# SPDX-License-Identifier: Apache-2.0
"""The model of a residual's noise, held against what defines it."""

import math

from gap_signals import white
import numpy as np
import pytest
from scipy.signal import lfilter

from ros2_ident.arrays import fast_noise
from ros2_ident.search.noise import (
    fit_noise,
    MOST_COEFFICIENTS,
    NoiseModel,
    Run,
    weighted_normal_matrix,
    Whitening,
)


def coloured(coefficients, count, seed=0):
    """Return noise of an autoregressive model with unit innovation."""
    drawn = np.random.default_rng(seed).normal(size=count + 500)
    return lfilter([1.0], np.concatenate(([1.0], -np.asarray(coefficients))), drawn)[500:]


def first_order(a, count=1000):
    """Return the model of a first order whose variance is one."""
    return NoiseModel(np.array([a]), 1.0, 1.0 - a**2, count)


def test_fast_noise_is_told_from_motion_impacts_and_short_series():
    rng = np.random.default_rng(3)
    noise = 0.2 * rng.normal(size=4000)
    time = 1e-3 * np.arange(4000)
    assert fast_noise(noise) == pytest.approx(0.2, rel=0.05)
    motion = 50.0 * np.sin(5.0 * time) + 7.0 * time
    assert fast_noise(motion + noise) == pytest.approx(0.2, rel=0.05)
    struck = noise.copy()
    struck[::200] += 1e3
    assert fast_noise(struck) == pytest.approx(0.2, rel=0.15)
    # Of a fourth difference five samples make one.
    assert fast_noise(np.ones(4), np.arange(4.0)) == fast_noise() == 0.0
    one = np.array([0.0, 0.0, 1.0, 0.0, 0.0])
    assert fast_noise(one, np.ones(4)) == pytest.approx(6.0 / math.sqrt(70.0) / 0.67448975)


def test_a_true_order_is_found_up_to_the_most():
    for order in (2, MOST_COEFFICIENTS):
        model = fit_noise(coloured([0.0] * (order - 1) + [0.8], 4000))
        assert model.coefficients.size == order
        assert model.coefficients[-1] == pytest.approx(0.8, abs=0.05)
    beyond = fit_noise(coloured([0.0] * MOST_COEFFICIENTS + [0.8], 4000))
    assert not beyond.coefficients.size


def test_rows_are_whitened_run_by_run():
    models = [NoiseModel(np.array([0.5, -0.2]), 4.0, 2.25, 100), white(2.0)]
    runs = [Run(0, 6, 0), Run(6, 8, 0), Run(8, 12, 1), Run(12, 15, 0)]
    rows = np.random.default_rng(0).normal(size=(3, 15))
    expected = rows / 2.0
    for start, stop in ((0, 6), (12, 15)):
        for t in range(start + 2, stop):
            left = rows[:, t] - 0.5 * rows[:, t - 1] + 0.2 * rows[:, t - 2]
            expected[:, t] = left / 1.5
    np.testing.assert_allclose(Whitening(runs, models)(rows), expected)
    np.testing.assert_allclose(Whitening(runs, models)(rows[0]), expected[0])
    assert Whitening([], models)(np.empty((3, 0))).shape == (3, 0)


@pytest.mark.parametrize('count', [16, 64, 65])
@pytest.mark.parametrize('a', [0.3, -0.3])
def test_products_with_the_covariance_are_those_of_the_full_matrix(count, a):
    # The rows are padded by as many zeros: what correlates over more than their length is lost.
    rows = np.random.default_rng(1).normal(size=(count, 2))
    lag = np.abs(np.subtract.outer(np.arange(count), np.arange(count)))
    found = weighted_normal_matrix(rows, first_order(a))
    np.testing.assert_allclose(found, rows.T @ a**lag @ rows, rtol=1e-6, atol=1e-6 * count)
    np.testing.assert_allclose(weighted_normal_matrix(rows, white(3.0)), 9.0 * rows.T @ rows)
