# SPDX-License-Identifier: Apache-2.0
"""Inertials that bodies can have: the cone, its repair, the point nearest to fit and belief."""

import numpy as np
from scipy.optimize import minimize

from ros2_ident.models.serial.cone import inertials_of, mended, nearest, pseudo_inertia

FREE = (np.empty((0, 10)), np.empty(0))


def consistent(inertials: np.ndarray) -> np.ndarray:
    """Return (L,) whether bodies can have these (L, 10) inertials."""
    scaled = inertials / np.maximum(np.abs(inertials).max(axis=1, keepdims=True), 1e-300)
    return np.linalg.eigvalsh(pseudo_inertia(scaled)).min(axis=1) > 0.0


def of_points(mass: np.ndarray, place: np.ndarray) -> np.ndarray:
    """Return the ten inertials of points (P,) at (P, 3), by their sums."""
    square = (place**2).sum(axis=1)
    inertia = np.einsum('p,pij->ij', mass, square[:, None, None] * np.eye(3)) - np.einsum(
        'p,pi,pj->ij', mass, place, place
    )
    places = [0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]
    return np.array([mass.sum(), *(mass @ place), *inertia[places]])


def bodies(count: int, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return np.array(
        [of_points(rng.uniform(0.1, 2.0, 6), rng.uniform(-0.3, 0.3, (6, 3))) for _ in range(count)]
    )


def test_a_pseudo_inertia_is_the_second_moments_of_the_points() -> None:
    mass, place = np.array([1.0, 2.0]), np.array([[0.1, 0.2, 0.3], [-0.5, 0.0, 0.4]])
    pseudo = pseudo_inertia(of_points(mass, place)[None])[0]
    whole = np.column_stack([place, np.ones(2)])
    np.testing.assert_allclose(pseudo, whole.T @ (mass[:, None] * whole), atol=1e-14)
    np.testing.assert_allclose(inertials_of(pseudo[None])[0], of_points(mass, place), atol=1e-14)


def test_the_triangle_of_inertias_and_the_centre_are_asked_for() -> None:
    fine = bodies(1)[0]
    flat = np.array([1.0, 0, 0, 0, 0.1, 0, 0.1, 0, 0, 0.5])
    outside = fine.copy()
    outside[1] = 10.0 * fine[0]
    assert consistent(np.array([fine, flat, outside, -fine])).tolist() == [True, *[False] * 3]
    repaired = mended(np.array([fine, flat]))
    assert consistent(repaired).all()
    np.testing.assert_array_equal(repaired[0], fine)
    assert repaired[1, 0] == 1.0


def test_a_fit_that_no_body_meets_is_met_as_far_as_it_goes() -> None:
    described = bodies(1)
    # Heavier by half and its moment of inertia about z gone: no body.
    told = np.zeros((2, 10))
    told[0, 0] = told[1, 9] = 1.0
    wanted = np.array([0.5 * described[0, 0], -1.2 * described[0, 9]])
    found = nearest(described, told, wanted, 1e6 * np.eye(2), FREE, 0.3)
    assert consistent(found).all()
    assert 0.0 < found[0, 9] < 0.1 * described[0, 9]


def test_it_is_the_minimum() -> None:
    described = bodies(1, seed=3)
    rng = np.random.default_rng(6)
    told, wanted = rng.normal(size=(4, 10)), 0.05 * rng.normal(size=4)
    precision = np.diag([1e2, 1e3, 1e4, 10.0])

    def cost(inertials: np.ndarray) -> float:
        pseudo, first = pseudo_inertia(np.array([inertials, described[0]]))
        if np.linalg.eigvalsh(pseudo).min() <= 0.0:
            return np.inf
        ratio = np.linalg.solve(first, pseudo)
        off = told @ (inertials - described[0]) - wanted
        apart = np.trace(ratio) - np.linalg.slogdet(ratio)[1] - 4.0
        return float(apart / (4.0 * 0.2**2) + 0.5 * off @ precision @ off)

    found = nearest(described, told, wanted, precision, FREE, 0.2)[0]
    best = cost(found)
    for step in rng.normal(size=(200, 10)) * np.abs(described[0]) * 1e-3:
        assert cost(found + step) >= best
    better = minimize(cost, found, method='Nelder-Mead', options={'maxiter': 500})
    assert better.fun >= best - 1e-9
