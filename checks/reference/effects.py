# SPDX-License-Identifier: Apache-2.0
"""What a machine may have beside its nominal physics: drawn by size, written into a plant.

Every effect of the diagnosis's catalogue is here twice: in the form a catalogue would write down
(`same`) and in another form of the same physics (`other`), so that a diagnosis is not judged on
its own equations (Colton and Kress call that the inverse crime). Effects of the group `outside`
are in no catalogue.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from checks.reference.effect_kind import Kind
from checks.reference.effect_table import KINDS as INSIDE
from checks.reference.outside_table import KINDS as OUTSIDE
from checks.reference.plant import Plant
from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.machine.machine import Machine
from ros2_ident.models import registry

Form = Literal['same', 'other']

# Kinds that do not fade out with their size: a bristle in place of the tanh, a limit.
NO_ZERO = ('presliding', 'torque_saturation')
# Effects of the catalogue that have their twin under another id.
TWINS = {'payload_turns': 'payload_change'}


@dataclass(frozen=True)
class Effect:
    """One effect with its numbers.

    Attributes:
        name: The kind's id.
        where: Drives it sits on, or `('all',)`.
        values: Physical values by name, SI units.
        form: Form of its equation.
        size: The size it was drawn with, 0 to 1; NaN where the values were given.
        seed: Seed of what is random in it (jitter, losses).
    """

    name: str
    where: tuple[str, ...]
    values: Mapping[str, float]
    form: Form = 'other'
    size: float = float('nan')
    seed: int = 0
    kind: Kind = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        """Look the kind up and check the values' names."""
        kind = kind_of(self.name)
        object.__setattr__(self, 'kind', kind)
        known = {quantity.name for quantity in (kind.size, *kind.others)}
        if set(self.values) != known:
            raise IdentError(
                ErrorCode.UNKNOWN_PARAMETER,
                f'effect {self.name} needs the values {", ".join(sorted(known))}; '
                f'found {", ".join(sorted(self.values)) or "none"}',
            )
        if kind.place == 'all' and self.where != ('all',):
            raise IdentError(
                ErrorCode.INVALID_GOAL,
                f'effect {self.name} sits on the whole machine; place it on all',
            )

    @property
    def equation(self) -> str:
        """The equation of the chosen form."""
        return self.kind.same if self.form == 'same' else self.kind.other

    def apply(self, plant: Plant) -> None:
        """Write the effect into a plant.

        Raises:
            IdentError: INVALID_GOAL where the machine has no such drive.
        """
        if self.kind.place == 'all':
            self.kind.write(plant, -1, self.values, self.form == 'other', self.seed)
            return
        names = plant.names if self.where == ('all',) else self.where
        for name in names:
            if name not in plant.names:
                raise IdentError(
                    ErrorCode.INVALID_GOAL,
                    f'effect {self.name}: there is no drive {name}; '
                    f'choose from {", ".join(plant.names)}',
                )
            i = plant.names.index(name)
            self.kind.write(plant, i, self.values, self.form == 'other', self.seed + i)


def kinds() -> Mapping[str, Kind]:
    """Return all kinds of effects by id: the catalogue's, then the ones outside it."""
    return {kind.name: kind for kind in (*INSIDE, *OUTSIDE)}


def kind_of(name: str) -> Kind:
    """Return a kind by id.

    Raises:
        IdentError: INVALID_GOAL where there is none of that name.
    """
    table = kinds()
    if name not in table:
        raise IdentError(
            ErrorCode.INVALID_GOAL, f'no effect is called {name}; choose from ' + ', '.join(table)
        )
    return table[name]


def suits(kind: Kind, machine: Machine, parameters: Mapping[str, float]) -> bool:
    """Return whether an effect can sit on a machine."""
    gear = any(key.endswith('gear_stiffness') for key in parameters)
    return machine_has(kind.needs, machine, gear)


def machine_has(needs: str, machine: Machine, gear: bool) -> bool:
    """Return whether a machine has what an effect needs; `gear` says whether its gear gives."""
    platform = registry.kind_of(machine).set_points is not None
    there = {
        '': True,
        'platform': platform,
        'gear': gear,
        'rigid': not (machine.number('gravity') or gear or platform),
        'integral': bool((machine.numbers('integral_gain') > 0.0).any()),
        'drives': len(machine.drives) > 1,
        'supply': machine.known('supply_voltage'),
    }
    return bool(there[needs])


def draw_effect(
    name: str,
    rng: np.random.Generator,
    size: float,
    where: Sequence[str],
    machine: Machine,
    form: Form = 'other',
) -> Effect:
    """Draw an effect's numbers.

    Args:
        name: The kind's id.
        rng: Source of chance.
        size: 0 (seen by nobody) to 1 (gross): the size quantity is low (high / low)^size.
        where: Drives, or `('all',)`; kinds that sit on the whole machine are put on all.
        machine: The machine; scales torques and forces.
        form: Form of the equation.

    Returns:
        The effect.
    """
    kind = kind_of(name)
    magnitude = kind.size.low * (kind.size.high / kind.size.low) ** size * kind.size.scale(machine)
    if kind.size.signed and rng.random() < 0.5:
        magnitude = -magnitude
    values = {kind.size.name: float(magnitude)}
    for quantity in kind.others:
        if quantity.choices:
            values[quantity.name] = float(rng.choice(quantity.choices))
        else:
            drawn = rng.uniform(quantity.low, quantity.high) * quantity.scale(machine)
            values[quantity.name] = float(
                -drawn if quantity.signed and rng.random() < 0.5 else drawn
            )
    seed = int(rng.integers(2**31))
    places = ('all',) if kind.place == 'all' else tuple(where)
    return Effect(name, places, values, form, float(size), seed)


def draw_imperfections(
    rng: np.random.Generator, machine: Machine, parameters: Mapping[str, float], count: int = 2
) -> tuple[Effect, ...]:
    """Draw the small unlisted imperfections that every real log has: each well below the noise.

    Args:
        rng: Source of chance.
        machine: The machine.
        parameters: Nominal parameters.
        count: How many beside the arctan in place of the sign's tanh.

    Returns:
        Effects to be applied before the one that counts.
    """
    drives = machine.drives
    names = [
        kind.name
        for kind in kinds().values()
        if kind.group not in ('nuisance', 'outside')
        and kind.name not in NO_ZERO
        and suits(kind, machine, parameters)
    ]
    chosen = rng.choice(names, size=count, replace=False)
    drawn = [draw_effect('arctan_sign', rng, 0.5, ('all',), machine)]
    for name in chosen:
        drawn.append(draw_effect(str(name), rng, -0.3, (str(rng.choice(drives)),), machine))
    return tuple(drawn)


def parse_effect(
    text: str, rng: np.random.Generator, machine: Machine, form: Form = 'other'
) -> Effect:
    """Read an effect from a command line.

    Args:
        text: `stribeck@drive_2:torque=0.05,speed=0.03`, or `stribeck@drive_2:size=0.5` to draw it,
            or `frame_resonance:size=0.8`; without `@` it sits on all drives.
        rng: Source of chance where the effect is drawn.
        machine: The machine.
        form: Form of the equation.

    Returns:
        The effect.

    Raises:
        IdentError: INVALID_GOAL where the text cannot be read.
    """
    head, _, tail = text.partition(':')
    name, _, place = head.partition('@')
    where = tuple(place.split('+')) if place else ('all',)
    try:
        values = {
            key: float(number) for key, number in (p.split('=') for p in tail.split(',') if p)
        }
    except ValueError:
        raise IdentError(
            ErrorCode.INVALID_GOAL,
            f'cannot read the effect {text!r}; write as stribeck@drive_2:torque=0.05,speed=0.03',
        ) from None
    if set(values) == {'size'}:
        return draw_effect(name, rng, values['size'], where, machine, form)
    return Effect(name, where, values, form, seed=int(rng.integers(2**31)))
