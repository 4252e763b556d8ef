# SPDX-License-Identifier: Apache-2.0
"""What a machine may have beside its nominal physics: drawn by size, written into a plant.

Tests hold the catalogue's kernels against these equations. In `blind.forms` stand other forms of
the same physics, so that a diagnosis is not judged on its own (Colton and Kress call that the
inverse crime), and effects of no catalogue.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from checks.reference.effect_kind import Kind
from checks.reference.effect_table import KINDS
from checks.reference.plant import Plant
from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.machine.machine import Machine
from ros2_ident.models import registry

# Effects of the catalogue that have their twin under another id.
TWINS = {
    'payload_turns': 'payload_change',
    'torque_ripple_2': 'torque_ripple',
    'torque_ripple_3': 'torque_ripple',
}


@dataclass(frozen=True)
class Effect:
    """One effect with its numbers.

    Attributes:
        where: Drives it sits on, or `('all',)`.
        values: Physical values by name, SI units.
    """

    name: str
    where: tuple[str, ...]
    values: Mapping[str, float]
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

    def apply(self, plant: Plant) -> None:
        """Write the effect into a plant.

        Raises:
            IdentError: INVALID_GOAL where the machine has no such drive.
        """
        if self.kind.place == 'all':
            self.kind.write(plant, -1, self.values)
            return
        names = plant.names if self.where == ('all',) else self.where
        for name in names:
            if name not in plant.names:
                raise IdentError(
                    ErrorCode.INVALID_GOAL,
                    f'effect {self.name}: there is no drive {name}; '
                    f'choose from {", ".join(plant.names)}',
                )
            self.kind.write(plant, plant.names.index(name), self.values)


def kinds() -> Mapping[str, Kind]:
    """Return all kinds of effects by id."""
    return {kind.name: kind for kind in KINDS}


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
    name: str, rng: np.random.Generator, size: float, where: Sequence[str], machine: Machine
) -> Effect:
    """Draw an effect's numbers.

    Args:
        size: 0 (seen by nobody) to 1 (gross): the size quantity is low (high / low)^size.
        where: Drives, or `('all',)`; kinds that sit on the whole machine are put on all.
        machine: The machine; scales torques and forces.
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
    places = ('all',) if kind.place == 'all' else tuple(where)
    return Effect(name, places, values)
