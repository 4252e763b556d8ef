# SPDX-License-Identifier: Apache-2.0
"""The evidence of what a residual lacks, held against the dense Gaussian formulas."""

from gap_signals import white
import numpy as np
import pytest

from ros2_ident.search.evidence import Evidence, weigh
from ros2_ident.search.noise import Run


def evidence(gain=0.0, **changes):
    kept = {
        'noise': (white(1.0),),
        'rms': np.array([5.0, 2.0]),
        'rest': np.array([3.0, 2.0]),
        'unseen': np.array([4.0, 2.5]),
        'gain': gain,
        'shift': np.array([0.01, -0.02]),
        'covariance': np.diag([1e-4, 4e-4]),
        'left': np.empty(0),
    }
    return Evidence(**{**kept, **changes})


def test_ends_hold_what_noise_alone_would_and_stay_in_the_box():
    theta, low, high = np.array([50.0, 0.0]), np.array([0.0, -1.0]), np.array([100.0, 9.0])
    tight = np.array([49.9, -0.01]), np.array([50.1, 0.01])
    least, most = evidence().ends(theta, low, high, *tight)
    # Middles 51 and -0.2; half widths 1.96 hundredths of 100, and of twice 10.
    np.testing.assert_allclose(least, [51.0 - 1.96, -0.2 - 0.392])
    np.testing.assert_allclose(most, [51.0 + 1.96, -0.2 + 0.392])
    wide = np.array([40.0, -2.0]), np.array([60.0, 3.0])
    least, most = evidence().ends(theta, low, high, *wide)
    np.testing.assert_allclose(least, wide[0])
    np.testing.assert_allclose(most, wide[1])
    far = evidence(covariance=np.diag([1.0, -1.0]))
    least, most = far.ends(theta, low, high, *tight)
    np.testing.assert_allclose(least, [0.0, -0.2])
    np.testing.assert_allclose(most, [100.0, 0.01])
    # Unknown ends are replaced.
    unknown = np.full(2, np.nan), np.full(2, np.nan)
    least, _ = evidence().ends(theta, low, high, *unknown)
    np.testing.assert_allclose(least, [51.0 - 1.96, -0.2 - 0.392])


def test_a_residual_that_is_predicted_wholly_is_weighed_at_each_place():
    rng = np.random.default_rng(0)
    missing = rng.normal(size=(400, 4))
    runs = (Run(0, 100, 1), Run(100, 250, 0), Run(250, 400, 1))
    blocks = np.arange(400) // 20
    truth = np.array([0.0, 3.0, 0.0, 0.0])
    seen = weigh(missing @ truth, rng.normal(size=(400, 2)), missing, runs, blocks)
    place = np.repeat([1, 0, 1], [100, 150, 150])
    residual = missing @ truth
    for k in range(2):
        assert seen.rms[k] == pytest.approx(np.sqrt(np.mean(residual[place == k] ** 2)))
    assert (seen.floor < 1e-4 * seen.rms).all()
    assert np.abs(seen.left).max() < 1e-4
    assert seen.gain > 100.0
