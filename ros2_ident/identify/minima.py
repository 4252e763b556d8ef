# SPDX-License-Identifier: Apache-2.0
"""Whether the best fit may not be the best there is: refinements that end apart tell."""

from collections.abc import Sequence
from itertools import accumulate, pairwise

import numpy as np

from ros2_ident.arrays import Array
from ros2_ident.identify.problem import Problem
from ros2_ident.search import RefineStatus
from ros2_ident.search.fit import Fitted
from ros2_ident.search.noise import fit_noise
from ros2_ident.search.refine import StartOutcome

# Minima lie apart by this part of the box in some parameter, and by so many half widths of its
# interval: a parameter that the data do not determine makes none.
APART, BEYOND = 0.01, 3.0
# One that leaves less than so many times the best one's mean square above the noise fits alike.
ALIKE = 2.0


def rival_minima(problem: Problem, found: Fitted) -> tuple[StartOutcome, ...]:
    """Return minima beside the best one that fit almost as well, lowest cost first.

    Args:
        problem: What was fitted.
        found: How; its refinements' ends are compared.

    Returns:
        Nothing where the best fit leaves noise only, or several refinements ended there.
    """
    refined, known = found.refined, found.intervals
    if refined is None or known is None or not np.isfinite(found.residual).all():
        return ()
    near = np.maximum(APART * (problem.high - problem.low), BEYOND * known.half_width)
    ends = [s for s in refined.starts if s.status is RefineStatus.CONVERGED]
    apart = [s for s in ends if (np.abs(s.theta - found.theta) > near).any()]
    if not apart or len(ends) - len(apart) > 1:
        return ()
    noise = _noise(found.residual, problem.series)
    limit = noise + ALIKE * (refined.cost**2 - noise)
    return tuple(sorted((s for s in apart if s.cost**2 < limit), key=lambda s: s.cost))


def _noise(residual: Array, series: Sequence[int]) -> float:
    """Return the mean square of what a residual's own past does not tell, series by series."""
    ends = pairwise(accumulate(series, initial=0))
    total = sum((b - a) * fit_noise(residual[a:b]).innovation for a, b in ends)
    return total / max(1, residual.size)
