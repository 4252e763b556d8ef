# SPDX-License-Identifier: Apache-2.0
"""The evidence of what a residual lacks, held against the dense Gaussian formulas."""

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from ros2_ident.search.evidence import _of_one_size, _Sums, Evidence, weigh
from ros2_ident.search.noise import Run, white

ROWS = 40


@pytest.fixture
def case():
    """Return whitened columns of two parameters and three things missing, and a residual."""
    rng = np.random.default_rng(2)
    columns = rng.normal(size=(ROWS, 5)) * [3.0, 0.1, 1.0, 2.0, 0.5]
    return columns, rng.normal(size=ROWS) + columns @ [0.3, 1.0, 0.2, -0.4, 0.0]


@pytest.mark.parametrize('limit', [np.full(3, np.inf), np.array([0.05, 10.0, 0.2])])
@pytest.mark.parametrize('size', [1e-3, 0.3, 2.0])
def test_the_sums_say_what_the_full_matrices_do(case, limit, size):
    columns, residual = case
    sums = _Sums(columns.T @ columns, columns.T @ residual, limit)

    def prior(size):
        return np.diag(np.concatenate([np.ones(2), np.minimum(size, limit) ** 2]))

    def likelihood(size):
        covariance = np.eye(ROWS) + columns @ prior(size) @ columns.T
        return multivariate_normal(np.zeros(ROWS), covariance).logpdf(residual)

    gain = sums._evidence(size) - sums._evidence(1e-4)
    assert gain == pytest.approx(likelihood(size) - likelihood(1e-4), rel=1e-7)
    precision = np.linalg.inv(prior(size)) + columns.T @ columns
    expected = np.linalg.solve(precision, columns.T @ residual)
    np.testing.assert_allclose(sums.solve(size), expected, rtol=1e-7, atol=1e-12)
    np.testing.assert_allclose(sums.covariance(size), np.linalg.inv(precision), rtol=1e-6)
    shift, covariance = sums.parameters(size)
    np.testing.assert_allclose(shift, -expected[:2])
    np.testing.assert_allclose(covariance, np.linalg.inv(precision)[:2, :2], rtol=1e-6)


def test_the_size_is_that_of_most_evidence_and_the_least_where_chance_gains_more(case):
    columns, residual = case
    sums = _Sums(columns.T @ columns, columns.T @ residual, np.full(3, np.inf))
    size, gain = sums.size(1.0)
    tried = np.logspace(-3.0, 1.0, 2000)
    told = [sums._evidence(s) for s in tried]
    best = tried[int(np.argmax(told))]
    assert size == pytest.approx(best, rel=0.13)  # ten sizes to a decade
    assert gain == pytest.approx(max(told) - sums._evidence(1e-5), abs=0.05)
    assert sums.size(100.0)[0] == pytest.approx(best, rel=0.13)
    # What is left when the columns have taken theirs is chance.
    left = residual - columns @ np.linalg.lstsq(columns, residual, rcond=None)[0]
    size, gain = _Sums(columns.T @ columns, columns.T @ left, np.full(3, np.inf)).size(1.0)
    assert size == pytest.approx(1e-5) and gain < 3.0


def test_columns_have_one_size_once_the_parameters_have_imitated_them():
    rng = np.random.default_rng(5)
    jacobian = rng.normal(size=(500, 2))
    basis, _ = np.linalg.qr(jacobian)
    own = rng.normal(size=(500, 3))
    own -= basis @ (basis.T @ own)
    own /= np.sqrt(np.mean(own**2, axis=0))
    missing = np.column_stack(
        [
            7.0 * own[:, 0] + jacobian[:, 0],
            own[:, 1],
            1e3 * jacobian[:, 1] + 0.5 * own[:, 2],  # the parameters say all but a trace of it
            np.zeros(500),
        ]
    )
    columns, limit = _of_one_size(jacobian, missing, None)
    np.testing.assert_allclose(columns, missing[:, :2] / [7.0, 1.0])
    assert np.isinf(limit).all() and limit.shape == (2,)
    columns, limit = _of_one_size(jacobian, missing, np.array([2.0, 0.5, 9.0, 9.0]))
    np.testing.assert_allclose(limit, [14.0, 0.5])
    more = np.column_stack([1e3 * jacobian[:, 1] + 2.0 * own[:, 2]])
    assert _of_one_size(jacobian, more, None)[0].shape == (500, 1)


def evidence(gain=0.0, **changes):
    kept = {
        'noise': (white(1.0),),
        'rms': np.array([5.0, 2.0]),
        'rest': np.array([3.0, 2.0]),
        'unseen': np.array([4.0, 2.5]),
        'size': 0.1,
        'gain': gain,
        'shift': np.array([0.01, -0.02]),
        'covariance': np.diag([1e-4, 4e-4]),
        'left': np.empty(0),
    }
    return Evidence(**{**kept, **changes})


def test_what_is_not_clear_counts_by_the_blocks_left_out():
    unclear, clear = evidence(29.0), evidence(31.0)
    assert unclear.floor.tolist() == [4.0, 2.5] and clear.floor.tolist() == [3.0, 2.0]
    np.testing.assert_allclose(clear.predicted, [4.0, 0.0])
    np.testing.assert_allclose(unclear.predicted, [3.0, 0.0])


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
