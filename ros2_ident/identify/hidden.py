# SPDX-License-Identifier: Apache-2.0
"""Noise of a fit's residual, and the effects of the catalogue that can hide in it."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt
import scipy

from ros2_ident.arrays import Array
from ros2_ident.identify.layout import Layout
from ros2_ident.models import EffectAt, FullModel
from ros2_ident.models.trials import LARGE, orders_shown, TRIAL, trials
from ros2_ident.recording.motion import fill_gaps
from ros2_ident.search.evidence import Evidence, weigh
from ros2_ident.search.least_squares import Point
from ros2_ident.search.noise import fit_noise, Run, Whitening
from ros2_ident.threads import processors

Mask = npt.NDArray[np.bool_]

# What is predicted of a residual counts from this share of the noise on. Practice cases of another
# simulator, 2026-11-22; see `gap.rules`.
MATERIAL = 0.45
# Columns times rows weighed at most, for memory, 160 MB: a long log is thinned to whole blocks.
MOST = 20_000_000
# A block is left out as a whole: so long, s, longer than a motion's forces hang together. By hand.
BLOCK = 1.0
# A log falls into so many blocks at least: their scatter is known to a sixth then, 1 / sqrt(2 16).
BLOCKS = 16
# Samples further apart than so many usual steps do not follow one another. By hand.
_GAP = 3
# Seconds at a log's start that are not compared: a machine that has stood still holds forces no
# model knows. By hand.
SETTLE = 0.1


@dataclass(frozen=True)
class Rows:
    """Which samples are weighed, and in which order.

    Attributes:
        masks: For each model (O, K).
        runs: Rows that follow one another.
        blocks: (R,) number of each row's block.
        share: Share of all samples that they are.
    """

    masks: tuple[Mask, ...]
    runs: tuple[Run, ...]
    blocks: npt.NDArray[np.int64]
    share: float


def settled(model: FullModel) -> Mask:
    """Return (O, K) where a model has samples, its start left out."""
    there: Mask = ~np.isnan(model.measured)
    there[:, : round(SETTLE / model.cycle)] = False
    return there


def rows_of(models: Sequence[FullModel], most: int) -> Rows:
    """Return the samples weighed: all, or whole blocks spread evenly where they are too many.

    Args:
        most: Most samples.
    """
    masks = [settled(m) for m in models]
    total = sum(int(mask.sum()) for mask in masks)
    seconds = sum(m.shape[1] * model.cycle for m, model in zip(masks, models, strict=True))
    length = min(BLOCK, seconds / BLOCKS)
    every = max(1, -(-total // most))
    blocks: list[npt.NDArray[np.int64]] = []
    first = 0
    for mask, model in zip(masks, models, strict=True):
        block = (np.arange(mask.shape[1]) * model.cycle / length).astype(np.int64)
        # Two blocks side by side, so that most samples have a past, and two such pairs at least.
        step = min(every, max(1, (int(block.max(initial=0)) + 1) // 4))
        mask &= (block // 2) % step == 0
        block = block // 2 // step * 2 + block % 2
        blocks += [first + block[row] for row in mask]
        first += int(block[-1]) + 1 if block.size else 0
    kept = sum(int(mask.sum()) for mask in masks)
    return Rows(tuple(masks), runs_of(masks), np.concatenate(blocks), kept / max(total, 1))


def runs_of(masks: Sequence[Mask]) -> tuple[Run, ...]:
    """Return the stretches without a gap of the samples in masks (O, K), one after the other."""
    runs: list[Run] = []
    start = 0
    for mask in masks:
        for place, row in enumerate(mask):
            for stretch in _uninterrupted(np.flatnonzero(row)):
                runs.append(Run(start, start + stretch.size, place))
                start += stretch.size
    return tuple(runs)


def _uninterrupted(there: npt.NDArray[np.intp]) -> list[npt.NDArray[np.intp]]:
    """Return the stretches of samples without a gap; a lost sample or two are none."""
    if not there.size:
        return []
    steps = np.diff(there)
    usual = int(np.bincount(steps).argmax()) if steps.size else 1
    return np.split(there, np.flatnonzero(steps > _GAP * usual) + 1)


def slopes_of(fitted: Layout, theta: Array, rows: Rows) -> tuple[Array, Array]:
    """Return (R,) the residual of a fit, and (R, N) its derivative by shares of the box.

    Args:
        theta: (N,) their parameters.
        rows: The R samples that are looked at.
    """
    box = fitted.box
    point = Point.at(residuals_at(fitted, rows), box, box.inside(theta))
    return point.residual, point.jacobian


def residuals_at(fitted: Layout, rows: Rows) -> Callable[[Array], Array]:
    """Return the map from candidates (S, N) to their residuals (S, R) at the rows looked at."""
    seen = [m.restricted(mask) for m, mask in zip(fitted.models, rows.masks, strict=True)]
    return lambda theta: np.hstack([m.residuals(fitted.own(i, theta)) for i, m in enumerate(seen)])


def whitening(left: Array, rows: Rows, places: int) -> Whitening:
    """Return what makes noise white that has the colour of what a fit leaves.

    Args:
        left: (R,) the residual.
        rows: The R samples that are looked at.
        places: How many places there are, each with a noise of its own.
    """
    each = ([left[r.start : r.stop] for r in rows.runs if r.place == d] for d in range(places))
    return Whitening(rows.runs, [fit_noise(*own) for own in each])


@dataclass(frozen=True)
class Alternative:
    """Changes of a residual by an effect.

    Attributes:
        points: (S, P) values of its parameters that were tried.
        changes: (S, R) how they change the residual.
        most: (S,) how many times that change may be there.
        group: (S,) within one of these sizes superpose, see `trials`.
    """

    at: EffectAt
    points: Array
    changes: Array
    most: Array
    group: npt.NDArray[np.int64]


@dataclass(frozen=True)
class Missing:
    """Residual of a fit, its noise, and effects that its models may lack.

    Attributes:
        rows: The R samples that are looked at.
        residual: (R,) there, weighted.
        slopes: (R, N) its derivative by the parameters' shares of their box.
        alternatives: For each effect what it would change.
        columns: (R, C) the changes by all of them, and how drives stray from an even motion.
        most: (C,) how many times each may be there.
        known: Rows (L, N) of what is known beforehand, and by how much (L,) the fit is off it.
    """

    rows: Rows
    residual: Array
    slopes: Array
    alternatives: tuple[Alternative, ...]
    columns: Array
    most: Array
    known: tuple[Array, Array] | None = None

    @cached_property
    def evidence(self) -> Evidence:
        """Noise, effects' predictions, the parameters' certainty; places are the outputs.

        In the unit of the weighted residual.
        """
        rows = self.rows
        found = weigh(
            self.residual, self.slopes, self.columns, rows.runs, rows.blocks,
            most=self.most, share=rows.share,
        )  # fmt: skip
        return found if self.known is None else found.with_rows(*self.known)


def missing_beside(
    fitted: Layout,
    theta: Array,
    candidates: Sequence[EffectAt] | None = None,
    stopped: Callable[[], bool] = lambda: False,
    threads: int | None = None,
    more: Mapping[EffectAt, Sequence[Array]] | None = None,
) -> Missing:
    """Return the effects that the models of a fit may lack.

    Args:
        theta: (N,) their parameters.
        candidates: Effects that the models do not have; all of the catalogue where None.
        stopped: Asked often; True leaves the rest of the candidates empty.
        threads: That simulate; one for each processor where None.
        more: Of candidates not linear in their sizes, (P,) values that the logs suggest.
    """
    first, *others = models = fitted.models
    if candidates is None:
        candidates = [at for at in first.extensions() if at not in first.effects]
    wide = [first.extended((*first.effects, at)) for at in candidates]
    more = more or {}
    pairs = zip(wide, candidates, strict=True)
    tried = sum(len(_tried(w, at, more=more.get(at, ()))[0]) for w, at in pairs)
    rows = rows_of(models, MOST // max(200, tried))
    residual, slopes = slopes_of(fitted, theta, rows)
    basis = np.linalg.qr(slopes)[0]
    free = residual - basis @ (basis.T @ residual)

    def changes_by(effects: Sequence[EffectAt]) -> Callable[[Array], Array]:
        several = [m.extended((*m.effects, *effects)) for m in models]
        masked = [m.restricted(x) for m, x in zip(several, rows.masks, strict=True)]

        def changed(points: Array) -> Array:
            base = np.repeat(theta[None], len(points), axis=0)
            own = [np.hstack([fitted.own(i, base), points]) for i in range(len(masked))]
            out = [m.residuals(row) for m, row in zip(masked, own, strict=True)]
            return np.hstack(out) - residual

        return changed

    def of(at: EffectAt, model: FullModel) -> Alternative:
        points, most, group = np.empty((0, 0)), 0.0, np.empty(0, np.int64)
        if not stopped():
            points, most, group = _tried(model, at, orders.get(at, ()), more.get(at, ()))
        out = changes_by([at])(points) if len(points) else np.empty((0, residual.size))
        there = np.isfinite(out).all(axis=1)
        out = out if there.all() else out[there]
        return Alternative(at, points[there], out, np.full(len(out), most), group[there])

    with ThreadPoolExecutor(threads or processors()) as pool:
        orders = dict[EffectAt, tuple[float, ...]]()
        for several in _turning(first, candidates):
            changed = changes_by(several)

            def change(points: Array, changed: Callable[[Array], Array] = changed) -> Array:
                parts = np.array_split(points, threads or processors())
                return np.concatenate(list(pool.map(changed, parts)))

            if not stopped():
                seen = [_of_place(rows, first, at.where) for at in several]
                model = first.extended((*first.effects, *several))
                shown = orders_shown(model, several, seen, change, free, basis, clear=True)
                orders.update(zip(several, shown, strict=True))
        found = tuple(pool.map(of, candidates, wide))
    answers = _answers(models, rows)
    columns = np.concatenate([answers, *(one.changes for one in found)]).T
    # Not held twice: they are the most of what is in memory.
    ends = np.cumsum([len(answers), *(len(one.points) for one in found)])
    parts = np.split(columns.T, ends[:-1])[1:]
    found = tuple(replace(one, changes=x) for one, x in zip(found, parts, strict=True))
    most = np.concatenate([np.full(len(answers), np.inf), *(one.most for one in found)])
    known, unit = fitted.known(), fitted.box.inside(theta)
    beforehand = None if known is None else (known.rows, known.residual(unit))
    return Missing(rows, residual, slopes, found, columns, most, beforehand)


def _turning(model: FullModel, candidates: Sequence[EffectAt]) -> Iterator[list[EffectAt]]:
    """Yield the places of each effect that has an order of a drive's turn."""
    for effect in dict.fromkeys(at.effect for at in candidates):
        several = [at for at in candidates if at.effect == effect]
        if any(p.role == 'order' for p in model.scaled(several[0])):
            yield several


def _of_place(rows: Rows, model: FullModel, place: str) -> Mask:
    """Return (R,) which rows are of a place's outputs; all where it has none."""
    own = np.array([place == (o.place or o.name) for o in model.outputs])
    own |= not own.any()
    return np.concatenate([np.repeat(own, mask.sum(axis=1)) for mask in rows.masks])


def _answers(models: Sequence[FullModel], rows: Rows) -> Array:
    """Return (D, R) how each drive strays from an even motion; (0, R) where set-points are logged.

    A controller that is to hold a speed answers with effort: then the effort follows the motion,
    and grows with acceleration as if there were more mass. With the gains unknown it is a column
    of unknown size.

    Reference:
        Janot, Vandanjon, Gautier, IEEE TCST 22(1), 2014: bias of inverse dynamics in closed loop.
    """
    parts = []
    for model, mask in zip(models, rows.masks, strict=True):
        seen = model.data.position
        if seen is None or not model.thinned:
            return np.empty((0, sum(int(mask.sum()) for mask in rows.masks)))
        at = [model.data.names.index(place) for place in model.places]
        strays = model.in_band(scipy.signal.detrend(np.stack([fill_gaps(seen[d]) for d in at])))
        parts.append((np.eye(len(at))[:, :, None] * strays)[:, mask])
    return np.concatenate(parts, axis=1)


def _tried(
    model: FullModel,
    at: EffectAt,
    orders: tuple[float, ...] = (),
    more: Sequence[Array] = (),
) -> tuple[Array, float, npt.NDArray[np.int64]]:
    """Return (S, P) values of a model's effect to try, and how many times its change may be.

    And (S,) the group of each, see `trials`.
    """
    groups = [*trials(at, model, orders), *([point] for point in more)]
    points = np.array([point for alike in groups for point in alike])
    itself = any(p.role == 'size' and p.starts for p in model.scaled(at))
    group = np.array([n for n, alike in enumerate(groups) for _ in alike], dtype=np.int64)
    return points, 1.0 if itself else LARGE / TRIAL, group
