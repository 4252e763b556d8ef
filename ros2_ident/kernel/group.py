# SPDX-License-Identifier: Apache-2.0
"""Candidates side by side in vectors of lanes, and what they are simulated for."""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ros2_ident import lanes
from ros2_ident.arrays import Array
from ros2_ident.kernel import measurement

# Cycles after which candidates that were not given up move together into fewer vectors.
PART = 8 * measurement.PIECE


class Task(NamedTuple):
    """Purpose of a simulation, as `measurement.hand_on` takes it.

    Q is 1 where the effort alone is wanted, else 3: `measurement.QUANTITIES`.

    Attributes:
        wanted: (Q, D, K) column of `out` for each quantity, drive and cycle, -1 for none.
        measured: (Q, D, K + 1) what was measured where costs are summed, NaN where there is no
            sample and behind the last cycle; else (0, 0, 0).
        samples: (Q, D) cycles that count.
        weights: (Q,) factors on the errors, positive.
        limits: (S,) cost above which a candidate need not be simulated further; (0,) for none.
        out: (S, C) what the log holds, or (S, 1) costs.
    """

    wanted: npt.NDArray[np.int64]
    measured: Array
    samples: npt.NDArray[np.int64]
    weights: Array
    limits: Array
    out: Array


class Group(NamedTuple):
    """Candidates on their way through the log, in G vectors of lanes.

    Attributes:
        blocks: (G, R * W) rows of `kernel.rows`.
        rows: (G, W) row of `Task.out` for each lane, -1 for none.
        substeps: (G, 2 * W) integration steps in a cycle, while fast and otherwise.
        state: (G, ...) what the simulation goes on with.
    """

    blocks: Array
    rows: npt.NDArray[np.int64]
    substeps: Array
    state: Array

    def moved_together(self) -> 'Group':
        """Return the candidates that were not given up, some, in as few vectors as hold them."""
        width = lanes.WIDTH
        left = np.flatnonzero(self.rows.ravel() >= 0)
        groups = -(-len(left) // width)
        if groups == len(self.rows):
            return self
        # The last vector is filled up with copies.
        lane = np.pad(left, (0, groups * width - len(left)), mode='edge')
        rows = self.rows.ravel()[lane]
        rows[len(left) :] = -1

        def moved(values: Array) -> Array:
            alone = values.reshape(len(values), -1, width).transpose(0, 2, 1)
            alone = alone[lane // width, lane % width].reshape(groups, width, -1)
            out = lanes.room(*alone.transpose(0, 2, 1).shape)
            out[:] = alone.transpose(0, 2, 1)
            return out.reshape(groups, values.shape[1])

        return Group(
            moved(self.blocks),
            rows.reshape(groups, width),
            moved(self.substeps),
            moved(self.state),
        )
