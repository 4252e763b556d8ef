# SPDX-License-Identifier: Apache-2.0
"""Where to start a refinement from: the best candidate, and good ones far from it."""

from collections.abc import Callable

import numpy as np

from ros2_ident.arrays import Array
from ros2_ident.search.evaluators import Cancel
from ros2_ident.search.operators import Flags

# Starts differ in at least one parameter by this part of the box.
APART = 0.1


def distinct_starts(
    best: Array,
    candidates: Array,
    costs: Array,
    exact: Flags,
    width: Array,
    count: int,
    evaluate: Callable[[Array, float], Array],
    stop: Cancel,
) -> Array:
    """Return the best candidate and the best that lie apart from it and each other.

    Some costs are lower bounds only; those that matter are found out as far as they do.

    Args:
        best: (N,) the best candidate.
        candidates: (E, N) all of them.
        costs: (E,) their costs, or lower bounds; is brought up to date.
        exact: (E,) where it is the cost; is brought up to date.
        width: (N,) widths of the box.
        count: Most starts.
        evaluate: (S, N), limit -> (S,) costs, or lower bounds of those above the limit.
        stop: Ends the search for further starts.

    Returns:
        (B, N) starts, the best first, B <= count.
    """
    if count < 2:
        return best[None]

    def apart(point: Array) -> Flags:
        far: Flags = (np.abs(candidates - point) / width).max(axis=1) > APART
        return far

    beside_best = apart(best)

    def chosen(among: Array) -> list[int]:
        rows: list[int] = []
        free = beside_best & np.isfinite(among)
        while len(rows) < count - 1 and free.any():
            # Of candidates of equal cost the one that was drawn first.
            rows.append(int(np.where(free, among, np.inf).argmin()))
            free &= apart(candidates[rows[-1]])
        return rows

    known = chosen(np.where(exact, costs, np.inf))
    limit = float(costs[known[-1]]) if len(known) == count - 1 else np.inf
    rows = np.flatnonzero(beside_best & ~exact & (costs <= limit))
    while len(rows) and not stop.is_set():
        costs[rows] = evaluate(candidates[rows], limit)
        exact[rows] = costs[rows] <= limit
        rows = np.array([row for row in chosen(costs) if not exact[row]], dtype=np.intp)
        limit = np.inf
    return np.array([best, *candidates[chosen(costs)]])
