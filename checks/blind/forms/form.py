# SPDX-License-Identifier: Apache-2.0
"""What a form is: an effect by somebody's law, with the ranges its numbers are drawn from."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from checks.blind.forms.law import take_law
from checks.reference.effect_kind import Quantity
from checks.reference.plant import Plant
from ros2_ident.effects import CATALOGUE
from ros2_ident.errors import ErrorCode, IdentError

Values = Mapping[str, float]
Write = Callable[[Plant, int, Values, int], None]
# How far a drawn number stays from every start value of its counterpart, as a share of that.
CLEAR = 0.04


@dataclass(frozen=True)
class Range(Quantity):
    """A number drawn evenly from a continuous range, or evenly in its logarithm.

    Attributes:
        counterpart: The catalogue's parameter that means the same; its start values are avoided.
    """

    geometric: bool = False
    counterpart: str = ''

    def at(self, share: float) -> float:
        """Return the number at a share of the range, before scale and sign."""
        if self.geometric:
            return float(self.low * (self.high / self.low) ** share)
        return float(self.low + share * (self.high - self.low))

    def draw(self, rng: np.random.Generator, starts: Sequence[float]) -> float:
        """Return a number that is no start value."""
        while True:
            value = self.at(rng.random())
            if all(abs(value - s) > CLEAR * abs(s) for s in starts):
                return -value if self.signed and rng.random() < 0.5 else value


@dataclass(frozen=True)
class Form:
    """An effect as the generator has it.

    Attributes:
        name: Its own name, as `stribeck.rational`.
        effect: The catalogue's id of the effect; empty outside the catalogue.
        law: The equation, in plain text.
        source: Author, year, and where.
        size: The quantity that the size draws, geometrically from low to high.
        write: Writes it into a plant: plant, drive's index (-1 for the machine), values, seed.
        place: `drive` where each drive can have it, `all` where the machine has one.
        needs: What the machine has to have, as of `reference.effect_kind.Kind`.
        fades: Whether it may be made as small as one likes, and so be an imperfection.
    """

    name: str
    effect: str
    law: str
    source: str
    size: Range
    others: tuple[Range, ...]
    write: Write
    place: Literal['drive', 'all'] = 'drive'
    needs: str = ''
    fades: bool = True

    @property
    def label(self) -> str:
        """What a case's label calls it: the catalogue's id, or its own name outside."""
        return self.effect or self.name


@dataclass(frozen=True)
class Hidden:
    """A form with its numbers, at a place: what a case hides.

    Attributes:
        values: Its numbers by name, SI units.
        seed: Seed of what is random in it over time.
    """

    form: Form
    where: str
    values: Values
    size: float
    seed: int

    @property
    def effect(self) -> str:
        """See `Form.label`."""
        return self.form.label

    def apply(self, plant: Plant) -> None:
        """Write it into a plant.

        Raises:
            IdentError: INVALID_GOAL where the machine has no such drive.
        """
        take_law(plant)
        if self.where == 'all':
            self.form.write(plant, -1, self.values, self.seed)
            return
        if self.where not in plant.names:
            raise IdentError(
                ErrorCode.INVALID_GOAL,
                f'{self.form.name}: there is no drive {self.where}; choose from '
                + ', '.join(plant.names),
            )
        i = plant.names.index(self.where)
        self.form.write(plant, i, self.values, self.seed + i)


def setter(**columns: int) -> Write:
    """Return a `write` that puts values into columns of their drive, by name."""

    def write(plant: Plant, i: int, values: Values, seed: int) -> None:
        for name, column in columns.items():
            plant.drive[i, column] = values[name]

    return write


def twins(name: str) -> frozenset[str]:
    """Return an id with those that are the same answer; alone where the catalogue lacks it."""
    return frozenset({name, *CATALOGUE[name].twins}) if name in CATALOGUE else frozenset({name})
