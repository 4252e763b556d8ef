# SPDX-License-Identifier: Apache-2.0
"""What a fit's residual shows of the noise, and what effects of the catalogue can hide in it."""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ros2_ident.models import EffectAt, FullModel
from ros2_ident.models.trials import LARGE, TRIAL, trials
from ros2_ident.search.evidence import Evidence, weigh
from ros2_ident.search.levenberg import difference_jacobian
from ros2_ident.search.noise import Run
from ros2_ident.threads import processors

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]
Own = Callable[[int, Array], Array]

# Columns times rows of what is weighed, at most: a long log is thinned to whole blocks.
_MOST = 20_000_000
# A block is left out as a whole: so long, s, but a log has so many at least.
_BLOCK, _BLOCKS = 1.0, 16
# Samples further apart than so many usual steps do not follow one another.
_GAP = 3
# Seconds at a log's start that are not compared: a machine that has stood still holds forces no
# model knows.
SETTLE = 0.1


@dataclass(frozen=True)
class Estimate:
    """Models of one machine at fitted parameters.

    Attributes:
        models: One a recording.
        own: (number, (S, N) candidates) to the (S, N') parameters of one model.
        theta: (N,) the parameters.
        low: (N,) lower ends of their box.
        high: (N,) upper ends.
    """

    models: tuple[FullModel, ...]
    own: Own
    theta: Array
    low: Array
    high: Array


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


def rows_of(models: Sequence[FullModel], most: int) -> Rows:
    """Return what is weighed: all samples, or whole blocks spread evenly where they are too many.

    Args:
        models: One a recording.
        most: Most samples.
    """
    masks = [~np.isnan(m.measured) for m in models]
    for mask, model in zip(masks, models, strict=True):
        mask[:, : round(SETTLE / model.cycle)] = False
    total = sum(int(mask.sum()) for mask in masks)
    seconds = sum(m.shape[1] * model.cycle for m, model in zip(masks, models, strict=True))
    length = min(_BLOCK, seconds / _BLOCKS)
    every = max(1, -(-total // most))
    blocks: list[npt.NDArray[np.int64]] = []
    first = 0
    for mask, model in zip(masks, models, strict=True):
        block = (np.arange(mask.shape[1]) * model.cycle / length).astype(np.int64)
        # Two blocks side by side, so that most samples have a past.
        mask &= (block // 2) % every == 0
        block = block // 2 // every * 2 + block % 2
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


@dataclass(frozen=True)
class Weighed:
    """What the residual of an estimate shows.

    Attributes:
        evidence: Noise, what effects of the catalogue predict, the parameters' certainty; places
            are the outputs, in the unit of the weighted residual.
        rows: The R samples that were weighed.
        slopes: (R, N) derivative of the residual by the parameters' shares of their box.
    """

    evidence: Evidence
    rows: Rows
    slopes: Array


def weigh_estimate(estimate: Estimate, stopped: Callable[[], bool] = lambda: False) -> Weighed:
    """Weigh what the residual of an estimate shows against what the catalogue's effects can do.

    Args:
        estimate: The fitted models.
        stopped: Asked often; True leaves the rest of the catalogue out.
    """
    candidates = [a for a in estimate.models[0].extensions() if a not in _there(estimate)]
    tried = [_tried(estimate.models[0], at) for at in candidates]
    rows = rows_of(estimate.models, _MOST // max(200, sum(len(p) for p, _ in tried)))
    span = estimate.high - estimate.low
    unit = (estimate.theta - estimate.low) / span

    def residuals(theta: Array) -> Array:
        return _residuals(estimate.models, estimate.own, theta, rows.masks)

    residual, jacobian = difference_jacobian(residuals, unit, estimate.low, span)

    def changes(at: EffectAt, tried: tuple[Array, float]) -> tuple[Array, Array]:
        points, most = tried
        if stopped():
            return np.empty((0, residual.size)), np.empty(0)
        models = tuple(m.extended((*m.effects, at)) for m in estimate.models)

        def own(number: int, theta: Array) -> Array:
            count = len(estimate.theta)
            return np.hstack([estimate.own(number, theta[:, :count]), theta[:, count:]])

        theta = np.hstack([np.repeat(estimate.theta[None], len(points), axis=0), points])
        out = _residuals(models, own, theta, rows.masks) - residual
        out = out[np.isfinite(out).all(axis=1)]
        return out, np.full(len(out), most)

    with ThreadPoolExecutor(processors()) as pool:
        parts = list(pool.map(changes, candidates, tried))
    missing = np.concatenate([np.empty((0, residual.size)), *(change for change, _ in parts)]).T
    most = np.concatenate([np.empty(0), *(limit for _, limit in parts)])
    evidence = weigh(
        residual, jacobian, missing, rows.runs, rows.blocks, most=most, share=rows.share
    )
    return Weighed(evidence, rows, jacobian)


def _there(estimate: Estimate) -> tuple[EffectAt, ...]:
    return estimate.models[0].effects


def _tried(model: FullModel, at: EffectAt) -> tuple[Array, float]:
    """Return (S, P) values of an effect to try, and how many times that its change may be."""
    extended = model.extended((*model.effects, at))
    points = np.array([point for group in trials(at, extended) for point in group])
    itself = any(p.role == 'size' and p.starts for p in extended.scaled(at))
    return points, 1.0 if itself else LARGE / TRIAL


def _residuals(
    models: Sequence[FullModel], own: Own, theta: Array, masks: Sequence[Mask]
) -> Array:
    """Return (S, R) weighted measured less simulated outputs."""
    parts = []
    for number, (model, mask) in enumerate(zip(models, masks, strict=True)):
        weight = np.repeat([o.weight for o in model.outputs], mask.sum(axis=1))
        simulated = model.simulate_at(own(number, theta), mask)
        parts.append((model.measured[mask] - simulated) * weight)
    return np.concatenate(parts, axis=1)
