# SPDX-License-Identifier: Apache-2.0
"""Filters along rows; kept apart, as numba takes long to import."""
# mypy: ignore-errors

import numpy as np

from ros2_ident.arrays import Array
from ros2_ident.compiled import cached


@cached
def run_both_ways(sections, still, rows):
    """Filter columns (K, R) in place (direct form II transposed), forwards and then backwards.

    Args:
        sections: (N, 6) as `scipy.signal.sosfilt` has them.
        still: (N, 2) their state where a value of 1 has lasted.
        rows: Side by side, so that the compiler takes several at a time.
    """
    count, width = rows.shape
    state = np.empty((len(sections), 2, width))
    for backwards in range(2):
        first, step = (count - 1, -1) if backwards else (0, 1)
        for s in range(len(sections)):
            for r in range(width):
                state[s, 0, r] = still[s, 0] * rows[first, r]
                state[s, 1, r] = still[s, 1] * rows[first, r]
        for n in range(count):
            k = first + n * step
            for s in range(len(sections)):
                b0, b1, b2, _, a1, a2 = sections[s]
                for r in range(width):
                    value = rows[k, r]
                    new = b0 * value + state[s, 0, r]
                    state[s, 0, r] = b1 * value - a1 * new + state[s, 1, r]
                    state[s, 1, r] = b2 * value - a2 * new
                    rows[k, r] = new


@cached
def follow(keep: float, row: Array) -> Array:
    """Return (K,) a first-order lag behind a row (K,) whose first value has lasted.

    Args:
        keep: Share of its distance that is left a value later.
    """
    out = np.empty_like(row)
    state = keep * row[0]
    for k in range(row.size):
        out[k] = (1.0 - keep) * row[k] + state
        state = keep * out[k]
    return out
