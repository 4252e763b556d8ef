# SPDX-License-Identifier: Apache-2.0
"""All that may have changed between two sides, each with what it would change."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from itertools import chain
import math
from typing import Literal, TypeVar

import numpy as np
import numpy.typing as npt

from ros2_ident.arrays import Array, NORMAL
from ros2_ident.change.result import Suspect
from ros2_ident.change.sides import Move, Sides
from ros2_ident.effects import get_effect, Hook
from ros2_ident.errors import IdentError
from ros2_ident.identify.hidden import Missing, residuals_at, Rows
from ros2_ident.identify.problem import Problem
from ros2_ident.machine.machine import Machine
from ros2_ident.machine.units import LEVER, per_metre
from ros2_ident.models import EffectAt, FullModel
from ros2_ident.models.drives.candidates import FRICTION
from ros2_ident.models.registry import stated_numbers
from ros2_ident.recording import Dataset
from ros2_ident.search.jacobian import COARSE_STEP, diverged

# Relative gain of a fit, and share of a residual, that are none. By hand.
SETTLED = 1e-5
# Friction and offsets of two logs differ by less than this share, in size and form, in 95 of 100
# cases, without any cause but a few kelvin. By hand: in an hour of warming up viscous friction
# falls by ten times as much (Bittencourt and Gunnarsson 2012, ASME J. Dyn. Syst. Meas. Control
# 134(5)).
BY_ITSELF = 0.02
# Share of its size over which what an effect does is as good as even: what has play or sticks is
# not smooth, and far smaller steps tell nothing of it. By hand.
_SMOOTH = 0.1
# Hooks of effects that are forms of friction.
_FORMS = Hook.SIGN, Hook.FRICTION
# By how much the zero of a drive differs from log to log, one standard deviation: a degree of a
# joint, as its marks are aligned by eye; of a slide what a pulley makes of that. By hand.
_HOMED = math.radians(1.0) * LEVER


@dataclass(frozen=True)
class Column:
    """Suspect with its columns among all that may have changed.

    Attributes:
        suspect: What it is.
        names: What each of its columns is a multiple of.
        units: Their units.
        scales: Each number for a coefficient of 1.
        columns: Its numbers among all changes.
        value: Value before; NaN of an effect.
        numbers: How many numbers it takes, shapes among them.
        at: An effect at its place.
        move: A change of parameters.
        begin: (P,) its parameters where the coefficients are 0.
        moved: (k, P) how they move with each.
        own: Of what kind it is where each log has its own, so that it is no suspect.
        usual: Standard deviation from log to log; inf where it is not known.
        most: Of an effect the largest of each that is looked for.
    """

    suspect: Suspect
    names: tuple[str, ...]
    units: tuple[str, ...]
    scales: Array
    columns: Sequence[int] = ()
    value: float = math.nan
    numbers: int = 1
    at: EffectAt | None = None
    move: Move | None = None
    begin: Array = field(default_factory=lambda: np.empty(0))
    moved: Array = field(default_factory=lambda: np.empty((0, 0)))
    own: Literal['', 'timing', 'zero'] = ''
    usual: float = 0.0
    most: Sequence[float] = ()

    @property
    def place(self) -> str:
        """Its drive; empty for the machine."""
        s = self.suspect
        named = s.name if s.kind == 'load' else s.name.rpartition('.')[0]
        return s.where.replace('all', '') or named


@dataclass(frozen=True)
class Homed:
    """Models of logs in which the encoder of a drive has another zero, by `by`; of none first."""

    models: tuple[FullModel, ...]
    drive: str = ''
    by: float = 0.0
    unit: str = ''


def shifted(problem: Problem) -> Iterator[Homed]:
    """Yield the models, and those of logs with another zero, drive by drive."""
    yield Homed(problem.models)
    setup = problem.setup
    if setup is None:
        return
    machine = setup.machine
    for name, unit in zip(machine.drives, travels_of(problem, machine), strict=True):
        by = _HOMED * per_metre(unit)
        datasets = tuple(_moved(x, name, by) for x in setup.data.datasets)
        with suppress(IdentError):
            moved = replace(setup, data=replace(setup.data, datasets=datasets))
            yield Homed(moved.problem().models, name, by, unit)


def travels_of(problem: Problem, machine: Machine) -> Sequence[str]:
    """Return (D,) units of the drives' positions: an arm may have joints of both kinds."""
    usual: Sequence[str] = (machine.travel_unit,) * len(machine.drives)
    return getattr(problem.models[0], 'travels', usual)


def _moved(data: Dataset, drive: str, by: float) -> Dataset:
    """Return a recording in which a drive is elsewhere, and its set-points with it."""
    there = np.zeros((len(data.names), 1))
    there[data.names.index(drive)] = by
    rows = {key: getattr(data, key) for key in ('position', 'command_position')}
    return replace(data, **{key: x + there for key, x in rows.items() if x is not None})


@dataclass(frozen=True)
class Columns:
    """All that may have changed, Q numbers.

    Attributes:
        each: What it is.
        changed: (Q,) which column each is: of those of both sides, or of others behind them.
        others: (R, E) these.
        usual: (Q,) standard deviation from log to log; inf where it is not known.
        alone: (Q,) whether that is of the change alone, and not beside all others.
        side: (Q,) whether it is on the side after; else before.
        kept: Those that did change.
    """

    each: list[Column]
    changed: npt.NDArray[np.int64]
    others: Array
    usual: Array
    alone: npt.NDArray[np.bool_]
    side: npt.NDArray[np.bool_]
    kept: range


def columns_of(sides: Sides, theta: Array, seen: Missing, zeros: Sequence[Homed]) -> Columns:
    """Return all that may have changed beside what did.

    Args:
        sides: The fit.
        theta: (N,) its parameters.
        seen: What it may lack.
        zeros: Models of logs with other zeros, see `shifted`.
    """
    rows, residual, jacobian = seen.rows, seen.residual, seen.slopes
    nominal = jacobian[:, : sides.nominal]
    columns: list[Column] = []
    changed: list[int] = []
    others: list[Array] = []
    stated: list[Array] = []
    beside = sides.nominal + seen.columns.shape[1]
    # Drives are read in turns: when, within a sample, is as they were switched on (uniform).
    period = max(float(m.cycle / np.mean(np.isfinite(m.measured))) for m in sides.bare)
    late = period / math.sqrt(12.0)
    effects = _effects(sides.models[0], seen, sides.nominal, late)
    for c, places in chain(_parameters(sides, theta), effects):
        columns.append(replace(c, columns=_appended(changed, places)))
    for c, own in chain(
        _constants(sides, theta, rows, residual),
        _stamps(seen),
        _loads(sides, nominal),
        _zeros(sides, theta, rows, zeros),
    ):
        if c.suspect.name in sides.stated:
            stated += own
            continue
        at = [beside + i for i in _appended(others, own)]
        columns.append(replace(c, columns=_appended(changed, at)))
    # Of numbers as on both sides, so that parts of either tell how it scatters.
    more, width = [_of_effects(sides, theta, seen)], sides.high - sides.low
    for m in sides.moved:
        more.append(_of_move(sides, nominal, m, width[sides.places_of(None, m.name)]))
    more.append(np.reshape(stated, (-1, residual.size)).T)
    at = [beside + i for i in _appended(others, list(np.hstack(more).T))]
    kept = _appended(changed, at)
    every = [*nominal.T, *seen.columns.T, *others]
    usual, alone = np.zeros(len(changed)), np.zeros(len(changed), dtype=bool)
    for c in columns:
        usual[[*c.columns]] = c.usual
    friction = _friction(sides, theta, nominal)
    laws = [(c.at, c.columns) for c in columns if c.at]
    for one, _ in sides.effects:
        places = sides.places_of(one, '')
        there = [kept[i - sides.nominal] for i in places]
        laws.append((one, there))
        if is_delay(one):
            usual[there], alone[there] = late / width[places], True
    for one, places in laws:
        if of_friction(one):
            usual[[*places]] = [friction(one.where, every[changed[i]]) for i in places]
            alone[[*places]] = True
    side = np.full(len(changed), True)
    side[kept.start : kept.start + sides.later.size - sides.nominal] = sides.later[sides.nominal :]
    of_others = np.reshape(others, (-1, residual.size)).T
    return Columns(columns, np.array(changed), of_others, usual, alone, side, kept)


def of_friction(at: EffectAt) -> bool:
    """Return whether an effect is a form of friction."""
    return get_effect(at.effect).hook in _FORMS


def is_delay(at: EffectAt) -> bool:
    """Return whether an effect makes something late."""
    return any(p.target.endswith('_delay') for p in get_effect(at.effect).parameters)


_Entry = TypeVar('_Entry')


def _appended(entries: list[_Entry], more: Sequence[_Entry]) -> range:
    """Append entries; return where they are."""
    entries += more
    return range(len(entries) - len(more), len(entries))


_Places = Iterator[tuple[Column, Sequence[int]]]
_Own = Iterator[tuple[Column, list[Array]]]


def _parameters(sides: Sides, theta: Array) -> _Places:
    """Yield the parameters, and which column is the derivative by each."""
    width = sides.high - sides.low
    for i, p in enumerate(sides.parameters[: sides.nominal]):
        known = 0.0 if p.absent is None else BY_ITSELF / NORMAL * abs(theta[i]) / width[i]
        own = {'own': 'timing', 'usual': math.inf} if p.unit == 's' else {'usual': known}
        c = Column(Suspect('parameter', p.name), (p.name,), (p.unit,), width[i : i + 1],
                   value=float(theta[i]), move=Move.single(p), **own)  # fmt: skip
        yield c, [i]


def _stamps(seen: Missing) -> _Own:
    """Yield delays of all drives alike, by 1 s, which stamps of two logs may differ by.

    One message has one stamp for all drives.
    """
    late = [one for one in seen.alternatives if is_delay(one.at) and len(one.points)]
    for name in dict.fromkeys(one.at.effect for one in late):
        own = [one.changes[0] / one.points[0, 0] for one in late if one.at.effect == name]
        c = Column(Suspect('effect', name, 'all'), (f'{name}.delay',), ('s',), np.ones(1),
                   own='timing', usual=math.inf)  # fmt: skip
        yield c, [np.sum(own, axis=0)]


def _loads(sides: Sides, slopes: Array) -> _Own:
    """Yield bodies at links, and (R,) the derivative by each of their inertials."""
    for joint, (own, of, by) in sides.bare[0].bodies().items():
        move = Move(joint, tuple(f'{joint}.{name}' for name in own), tuple(own.values()), of, by)
        scales = 2.0 * sides.reach(move)
        c = Column(Suspect('load', joint), move.numbers, move.units, scales, numbers=len(own),
                   move=move)  # fmt: skip
        yield c, list(_of_move(sides, slopes, move, scales).T)


def _of_move(sides: Sides, slopes: Array, move: Move, scales: Array) -> Array:
    """Return (R, k) the derivative by a change's numbers, on both sides."""
    parts = [sides.names.index(name) for name in move.of]
    return slopes[:, parts] @ (move.by / (sides.high - sides.low)[parts, None] * scales)


def _of_effects(sides: Sides, theta: Array, seen: Missing) -> Array:
    """Return (R, E) the derivative by the numbers of effects that are there on one side."""
    own, evaluate = range(sides.nominal, sides.fitted), residuals_at(sides, seen.rows)
    slopes, width = seen.slopes[:, own].copy(), sides.high - sides.low
    for i in own:
        none = sides.parameters[i].absent
        by = 0.0 if none is None else _SMOOTH * float(theta[i] - none)
        if by:
            tried = evaluate(theta + np.outer((by, -by), np.arange(theta.size) == i))
            if not diverged(tried).any():
                slopes[:, i - own.start] = (tried[0] - tried[1]) * width[i] / (2.0 * by)
    return slopes


def _constants(sides: Sides, theta: Array, rows: Rows, residual: Array) -> _Own:
    """Yield stated numbers of the machine file, and (R,) the derivative by their logarithm."""
    machine = sides.bare[-1].machine
    for name, (value, unit) in (stated_numbers(machine) if machine else {}).items():
        with suppress(IdentError):
            moved = sides.times(name, math.exp(COARSE_STEP))
            slope = (residuals_at(moved, rows)(theta[None])[0] - residual) / COARSE_STEP
            if np.isfinite(slope).all():
                c = Suspect('constant', name)
                yield Column(c, (name,), (unit,), np.array([value]), value=value), [slope]


def _zeros(sides: Sides, theta: Array, rows: Rows, zeros: Sequence[Homed]) -> _Own:
    """Yield the zeros of all drives, and (R,) what the usual difference of each does.

    Numbers are as the machine file states them: what changed of them is of second order.
    """
    plain, *moved = (residuals_at(sides.on(x.models), rows)(theta[None])[0] for x in zeros)
    least = SETTLED * float(np.sqrt(np.mean(plain**2)))
    seen = [
        (x, residual - plain) for x, residual in zip(zeros[1:], moved, strict=True)
        if least < np.sqrt(np.mean((residual - plain) ** 2)) < math.inf
    ]  # fmt: skip
    if seen:
        c = Column(
            Suspect('constant', 'zero'), tuple(x.drive for x, _ in seen),
            tuple(x.unit for x, _ in seen), np.array([-x.by for x, _ in seen]),
            own='zero', usual=1.0,
        )  # fmt: skip
        yield c, [column for _, column in seen]


def _effects(first: FullModel, seen: Missing, nominal: int, late: float) -> _Places:
    """Yield effects, one for each of their shapes, and which columns are of each of their sizes.

    Args:
        nominal: Number of the columns before those of `seen`.
        late: By how much the delay of one drive differs from log to log, s.
    """
    end = nominal + seen.columns.shape[1] - sum(len(one.changes) for one in seen.alternatives)
    for one in seen.alternatives:
        begin, end = end, end + len(one.changes)
        wide = first.extended((*first.effects, one.at))
        own = wide.scaled(one.at)
        units = [p.unit for p in wide.parameters[-len(own) :]]
        neutral = np.array([p.neutral for p in own])
        sized = np.array([p.role == 'size' for p in own])
        for group in np.unique(one.group):
            at = np.flatnonzero(one.group == group)
            moved = one.points[at] - neutral
            which = [int(np.argmax(np.abs(np.where(sized, m, 0.0)))) for m in moved]
            start = np.where(sized, neutral, one.points[at[0]])
            c = Column(
                Suspect('effect', one.at.effect, one.at.where),
                tuple(own[w].name for w in which),
                tuple(units[w] for w in which),
                np.array([m[w] for m, w in zip(moved, which, strict=True)]),
                numbers=len(own), at=one.at, begin=start, moved=one.points[at] - start,
                usual=late / one.points[at[0], 0] if is_delay(one.at) else 0.0,
                most=[max(abs(own[w].high), abs(own[w].low)) for w in which],
            )  # fmt: skip
            yield c, (begin + at).tolist()


def _friction(sides: Sides, theta: Array, slopes: Array) -> Callable[[str, Array], float]:
    """Return by how much a form (R,) of a drive's friction differs from log to log.

    One standard deviation: as much force, where it acts, as the usual difference of all its
    friction there.
    """
    width, whole = sides.high - sides.low, dict[str, Array]()
    for i, p in enumerate(sides.parameters[: sides.nominal]):
        place, _, name = p.name.rpartition('.')
        if name in FRICTION:
            whole[place] = whole.get(place, 0.0) + slopes[:, i] * theta[i] / width[i]

    def usual(place: str, form: Array) -> float:
        own = sum((x for at, x in whole.items() if not at or place in (at, 'all', '')), 0.0 * form)
        # Where it acts: a peak at low speed has little of the force along a motion.
        square = form**2
        there = float(square @ square)
        return BY_ITSELF / NORMAL * math.sqrt(square @ own**2 / there) if there else 0.0

    return usual
