# SPDX-License-Identifier: Apache-2.0
"""The genetic algorithm's operators as pure functions on the unit cube.

Equation numbers are those of Ludwig and Gerstmayr (2011), section 2. The cube's coordinate i is
(theta_i - theta_i,min) / (theta_i,max - theta_i,min), which takes the ranges out of
eqs. 4, 6 and 7.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
import scipy

from ros2_ident.arrays import Array as Array

Flags = NDArray[np.bool_]
Index = NDArray[np.intp]

TINY = float(np.finfo(np.float64).tiny)


def gaussian_root(uniform: Array) -> Array:
    """Return mutation steps whose magnitude follows exp(-s^2).

    Args:
        uniform: Any shape, uniform in [0, 1].

    Returns:
        Same shape; sgn(x - 1/2) sqrt(-ln(2 |x - 1/2|)), 0 at x = 1/2; variance 1.

    Reference:
        Ludwig and Gerstmayr (2011), eq. 5, with the square root that its print lost.
    """
    steps = laplace(uniform)
    return np.asarray(np.sqrt(np.abs(steps)) * np.sign(steps))


def laplace(uniform: Array) -> Array:
    """Return mutation steps of a Laplace law, eq. 5 to the letter.

    Args:
        uniform: Any shape, uniform in [0, 1].

    Returns:
        Same shape; -sgn(x - 1/2) ln(2 |x - 1/2|), 0 at x = 1/2; variance 2.

    Reference:
        Ludwig and Gerstmayr (2011), eq. 5, read without a root.
    """
    # At x = 1/2 the pole of the logarithm is multiplied by sgn(0) = 0; a finite stand-in keeps it.
    away = uniform - 0.5
    size = np.maximum(-np.log(np.maximum(2.0 * np.abs(away), TINY)), 0.0)
    return np.asarray(size * np.sign(away))


def normal(uniform: Array) -> Array:
    """Return mutation steps of the standard normal law, as the text beside eq. 5 has it.

    Args:
        uniform: Any shape, uniform in [0, 1].

    Returns:
        Same shape; the inverse of the normal distribution at x, finite at 0 and 1; variance 1.

    Reference:
        Ludwig and Gerstmayr (2011), section 2: "related to the inverse formula of standard normal
        distribution".
    """
    steps: Array = scipy.special.ndtri(np.clip(uniform, TINY, 1.0 - 2.0**-53))
    return steps


MUTATIONS: dict[str, Callable[[Array], Array]] = {
    'gaussian_root': gaussian_root,
    'laplace': laplace,
    'normal': normal,
}


def uniform_points(count: int, dimension: int, rng: np.random.Generator) -> Array:
    """Draw a generation uniformly, eq. 4.

    Args:
        count: Number of points S.
        dimension: Number of parameters N.
        rng: Source of the draws.

    Returns:
        (S, N) in the unit cube.
    """
    return rng.random((count, dimension))


def kronecker(count: int, dimension: int, rng: np.random.Generator) -> Array:
    """Draw a low-discrepancy lattice with a random shift.

    Point n is frac(shift + n alpha) with alpha_i = phi^-i and phi the positive root of
    x^(N+1) = x + 1: the golden ratio in one dimension. It leaves no large hole in the plane, nor
    in any one coordinate, and needs no table.

    Args:
        count: Number of points S.
        dimension: Number of parameters N.
        rng: Source of the shift.

    Returns:
        (S, N) in the unit cube.

    Reference:
        Niederreiter (1992), Random Number Generation and Quasi-Monte Carlo Methods, section 3.1;
        the choice of alpha: Roberts (2018), The Unreasonable Effectiveness of Quasirandom
        Sequences.
    """
    root = 2.0
    for _ in range(64):
        root = (1.0 + root) ** (1.0 / (dimension + 1))
    alpha = root ** -np.arange(1.0, dimension + 1.0)
    points: Array = rng.random(dimension) + np.arange(1.0, count + 1.0)[:, None] * alpha
    return points - np.floor(points)


FIRST_GENERATIONS: dict[str, Callable[[int, int, np.random.Generator], Array]] = {
    'uniform': uniform_points,
    'kronecker': kronecker,
}


def mutate(
    parents: Array, children: int, scale: float, law: str, rng: np.random.Generator
) -> Array:
    """Return every parent's children, eq. 6, clipped to the cube.

    Args:
        parents: (P, N) survivors in the unit cube.
        children: Children of each parent.
        scale: The factor xi^(g-1), g the parents' generation.
        law: `gaussian_root`, `laplace` or `normal`.
        rng: Source of the draws, a fresh one for every component.

    Returns:
        (P * children, N) in the unit cube; the children of one parent are neighbours.
    """
    steps = MUTATIONS[law](rng.random((len(parents) * children, parents.shape[1])))
    return np.asarray(np.clip(parents.repeat(children, axis=0) + scale * steps, 0.0, 1.0))


def select(points: Array, costs: Array, count: int, distance: float) -> Index:
    """Return who survives: the best ones that keep their distance, eq. 7.

    Candidates are taken in the order of their cost, the best always, each further one only where
    its distance to every survivor taken so far exceeds `distance`. A copy of a survivor never
    survives, nor does a diverged candidate (cost inf). Among equal costs the earlier candidate
    goes first.

    Args:
        points: (S, N) in the unit cube.
        costs: (S,), no NaN.
        count: Most survivors.
        distance: d_min,0 xi^(g-1), a length in the unit cube.

    Returns:
        (P,) indices by rising cost, P <= count.
    """
    free = costs < np.inf
    taken: list[int] = []
    for index in np.argsort(costs, kind='stable'):
        if len(taken) == count:
            break
        if free[index]:
            taken.append(index)
            # "Exceeds", eq. 7: at distance 0 a copy is still too near.
            apart = points.T - points[index][:, np.newaxis]
            free &= (apart * apart).sum(axis=0) > distance * distance
    return np.array(taken, dtype=np.intp)
