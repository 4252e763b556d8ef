# SPDX-License-Identifier: Apache-2.0
"""What a kind of effect is to the reference: its quantities, its equation, who writes it."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
import math
from typing import Literal

import numpy as np

from checks.reference.plant import Plant
from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.machine.machine import Machine

# The table's torques and forces suit the tripod of config/tripod.yaml; other machines scale them.
TRIPOD_LIMIT = 6.0  # N m
TRIPOD_FORCE = 6.0 * 2.0 * np.pi / 0.08  # N


@dataclass(frozen=True)
class Quantity:
    """One drawn number of an effect.

    Attributes:
        low: Value at size 0, or lower end of the draw.
        high: Value at size 1, or upper end of the draw.
        choices: Values to choose from, instead of the range.
    """

    name: str
    unit: str
    low: float = 0.0
    high: float = 0.0
    signed: bool = False
    choices: tuple[float, ...] = ()

    def scale(self, machine: Machine) -> float:
        """Return the factor from the tripod's torques and forces to another machine's.

        Raises:
            IdentError: INVALID_GOAL where the machine has no limit to go by.
        """
        if not self.unit.startswith('N'):
            return 1.0
        limit = float(machine.numbers('torque_limit').max())
        if not math.isfinite(limit):
            raise IdentError(
                ErrorCode.INVALID_GOAL,
                f'{self.name} is drawn as a share of controller.torque_limit, which the machine '
                f'file lacks; add it, or give {self.name}=VALUE in {self.unit}',
            )
        if self.unit.startswith('N m'):
            return limit / TRIPOD_LIMIT
        return limit * float(machine.numbers('gear_factor').max()) / TRIPOD_FORCE


Write = Callable[[Plant, int, Mapping[str, float]], None]


@dataclass(frozen=True)
class Kind:
    """A kind of effect.

    Attributes:
        write: Writes it into a plant: plant, drive's index (-1 for the machine), values.
        size: The quantity that the size draws, geometrically from low to high.
        others: Quantities drawn beside it, uniformly.
        place: `drive` where each drive can have it, `all` where the machine has one.
        needs: What the machine has to have: `gear`, `rigid` (no gear that gives, and no weight),
            `platform`, `integral`, `drives` (more than one), `supply` (motors fed with a
            voltage), or nothing.
    """

    name: str
    law: str
    write: Write
    size: Quantity
    others: tuple[Quantity, ...] = ()
    place: Literal['drive', 'all'] = 'drive'
    needs: str = ''
