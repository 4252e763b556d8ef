# SPDX-License-Identifier: Apache-2.0
"""Noise of any size and colour, what is missing, and intervals that allow for it."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

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


def test_noise_that_columns_could_follow_is_not_taken_for_less():
    told = []
    for seed in range(24):
        rng = np.random.default_rng(seed)
        missing, drawn = waves(rng, 60), noise(rng, 0.01, 0.9)
        seen = weigh(drawn + 0.01 * missing[:, 7], waves(rng, 5), missing, RUNS, BLOCKS)
        told.append(seen.floor[0] / drawn.std())
    assert np.sqrt(np.mean((np.array(told) - 1.0) ** 2)) < 0.015


def test_places_of_one_noise_share_it():
    rng = np.random.default_rng(3)
    drawn = noise(rng, 0.01, 0.9)
    runs = (Run(0, ROWS // 2, 0), Run(ROWS // 2, ROWS, 1))
    one, two = weigh(drawn, waves(rng, 5), waves(rng, 9), runs, BLOCKS).noise
    assert one is two and one.samples == ROWS
    drawn[ROWS // 2 :] *= 2.0
    one, two = weigh(drawn, waves(rng, 5), waves(rng, 9), runs, BLOCKS).noise
    assert two.variance / one.variance == pytest.approx(4.0, rel=0.3)


def test_what_no_column_predicts_on_other_blocks_is_noise():
    # Of its own in every block: a fit would follow it, a prediction cannot.
    rng = np.random.default_rng(4)
    columns = (BLOCKS[:, None] == np.arange(BLOCKS.max() + 1)).astype(float)
    residual = noise(rng, 0.01, 0.0) + 0.02 * rng.standard_normal(BLOCKS.max() + 1)[BLOCKS]
    seen = weigh(residual, waves(rng, 2), columns, RUNS, BLOCKS)
    assert seen.rest[0] < 0.012
    assert seen.unseen[0] == pytest.approx(seen.rms[0], rel=0.01)


def test_what_is_not_clear_counts_where_it_comes_true_on_other_blocks():
    rng = np.random.default_rng(3)
    missing = waves(rng, 60)
    residual = noise(rng, 0.01, 0.0) + 0.2 * missing[:, 7]
    seen = weigh(residual, waves(rng, 5), missing, RUNS, BLOCKS)
    # Each block is predicted by the others alone, and as well as they can.
    assert seen.unseen[0] == pytest.approx(0.01, rel=0.1)
    assert seen.unseen[0] > seen.rest[0]
    assert replace(seen, gain=31.0).floor[0] == seen.rest[0]
    assert replace(seen, gain=29.0).floor[0] == seen.unseen[0]


def test_intervals_hold_the_truth_though_the_model_lacks_something():
    hits = {'noise alone': 0, 'with what is missing': 0}
    low, high, tries = np.zeros(3), np.ones(3), 60
    for seed in range(tries):
        rng = np.random.default_rng(seed)
        missing = waves(rng, 30)
        # Parameters act much like what is missing.
        jacobian = 0.3 * (missing[:, :3] + 0.5 * waves(rng, 3))
        size = 0.003 * rng.standard_normal(30)
        truth = np.full(3, 0.5)
        made = missing @ size + noise(rng, 0.01, 0.0)
        theta = truth + np.linalg.lstsq(jacobian, made, rcond=None)[0]
        residual = made - jacobian @ (theta - truth)
        seen = weigh(residual, -jacobian, missing, RUNS, BLOCKS)
        error = residual.std() * np.sqrt(np.diag(np.linalg.inv(jacobian.T @ jacobian)))
        alone = theta - 1.96 * error, theta + 1.96 * error
        both = seen.ends(theta, low, high, *alone)
        for name, (least, most) in (('noise alone', alone), ('with what is missing', both)):
            hits[name] += int(((least <= truth) & (truth <= most)).sum())
    assert hits['noise alone'] < 0.6 * 3 * tries
    assert 0.9 * 3 * tries <= hits['with what is missing']


def test_rows_left_out_tell_as_much_as_those_weighed():
    rng = np.random.default_rng(6)
    jacobian, missing = waves(rng, 3), waves(rng, 20)
    residual = noise(rng, 0.01, 0.0)
    whole = weigh(residual, jacobian, missing, RUNS, BLOCKS)
    half = weigh(
        residual[: ROWS // 2], jacobian[: ROWS // 2], missing[: ROWS // 2], RUNS[:1],
        BLOCKS[: ROWS // 2], share=0.5,
    )  # fmt: skip
    assert np.diag(half.covariance) == pytest.approx(np.diag(whole.covariance), rel=0.2)


def test_more_columns_that_are_alike_than_samples_are_weighed():
    rng = np.random.default_rng(6)
    time = np.linspace(0.0, 1.0, 60)[:, None]
    rates = np.repeat(np.linspace(0.5, 3.0, 15), 10)
    alike = np.sin(2.0 * np.pi * rates * time + np.tile(np.linspace(0.0, 3.0, 10), 15))
    residual = alike[:, 3] + alike[:, 40] + 1e-6 * rng.standard_normal(60)
    seen = weigh(residual, time, alike, [Run(0, 60, 0)], np.arange(60) // 10)
    assert seen.gain > 100.0
    assert 0.0 < seen.floor[0] < 1e-3
    assert np.isfinite(seen.left).all()


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


def test_a_model_without_anything_to_add_is_weighed_too():
    rng = np.random.default_rng(7)
    seen = weigh(noise(rng, 0.01, 0.5), waves(rng, 2), np.empty((ROWS, 0)), RUNS, BLOCKS)
    assert seen.gain == 0.0
    assert seen.floor[0] == pytest.approx(0.01, rel=0.05)


# ------------------------------------------------- against the dense Gaussian formulas


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
