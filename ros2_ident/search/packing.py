# SPDX-License-Identifier: Apache-2.0
"""A search whose candidates come in an order that fills the vector lanes."""

from collections.abc import Callable
from typing import Any

import numpy as np

from ros2_ident.search import GeneticSearch, GeneticSettings
from ros2_ident.search.operators import Array

# Sorted in parts, so that a budget that ends within a generation leaves no corner of the box out.
PART = 128


class PackedSearch(GeneticSearch):
    """The genetic algorithm, its candidates sorted by the work that each of them is.

    Candidates that take the same number of integration steps share a vector of lanes. The order
    matters to the time only: costs are put back in the order of the search, which draws and
    selects as without.

    Args:
        dimension: As for `GeneticSearch`.
        settings: Likewise.
        seed: Likewise.
        work: (S, N) in the unit cube -> (S,) work.
    """

    def __init__(
        self,
        dimension: int,
        settings: GeneticSettings,
        seed: int,
        work: Callable[[Array], Any],
    ) -> None:
        super().__init__(dimension, settings, seed)
        self._work = work
        self._order: Any = np.empty(0, dtype=np.int64)

    def ask(self) -> Array:
        """Return the candidates (S, N) of the present generation in the unit cube, sorted."""
        points = super().ask()
        work = np.asarray(self._work(points))
        part = np.arange(len(points)) // PART
        self._order = np.lexsort((work, part))
        packed: Array = points[self._order]
        return packed

    def _as_drawn(self, values: Any) -> Any:
        drawn = np.empty_like(values)
        drawn[self._order] = values
        return drawn
