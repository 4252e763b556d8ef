# SPDX-License-Identifier: Apache-2.0
"""Which effects could explain a residual at all: a look before the fits.

Each effect is tried at a few sizes and shapes by simulation; how the output changes, less what the
parameters already fitted can imitate, is compared with the residual. It ranks candidates and gives
each its starts; it decides nothing.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import uniform_filter1d

from ros2_ident.arrays import Array
from ros2_ident.effects import get_effect
from ros2_ident.models import EffectAt, FullModel
from ros2_ident.models.trials import LARGE, TRIAL, trials

# Samples of a mean that noise hardly lifts.
_MEAN = 9
# Shares of the highest effort that a drive would make without a limit, to start looking below.
_BELOW = (0.92, 0.8, 0.65, 0.5)


@dataclass(frozen=True)
class Start:
    """Start of a joint fit.

    Attributes:
        effects: The effect at its place; one of several drives at each.
        theta: (N,) parameters fitted so far, moved along with the effect.
        phi: (P,) the effects' own parameters.
        gain: Decrease of the sum of squared weighted residuals that the linearised fit promises.
        visible: RMS, in units of the floor, of what a large effect of this kind (a sixth of its
            range, or a start) leaves after the fitted parameters imitate it as far as they can,
            over the drives it sits on; well below 1 the log cannot show the effect.
    """

    effects: tuple[EffectAt, ...]
    theta: Array
    phi: Array
    gain: float
    visible: float


def limits_shown(
    candidate: EffectAt, models: Sequence[FullModel], thetas: Sequence[Array]
) -> list[Array]:
    """Return (P,) parameters to start an effort's limit from; none for another effect.

    It acts only below what a drive would do without it: at the highest logged effort; without one
    below what the model makes.

    Args:
        candidate: The effect and its place.
        models: The models without it, one a recording.
        thetas: (N,) parameters of each.
    """
    share = share_of_limit(candidate, models[0])
    if share is None:
        return []
    top = max(_highest(effort_of(model, candidate.where)) for model in models)
    if top:
        return [share(top)]
    row = models[0].places.index(candidate.where)
    pairs = zip(models, thetas, strict=True)
    most = max(float(np.abs(model.simulated_effort(x)[row]).max()) for model, x in pairs)
    return list(np.unique([share(x * most) for x in _BELOW], axis=0)) if most > 0.0 else []


def _highest(effort: Array) -> float:
    """Return the highest mean of a few samples of an effort (K,), in size; 0 for none."""
    logged = effort[np.isfinite(effort)]
    return float(np.abs(uniform_filter1d(logged, _MEAN)).max()) if logged.size else 0.0


def share_of_limit(candidate: EffectAt, model: FullModel) -> Callable[[float], Array] | None:
    """Return what makes an effort an effect's (P,) parameters; None where it is no limit's."""
    if get_effect(candidate.effect).shown_by != 'flat_top':
        return None
    (parameter, *others) = model.scaled(candidate)
    limit = model.effort_limit(candidate.where)
    if others or not np.isfinite(limit):
        return None
    return lambda effort: np.array([min(max(effort / limit, parameter.low), parameter.high)])


def effort_of(model: FullModel, place: str) -> Array:
    """Return (K,) the effort that was logged at a place, whatever is compared; empty for none."""
    row, data = model.places.index(place), model.data
    if model.outputs[row].quantity == 'effort':
        own: Array = model.measured[row]
    else:
        own = np.empty(0) if data.effort is None else data.effort[data.names.index(place)]
    return own


def screen(
    candidate: EffectAt,
    models: Sequence[FullModel],
    evaluate: Callable[[Array], Array],
    theta: Array,
    residual: Array,
    basis: Array,
    inverse: Array,
    outputs: Array,
    low: Array,
    high: Array,
    orders: tuple[float, ...] = (),
) -> list[Start]:
    """Rank the starts of one effect at one place.

    Args:
        candidate: The effect and its place.
        models: The model extended by it, one a recording; its parameters are the fitted ones and
            then the effect's.
        evaluate: (S, N + P) candidates to (S, R) weighted residuals of these models.
        theta: (N,) parameters fitted without the effect.
        residual: (R,) weighted residual there.
        basis: (R, B) orthonormal basis of the Jacobian's columns.
        inverse: (N, R) pseudo-inverse of the Jacobian by the parameters' shares of their box.
        outputs: (R', B) the same basis for the first R' rows alone, which are the outputs'.
        low: (N,) lower bounds of the fitted parameters.
        high: (N,) upper bounds.
        orders: Orders of the drive's turn that the residual shows.

    Returns:
        One start a group, the most promising first.
    """
    groups = trials(candidate, models[0], orders)
    parameters = models[0].scaled(candidate)
    neutral = np.array([p.neutral for p in parameters])
    lower = np.array([p.low for p in parameters])
    upper = np.array([p.high for p in parameters])
    size = np.array([p.role == 'size' for p in parameters])
    points = np.array([point for group in groups for point in group])
    values = evaluate(np.hstack([np.repeat(theta[None], len(points), axis=0), points]))
    changes = (residual[None] - values).T
    free = residual - basis @ (basis.T @ residual)
    nonlinear = any(p.role == 'size' and p.starts for p in parameters)
    samples = len(outputs) / (1 if candidate.where == 'all' else len(models[0].places))
    starts = []
    at = 0
    for group in groups:
        columns = changes[:, at : at + len(group)]
        vectors = points[at : at + len(group)]
        at += len(group)
        if not np.isfinite(columns).all():
            continue
        rest = columns - basis @ (basis.T @ columns)
        if not (rest**2).sum() > 1e-9:
            continue
        factor = np.linalg.lstsq(rest, free, rcond=1e-9)[0]
        if len(group) == 1 and nonlinear:
            # A trial far from neutral stands for itself; the straight line through it is no guide
            # far away.
            factor = np.clip(factor, 0.02, 3.0)
        phi = vectors[0].copy()
        phi[size] = neutral[size]
        phi = phi + factor @ np.where(size, vectors - neutral, 0.0)
        clipped = np.clip(phi, lower, upper)
        # What the bounds cut off is lost; with several sizes the largest cut counts.
        moved = np.abs(phi - neutral)[size]
        kept = np.abs(clipped - neutral)[size]
        ratio = (
            float(np.min(np.where(moved > 0, kept / np.maximum(moved, 1e-300), 1.0)))
            if size.any()
            else 1.0
        )
        if np.sign(phi - neutral)[size] @ np.sign(clipped - neutral)[size] <= 0:
            ratio = 0.0
        factor = factor * ratio
        gain = float(free @ free - ((free - rest @ factor) ** 2).sum())
        shift = inverse @ (residual - columns @ factor)
        moved_theta = np.clip(theta - shift * (high - low), low, high)
        enlarge = 1.0 if nonlinear else LARGE / TRIAL
        left = columns[: len(outputs)]
        left = left - outputs @ (outputs.T @ left)
        visible = enlarge * float(np.sqrt((left**2).sum(axis=0).max() / samples))
        own = np.where(size, clipped, phi)
        starts.append(Start((candidate,), moved_theta, own, gain, visible))
    return sorted(starts, key=lambda s: -s.gain)
