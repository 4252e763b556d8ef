# SPDX-License-Identifier: Apache-2.0
"""The likelihood of two sides, beside that of a normal distribution written out."""

from dataclasses import replace

import numpy as np
import scipy

from ros2_ident.change.sides import Marginal
from ros2_ident.search.noise import NoiseModel, Run, Whitening

ROWS, OWN, COMMON = 60, 2, 3


def made(rng: np.random.Generator) -> tuple[Marginal, np.ndarray]:
    """Return what two pairs of logs lack beside white noise, and its covariance (R, R)."""
    columns = rng.normal(size=(OWN + COMMON, 2 * ROWS))
    sizes = np.array([0.5, 2.0, 1e-3])
    noise = NoiseModel(np.empty(0), 0.25, 0.25, ROWS)
    whiten = Whitening([Run(0, ROWS, 0), Run(ROWS, 2 * ROWS, 0)], (noise,))
    white = whiten(columns)
    pairs = [np.arange(k * ROWS, (k + 1) * ROWS) for k in range(2)]
    scaled = columns * np.concatenate([np.ones(OWN), sizes])[:, None]
    blocks = [0.25 * np.eye(ROWS) + scaled[:, x].T @ scaled[:, x] for x in pairs]
    return Marginal(
        whiten, white, sizes, np.full(COMMON, np.inf), 1.0,
        tuple((x, white[:, x] @ white[:, x].T) for x in pairs),
    ), scipy.linalg.block_diag(*blocks)  # fmt: skip


def test_the_likelihood_is_that_of_a_normal_distribution():
    rng = np.random.default_rng(0)
    marginal, covariance = made(rng)
    residual = rng.normal(size=2 * ROWS)
    whole = residual @ np.linalg.solve(covariance, residual) + np.linalg.slogdet(covariance)[1]
    of_noise = 2 * ROWS * np.log(0.25)
    assert np.isclose(marginal.loss(residual), whole - of_noise, rtol=1e-9)
    squares = np.sum(marginal(residual[None])[0] ** 2)
    assert np.isclose(squares, residual @ np.linalg.solve(covariance, residual), rtol=1e-9)


def test_sizes_are_those_of_what_a_residual_has():
    rng = np.random.default_rng(1)
    marginal, _ = made(rng)
    noise = 0.5 * rng.normal(size=2 * ROWS)
    none = marginal.sized()
    assert (none.sizes < 1e-4).all()
    for there in (0.0, 3.0):
        residual = noise + there * 0.5 * marginal.columns[OWN]
        found = marginal.sized(residual)
        # Ten times as large or small they are less probable; of noise alone there are none.
        others = [replace(found, sizes=factor * found.sizes) for factor in (0.1, 10.0)]
        if there:
            assert 0.5 * there < found.sizes[0] < 2.0 * there
            assert all(found.loss(residual) < x.loss(residual) for x in others)
            assert found.loss(residual) < none.loss(residual) - 100.0
        else:
            assert np.array_equal(found.sizes, none.sizes)
