# SPDX-License-Identifier: Apache-2.0
"""Small fits by Levenberg and Marquardt: what they find, and at what price."""

import numpy as np
import pytest

from ros2_ident.search.levenberg import local_fit

LOW, HIGH = np.array([-2.0, -4.0]), np.array([2.0, 6.0])


class Valley:
    """Rosenbrock's valley, its minimum at (1, 1); notes what is asked."""

    def __init__(self):
        self.asked = []

    def __call__(self, theta):
        self.asked.append(theta.copy())
        return np.stack([10.0 * (theta[:, 1] - theta[:, 0] ** 2), 1.0 - theta[:, 0]], axis=1)


def test_a_bent_valley_is_followed_to_its_end():
    valley = Valley()
    found = local_fit(valley, np.array([-1.2, 1.0]), LOW, HIGH, iterations=40, tolerance=1e-12)
    np.testing.assert_allclose(found.theta, [1.0, 1.0], rtol=1e-3)
    assert found.loss == pytest.approx(np.mean(found.residual**2))
    np.testing.assert_allclose(found.theta, LOW + found.unit * (HIGH - LOW))
    assert found.evaluations == sum(map(len, valley.asked))


@pytest.mark.parametrize(('truth', 'ends'), [([5.0, 1.0], [2.0, 1.0]), ([-7.0, 9.0], [-2.0, 6.0])])
def test_a_bound_that_the_fit_leans_on_is_kept_and_the_rest_goes_on(truth, ends):
    seen = []

    def tilted(theta):
        seen.append(theta)
        off = theta - truth
        # The parameters trade: at the bound the other one's best is another.
        return np.stack([off[:, 0], off[:, 1], 0.5 * off.sum(axis=1)], axis=1)

    found = local_fit(tilted, np.zeros(2), LOW, HIGH, iterations=30, tolerance=1e-12)
    every = np.concatenate(seen)
    assert (every >= LOW - 1e-12).all() and (every <= HIGH + 1e-12).all()
    assert found.theta[0] == ends[0]
    # Where the first stays at its bound, 1.25 y + 0.25 x is to be least.
    free = truth[1] - 0.25 / 1.25 * (ends[0] - truth[0])
    assert found.theta[1] == pytest.approx(np.clip(free, LOW[1], HIGH[1]), abs=1e-3)
