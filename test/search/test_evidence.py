# SPDX-License-Identifier: Apache-2.0
"""Noise of any size and colour, what is missing, and intervals that allow for it."""

import numpy as np
import pytest
from scipy.signal import butter, filtfilt, lfilter

from ros2_ident.search.evidence import weigh
from ros2_ident.search.noise import Run

ROWS = 6000
RUNS = (Run(0, ROWS // 2, 0), Run(ROWS // 2, ROWS, 0))
BLOCKS = np.arange(ROWS) // 200


def noise(rng: np.random.Generator, size: float, rho: float) -> np.ndarray:
    drawn = rng.standard_normal(ROWS + 1000)
    return size * lfilter([np.sqrt(1.0 - rho**2)], [1.0, -rho], drawn)[1000:]


def waves(rng: np.random.Generator, count: int) -> np.ndarray:
    """Return (R, C) smooth columns of RMS 1, such as a motion makes."""
    time = np.linspace(0.0, 1.0, ROWS)[:, None]
    rate = rng.uniform(5.0, 80.0, count)
    return np.sqrt(2.0) * np.sin(2.0 * np.pi * rate * time + rng.uniform(0.0, 6.28, count))


@pytest.mark.parametrize('rho', [0.0, 0.5, 0.9, 0.99])
@pytest.mark.parametrize('size', [0.004, 0.025])
def test_noise_of_any_size_and_colour_is_noise(rho, size):
    rng = np.random.default_rng(int(1000 * rho + 1e4 * size))
    residual = noise(rng, size, rho)
    seen = weigh(residual, waves(rng, 5), waves(rng, 60), RUNS, BLOCKS)
    assert seen.floor[0] == pytest.approx(residual.std(), rel=0.05)
    assert seen.predicted[0] < 0.25 * size
    assert seen.gain < 5.0
    answer = lfilter([1.0], [1.0, *-seen.noise[0].coefficients], np.eye(1, 4000)[0])
    assert answer[1:] @ answer[:-1] == pytest.approx(rho * (answer @ answer), rel=0.03, abs=0.03)


@pytest.mark.parametrize('rho', [0.0, 0.9])
def test_what_a_column_predicts_is_no_noise(rho):
    rng = np.random.default_rng(3)
    missing = waves(rng, 60)
    drawn = noise(rng, 0.01, rho)
    residual = drawn + 0.01 * missing[:, 7]
    seen = weigh(residual, waves(rng, 5), missing, RUNS, BLOCKS)
    assert seen.floor[0] == seen.rest[0]
    # Coloured noise covers a part of it.
    assert 0.75 * 0.01 < seen.predicted[0] < 1.1 * 0.01
    assert seen.floor[0] == pytest.approx(drawn.std(), rel=0.03)


def test_a_few_smooth_rows_that_columns_follow_wholly_may_be_noise():
    # Smoothed as a motion of 11 Hz is: such noise has no innovations, and its likelihood no limit.
    for seed in range(4):
        rng = np.random.default_rng(seed)
        smooth = filtfilt(*butter(2, 0.4), rng.standard_normal((80, 100)))[:, 25:75].T
        residual, columns = smooth[:, 0], smooth[:, 1:]
        seen = weigh(residual, columns[:, :4], columns[:, 4:], [Run(0, 50, 0)], np.arange(50) // 3)
        assert seen.floor[0] > 0.8 * residual.std()
        assert seen.gain < 30.0


@pytest.mark.parametrize('rho', [0.0, 0.9])
def test_more_columns_than_samples_do_not_explain_noise(rho):
    floors = []
    for seed in range(4):
        rng = np.random.default_rng(seed)
        drawn = noise(rng, 1.0, rho)[:150]
        time = np.linspace(0.0, 1.0, 150)[:, None]
        missing = np.sin(time * rng.uniform(6.0, 300.0, 500) + rng.uniform(0.0, 6.28, 500))
        seen = weigh(drawn, time, missing, [Run(0, 150, 0)], np.arange(150) // 10)
        floors.append(seen.floor[0] / np.sqrt(np.mean(drawn**2)))
        assert seen.gain < 5.0
    assert np.mean(floors) == pytest.approx(1.0, abs=0.1)
