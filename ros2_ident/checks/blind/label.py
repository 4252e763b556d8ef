# SPDX-License-Identifier: Apache-2.0
"""What was put into a case: the label that stays sealed until the case is diagnosed."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from ros2_ident.models import Machine
from ros2_ident.reference.effects import Effect
from ros2_ident.reference.motions import draw_motion, Motion, space_of
from ros2_ident.reference.space import Space

# What a case can hold: one effect, two, none, one that no catalogue lists, one that the motion
# does not show.
SORTS = ('single', 'pair', 'none', 'outside', 'hidden')


@dataclass(frozen=True)
class MotionOrder:
    """A motion to be drawn.

    Attributes:
        kind: One of `reference.motions.KINDS`.
        seconds: Duration [s].
        seed: Its seed.
        pace: Share of the machine's usual speed; the acceleration goes with its square.
    """

    kind: str
    seconds: float
    seed: int
    pace: float = 1.0

    def draw(self, machine: Machine) -> Motion:
        """Return the set-points."""
        usual = space_of(machine)
        space = Space(
            usual.centre,
            usual.reach,
            usual.speed * self.pace,
            usual.acceleration * self.pace**2,
        )
        return draw_motion(self.kind, machine, self.seconds, self.seed, space)


@dataclass(frozen=True)
class Label:
    """One case.

    Attributes:
        case: Its number, from 1.
        sort: One of `SORTS`.
        parameters: The machine's true nominal parameters.
        motions: Of the recording to fit on and of the one held out.
        effects: What has to be found.
        imperfections: Small unlisted deviations beside it.
        aimed: The sizes aimed at: what each effect leaves after a linearised nominal fit, in
            units of the noise.
        noise: Jitter [s] and share of lost samples of the log.
        seed: Of the log's noise.
    """

    case: int
    sort: str
    parameters: Mapping[str, float]
    motions: tuple[MotionOrder, MotionOrder]
    effects: tuple[Effect, ...]
    imperfections: tuple[Effect, ...]
    aimed: tuple[float, ...]
    noise: Mapping[str, float]
    seed: int


def effect_mapping(effect: Effect) -> dict[str, Any]:
    """Return an effect as a mapping of plain values."""
    return {
        'effect': effect.name,
        'where': list(effect.where),
        'values': dict(effect.values),
        'form': effect.form,
        'size': effect.size,
        'seed': effect.seed,
    }


def _effect(plain: Mapping[str, Any]) -> Effect:
    return Effect(
        plain['effect'],
        tuple(plain['where']),
        plain['values'],
        plain['form'],
        plain['size'],
        plain['seed'],
    )


def to_mapping(label: Label) -> dict[str, Any]:
    """Return a label as a mapping of plain values."""
    return {
        'case': label.case,
        'sort': label.sort,
        'parameters': dict(label.parameters),
        'motions': [asdict(m) for m in label.motions],
        'effects': [effect_mapping(e) for e in label.effects],
        'imperfections': [effect_mapping(e) for e in label.imperfections],
        'aimed': list(label.aimed),
        'noise': dict(label.noise),
        'seed': label.seed,
    }


def from_mapping(plain: Mapping[str, Any]) -> Label:
    """Return the label that `to_mapping` wrote."""
    fit, check = (MotionOrder(**m) for m in plain['motions'])
    return Label(
        plain['case'],
        plain['sort'],
        plain['parameters'],
        (fit, check),
        tuple(_effect(e) for e in plain['effects']),
        tuple(_effect(e) for e in plain['imperfections']),
        tuple(plain['aimed']),
        plain['noise'],
        plain['seed'],
    )
