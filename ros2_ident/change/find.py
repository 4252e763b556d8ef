# SPDX-License-Identifier: Apache-2.0
"""Which change tells the logs after from those before."""

from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property, lru_cache, partial
from itertools import chain, islice
import math

import numpy as np
import numpy.typing as npt

from ros2_ident.arrays import Array, NORMAL
from ros2_ident.change.columns import (
    Column,
    columns_of,
    Homed,
    is_delay,
    of_friction,
    SETTLED,
    shifted,
)
from ros2_ident.change.noise import noise_apart, OwnSteps, steps_of_one_side
from ros2_ident.change.result import Apart, ApartKind, Change, Comparison, Size, Suspect, Visible
from ros2_ident.change.sides import AFTER, Marginal, Sides
from ros2_ident.effects import get_effect, shown_by
from ros2_ident.gap.contradictions import unexplained
from ros2_ident.gap.fits import PROMISING
from ros2_ident.gap.rules import Rules
from ros2_ident.gates import GateReport
from ros2_ident.identify.hidden import BLOCKS, missing_beside, residuals_at, Rows
from ros2_ident.identify.problem import Problem
from ros2_ident.models import EffectAt
from ros2_ident.models.drives.candidates import COULOMB, FRICTION
from ros2_ident.models.registry import STATED_WITHIN
from ros2_ident.models.trials import limits_shown
from ros2_ident.search.changes import (
    Changes,
    evidence_of,
    Logs,
    weigh_changes,
)
from ros2_ident.search.evidence import price_of
from ros2_ident.search.jacobian import Box, diverged, Residuals
from ros2_ident.search.least_squares import descent, Point

# Suspects of a round that are fitted, at least. By hand.
_FITS = 4
# Steps of a fit that begins where straight lines lead, at most. By hand.
_STEPS = 6
# Times that a fit and the sizes of what the model lacks are found in turn.
_TURNS = 2
# Logarithm of the odds from which on a change is named: 95 of 100 are right then.
_SURE = math.log(0.95 / 0.05)
# Each part of a log is predicted from the others. Two logs have so many blocks each at least; of
# fewer parts it is hardly known how a change scatters between them.
_PARTS = BLOCKS // 2


@dataclass(frozen=True)
class _Best:
    """Best parameters (N,) of a fit, and minus twice the logarithm of its likelihood."""

    theta: Array
    loss: float


@dataclass(frozen=True)
class _Fit:
    """Fit with a suspect beside all else: its evidence, and what explains as much."""

    column: Column
    evidence: float
    sides: Sides
    theta: Array
    ties: tuple[Suspect, ...] = ()

    @property
    def limits(self) -> set[EffectAt | None]:
        """Laws that it comes to by numbers that ended at a bound."""
        at, sides = self.column.at, self.sides
        if at is None:
            return set()
        share = (self.theta - sides.low) / (sides.high - sides.low)
        ended = get_effect(at.effect).ended(share[sides.places_of(at, '')].tolist())
        return {EffectAt(p.limit, at.where) for p in ended if p.limit}


@dataclass(frozen=True)
class _Number:
    """Number of a change that is in a fit.

    Attributes:
        place: Which it is of all that changed.
        name: Its name.
        unit: Its unit.
        none: Where there is no change; None of a shape.
        value: What it is.
        width: What its column is the derivative by.
    """

    place: int
    name: str
    unit: str
    none: float | None
    value: float
    width: float


@dataclass(frozen=True)
class _Round:
    """All that may have changed beside what did, at one fit."""

    sides: Sides
    theta: Array
    rows: Rows
    logs: Logs
    columns: list[Column]
    weighed: Changes
    marginal: Marginal
    nominal: Array
    kept: Array

    @property
    def suspects(self) -> list[Column]:
        """Those that may be named."""
        return [c for c in self.columns if not c.own]

    def numbers_of(self, column: Column) -> list[_Number]:
        """Return the numbers of a change that is in the fit, stated ones behind all others."""
        sides, s, first = self.sides, column.suspect, self.sides.nominal
        if s.kind == 'constant':
            count = len(sides.parameters) - first
            # The derivative is by the logarithm.
            return [
                _Number(count + i, name, column.units[0], before, after, after)
                for i, (name, (before, after)) in enumerate(sides.stated.items())
                if name == s.name
            ]
        wide = sides.high - sides.low
        numbers = []
        for i in sides.places_of(column.at, s.name):
            p = sides.parameters[i]
            none = p.absent if column.at else 0.0
            name, value = p.name.removesuffix(AFTER), float(self.theta[i])
            numbers.append(_Number(i - first, name, p.unit, none, value, float(wide[i])))
        return numbers

    def sizes_of(self, column: Column) -> dict[int, float]:
        """Return the sizes of a change that is in the fit, in shares of their widths."""
        numbers = self.numbers_of(column)
        return {x.place: (x.value - x.none) / x.width for x in numbers if x.none is not None}

    def kept_of(self, column: Column) -> list[int]:
        """Return the columns of the numbers of a change that is in the fit."""
        return [self.weighed.kept[x.place] for x in self.numbers_of(column)]

    @cached_property
    def loss(self) -> float:
        """Minus twice the logarithm of the posterior, as of `_best`."""
        residual, box = residuals_at(self.sides, self.rows)(self.theta[None])[0], self.sides.box
        told = self.marginal.sized(residual), self.marginal
        return min(x.loss(residual) for x in told) + box.aside(box.inside(self.theta))

    def evidence(self, column: Column) -> float:
        """Return the evidence of a suspect to first order, an effect within its box."""
        estimate, _, gain = self.weighed.of(column.columns)
        most = np.asarray(column.most or math.inf) / np.abs(column.scales)
        share = 1.0 / max(1.0, float(np.max(np.abs(estimate) / most)))
        return evidence_of(share * (2.0 - share) * gain, len(column.columns))


def find_change(
    problem: Problem,
    after: npt.NDArray[np.bool_],
    theta: Array,
    log: npt.NDArray[np.int64],
    *,
    paired: bool = False,
    without: Sequence[str] = (),
    among: int = 1,
    stopped: Callable[[], bool] = lambda: False,
    on_step: Callable[[float, str], None] = lambda share, text: None,
    threads: int | None = None,
    reports: Sequence[GateReport] = (),
) -> Comparison:
    """Say what changed between the logs before and those after.

    Args:
        problem: Nominal models of one machine, one a recording; those before first.
        after: (M,) whether a recording is of the side after.
        theta: (N,) one fit of all.
        log: (M,) number of the log a recording is part of, ascending.
        paired: Whether the first log after was recorded as the first one before, and so on: what
            the model lacks, and its parameters, are of each pair then.
        without: Ids of effects to leave out.
        among: Comparisons of which this is one: what shows in one of many has to be clearer.
        stopped: Asked often; True ends it with the changes found so far.
        on_step: Told the share that is done, and a sentence.
        threads: That simulate; one for each processor where None.
        reports: The checks of the side before, and of that after.
    """
    looked = partial(
        _round, log=log, zeros=tuple(shifted(problem)), paired=paired, without=without,
        stopped=stopped, threads=threads,
    )  # fmt: skip
    # No fit tells them from noise.
    known, stepped = shown_by('reading_steps'), tuple[OwnSteps, ...]()
    if known and known.id not in without:
        stepped = tuple(steps_of_one_side(problem.models, after, theta))
    found: list[_Fit] = []
    seen = {(x.change.suspect.name, x.change.suspect.where) for x in stepped}
    dropped = set(seen)
    begun = now = looked(Sides(problem.models, after), theta)
    price, again = price_of(among * len(now.suspects)) + _SURE, 0
    for _ in range(2 * Rules.most):
        on_step(0.2 + 0.15 * len(found), 'fitting what may have changed')
        base = cache(partial(_fitted, now, now.sides, now.theta, stopped))
        less = [(x, *_less(now, x.column, stopped)) for x in found[:-1] if now.kept_of(x.column)]
        better = _escaped(now, less, base, stopped) if less else None
        weak = next((x for x in less if not _still(now, x[0].column, x[2], price, base)), None)
        if stopped():
            break
        if better is not None:
            sides, best = now.sides, better.theta
        elif weak is not None:
            # What came first stood for what came after, and does not come back for it.
            one, sides, point = weak
            found.remove(one)
            dropped.add((one.column.suspect.name, one.column.suspect.where))
            best = point.theta
        elif (
            len(found) < Rules.most
            and (step := _step(now, price, found, dropped, base, stopped)) is not None
        ):
            found.append(step)
            sides, best = step.sides, step.theta
        elif again < len(found) and base().loss + price < now.loss:
            # It was fitted with the noise of the fit before.
            sides, best, again = now.sides, base().theta, len(found)
        else:
            break
        on_step(0.2 + 0.15 * len(found), 'looking at all that may have changed beside it')
        now = looked(sides, best)
    named = [x for x in found if _named(now, x, price)]
    if named and len(named) < len(found):
        # What is explained is beside friction that differs by itself.
        begun = now
        for x in named:
            sides, point = _less(begun, x.column, stopped)
            begun = replace(begun, sides=sides, theta=point.theta)
    changes = *(x.change for x in stepped), *_changes(now, named, theta)
    explained = min((x.explained for x in stepped), default=math.nan)
    if named:
        explained = _explained(begun, now, named, stopped)
    count = int(np.unique(log[~after]).size), int(np.unique(log[after]).size)
    return Comparison(
        changes=changes,
        explained=explained,
        smallest=tuple(
            x for x in _visible(now, price) if (x.suspect.name, x.suspect.where) not in seen
        ),
        apart=(
            *_of_each_log(now, price),
            *_by_itself(now, [x for x in found if x not in named]),
            *_noise(now, price, {where for _, where in seen}),
        ),
        logs=count,
        paired=paired,
        price=price,
        complete=not stopped(),
        pushed=_pushed(begun, now, reports),
        friction=tuple(_all_friction(now, found, theta)) if named else (),
    )


def _round(
    sides: Sides,
    theta: Array,
    log: npt.NDArray[np.int64],
    zeros: Sequence[Homed],
    paired: bool,
    without: Sequence[str],
    stopped: Callable[[], bool],
    threads: int | None,
) -> _Round:
    theta, first = sides.inside(theta), sides.models[0]
    taken = {*first.effects, *(at for at, _ in sides.effects)}
    candidates = [
        at for at in first.extensions(changed=True)
        if at not in taken and at.effect not in without
    ]  # fmt: skip
    # What is limited on one side is so at another effort than the other side has.
    each = sides.each(theta)
    parts = [[each[i] for i in numbers] for numbers in sides.groups]
    limits = {at: [x for part in parts for x in limits_shown(at, part)] for at in candidates}
    seen = missing_beside(sides, theta, candidates, stopped, threads, limits)
    rows, nominal = seen.rows, seen.slopes[:, : sides.nominal]
    found, logs = columns_of(sides, theta, seen, zeros), _logs(sides, rows, log, paired)
    weighed = weigh_changes(
        seen.residual, nominal, seen.columns, found.others, found.changed, rows.runs, rows.blocks,
        logs, most=seen.most, usual=found.usual, alone=found.alone, side=found.side,
        kept=found.kept, known=seen.known,
    )  # fmt: skip
    apart = nominal if paired else nominal[:, :0]
    marginal = Marginal.of(weighed, rows, logs, apart)
    kept = found.others[:, found.others.shape[1] - len(found.kept) :]
    return _Round(sides, theta, rows, logs, found.each, weighed, marginal, nominal, kept)


def _logs(sides: Sides, rows: Rows, log: npt.NDArray[np.int64], paired: bool) -> Logs:
    """Return which rows are of which log, and how they are left out."""
    ends = np.cumsum([0, *(int(mask.sum()) for mask in rows.masks)])
    numbers = [np.unique(log[sides.after == s]).tolist() for s in (False, True)]
    least = min(map(len, numbers))
    there, pair, fold = [], [], np.zeros_like(rows.blocks)
    for k in (k for own in numbers for k in own):
        own = np.flatnonzero(log == k)
        there.append(slice(int(ends[own[0]]), int(ends[own[-1] + 1])))
        place = next(own.index(k) for own in numbers if k in own)
        pair.append(place if paired else 0)
        fold[there[-1]] = place % least
    if least == 1:
        # Parts of each log, so that all have both sides.
        turn = [np.unique(rows.blocks[here], return_inverse=True)[1] for here in there]
        parts = min(_PARTS, *(int(block.max(initial=0)) + 1 for block in turn))
        for here, block in zip(there, turn, strict=True):
            fold[here] = block * parts // (1 + block.max(initial=0))
    after = np.repeat([False, True], list(map(len, numbers)))
    return Logs(tuple(there), after, np.array(pair), fold)


# ---------------------------------------------------------------------- one change more


def _step(
    now: _Round,
    price: float,
    found: Sequence[_Fit],
    dropped: Collection[tuple[str, str]],
    base: Callable[[], _Best],
    stopped: Callable[[], bool],
) -> _Fit | None:
    """Return the change whose evidence is more than its choice among all may be by chance.

    No law is exactly the machine's: another one where something changed already may do no more
    than mend the first one's form.

    Args:
        base: The best fit with what was found.
    """
    told = {id(c): now.evidence(c) for c in now.suspects}
    ordered: list[Column] = []
    for c in sorted(now.suspects, key=lambda c: -told[id(c)]):
        # Of one effect the shape that explains most.
        key = c.suspect.name, c.suspect.where
        if key not in dropped and key not in {(x.suspect.name, x.suspect.where) for x in ordered}:
            ordered.append(c)
    fits: list[_Fit] = []
    top = held = 0.0
    for i, c in enumerate(ordered):
        # Of many that explain as much to first order none is left out: one of them may be the
        # cause. What explained nothing once fitted keeps no other back.
        least = PROMISING * held if i < _FITS else _nearly(told[id(ordered[0])])
        if not told[id(c)] > max(price, least):
            break
        f = _with(now, c, base(), max(price, _nearly(top)), stopped)
        held = max(held, told[id(c)] if f.evidence > price else 0.0)
        if all(f.evidence > Rules.alike * x.evidence for x in found
               if '' in (x.column.place, c.place) or x.column.place == c.place):  # fmt: skip
            fits.append(f)
            top = max(top, f.evidence)
    # A law that ended at a bound tells nothing beside the one that it comes to there.
    fits = [f for f in fits if not f.limits & {x.column.at for x in fits}]
    top = max((f.evidence for f in fits), default=0.0)
    if not top > price:
        return None
    alike = [f for f in fits if f.evidence > _nearly(top)]
    # Gains and other stated numbers come first: efforts follow from how a machine is driven.
    order = {'constant': 0, 'parameter': 1, 'effect': 2, 'load': 2}
    one = min(alike, key=lambda f: (order[f.column.suspect.kind], f.column.numbers, -f.evidence))
    return replace(one, ties=tuple(f.column.suspect for f in alike if f is not one))


def _nearly(evidence: float) -> float:
    """Return the evidence that is as good, a suspect being chosen for more than its evidence."""
    return min(evidence - price_of(1), (1.0 - Rules.alike) * evidence)


def _fitted(now: _Round, sides: Sides, start: Array, stopped: Callable[[], bool]) -> _Best:
    """Return the best fit of sides under the noise, with what the model lacks left open."""
    return _best(now, residuals_at(sides, now.rows), sides.box, start, stopped)


def _best(
    now: _Round, evaluate: Residuals, box: Box, start: Array, stopped: Callable[[], bool]
) -> _Best:
    """Return the best fit of residuals.

    At first the model lacks nothing, so that parameters go where they explain most; then as much
    as that leaves, or as without the change: parameters that took all leave nothing to tell it by.
    """
    theta, loss, marginal = start, math.inf, now.marginal.sized()
    for _ in range(_TURNS):
        theta = _descended(evaluate, box, theta, marginal, stopped)
        residual = evaluate(theta[None])[0]
        if diverged(residual):
            break
        told = now.marginal.sized(residual), now.marginal
        marginal = min(told, key=lambda one: one.loss(residual))
        loss = marginal.loss(residual) + box.aside(box.inside(theta))
    return _Best(theta, loss)


def _descended(
    evaluate: Residuals, box: Box, start: Array, marginal: Marginal, stopped: Callable[[], bool]
) -> Array:
    """Return the best parameters (N,) with what the model may lack as it is."""
    point = Point.at(lambda theta: marginal(evaluate(theta)), box, box.inside(start))
    for better in islice(descent(point, SETTLED, prior=True), _STEPS):
        point = better
        if stopped():
            break
    return point.theta


def _with(now: _Round, c: Column, base: _Best, least: float, stopped: Callable[[], bool]) -> _Fit:
    """Return the fit of a suspect beside the parameters, and its evidence.

    Args:
        least: Evidence up to which it does not matter how much there is; it is no less then.
    """
    begun = list(_begun(now, c))
    fits = [
        (suspect, sides, _fitted(now, sides, sides.start(now.sides, now.theta, own), stopped))
        for suspect, sides, own in begun
    ]
    if c.suspect.kind == 'constant':
        fits.append((c.suspect, *_restated(now, c, stopped)))

    def evidences(without: float) -> list[float]:
        gains = [max(0.0, without - found.loss) for _, _, found in fits]
        return [evidence_of(now.weighed.among_logs(x, c.columns), c.numbers) for x in gains]

    told = evidences(base.loss)
    if c.at is not None and max(told) > least:
        # On both sides it is what the model lacks, which one motion may show and not another.
        without = [base.loss]
        for suspect, sides, own in begun:
            both = sides.also((c.at, suspect.side == 'before'))
            start = both.start(now.sides, now.theta, own)
            without.append(_fitted(now, both, start, stopped).loss)
        told = evidences(min(without))
    # There after only, where that is alike.
    best = max(range(len(fits)), key=lambda i: told[i] - i * price_of(1))
    suspect, sides, found = fits[best]
    return _Fit(replace(c, suspect=suspect), told[best], sides, found.theta)


def _begun(now: _Round, c: Column) -> Iterator[tuple[Suspect, Sides, Array]]:
    """Yield how a suspect may be there, the sides with it, and (P,) its numbers to begin with."""
    estimate, suspect = now.weighed.of(c.columns)[0], c.suspect
    if c.at is not None:
        box = np.array([(p.low, p.high) for p in now.sides.models[0].scaled(c.at)]).T
        # What cannot be less than nothing on one side is on the other.
        for later, sign in ((True, 1.0), (False, -1.0)):
            # Where straight lines lead, or where it was tried: a limit acts at its value alone.
            along = np.stack([estimate, np.sign(estimate)])
            tried = np.clip(c.begin + sign * along @ c.moved, *box)
            if not np.array_equal(tried[0], c.begin):
                there = replace(suspect, side='after' if later else 'before')
                sides = now.sides.also((c.at, later))
                starts = np.stack([sides.start(now.sides, now.theta, own) for own in tried])
                left = now.marginal.sized()(residuals_at(sides, now.rows)(starts))
                yield there, sides, tried[int(np.argmin(np.sum(left**2, axis=1)))]
    elif c.move:
        yield suspect, now.sides.also(c.move), estimate * c.scales


def _restated(now: _Round, c: Column, stopped: Callable[[], bool]) -> tuple[Sides, _Best]:
    """Return the sides with the most probable stated number after, and their fit.

    Its logarithm is a parameter more.
    """
    most = math.log(STATED_WITHIN)

    @lru_cache(maxsize=2)
    def stated(power: float) -> tuple[Sides, Residuals]:
        sides = now.sides.stating(c.suspect.name, c.value * math.exp(power))
        return sides, residuals_at(sides, now.rows)

    def evaluate(theta: Array) -> Array:
        out: Array = np.empty((len(theta), now.rows.blocks.size))
        for power in np.unique(theta[:, -1]).tolist():
            at = theta[:, -1] == power
            out[at] = stated(power)[1](theta[at, :-1])
        return out

    start = np.append(now.theta, now.weighed.of(c.columns)[0])
    found = _best(now, evaluate, now.sides.box.wider(-most, most), start, stopped)
    return stated(float(found.theta[-1]))[0], _Best(found.theta[:-1], found.loss)


# ---------------------------------------------------------------------- what is said


def _named(now: _Round, x: _Fit, price: float) -> bool:
    """Return whether a change is more than it differs by within a side, and friction by itself."""
    sizes = now.sizes_of(x.column)
    if not sizes:
        return True
    at, kept = [*sizes], [now.weighed.kept[i] for i in sizes]
    # When it was found nothing told how the parts of one log scatter.
    more = now.weighed.scatter[0][kept] / now.weighed.inflation[kept]
    if not x.evidence > price * float(more.mean()):
        return False
    # Of its shape nothing is asked here: that was paid for when it was found.
    gain = now.weighed.beyond(np.array([*sizes.values()]), at)
    return evidence_of(gain, len(at)) > price


def _explained(
    begun: _Round, now: _Round, named: Sequence[_Fit], stopped: Callable[[], bool]
) -> float:
    """Return the share of the difference that what changed explains on parts left out.

    Of that and of what all that may have changed beside it explains there; NaN where it explains
    nothing. How large it is, is told by the other parts, a little off what all of them tell.
    """
    left = []
    for x in (begun, now):
        evaluate = residuals_at(x.sides, now.rows)
        theta = _descended(evaluate, x.sides.box, x.theta, now.marginal, stopped)
        left.append(evaluate(theta[None])[0])
    before, after = left
    some = now.weighed.unseen([i for x in named for i in now.kept_of(x.column)])
    whole = Marginal.of(now.weighed, now.rows, now.logs, now.nominal, folded=True)
    some += whole.loss(before) - whole.loss(after)
    return some / (some + max(0.0, now.weighed.unseen())) if some > 0.0 else math.nan


def _pushed(begun: _Round, now: _Round, reports: Sequence[GateReport]) -> bool:
    """Return whether the logs have efforts that were not commanded, and no change explains.

    Args:
        reports: As of `find_change`, like the rounds of `_explained`.
    """
    fits = [x.sides.each(x.theta) for x in (begun, now)]
    sides = [[[fit[i] for i in part] for fit in fits] for part in now.sides.groups]
    return any(unexplained(x, *own).pushes for x, own in zip(reports, sides, strict=False))


def _of_either_sign(sides: Sides) -> set[str]:
    """Return the parameters that may be of either sign; a stated number changes by a factor."""
    return {p.name for p in sides.parameters[: sides.nominal] if p.low < 0.0 < p.high}


def _changes(now: _Round, found: Sequence[_Fit], theta: Array) -> Iterator[Change]:
    """Yield what changed with its intervals, all changes beside one another.

    Args:
        theta: (N,) one fit of all logs; without what the model may lack it is the plainest.
    """
    half, either = now.weighed.half_widths(), _of_either_sign(now.sides)
    for x in found:
        s, sizes = x.column.suspect, list[Size]()
        for n in now.numbers_of(x.column):
            before, more = math.nan, n.value
            if s.kind == 'parameter':
                before = float(theta[now.sides.names.index(s.name)])
            elif s.kind == 'constant' and n.none is not None:
                before, more = n.none, n.value - n.none
            wide = abs(half[n.place] * n.width)
            sizes.append(
                Size(n.name, more, more - wide, more + wide, n.unit, before, s.name in either)
            )
        yield Change(s, tuple(sizes), x.evidence, x.ties)


def _all_friction(now: _Round, found: Sequence[_Fit], theta: Array) -> Iterator[Size]:
    """Yield what several changes of a drive's friction come to, as one of its Coulomb friction.

    Laws found beside one another may do opposite things: together they are projected on it, on
    each side by itself.
    """
    sides, told = now.sides, dict[str, list[Column]]()
    width = sides.high - sides.low
    for c in (x.column for x in found):
        if of_friction(c.at) if c.at else c.suspect.name.rpartition('.')[2] in FRICTION:
            told.setdefault(c.place, []).append(c)
    for place, several in told.items():
        names = [f'{place}.{name}' for name in COULOMB]
        at = next(
            (i for i, name in enumerate(sides.names[: sides.nominal]) if name in names), None
        )
        if at is None or len(several) < 2:
            continue
        slope = now.nominal[:, at]
        share, own = np.zeros((2, now.kept.shape[1]))
        for c in several:
            own[[x.place for x in now.numbers_of(c)]] = 1.0 if c.suspect.side == 'after' else -1.0
            for i, size in now.sizes_of(c).items():
                share[i] = size
        along = slope @ now.kept / np.maximum(slope**2 @ (now.kept != 0.0), 1e-300) * width[at]
        own *= along
        more = float(own @ share)
        half = NORMAL * math.sqrt(own @ now.weighed.beside()[0] @ own)
        p = sides.parameters[at]
        yield Size(p.name, more, more - half, more + half, p.unit, float(theta[at]))


def _less(now: _Round, c: Column, stopped: Callable[[], bool]) -> tuple[Sides, _Best]:
    """Return the sides without a change, and their best fit."""
    sides = now.sides.less(c.at, c.suspect.name)
    start = sides.start(now.sides, now.theta, np.empty(0))
    return sides, _fitted(now, sides, start, stopped)


def _escaped(
    now: _Round,
    less: Sequence[tuple[_Fit, Sides, _Best]],
    base: Callable[[], _Best],
    stopped: Callable[[], bool],
) -> _Best | None:
    """Return a better fit with all that was found than the best one, where there is one.

    More never explains less: where a fit without a change is better, that with it is a local
    optimum, and begins anew from there.

    Args:
        less: The changes, the sides without each, and their best fit.
        base: As of `_step`.
    """
    x, sides, without = min(less, key=lambda one: one[2].loss)
    if without.loss >= base().loss:
        return None
    own = now.sides.places_of(x.column.at, x.column.suspect.name)
    start = now.sides.start(sides, without.theta, now.theta[own])
    again = _fitted(now, now.sides, start, stopped)
    return again if again.loss < base().loss else None


def _still(
    now: _Round, c: Column, without: _Best, price: float, base: Callable[[], _Best]
) -> bool:
    """Return whether a change counts beside those found after it; arguments as of `_step`.

    Args:
        without: The best fit without it.
    """
    gain = max(0.0, without.loss - base().loss)
    return evidence_of(now.weighed.among_logs(gain, now.kept_of(c)), c.numbers) > price


def _visible(now: _Round, price: float) -> Iterator[Visible]:
    """Yield the smallest change of each suspect that shows."""
    smallest = dict[tuple[str, str], Visible]()
    moved = {name for m in now.sides.moved for name in (m.name, *m.of)}
    either = _of_either_sign(now.sides)
    for c in now.suspects:
        if c.suspect.name in moved:
            continue
        sizes = (now.weighed.shown(c.columns, price) * np.abs(c.scales)).tolist()
        for name, unit, size, most in zip(
            c.names, c.units, sizes, c.most or [math.inf] * len(c.names), strict=True
        ):
            size = size if size <= most else math.inf
            key = c.suspect.name, c.suspect.where
            one = Visible(c.suspect, name, size, unit, c.value, c.suspect.name in either)
            known = smallest.setdefault(key, one)
            # Of several shapes; numbers of several units are not compared, the first is told.
            if size < known.size and (name == known.name or known.size == math.inf):
                smallest[key] = one
    yield from smallest.values()


def _of_each_log(now: _Round, price: float) -> Iterator[Apart]:
    """Yield by what else the logs of one side differ from the others; of a kind the clearest."""
    told: dict[str, tuple[float, list[Apart]]] = {}
    # Variance of the difference of two sides' means, in that of a log.
    spread = sum(1.0 / np.sum(now.logs.after == side) for side in (False, True))
    for c in now.columns:
        estimate, covariance, gain = now.weighed.of(c.columns, alike=True)
        if not (c.own and gain):
            continue
        score = np.linalg.solve(covariance, estimate)
        known = np.eye(len(estimate)) / (c.usual**2 * spread)
        covariance = np.linalg.inv(np.linalg.inv(covariance) + known)
        estimate = covariance @ score
        evidence = evidence_of(float(estimate @ score), len(c.columns))
        if evidence > told.get(c.own, (price,))[0]:
            sure = np.abs(estimate) > NORMAL * np.sqrt(np.diag(covariance))
            told[c.own] = evidence, [
                Apart(c.own, c.names[i], 0.0, float(estimate[i] * c.scales[i]),
                      c.units[i]) for i in np.flatnonzero(sure)
            ]  # fmt: skip
    yield from (one for _, several in told.values() for one in several)


def _by_itself(now: _Round, several: Sequence[_Fit]) -> Iterator[Apart]:
    """Yield what fits as a change and differs by as much itself, by what it is."""
    told: dict[ApartKind, list[Apart]] = {'timing': [], 'friction': [], 'scatter': []}
    for c in (x.column for x in several):
        for n in now.numbers_of(c):
            if n.none is None:
                continue
            values = n.none, n.value
            one, other = values[::-1] if c.suspect.side == 'before' else values
            kind: ApartKind = 'friction' if c.at and of_friction(c.at) else 'scatter'
            kind = 'timing' if c.at and is_delay(c.at) else kind
            told[kind].append(Apart(kind, n.name, one, other, n.unit))
    yield from chain(*told.values())


def _noise(now: _Round, price: float, known: Collection[str]) -> Iterator[Apart]:
    """Yield by what the noise of one side differs, but of drives where it is known why."""
    residual = residuals_at(now.sides, now.rows)(now.theta[None])
    white = now.marginal.sized(residual[0])(residual)[0][: now.rows.blocks.size]
    outputs = now.sides.models[0].outputs
    told = noise_apart(white, now.rows, now.logs, now.weighed.noise, outputs, price)
    names = {output.name: output.place or output.name for output in outputs}
    yield from (x for x in told if names[x.text] not in known)
