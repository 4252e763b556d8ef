# SPDX-License-Identifier: Apache-2.0
"""Draws cases: machine, motions, effects, sizes, and the small imperfections of every real log."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ros2_ident.checks.blind.label import Label, MotionOrder
from ros2_ident.checks.blind.probe import Probe
from ros2_ident.effects import twins
from ros2_ident.models import Machine, make_model
from ros2_ident.recording import Dataset
from ros2_ident.reference.bag_making import draw_parameters
from ros2_ident.reference.effects import draw_effect, Effect, kind_of, kinds, NO_ZERO, suits

FIT_SECONDS, CHECK_SECONDS = 8.0, 6.0
ORDINARY = (
    'multi_point',
    'mixed',
    'pick_and_place',
    'multisine',
    'reversals',
    'dwell',
    'chirp',
)
# Motions that excite little: kind and pace.
QUIET = (('creep', 1.0), ('multi_point', 0.12), ('dwell', 0.15))
# Sizes, after the nominal fit, in units of the noise.
SINGLE = (0.3, 8.0)
PAIR = (1.0, 6.0)
OUTSIDE = (0.7, 8.0)
IMPERFECT = (0.1, 0.4)
HIDDEN_BELOW = 0.2
SHOWN_ABOVE = 1.0
# Beyond these the tables' ranges end; a limit reaches down to what small motions need.
SMALLEST = -3.0
LARGEST = {'torque_saturation': 3.5, 'position_dependent_stiffness': 1.0}
SAME_FORM = 0.25
TRIES = 6


@dataclass(frozen=True)
class Shares:
    """How the cases are divided; normalised to one."""

    single: float = 0.45
    pair: float = 0.15
    none: float = 0.20
    outside: float = 0.12
    hidden: float = 0.08

    def counts(self, cases: int) -> dict[str, int]:
        """Return how many cases of each sort there are among `cases`."""
        parts = {name: float(value) for name, value in vars(self).items()}
        total = sum(parts.values())
        exact = {name: cases * value / total for name, value in parts.items()}
        out = {name: int(value) for name, value in exact.items()}
        order = sorted(exact, key=lambda name: out[name] - exact[name])
        for name in order[: cases - sum(out.values())]:
            out[name] += 1
        return out


@dataclass(frozen=True)
class Wanted:
    """What a case shall be.

    Attributes:
        case: Its number, from 1.
        sort: One of `label.SORTS`.
        names: Kinds of effects to try, in this order.
        sizes: Sizes aimed at.
    """

    case: int
    sort: str
    names: tuple[str, ...]
    sizes: tuple[float, ...]


def known_kinds(machine: Machine) -> tuple[str, ...]:
    """Return the kinds that are in the catalogue and make sense on a machine."""
    nothing = np.zeros((len(machine.drives), 400))
    cycle = machine.number('cycle')
    data = Dataset(machine.drives, cycle, 0, nothing, nothing, None, None, nothing)
    listed = {at.effect for at in make_model(machine, data).extensions()}
    return tuple(name for name in kinds() if name in listed and _suits(name, machine))


def outside_kinds(machine: Machine) -> tuple[str, ...]:
    """Return the kinds that no catalogue lists."""
    group = [kind.name for kind in kinds().values() if kind.group == 'outside']
    return tuple(name for name in group if _suits(name, machine))


def _suits(name: str, machine: Machine) -> bool:
    return suits(kind_of(name), machine, dict.fromkeys(machine.bounds, 0.0))


def plan(machine: Machine, cases: int, seed: int, shares: Shares) -> tuple[Wanted, ...]:
    """Divide the cases: every kind comes round before one comes twice, sizes are spread evenly.

    Args:
        machine: The machine.
        cases: How many.
        seed: Of the run.
        shares: How they are divided.

    Returns:
        What each case shall be, in an order that tells nothing.
    """
    rng = np.random.default_rng([seed, 0])
    counts = shares.counts(cases)
    inside, outside = known_kinds(machine), outside_kinds(machine)
    bag: dict[str, list[str]] = {}

    def following(source: tuple[str, ...], what: str) -> str:
        if not bag.get(what):
            bag[what] = [str(name) for name in rng.permutation(source)]
        return bag[what].pop()

    def spread(low: float, high: float, count: int) -> list[float]:
        even = (rng.permutation(count) + rng.random(count)) / max(1, count)
        return [float(x) for x in low * (high / low) ** even]

    out: list[tuple[str, tuple[str, ...], tuple[float, ...]]] = []
    for size in spread(*SINGLE, counts['single']):
        out.append(('single', (following(inside, 'single'), *_more(rng, inside)), (size,)))
    sizes = zip(spread(*PAIR, counts['pair']), spread(*PAIR, counts['pair']), strict=True)
    for pair in sizes:
        names = (following(inside, 'pair'), following(inside, 'pair'), *_more(rng, inside))
        out.append(('pair', names, pair))
    for size in spread(*OUTSIDE, counts['outside']):
        names = (following(outside, 'outside'), *_more(rng, outside))
        out.append(('outside', names, (size,)))
    for _ in range(counts['hidden']):
        out.append(('hidden', (following(inside, 'hidden'), *_more(rng, inside)), ()))
    out += [('none', (), ())] * counts['none']
    order = rng.permutation(len(out))
    return tuple(Wanted(n + 1, *out[i]) for n, i in enumerate(order))


def _more(rng: np.random.Generator, names: Sequence[str]) -> tuple[str, ...]:
    """Return kinds to fall back on where one cannot be seen on the motion drawn."""
    return tuple(str(name) for name in rng.permutation(list(names))[:TRIES])


class Drawer:
    """Draws one case.

    Args:
        machine: The machine.
        seed: Of the run.
        wanted: What the case shall be.
    """

    def __init__(self, machine: Machine, seed: int, wanted: Wanted) -> None:
        self.machine = machine
        self.wanted = wanted
        self.rng = np.random.default_rng([seed, wanted.case])
        self.parameters = draw_parameters(machine, self.rng)
        self.motions = self._ordinary()
        self.probe = self._probe(self.motions)

    def _ordinary(self) -> tuple[MotionOrder, MotionOrder]:
        fit, check = (str(kind) for kind in self.rng.choice(ORDINARY, 2, replace=False))
        a, b = (int(x) for x in self.rng.integers(2**31, size=2))
        return MotionOrder(fit, FIT_SECONDS, a), MotionOrder(check, CHECK_SECONDS, b)

    def _quiet(self) -> tuple[MotionOrder, MotionOrder]:
        kind, pace = QUIET[int(self.rng.integers(len(QUIET)))]
        a, b = (int(x) for x in self.rng.integers(2**31, size=2))
        fit = MotionOrder(kind, FIT_SECONDS, a, pace)
        return fit, MotionOrder(kind, CHECK_SECONDS, b, pace)

    def _probe(self, motions: tuple[MotionOrder, MotionOrder]) -> Probe:
        return Probe(self.machine, self.parameters, [m.draw(self.machine) for m in motions])

    def draw(self) -> Label:
        """Return the case."""
        found = getattr(self, f'_{self.wanted.sort}')()
        effects = tuple(effect for effect, _ in found)
        small = self._imperfections(effects) if self.rng.random() < 0.5 else ()
        return Label(
            self.wanted.case,
            self.wanted.sort,
            self.parameters,
            self.motions,
            effects,
            small,
            tuple(size for _, size in found),
            {
                'jitter': float(self.rng.uniform(5e-6, 4e-5)),
                'drop': float(self.rng.uniform(5e-4, 3e-3)),
            },
            int(self.rng.integers(2**31)),
        )

    def _sized(
        self, name: str, target: float, rounds: int = 4, largest: float = 1.15
    ) -> tuple[Effect, float]:
        """Draw an effect and give it the size that leaves `target` after the nominal fit."""
        kind = kind_of(name)
        where = (str(self.rng.choice(self.machine.drives)),)
        form: Any = 'same' if self.rng.random() < SAME_FORM else 'other'
        seed = int(self.rng.integers(2**31))
        decades = abs(np.log(kind.size.high / kind.size.low))
        top = LARGEST.get(name, largest)
        size, best = 0.5, None
        for _ in range(rounds):
            # The same seed: signs and shapes stay, only the size moves.
            effect = draw_effect(
                name, np.random.default_rng(seed), size, where, self.machine, form
            )
            left = self.probe.linear([effect])
            miss = abs(np.log(max(left, 1e-3) / target))
            if best is None or miss < best[0]:
                best = (miss, effect, left)
            if miss < 0.15:
                break
            wish = size + np.log(target / max(left, 0.05)) / decades
            wish = float(np.clip(wish, SMALLEST, top))
            if abs(wish - size) < 0.01:
                break
            size = wish
        assert best is not None
        return best[1], best[2]

    def _first(self, names: Sequence[str], target: float, least: float) -> tuple[Effect, float]:
        best: tuple[Effect, float] | None = None
        for name in names[: TRIES + 1]:
            effect, left = self._sized(name, target)
            if best is None or left > best[1]:
                best = effect, left
            if left >= least:
                return effect, left
        assert best is not None
        return best

    def _single(self) -> list[tuple[Effect, float]]:
        (target,) = self.wanted.sizes
        return [self._first(self.wanted.names, target, min(0.6 * target, 1.2))]

    def _outside(self) -> list[tuple[Effect, float]]:
        return self._single()

    def _none(self) -> list[tuple[Effect, float]]:
        return []

    def _pair(self) -> list[tuple[Effect, float]]:
        first, second = self.wanted.sizes
        names = self.wanted.names
        one = self._first((names[0], *names[2:]), first, 0.8)
        taken = twins(one[0].name)
        other = [name for name in (names[1], *reversed(names[2:])) if name not in taken]
        return [one, self._first(other, second, 0.8)]

    def _hidden(self) -> list[tuple[Effect, float]]:
        """Draw an effect that ordinary motions show and a quiet one does not."""
        best: tuple[Effect, float] | None = None
        for name in self.wanted.names:
            effect, shown = self._sized(name, 2.0 * SHOWN_ABOVE, rounds=3)
            if shown < SHOWN_ABOVE:
                continue
            motions = self._quiet()
            probe = self._probe(motions)
            left = probe.linear([effect])
            if best is None or left < best[1]:
                best, self.motions, self_probe = (effect, left), motions, probe
            if left < HIDDEN_BELOW:
                break
        if best is None:
            # Nothing could be shown at all: the case becomes one without an effect.
            return []
        self.probe = self_probe
        return [best]

    def _imperfections(self, effects: Sequence[Effect]) -> tuple[Effect, ...]:
        """Draw one or two small effects, and the other sign of friction where it stays small."""
        total = float(self.rng.uniform(*IMPERFECT))
        taken = {effect.name for effect in effects}
        names = [n for n in known_kinds(self.machine) if n not in NO_ZERO and n not in taken]
        names += [n for n in ('gear_hardening',) if _suits(n, self.machine)]
        count = int(self.rng.integers(1, 3))
        out = []
        sign = draw_effect('arctan_sign', self.rng, 0.5, ('all',), self.machine)
        if self.probe.linear([sign]) < total:
            out.append(sign)
        for name in self.rng.choice(names, count, replace=False):
            effect, left = self._sized(str(name), total / np.sqrt(count), rounds=3)
            if left < 1.5 * IMPERFECT[1]:
                out.append(effect)
        # Linearised, and on one recording, they can look smaller than they are.
        while out and self.probe.truth(out).size > IMPERFECT[1]:
            out.pop()
        return tuple(out)
