# SPDX-License-Identifier: Apache-2.0
"""What is drawn of a machine in space: points and lines, whoever draws them."""

from dataclasses import dataclass

from ros2_ident.arrays import Array


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
