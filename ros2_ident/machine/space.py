# SPDX-License-Identifier: Apache-2.0
"""A machine in space: place and speed of its motion by default, and its picture."""

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


@dataclass(frozen=True, eq=False)
class Figure:
    """A machine at F instants; lengths in m.

    Attributes:
        size: A length of the machine to which what is drawn is scaled, m.
        tool: Where its tool is (F, 3).
        blocks: Middles of its B drives' carriages (F, B, 3).
        links: Ends of the lines from carriages to tool (F, L, 2, 3).
        body: Ends of the lines of the tool itself, about its place (L, 2, 3).
        frame: Ends of the lines that stand still (L, 2, 3).
    """

    size: float
    tool: Array
    blocks: Array
    links: Array
    body: Array
    frame: Array
