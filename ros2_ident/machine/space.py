# SPDX-License-Identifier: Apache-2.0
"""Where and how fast a machine moves when nobody says otherwise."""

from dataclasses import dataclass

import numpy as np

from ros2_ident.arrays import Array


@dataclass(frozen=True)
class Space:
    """Where and how fast a machine moves.

    Attributes:
        centre: (M,) middle of the workspace [m]: platform position, or axis position.
        reach: (M,) half its extents [m].
        speed: Largest speed [m/s].
        acceleration: Largest acceleration [m/s^2].
    """

    centre: Array
    reach: Array
    speed: float
    acceleration: float

    def point(self, rng: np.random.Generator, share: float = 1.0) -> Array:
        """Return a point drawn evenly from the workspace, shrunk to a share of its reach."""
        return np.asarray(
            self.centre + share * self.reach * rng.uniform(-1.0, 1.0, self.centre.size)
        )
