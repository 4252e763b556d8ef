# SPDX-License-Identifier: Apache-2.0
"""How large a drive's logged effort gets: the measure of what an effect may add to it."""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from ros2_ident.machine.machine import Machine
from ros2_ident.recording import Dataset

# What one sample in a thousand exceeds: a push of 10 ms counts in a log of 10 s, a spike does not.
_QUANTILE = 0.999


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
