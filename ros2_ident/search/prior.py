# SPDX-License-Identifier: Apache-2.0
"""Which of the fits that data cannot tell apart: the most probable one, given the box."""

from dataclasses import dataclass
import math

import numpy as np
from scipy.optimize import lsq_linear

from ros2_ident.arrays import Array

# What may be anywhere between 0 and 1 has this standard deviation about one half.
BOX_DEVIATION = math.sqrt(1.0 / 12.0)


@dataclass(frozen=True)
class Posterior:
    """Least squares with what a box tells before: a normal prior with its mean and variance.

    Parameters are shares of their box. What the data determine hardly feels it; what they leave
    open stays in the middle.

    Attributes:
        certainty: What a square of the residual counts, one over its unit squared.

    Reference:
        Maximum a posteriori: Gelman et al. (2013), Bayesian Data Analysis, section 13.1.
    """

    certainty: float

    @classmethod
    def of(cls, residual: Array) -> 'Posterior':
        """Return it for a fit's (R,) residual taken as white noise.

        Raises:
            ZeroDivisionError: Where there is no residual.
        """
        return cls(len(residual) / float(residual @ residual))

    def loss(self, unit: Array, residual: Array) -> float:
        """Return minus twice the logarithm of the posterior, but for a constant."""
        aside = (unit - 0.5) / BOX_DEVIATION
        return self.certainty * float(residual @ residual) + float(aside @ aside)

    def least(
        self, unit: Array, residual: Array, jacobian: Array, damping: float = 0.0
    ) -> tuple[Array, float]:
        """Return the (N,) parameters of the least loss by a (R, N) Jacobian, and that loss.

        Damping holds them where they are, by a share of the columns' squares.
        """
        both = math.sqrt(self.certainty) * np.column_stack([jacobian, -residual])
        # The triangular factor has the minimum of the whole.
        triangle = np.asarray(np.linalg.qr(both, mode='r'))
        rows = [triangle[:, :-1], np.eye(unit.size) / BOX_DEVIATION]
        wanted = [triangle[:, -1], (0.5 - unit) / BOX_DEVIATION]
        if damping:
            rows.append(np.diag(math.sqrt(damping) * np.linalg.norm(rows[0], axis=0)))
            wanted.append(np.zeros(unit.size))
        found = lsq_linear(
            np.concatenate(rows),
            np.concatenate(wanted),
            (-unit - 1e-15, 1.0 - unit + 1e-15),
            method='bvls',
        )
        return np.clip(unit + found.x, 0.0, 1.0), 2.0 * float(found.cost)
