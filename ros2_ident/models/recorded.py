# SPDX-License-Identifier: Apache-2.0
"""A recording's motion as the controllers saw it, and how large its efforts get."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ros2_ident.arrays import Array
from ros2_ident.machine.machine import Machine
from ros2_ident.recording import Dataset
from ros2_ident.recording.motion import fill_smoothly

# The effort before the first cycle is the mean of this much of the log, s.
_BEGINNING = 0.05
# What one sample in a thousand exceeds: a push of 10 ms counts in a log of 10 s, a spike does not.
_QUANTILE = 0.999


@dataclass(frozen=True)
class RecordedMotion:
    """Recorded motion at every controller cycle.

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


def effort_range(machine: Machine, data: Sequence[Dataset]) -> npt.NDArray[np.float64]:
    """Return the size of each drive's logged effort that one sample in a thousand exceeds.

    What acts on a drive in a closed loop has to be paid by its motor, so it shows in the log. A
    limit that the machine file states says less: drives seldom come near theirs, and a file may
    leave it out.

    Args:
        machine: The machine.
        data: Its recordings; the largest of them counts.

    Returns:
        (D,) efforts [model's unit], at least the noise; a hundred times it for a drive that no
        recording shows.
    """
    out = np.full(len(machine.drives), 100.0 * machine.effort_noise)
    for d, name in enumerate(machine.drives):
        rows = [one.effort[one.names.index(name)] for one in data if one.effort is not None]
        seen = [np.abs(row[np.isfinite(row)]) for row in rows if np.isfinite(row).any()]
        if seen:
            largest = max(float(np.quantile(size, _QUANTILE)) for size in seen)
            out[d] = max(largest, machine.effort_noise, 1e-12)
    return out
