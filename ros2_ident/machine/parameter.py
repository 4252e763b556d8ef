# SPDX-License-Identifier: Apache-2.0
"""Parameter: a named number with its unit and its box."""

from dataclasses import dataclass
import math
from typing import Literal

from ros2_ident.errors import ErrorCode, IdentError

Kind = Literal['physical', 'base', 'measurement']


@dataclass(frozen=True)
class Parameter:
    """One parameter of a model.

    Attributes:
        name: `tool_mass`, or `drive_1.gear_stiffness` where each drive has its own.
        unit: SI unit as text; `1` for a ratio.
        low: Lower bound of the search, in `unit`.
        high: Upper bound of the search, in `unit`.
        kind: `physical` for the machine, `measurement` for how it was logged; `base` for what
            stands for several of the machine's that show together only, and has either sign.
        source: Equation or reference the parameter stands in.
        absent: Value that means that the machine has none of it, where that is an answer: 0 of
            friction, an offset or a delay, not of a mass.

    Raises:
        IdentError: BAD_MACHINE_FILE where the bounds are not finite or not in order.
    """

    name: str
    unit: str
    low: float
    high: float
    kind: Kind
    source: str
    absent: float | None = None

    def __post_init__(self) -> None:
        if not (math.isfinite(self.low) and math.isfinite(self.high) and self.low < self.high):
            raise IdentError(
                ErrorCode.BAD_MACHINE_FILE,
                f'parameter {self.name} has the bounds [{self.low}, {self.high}]; '
                'write a finite lower bound below a finite upper one',
            )
