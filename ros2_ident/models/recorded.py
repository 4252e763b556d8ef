# SPDX-License-Identifier: Apache-2.0
"""A recording's motion as the controllers saw it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ros2_ident.arrays import Array
from ros2_ident.recording import Dataset
from ros2_ident.recording.motion import fill_smoothly

# The effort before the first cycle is the mean of this much of the log, s.
_BEGINNING = 0.05


@dataclass(frozen=True)
class RecordedMotion:
    """What a log holds of the motion, at every controller cycle.

    Attributes:
        values: (2 * D * K,) positions of the drives, then their velocities.
        hold: (D,) effort at the log's start.
    """

    values: Array
    hold: Array


def recorded_motion(data: Dataset, drives: Sequence[str]) -> RecordedMotion:
    """Return the motion of the drives, cycles without a sample filled smoothly.

    Args:
        data: The recording on the grid of controller cycles, with position and effort.
        drives: Names, in the order wanted.
    """
    rows = [data.names.index(name) for name in drives]
    assert data.position is not None and data.effort is not None
    positions = [fill_smoothly(data.position[row]) for row in rows]
    if data.velocity is None:
        velocities = [np.gradient(position, data.cycle) for position in positions]
    else:
        velocities = [fill_smoothly(data.velocity[row]) for row in rows]
    first = data.effort[rows, : max(1, int(_BEGINNING / data.cycle))]
    seen = np.isfinite(first)
    hold = np.where(seen, first, 0.0).sum(axis=1) / np.maximum(seen.sum(axis=1), 1)
    return RecordedMotion(np.concatenate([*positions, *velocities]), hold)
