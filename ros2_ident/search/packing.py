# SPDX-License-Identifier: Apache-2.0
"""The order of candidates that fills the vector lanes.

Candidates that take the same number of integration steps share a vector of lanes. The order
matters to the time only: a search draws and selects as without.
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from ros2_ident.arrays import Array
from ros2_ident.search.operators import Index

# (S, N) candidates in the unit cube -> (S,) how much work each of them is.
Work = Callable[[Array], Any]
# Sorted in parts, so that a budget that ends within a generation leaves no corner of the box out.
PART = 128
# So many are looked at in one go: what a model makes of a candidate takes some kB.
_BLOCK = 64 * PART


class Packing:
    """A generation's candidates in an order in which neighbours are alike in work.

    Args:
        points: (S, N) candidates as they were drawn, in the unit cube.
        work: How much work each is; None leaves the order as it is.
        stop: Whether nothing will be simulated any more; the order then stays as it is.
    """

    def __init__(
        self, points: Array, work: Work | None, stop: Callable[[], bool] = bool
    ) -> None:
        self._order: Index | None = None
        if work is None:
            return
        found = []
        for begin in range(0, len(points), _BLOCK):
            if stop():
                return
            found.append(np.asarray(work(points[begin : begin + _BLOCK])))
        part = np.arange(len(points)) // PART
        self._order = np.lexsort((np.concatenate(found), part))

    def packed(self, drawn: Any) -> Any:
        """Return values of the candidates (S, ...) in the packed order."""
        return drawn if self._order is None else drawn[self._order]

    def drawn(self, packed: Any) -> Any:
        """Return values of the candidates (S, ...) in the order in which they were drawn."""
        if self._order is None:
            return packed
        out = np.empty_like(packed)
        out[self._order] = packed
        return out

    def places(self, drawn: Index) -> Index:
        """Return where candidates, given by their number as drawn, stand in the packed order."""
        if self._order is None:
            return drawn
        places: Index = np.empty_like(self._order)
        places[self._order] = np.arange(len(self._order))
        return places[drawn]
