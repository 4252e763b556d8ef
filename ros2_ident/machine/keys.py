# SPDX-License-Identifier: Apache-2.0
"""Key of a machine file, and the keys that every kind of machine has.

A kind lists its keys; the loader and `ident check` judge by that list, `ident new-machine` and the
reference page are written from it.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
import math
from typing import Literal

Section = Literal['', 'geometry', 'drive', 'controller', 'parameters']
Value = float | str
# What an absent key means, made from the drive's constants before it in the table.
Derived = Callable[[Mapping[str, Value]], Value]

# What a machine behaves like whose kind has no such key, and what an absent one means by default.
NEUTRAL: Mapping[str, Value] = {
    'gravity': 0.0,
    'gear_factor': 1.0,
    'travel_per_turn': 2.0 * math.pi,
    'rail_mass': 0.0,
    'coulomb_regularisation': 5e-3,
    'law': 'cascade_pi',
    'position_gain': math.nan,
    'velocity_gain': math.nan,
    'integral_gain': 0.0,
    'velocity_feedforward': 0.0,
    'torque_limit': math.inf,
}


# In the place of a description's file: the topic on which the node hears it.
DESCRIPTION_TOPIC = '/robot_description'


@dataclass(frozen=True)
class Key:
    """One key of a machine file.

    Attributes:
        section: The mapping it stands in; empty for the file itself.
        name: The key.
        unit: Its unit, `1` for a plain number, empty where it is no number. The values of
            `parameters` are intervals in it.
        meaning: What it is.
        example: Value in a new machine file.
        absent: What its absence means, in words; empty where it may not be absent.
        default: What its absence means; where None, what `NEUTRAL` says.
        low: Smallest plausible value.
        high: Largest plausible value.
        force_unit: Its unit where the effort is a force.
        shown: Whether a new machine file sets it; else it stands there behind a `#`.
        each: Whether it belongs to a drive: the file has one value for all, or a list.
        choices: What may stand there where it is no number; empty for anything.
        aliases: Other words for a choice.
        remedy: What to do where a value is implausible.
        file: Whether it names a file, by its way from the machine file's folder. What the file
            holds is then the constant: a machine needs no path. `DESCRIPTION_TOPIC` stands for
            what the node hears.
    """

    section: Section
    name: str
    unit: str
    meaning: str
    example: object
    absent: str = ''
    default: Value | Derived | None = None
    low: float = -math.inf
    high: float = math.inf
    force_unit: str = ''
    shown: bool = True
    each: bool = False
    choices: tuple[str, ...] = ()
    aliases: tuple[tuple[str, str], ...] = ()
    remedy: str = 'check value and unit'
    file: bool = False

    @property
    def path(self) -> tuple[str, ...]:
        """Where it stands: section and name, or the name alone."""
        return (self.section, self.name) if self.section else (self.name,)

    @property
    def constant(self) -> bool:
        """Whether it says something of the machine that models read."""
        return self.section not in ('', 'parameters')

    def at(self, example: object, **changes: object) -> 'Key':
        """Return the key with another example, and other changes."""
        return replace(self, example=example, **changes)  # type: ignore[arg-type]

    def value(self, before: Mapping[str, Value]) -> Value:
        """Return what the key's absence means.

        Args:
            before: The same drive's constants before it in the table.
        """
        if callable(self.default):
            return self.default(before)
        return NEUTRAL.get(self.name, math.nan) if self.default is None else self.default

    def searched(
        self, low: float | None = None, high: float | None = None, shown: bool = False
    ) -> 'Key':
        """Return a constant as something to be identified.

        Args:
            low: Lower bound of the example; three quarters of the constant's by default. Where
                each drive has its own, less than that by how much.
            high: Upper bound of the example; five quarters of the constant's by default. Where
                each drive has its own, more than that by how much.
            shown: As the attribute.
        """
        ends: tuple[object, ...]
        if isinstance(self.example, tuple):
            ends = tuple((x + (low or 0.0), x + (high or 0.0)) for x in self.example)
        else:
            assert isinstance(self.example, float)
            ends = (
                0.75 * self.example if low is None else low,
                1.25 * self.example if high is None else high,
            )
        absent = 'the constant above holds'
        return replace(self, section='parameters', example=ends, shown=shown, absent=absent)


# Keys of a section; what is not of the geometry belongs to a drive.
of_geometry = partial(Key, 'geometry')
of_drive = partial(Key, 'drive', each=True)
of_controller = partial(Key, 'controller', each=True)
sought = partial(Key, 'parameters', each=True)

# Of machines whose effort is logged by a drive, in its own unit.
EFFORT = (
    Key('', 'effort_unit', '', 'of the logged effort: N m, N, A or percent', 'N m',
        absent='N m by default'),
    Key('', 'torque_constant', 'N m/A', 'torque per current, or a list of each drive', 0.5,
        absent='needed where effort_unit is A', low=-1e3, high=1e3, force_unit='N/A', shown=False,
        each=True),
    Key('', 'rated_torque', 'N m', 'torque at 100 %, or a list of each drive', 2.4,
        absent='needed where effort_unit is percent', low=-1e5, high=1e5, force_unit='N',
        shown=False, each=True),
)


def head(
    kind: str,
    drives: tuple[str, ...],
    meaning: str = 'joint names in the bag',
    noise: float = 0.01,
    effort: tuple[Key, ...] = EFFORT,
) -> tuple[Key, ...]:
    """Return the keys that a machine file begins with.

    Args:
        kind: Name of the kind.
        drives: Joint names of the example.
        meaning: What the joint names are.
        noise: Example of the effort's noise.
        effort: Keys that say what the logged effort is.
    """
    return (
        Key('', 'machine', '', 'kind of machine', kind),
        Key('', 'drives', '', meaning, drives),
        *effort,
        Key('', 'effort_noise', 'N m', 'standard deviation of the logged effort at rest', noise,
            absent='0.01 by default', low=0.0, high=1e4, force_unit='N'),
    )


def literal(key: Key) -> str:
    """Return the example of a key as YAML."""
    value = key.example
    if key.section == 'parameters':
        assert isinstance(value, tuple)
        if isinstance(value[0], tuple):
            return f'[{", ".join(literal(key.at(box)) for box in value)}]'
        unit = '"1"' if key.unit == '1' else key.unit
        return f'[{digits(value[0])}, {digits(value[1])}, {unit}]'
    if isinstance(value, tuple):
        return f'[{", ".join(str(part) for part in value)}]'
    return digits(value) if isinstance(value, float) else str(value)


def digits(value: float) -> str:
    """Return a number so that YAML 1.1 reads it as one: with a point, its exponent with a sign."""
    if value and not 1e-3 <= abs(value) < 1e4:
        mantissa, _, exponent = f'{value:.7e}'.partition('e')
        mantissa = mantissa.rstrip('0')
        return f'{mantissa}{"0" if mantissa.endswith(".") else ""}e{int(exponent):+d}'
    text = f'{value:.9g}'
    return text if '.' in text else f'{text}.0'
