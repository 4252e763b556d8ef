# SPDX-License-Identifier: Apache-2.0
"""The refinement: accuracy, bounds, divergence, cancel, and its Jacobian."""

import math

import numpy as np
import pytest

from ros2_ident.errors import IdentError
from ros2_ident.search import finite_differences, refine, RefineStatus
from ros2_ident.search.jacobian import Box, Slopes, slopes_near
from ros2_ident.search.least_squares import least_squares, Point

TIME = np.linspace(0.0, 1.0, 200)
TRUTH = np.array([3.0, 2000.0])
LOW, HIGH = np.array([0.0, 100.0]), np.array([10.0, 1e5])


def model(theta):
    """Return a decaying oscillation (S, R); its frequency grows as the root of theta_2."""
    return np.exp(-theta[:, :1] * TIME) * np.cos(np.sqrt(theta[:, 1:2]) * TIME)


def residuals(theta):
    return model(TRUTH[None, :]) - model(theta)


def one_is_missing(theta):
    out = residuals(theta)
    out[:, 3] = math.nan
    return out


def test_converges_to_rounding():
    result = refine(residuals, [[2.0, 2100.0]], LOW, HIGH)
    np.testing.assert_allclose(result.theta, TRUTH, rtol=1e-9)
    assert result.status is RefineStatus.CONVERGED
    assert result.cost < 1e-9
    assert result.residual.shape == (200,)
    assert result.jacobian.shape == (200, 2)


def test_several_starts_find_the_best_of_several_minima():
    starts = [[3.0, 9000.0], [3.0, 40000.0], [3.0, 40000.0], [5.0, 2200.0]]
    result = refine(residuals, starts, LOW, HIGH)
    np.testing.assert_allclose(result.theta, TRUTH, rtol=1e-8)
    assert len(result.starts) == 3  # the copy is left out
    assert min(s.cost for s in result.starts) == result.cost
    assert result.evaluations == sum(s.evaluations for s in result.starts) + 4


@pytest.mark.parametrize(('truth', 'ends'), [([5.0, 1.0], [2.0, 1.0]), ([-7.0, 9.0], [-2.0, 6.0])])
def test_a_bound_that_the_fit_leans_on_is_kept_and_the_rest_goes_on(truth, ends):
    seen, low, high = [], np.array([-2.0, -4.0]), np.array([2.0, 6.0])

    def tilted(theta):
        seen.append(theta)
        off = theta - truth
        # The parameters trade: at the bound the other one's best is another.
        return np.stack([off[:, 0], off[:, 1], 0.5 * off.sum(axis=1)], axis=1)

    found = least_squares(tilted, np.zeros(2), low, high, iterations=30, tolerance=1e-12)
    every = np.concatenate(seen)
    assert (every >= low - 1e-12).all() and (every <= high + 1e-12).all()
    assert found.theta[0] == ends[0]
    # Where the first stays at its bound, 1.25 y + 0.25 x is to be least.
    free = truth[1] - 0.25 / 1.25 * (ends[0] - truth[0])
    assert found.theta[1] == pytest.approx(np.clip(free, low[1], high[1]), abs=1e-3)


def test_what_the_data_leave_open_stays_in_the_middle_of_its_box():
    """Two parameters act as their sum alone, one not at all."""
    slopes, noise = np.linspace(1.0, 2.0, 50), np.random.default_rng(4).normal(size=50)

    def summed(theta):
        return (theta[:, :1] + theta[:, 1:2] - 3.0) * slopes + 0.01 * noise

    found = refine(summed, [[3.9, 0.1, -1.9]], [0.0, 0.0, -2.0], [4.0, 4.0, 8.0])
    assert found.status is RefineStatus.CONVERGED
    assert found.theta[:2].sum() == pytest.approx(3.0, abs=0.01)
    np.testing.assert_allclose(found.theta, [1.5, 1.5, 3.0], atol=0.02)


def test_diverged_starts_are_passed_over():
    def sometimes(theta):
        told = residuals(theta)
        told[theta[:, 1] > 5000.0] = math.inf
        return told

    result = refine(sometimes, [[3.0, 9000.0], [2.5, 2050.0]], LOW, HIGH)
    assert [s.status for s in result.starts] == [RefineStatus.DIVERGED, RefineStatus.CONVERGED]
    np.testing.assert_allclose(result.theta, TRUTH, rtol=1e-8)
    nothing = refine(sometimes, [[3.0, 9000.0]], LOW, HIGH)
    assert nothing.status is RefineStatus.DIVERGED
    assert np.isnan(nothing.theta).all()
    assert math.isinf(nothing.cost)


@pytest.mark.parametrize(
    ('call', 'text'),
    [
        (lambda: refine(residuals, [], LOW, HIGH), 'at least one row of 2 finite parameters'),
        (lambda: refine(residuals, [[math.nan, 1.0]], LOW, HIGH), '2 finite parameters'),
        (lambda: refine(residuals, [[1.0, 200.0]], HIGH, LOW), 'below its finite upper bound'),
        (lambda: refine(residuals, [[1.0]], LOW, HIGH[:1]), 'two lists of finite numbers'),
        (
            lambda: refine(one_is_missing, [[1.0, 200.0]], LOW, HIGH),
            'leave out samples that were not measured',
        ),
        (
            lambda: refine(lambda t: residuals(t)[:1], [[1.0, 200.0]], LOW, HIGH),
            r'the shape \(1, 200\) for 2 candidates',
        ),
    ],
)
def test_unusable_input_is_refused(call, text):
    with pytest.raises(IdentError, match=text):
        call()


# the Jacobian


@pytest.mark.parametrize('central', [False, True])
@pytest.mark.parametrize('corner', [None, 0.0, 1.0])
def test_differences_agree_with_the_derivative(central, corner):
    box = Box.of(LOW, HIGH)
    theta = TRUTH if corner is None else box.physical(np.full(2, corner))
    unit = box.inside(theta)
    found = finite_differences(residuals, unit, residuals(theta[None, :])[0], box, central=central)
    decay, stiffness = theta
    wave = np.sqrt(stiffness) * TIME
    exact = np.stack(
        [
            TIME * np.exp(-decay * TIME) * np.cos(wave),
            np.exp(-decay * TIME) * np.sin(wave) * TIME / (2.0 * np.sqrt(stiffness)),
        ],
        axis=1,
    )
    scale = np.abs(exact).max(axis=0) * box.width
    tolerance = 1e-8 if central and corner is None else 2e-4
    assert (np.abs(found - exact * box.width) / scale).max() < tolerance


@pytest.mark.filterwarnings('error')
@pytest.mark.parametrize('size', [1e200, np.inf, np.nan])
def test_a_fit_beside_a_cliff_ends_without_a_word_of_numpy(size):
    def evaluate(theta):
        return np.where(theta > 0.6, size, (theta - 0.9) * np.ones(5))

    fitted = least_squares(evaluate, np.array([0.3]), np.array([0.0]), np.array([1.0]))
    assert 0.5 < fitted.theta[0] <= 0.6


MOTION = np.random.default_rng(4).normal(size=(3, 200))


def counted(seen, scaled):
    """Return a residual linear in four parameters, or one that the fourth scales."""

    def evaluate(theta):
        seen.append(len(theta))
        lines, last = (theta[:, :3] * (1.0, 1e-3, 1e3)) @ MOTION, theta[:, 3:]
        return lines * (1.0 + last) if scaled else lines + last

    return evaluate


@pytest.mark.parametrize(
    ('scaled', 'runs', 'lasting'),
    [
        # one for all three lines, one for what is new
        (False, 1 + 1, [True, True, True, False]),
        # none of them is the same: all four as well
        (True, 1 + 4, [False] * 4),
    ],
)
def test_columns_of_another_point_are_taken_where_one_candidate_finds_them_the_same(
    scaled, runs, lasting
):
    low, high = np.zeros(4), np.ones(4)
    box, unit = Box.of(low, high), np.array([0.2, 0.9, 0.4, 0.7])
    seen = []
    evaluate = counted(seen, scaled)
    near = Slopes((MOTION.T * (1.0, 1e-3, 1e3)), np.full(3, True))
    residual = evaluate(unit[None])[0]
    seen.clear()
    found = slopes_near(evaluate, unit, residual, box, 1e-4, near)
    assert sum(seen) == runs
    assert found.lasting.tolist() == lasting
    exact = finite_differences(evaluate, unit, residual, box, step=1e-4)
    scale = np.abs(exact).max(axis=0) + 1e-12
    assert (np.abs(found.columns - exact) / scale).max() < 1e-6


def test_a_column_that_was_the_same_at_two_points_is_one_that_lasts():
    box = Box.of(np.zeros(4), np.ones(4))
    evaluate = counted(seen := [], False)
    nothing = Slopes(np.empty((200, 0)), np.empty(0, dtype=bool))
    first = Point.at(evaluate, box, np.full(4, 0.5), nothing)
    assert first.slopes.lasting.sum() == 0
    (second,) = first.moved(np.full((1, 4), 0.3))
    assert second.slopes.lasting.all()
    (third,) = second.moved(np.full((1, 4), 0.6))
    seen.clear()
    assert third.slopes.lasting.all()
    assert sum(seen) == 1
