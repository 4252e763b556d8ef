# SPDX-License-Identifier: Apache-2.0
"""What each case of a run shall be: every effect comes round before one comes twice."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from checks.blind import faults
from checks.blind.forms import FORMS, suits
from ros2_ident.machine.machine import Machine
from ros2_ident.models import make_model
from ros2_ident.recording import Dataset

# Sizes, after the nominal fit, in units of the true noise.
SINGLE = (0.3, 8.0)
SEVERAL = (1.0, 6.0)
OUTSIDE = (0.7, 8.0)
TRIES = 6
# Share of the cases whose noise is hard, see `rough.Rough.hard`.
HARD = 0.2


def counts_of(shares: Mapping[str, float], cases: int) -> dict[str, int]:
    """Return how many of so many cases are of each sort, by shares of any sum."""
    total = sum(shares.values())
    exact = {name: cases * value / total for name, value in shares.items()}
    out = {name: int(value) for name, value in exact.items()}
    order = sorted(exact, key=lambda name: out[name] - exact[name])
    for name in order[: cases - sum(out.values())]:
        out[name] += 1
    return out


@dataclass(frozen=True)
class Wanted:
    """What a case shall be.

    Attributes:
        sort: One of `sorts.SHARES`.
        names: Effects to try, in this order; or the kind of fault.
    """

    case: int
    sort: str
    names: tuple[str, ...]
    sizes: tuple[float, ...]
    hard: bool


def forms_of(machine: Machine) -> dict[str, list[str]]:
    """Return the forms that a machine can have, by effect, or by their own name outside.

    Of the catalogue's effects those are there that are no parameter of the machine anyway.
    """
    nothing = np.zeros((len(machine.drives), 400))
    cycle = machine.number('cycle')
    data = Dataset(machine.drives, cycle, 0, nothing, nothing, None, None, nothing)
    listed = {at.effect for at in make_model(machine, data).extensions()}
    out: dict[str, list[str]] = {}
    for form in FORMS.values():
        if suits(form, machine) and (not form.effect or form.effect in listed):
            out.setdefault(form.label, []).append(form.name)
    return out


class _Bag:
    """Names in random order, each drawn once before one is drawn twice."""

    def __init__(self, names: Sequence[str], rng: np.random.Generator) -> None:
        self.names, self.rng = list(names), rng
        self.left: list[str] = []

    def draw(self, without: Sequence[str] = ()) -> str:
        """Return the next name that is not among `without`."""
        for _ in range(3 * len(self.names)):
            self.left = self.left or [str(n) for n in self.rng.permutation(self.names)]
            name = self.left.pop()
            if name not in without:
                return name
        raise ValueError('there are too few effects for one case')

    def more(self) -> list[str]:
        """Return names to fall back on where one cannot be seen on the motion drawn."""
        return [str(name) for name in self.rng.permutation(self.names)[:TRIES]]


def spread(rng: np.random.Generator, ends: tuple[float, float], count: int) -> list[float]:
    """Return sizes spread evenly in the logarithm, in random order."""
    low, high = ends
    even = (rng.permutation(count) + rng.random(count)) / max(1, count)
    return [float(x) for x in low * (high / low) ** even]


def plan(
    inside: Sequence[str],
    outside: Sequence[str],
    cases: int,
    seed: int,
    shares: Mapping[str, float],
) -> tuple[Wanted, ...]:
    """Divide the cases.

    Returns:
        What each case shall be, in an order that tells nothing.
    """
    rng = np.random.default_rng([seed, 0])
    counts = counts_of(shares, cases)
    drawn = _several(rng, inside, counts)
    foreign = _Bag(outside, rng)
    for size in spread(rng, OUTSIDE, counts['outside']):
        drawn.append(('outside', (foreign.draw(), *foreign.more()), (size,)))
    hidden = _Bag(inside, rng)
    for _ in range(counts['hidden']):
        drawn.append(('hidden', (hidden.draw(), *hidden.more()), ()))
    kinds = _Bag(list(faults.KINDS), rng)
    drawn += [('fault', (kinds.draw(),), ()) for _ in range(counts['fault'])]
    drawn += [('none', (), ())] * counts['none'] + [('ideal', (), ())] * counts['ideal']
    hard = rng.permutation(len(drawn)) < HARD * len(drawn)
    order = rng.permutation(len(drawn))
    return tuple(
        Wanted(n + 1, sort, names, sizes, bool(hard[n]))
        for n, (sort, names, sizes) in enumerate(drawn[i] for i in order)
    )


def _several(
    rng: np.random.Generator, inside: Sequence[str], counts: Mapping[str, int]
) -> list[tuple[str, tuple[str, ...], tuple[float, ...]]]:
    """Return the cases of one, two and three effects."""
    out = []
    sorts = (('single', 1, SINGLE), ('pair', 2, SEVERAL), ('triple', 3, SEVERAL))
    for sort, number, ends in sorts:
        bag = _Bag(inside, rng)
        sizes = [spread(rng, ends, counts[sort]) for _ in range(number)]
        for wanted in zip(*sizes, strict=True):
            names: list[str] = []
            for _ in range(number):
                names.append(bag.draw(names))
            out.append((sort, (*names, *bag.more()), tuple(wanted)))
    return out
