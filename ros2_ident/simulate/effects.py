# SPDX-License-Identifier: Apache-2.0
"""Effects that a simulated machine has, as they are named on a command line."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
import sys

import numpy as np

from ros2_ident.effects import Effect, EffectParameter, get_effect, SOURCES
from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.machine.machine import Machine
from ros2_ident.models.protocol import EffectAt
from ros2_ident.simulate.motions import Motion


@dataclass(frozen=True)
class Added:
    """An effect with its numbers.

    Attributes:
        effect: The effect.
        where: Drives that it sits on; all where empty.
        values: Its parameters by their short names, physical units; or `size` alone, the share of
            the largest that a search looks for, the rest to be drawn.
    """

    effect: Effect
    where: tuple[str, ...]
    values: Mapping[str, float]

    def places(self, machine: Machine) -> list[EffectAt]:
        """Return where it sits in a machine."""
        if self.effect.place == 'all':
            return [EffectAt(self.effect.id, 'all')]
        return [EffectAt(self.effect.id, drive) for drive in self.where or machine.drives]

    def values_at(
        self,
        at: EffectAt,
        parameters: Sequence[EffectParameter],
        motion: Motion,
        machine: Machine,
        rng: np.random.Generator,
    ) -> dict[str, float]:
        """Return its values by the full names of a model's parameters.

        Args:
            at: One of its places.
            parameters: Its parameters as they are there.
            motion: Set-points, within which places and instants are drawn.
            machine: The machine.
            rng: Source of chance.
        """
        prefix = at.effect if at.where == 'all' else f'{at.where}.{at.effect}'
        drawn = set(self.values) == {'size'} != {p.name for p in parameters}
        out = {}
        for p in parameters:
            if not drawn:
                out[f'{prefix}.{p.name}'] = self.values[p.name]
                continue
            if p.role == 'size':
                end = rng.choice([end for end in (p.low, p.high) if end != p.neutral])
                value = p.neutral + self.values['size'] * (end - p.neutral)
            elif p.role == 'position' and at.where != 'all':
                row = motion.position[machine.drives.index(at.where)]
                value = rng.uniform(row.min(), row.max())
            elif p.role == 'time':
                value = rng.uniform(0.0, motion.seconds)
            else:
                value = rng.choice(p.starts) if p.starts else rng.uniform(p.low, p.high)
            out[f'{prefix}.{p.name}'] = float(value)
        return out


def read_effect(text: str) -> Added:
    """Read an effect from a command line.

    Args:
        text: `stribeck@drive_2:torque=0.05,velocity=0.03`, or `stribeck@drive_2:size=0.5`; without
            `@` it sits on all drives, with `@drive_1+drive_2` on these. In place of its id, the
            file of an effect of your own that `add_effect_files` has read.

    Raises:
        IdentError: INVALID_GOAL where the text cannot be read, UNKNOWN_PARAMETER for an effect
        that is not known or values that are not its.
    """
    head, _, tail = text.partition(':')
    name, _, place = head.partition('@')
    try:
        pairs = [part.split('=') for part in tail.split(',') if part]
        values = {key: float(number) for key, number in pairs}
    except ValueError:
        raise IdentError(
            ErrorCode.INVALID_GOAL,
            f'cannot read the effect {text!r}; write as '
            'stribeck@drive_2:torque=0.05,velocity=0.03',
        ) from None
    if name.endswith('.py'):
        effect: Effect = sys.modules[SOURCES[Path(name).expanduser().resolve()]].EFFECT
    else:
        effect = get_effect(name)
    known = [p.name for p in effect.parameters]
    if set(values) not in ({'size'}, set(known)):
        raise IdentError(
            ErrorCode.UNKNOWN_PARAMETER,
            f'effect {effect.id} needs the values {", ".join(known)}, or size alone; '
            f'found {", ".join(values) or "none"}',
        )
    return Added(effect, tuple(place.split('+')) if place not in ('', 'all') else (), values)
