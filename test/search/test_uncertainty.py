# SPDX-License-Identifier: Apache-2.0
"""Intervals: classical case, coverage under coloured noise, what is not fixed."""

import math

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.stats import t as student

from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.search import intervals

COUNT = 600
TIME = np.linspace(0.0, 6.0, COUNT)
JACOBIAN = np.stack([np.ones(COUNT), TIME, np.sin(3.0 * TIME)], axis=1)
TRUTH = np.array([0.5, 0.2, 0.7])
LOW, HIGH = np.full(3, -10.0), np.full(3, 10.0)


def coloured(rng, rho, count=COUNT):
    white = rng.normal(size=count + 500)
    return lfilter([1.0], [1.0, -rho], white)[500:] * math.sqrt(1.0 - rho**2)


def fit(noise, jacobian=JACOBIAN):
    """Return the least squares estimate and its intervals, model J theta."""
    theta, *_ = np.linalg.lstsq(jacobian, jacobian @ TRUTH + noise, rcond=None)
    residual = jacobian @ (TRUTH - theta) + noise
    return theta, intervals(-jacobian, residual, theta, LOW, HIGH)


def test_white_noise_gives_the_classical_interval():
    noise = np.random.default_rng(4).normal(size=COUNT)
    theta, found = fit(noise)
    residual = noise + JACOBIAN @ (TRUTH - theta)
    covariance = residual @ residual / (COUNT - 3) * np.linalg.inv(JACOBIAN.T @ JACOBIAN)
    error = np.sqrt(np.diag(covariance))
    np.testing.assert_allclose(found.half_width, student.ppf(0.975, COUNT - 3) * error, rtol=1e-10)
    np.testing.assert_allclose(found.correlation, covariance / np.outer(error, error), rtol=1e-9)


@pytest.mark.parametrize('rho', [0.0, 0.5, 0.9, -0.5])
def test_intervals_cover_the_truth(rho):
    rng = np.random.default_rng(11)
    covered, classical, draws = 0, 0, 400
    for _ in range(draws):
        noise = coloured(rng, rho)
        theta, found = fit(noise)
        covered += ((found.low <= TRUTH) & (found.high >= TRUTH)).sum()
        residual = noise + JACOBIAN @ (TRUTH - theta)
        naive = np.sqrt(
            np.diag(np.linalg.inv(JACOBIAN.T @ JACOBIAN)) * (residual @ residual) / COUNT
        )
        classical += (np.abs(theta - TRUTH) < 1.96 * naive).sum()
    assert 0.90 <= covered / (3 * draws) <= 0.985
    if rho == 0.9:
        assert classical / (3 * draws) < 0.7  # what a white-noise interval would have claimed


def test_each_series_has_its_own_noise():
    rng = np.random.default_rng(5)
    noise = np.concatenate([rng.normal(size=300), 0.01 * rng.normal(size=300)])
    jacobian = np.zeros((600, 2))
    jacobian[:300, 0] = 1.0
    jacobian[300:, 1] = 1.0
    theta = np.array([noise[:300].mean(), noise[300:].mean()])
    residual = noise - jacobian @ theta
    box = np.full(2, -50.0), np.full(2, 50.0)
    apart = intervals(jacobian, residual, theta, *box, series=[300, 300])
    wanted = 1.96 * np.array([1.0, 0.01]) / math.sqrt(300)
    assert apart.half_width == pytest.approx(wanted, rel=0.15)


def test_twins_are_not_identifiable_and_the_third_is():
    jacobian = np.stack([np.sin(TIME), -3.0 * np.sin(TIME), np.cos(TIME)], axis=1)
    noise = 0.01 * np.random.default_rng(0).normal(size=COUNT)
    found = intervals(jacobian, noise, TRUTH, LOW, HIGH)
    assert np.isinf(found.half_width[:2]).all()
    assert np.isfinite(found.half_width[2])
    assert np.isnan(found.correlation[0, 1])
    assert found.correlation[2, 2] == 1.0
    nothing = intervals(0.0 * JACOBIAN, np.ones(COUNT), TRUTH, LOW, HIGH)
    assert np.isinf(nothing.half_width).all()


def test_fewer_samples_than_parameters_are_refused():
    with pytest.raises(IdentError, match='record more samples') as caught:
        intervals(JACOBIAN[:3], np.zeros(3), TRUTH, LOW, HIGH)
    assert caught.value.code == ErrorCode.NO_DATA
