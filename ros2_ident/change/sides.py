# SPDX-License-Identifier: Apache-2.0
"""Models of two sides as one fit: what is common, and what changed."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt
import scipy

from ros2_ident.arrays import Array
from ros2_ident.identify.hidden import Rows
from ros2_ident.identify.layout import Layout
from ros2_ident.machine.machine import Parameter
from ros2_ident.models import EffectAt, FullModel
from ros2_ident.models.registry import stated_numbers, STATED_WITHIN
from ros2_ident.search.changes import Changes, Logs
from ros2_ident.search.evidence import SIZES, Sums
from ros2_ident.search.jacobian import diverged
from ros2_ident.search.noise import Whitening

# Behind the name of a parameter: by how much it is more after.
AFTER = ' after'


@dataclass(frozen=True, eq=False)
class Move:
    """Change of parameters that all logs have.

    Attributes:
        name: What changes: a parameter, or a link with a body at it.
        numbers: (k,) names of its numbers; of a parameter its own.
        units: (k,) their units.
        of: (E,) the parameters that are others after.
        by: (E, k) by how much with each number.
    """

    name: str
    numbers: tuple[str, ...]
    units: tuple[str, ...]
    of: tuple[str, ...]
    by: Array

    @classmethod
    def single(cls, p: Parameter) -> 'Move':
        """Return the change of one parameter."""
        return cls(p.name, (p.name,), (p.unit,), (p.name,), np.ones((1, 1)))


class Sides(Layout):
    """Models before and after, their changes as parameters that come last.

    Args:
        models: Nominal models, those before first.
        after: (M,) whether a model is of the side after.
        effects: Effects, each with whether it is on the side after.
        moved: Changes of parameters.

    Attributes:
        nominal: Number of parameters that are no change.
        fitted: Number of those that are no change of one of them.
        after: As given.
        later: (N,) whether a parameter acts on the side after only; else a change acts on the side
            before only.
        moved: As given.
    """

    def __init__(
        self,
        models: Sequence[FullModel],
        after: npt.NDArray[np.bool_],
        effects: Sequence[tuple[EffectAt, bool]] = (),
        moved: Sequence[Move] = (),
    ) -> None:
        on = {side: tuple(at for at, s in effects if s == side) for side in (False, True)}
        pairs = zip(models, after, strict=True)
        super().__init__([m.extended((*m.effects, *on[bool(s)])) for m, s in pairs])
        self.bare, self.after, self.effects = tuple(models), after, tuple(effects)
        self.nominal, self.moved = len(models[0].parameters), tuple(moved)
        self.fitted = len(self.parameters)
        # A change may lead out of the box of what was known before, but does not turn a sign.
        most = np.maximum(np.abs(self.low), np.abs(self.high))
        self._width = np.maximum(self.high - self.low, (STATED_WITHIN - 1.0) * most)
        far = self.low - self._width, self.high + self._width
        self._ends = (
            np.where(self.low >= 0.0, np.maximum(far[0], 0.0), far[0]),
            np.where(self.high <= 0.0, np.minimum(far[1], 0.0), far[1]),
        )
        first = [m.parameters for m, s in zip(self.models, after, strict=True) if not s]
        early = {p.name for own in first for p in own[self.nominal :]}
        late, parts = [], [np.empty((self.fitted, 0))]
        for m in moved:
            at = [self.names.index(name) for name in m.of]
            parts.append(np.zeros((self.fitted, len(m.numbers))))
            parts[-1][at] = m.by
            for name, unit, end in zip(m.numbers, m.units, self.reach(m).tolist(), strict=True):
                p = replace(self.parameters[at[0]], name=f'{name}{AFTER}', unit=unit)
                late.append(replace(p, low=-end, high=end))
        self._by = np.concatenate(parts, axis=1)
        self.later = np.array([p.name not in early for p in self.parameters] + [True] * len(late))
        self.parameters += tuple(late)
        self.names = tuple(p.name for p in self.parameters)
        self.low = np.array([p.low for p in self.parameters])
        self.high = np.array([p.high for p in self.parameters])

    @property
    def groups(self) -> list[list[int]]:
        """Numbers of the models of each side."""
        return [np.flatnonzero(self.after == side).tolist() for side in (False, True)]

    def reach(self, move: Move) -> Array:
        """Return (k,) the largest numbers of a change.

        None takes a parameter further than its own change might.
        """
        width = self._width[[self.names.index(name) for name in move.of]]
        return np.asarray(np.min(width[:, None] / np.maximum(np.abs(move.by), 1e-300), axis=0))

    def own(self, number: int, theta: Array) -> Array:
        """Return (S, N') the parameters of one model among candidates (S, N)."""
        theta = np.atleast_2d(theta)
        fitted = theta[:, : self.fitted]
        if self.moved and self.after[number]:
            there = self._by.any(axis=1)
            low, high = (x[there] for x in self._ends)
            fitted = fitted.copy()
            more = theta[:, self.fitted :] @ self._by[there].T
            fitted[:, there] = np.clip(fitted[:, there] + more, low, high)
        return super().own(number, fitted)

    def inside(self, theta: Array) -> Array:
        """Return (N,) the same parameters, of which no change is larger than acts.

        Beyond it nothing changes, and a derivative would say that nothing is known.
        """
        theta, end = theta.copy(), self.fitted
        for m in self.moved:
            end += len(m.numbers)
            if len(m.of) == 1:
                i = self.names.index(m.of[0])
                low, high = (float(x[i] - theta[i]) for x in self._ends)
                theta[end - 1] = np.clip(theta[end - 1], low, high)
        return theta

    def also(self, change: tuple[EffectAt, bool] | Move) -> 'Sides':
        """Return the sides with one change more: an effect on one side, or of parameters."""
        if isinstance(change, Move):
            return Sides(self.bare, self.after, self.effects, (*self.moved, change))
        return Sides(self.bare, self.after, (*self.effects, change), self.moved)

    def less(self, at: EffectAt | None, name: str) -> 'Sides':
        """Return the sides without a change: an effect, of parameters, or of a stated number."""
        if name in self.stated:
            return self.stating(name, self.stated[name][0])
        effects = [x for x in self.effects if x[0] != at]
        return Sides(self.bare, self.after, effects, [x for x in self.moved if x.name != name])

    def places_of(self, at: EffectAt | None, name: str) -> list[int]:
        """Return where the numbers of a change are: an effect's, or of parameters."""
        if at is None:
            own = [x for m in self.moved if m.name == name for x in m.numbers]
            return [self.names.index(f'{x}{AFTER}') for x in own]
        return [i for i, own in enumerate(self.names) if own.startswith(at.prefix)]

    def on(self, models: Sequence[FullModel]) -> 'Sides':
        """Return the sides with other models of the same recordings."""
        return Sides(models, self.after, self.effects, self.moved)

    def stating(self, name: str, value: float) -> 'Sides':
        """Return the sides with another number of the machine file after."""
        pairs = zip(self.bare, self.after, strict=True)
        return self.on([m.stating(name, value) if a else m for m, a in pairs])

    def times(self, name: str, factor: float) -> 'Sides':
        """Return the sides with a multiple of a number of the machine file, each of its own."""
        numbers = [_stated(m)[name] for m in self.bare]
        pairs = zip(self.bare, numbers, strict=True)
        return self.on([m.stating(name, factor * value) for m, value in pairs])

    @cached_property
    def stated(self) -> dict[str, tuple[float, float]]:
        """Numbers of the machine file that are others after: what they are before and after."""
        before, after = (_stated(self.bare[i]) for i in (0, -1))
        return {name: (before[name], x) for name, x in after.items() if x != before[name]}

    def start(self, base: 'Sides', theta: Array, new: Array) -> Array:
        """Return (N,) parameters from those (N',) with a change less, and its own (P,)."""
        known, more = dict(zip(base.names, theta.tolist(), strict=True)), iter(new.tolist())
        start = np.array([known[n] if n in known else next(more) for n in self.names])
        return self.inside(np.clip(start, self.low, self.high))


def _stated(model: FullModel) -> dict[str, float]:
    machine = model.machine
    return {name: value for name, (value, _) in stated_numbers(machine).items()} if machine else {}


@dataclass(frozen=True)
class Marginal:
    """Residuals whitened, with what the model lacks on both sides integrated out.

    The sum of squares of what it returns is minus twice the logarithm of the likelihood, but for
    what no parameter changes.

    Attributes:
        whiten: Makes noise white.
        columns: (M + C, R) whitened: what pairs and logs have of their own, of coefficients with a
            standard deviation of 1; then what the model lacks, of one size.
        sizes: (C,) standard deviations of its coefficients.
        limit: (C,) the largest.
        scale: RMS of the residual.
        pairs: Rows of each pair, and the products (M + C, M + C) of the columns there.
    """

    whiten: Whitening
    columns: Array
    sizes: Array
    limit: Array
    scale: float
    pairs: tuple[tuple[npt.NDArray[np.int64], Array], ...]

    @classmethod
    def of(
        cls, weighed: Changes, rows: Rows, logs: Logs, jacobian: Array, *, folded: bool = False
    ) -> 'Marginal':
        """Return it for the noise and the missing part that were found.

        Args:
            jacobian: (R, N) derivative by what each pair has of its own; (R, 0) for nothing.
            folded: Whether each part that is left out has it of its own, too.
        """
        whiten = Whitening(rows.runs, weighed.noise)
        deviates = weighed.alone.T
        if not folded:
            deviates = np.concatenate([deviates, weighed.scattering.T])
        alone = [np.zeros_like(deviates) for _ in logs.rows]
        for own, log in zip(alone, logs.rows, strict=True):
            own[:, log] = deviates[:, log]
        pair = np.concatenate([np.full(x.stop - x.start, p)
                               for x, p in zip(logs.rows, logs.pair, strict=True)])  # fmt: skip
        columns = whiten(np.concatenate([jacobian.T, *alone, weighed.common.T]))
        if folded:
            pair = pair * (1 + logs.fold.max()) + logs.fold
        rows_of = [np.flatnonzero(pair == p) for p in np.unique(pair)]
        pairs = tuple((x, columns[:, x] @ columns[:, x].T) for x in rows_of)
        return cls(whiten, columns, weighed.sizes, weighed.limit, weighed.scale, pairs)

    def sized(self, residual: Array | None = None) -> 'Marginal':
        """Return it with the sizes that a residual (R,) makes most probable; with none where None.

        A change that is not in a fit looks as if the model lacked much.
        """
        if residual is None:
            return replace(self, sizes=np.minimum(self.scale * SIZES[0], self.limit))
        normal = np.sum([x for _, x in self.pairs], axis=0)
        sums = Sums(normal, self.columns @ self.whiten(residual), self.limit)
        return replace(self, sizes=sums.sizes(self.scale)[0])

    @cached_property
    def _parts(self) -> list[tuple[npt.NDArray[np.int64], Array, Array]]:
        """For each pair its rows, columns and the factor of their precision."""
        unit = np.ones(len(self.columns))
        unit[len(unit) - len(self.sizes) :] = self.sizes
        found = []
        for there, normal in self.pairs:
            precision = np.eye(len(unit)) + normal * np.outer(unit, unit)
            factor = scipy.linalg.cholesky(precision, lower=True)
            found.append((there, self.columns[:, there] * unit[:, None], factor))
        return found

    def loss(self, residual: Array) -> float:
        """Return minus twice the logarithm of the likelihood of a residual (R,).

        But for what the noise alone decides.
        """
        found = self(residual[None])[0]
        volume = sum(float(np.sum(np.log(np.diag(factor)))) for _, _, factor in self._parts)
        return float(found @ found) + 2.0 * volume

    def __call__(self, residual: Array) -> Array:
        """Return (S, R + C) of residuals (S, R)."""
        there = ~diverged(residual)
        white = self.whiten(np.where(there[:, None], residual, 0.0))
        out = [white]
        for rows, own, factor in self._parts:
            taken = scipy.linalg.cho_solve((factor, True), own @ white[:, rows].T)
            white[:, rows] -= taken.T @ own
            out.append(taken.T)
        found = np.concatenate(out, axis=1)
        found[~there] = np.inf
        return found
