# SPDX-License-Identifier: Apache-2.0
"""Least squares in one step, on rows made of numbers."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.signal import decimate

from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.search import algebraic
from ros2_ident.search.algebraic import solve
from ros2_ident.search.genetic import StopReason

TRUTH = np.array([2.0, -30.0])


class Rows:
    """Residuals that are straight in two parameters, of several series; counts what is asked.

    Args:
        lengths: Of the series.
        noises: Of each series.
        bend: What an argument does beyond a straight line.
    """

    low, high = np.array([0.0, -100.0]), np.array([4.0, 100.0])
    names = ('a', 'b')

    def __init__(self, lengths, noises=None, bend=lambda theta: 0.0):
        rng = np.random.default_rng(0)
        self.series = tuple(lengths)
        time = np.concatenate([1e-2 * np.arange(n) for n in lengths])
        self.slopes = np.stack([1.0 + np.sin(2.0 * time), np.cos(time)], axis=1)
        sizes = [0.0] * len(lengths) if noises is None else noises
        drawn = [s * rng.normal(size=n) for s, n in zip(sizes, lengths, strict=True)]
        self.measured = self.slopes @ TRUTH + np.concatenate(drawn)
        self.bend, self.asked = bend, 0

    def residuals(self, theta):
        self.asked += len(theta)
        return theta @ self.slopes.T - self.measured + self.bend(theta)

    def cost_of(self, residual):
        return float(np.sqrt(np.mean(residual**2)))


def weighted(problem, lengths, rounds=3):
    """Return the estimate whose weights follow what each series leaves."""
    weights = np.ones(sum(lengths))
    for _ in range(rounds):
        theta = np.linalg.lstsq(
            problem.slopes * weights[:, None], problem.measured * weights, rcond=None
        )[0]
        left = problem.slopes @ theta - problem.measured
        ends = np.cumsum(lengths)[:-1]
        sizes = np.array([part.std() for part in np.split(left, ends)])
        weights = np.repeat(sizes.max() / sizes, lengths)
    return theta, left, weights


def test_without_noise_the_truth_is_found_wherever_the_box_is():
    problem = Rows([300, 200])
    problem.low, problem.high = np.array([50.0, -8.0]), np.array([51.0, 8.0])
    found = solve(problem, decimation=1)
    np.testing.assert_allclose(found.theta, TRUTH, rtol=1e-9)
    assert np.abs(found.residual).max() < 1e-9
    assert found.evaluations == 5
    assert problem.asked == 6  # one more tells whether they multiply each other
    assert found.ga.stop is StopReason.SOLVED
    assert (found.ga.evaluations, found.ga.generations, found.refined) == (0, 0, None)
    assert not (found.cancelled or found.left_out)
    assert 0.0 <= found.seconds < 60.0


def test_what_cannot_be_below_zero_is_not_and_the_others_make_the_best_of_it():
    problem = Rows([300], [0.1])
    problem.low = np.array([-4.0, 0.0])
    found = solve(problem, decimation=1)
    own = problem.slopes[:, 0]
    assert found.theta[1] == pytest.approx(0.0, abs=1e-12)
    assert found.theta[0] == pytest.approx(own @ problem.measured / (own @ own), rel=1e-9)


def test_series_that_are_long_enough_are_decimated_one_by_one(monkeypatch):
    lengths = [400, 399, 801]
    problem = Rows(lengths, [1.0, 2.0, 3.0])
    seen = SimpleNamespace()

    def noted(jacobian, residual, *_, series, level):
        seen.rows, seen.series = residual, series

    monkeypatch.setattr(algebraic, 'intervals', noted)
    found = solve(problem, decimation=10)
    assert seen.series == (40, 399, 81) and len(seen.rows) == 520
    parts = np.split(np.column_stack([problem.measured, problem.slopes]), [400, 799])
    kept = [decimate(p, 10, axis=0, zero_phase=True) if len(p) != 399 else p for p in parts]
    both = np.concatenate(kept)
    small = SimpleNamespace(measured=both[:, 0], slopes=both[:, 1:])
    theta, _, _ = weighted(small, [40, 399, 81])
    np.testing.assert_allclose(found.theta, theta, rtol=1e-6)
    # The residual is that of all rows.
    np.testing.assert_allclose(
        found.residual, problem.slopes @ theta - problem.measured, rtol=1e-6
    )


def test_what_the_data_do_not_show_stays_in_the_middle_of_its_box():
    problem = Rows([200])
    problem.slopes[:, 1] = 0.0
    problem.measured = problem.slopes @ TRUTH
    found = solve(problem, decimation=1)
    np.testing.assert_allclose(found.theta, [2.0, 0.0])
    assert np.isinf(found.intervals.half_width[1])


@pytest.mark.parametrize(
    ('bend', 'said'),
    [
        (lambda theta: 1e-3 * theta[:, 1:] ** 2, '^b does not act linearly'),
        (lambda theta: 1e-3 * (theta**2).sum(axis=1)[:, None], '^a, b do not act linearly'),
        (
            lambda theta: 1e-3 * theta[:, :1] * theta[:, 1:],
            '^some of the parameters multiply each other and do not act linearly',
        ),
    ],
)
def test_what_bends_is_named(bend, said):
    with pytest.raises(IdentError, match=said) as caught:
        solve(Rows([100], bend=bend))
    assert caught.value.code is ErrorCode.INVALID_GOAL


def test_a_middle_that_diverges_is_refused():
    problem = Rows([100], bend=lambda theta: np.where(theta[:, :1] > 2.5, np.inf, 0.0))
    with pytest.raises(IdentError, match='in the middle of the bounds diverges') as caught:
        solve(problem)
    assert caught.value.code is ErrorCode.DIVERGED


def test_rounding_errors_of_what_hardly_acts_are_not_taken_for_a_curve():
    problem = Rows([300], [0.1])
    problem.slopes[:, 1] *= 1e-9
    problem.bend = lambda theta: 1e-12 * np.cos(theta[:, 1:])
    found = solve(problem, decimation=1)
    assert found.theta[1] == pytest.approx(0.0)  # the middle of its box
