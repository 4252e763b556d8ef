# SPDX-License-Identifier: Apache-2.0
"""Values of an effect's parameters to try: few that show what it can do to an output.

What is between a ripple and the log turns its phase with the speed, and an order of the motor's
turn that is missed by a little explains nothing: only a simulation of each tells.
"""

from collections.abc import Callable, Iterator, Sequence
import itertools

import numpy as np
import numpy.typing as npt
import scipy

from ros2_ident.arrays import Array
from ros2_ident.effects import EffectParameter, get_effect
from ros2_ident.models.protocol import EffectAt, FullModel

# Share of a size's range that is tried where the output is linear in it.
TRIAL = 0.03
# Share that counts as a large effect.
LARGE = 0.17
# Orders looked at are of so many periods over the stroke at least; orders so far apart, in periods
# over the stroke, still look alike.
_PERIODS, _DENSE = 1.5, 0.5
# So many samples are simulated in all, so many orders at once; so many are returned.
_MOST, _AT_ONCE, _BEST = 40_000_000, 16, 3
# Samples of a mean that noise hardly lifts: to a third.
_MEAN = 9
# Shares of the highest effort that a drive would make without a limit, to start looking below. A
# grid.
_BELOW = (0.92, 0.8, 0.65, 0.5)
# How many orders are next to one; how often chance alone may make one stand out of all.
_BESIDE, _CHANCE = 41, 1e-4


def shape_values(
    parameter: EffectParameter, model: FullModel, where: str, orders: tuple[float, ...] = ()
) -> tuple[float, ...]:
    """Return the values of a shape parameter to start from, in its own unit."""
    if parameter.role == 'order':
        # With fewer periods it is a spring or a constant force.
        return (*(n for n in parameter.starts if n * turns_of(model, where) >= _PERIODS), *orders)
    if parameter.role == 'position' and not parameter.starts:
        data = model.data
        position = data.command_position if data.command_position is not None else data.position
        assert position is not None
        rows = range(len(data.names)) if where == 'all' else [data.names.index(where)]
        span = np.nanquantile(position[list(rows)], (0.05, 0.5, 0.95))
        return tuple(float(v) for v in np.clip(span, parameter.low, parameter.high))
    if parameter.role == 'time':
        length = model.measured.shape[1] * model.cycle
        return tuple(float(v) for v in length * np.linspace(0.1, 0.9, 9))
    return parameter.starts or (parameter.neutral,)


def trials(
    candidate: EffectAt, model: FullModel, orders: tuple[float, ...] = ()
) -> list[list[Array]]:
    """Return groups of values of an effect's parameters: within one, sizes superpose.

    Args:
        candidate: The effect and its place.
        model: The model on the first recording, for what the starts depend on.
        orders: Orders of the drive's turn that the residual shows, see `orders_shown`.

    Returns:
        Groups of (P,) vectors in physical units; none where the motion is too short for any.
    """
    parameters = model.scaled(candidate)
    neutral = np.array([p.neutral for p in parameters])
    shapes = [i for i, p in enumerate(parameters) if p.role != 'size']
    sizes = [i for i, p in enumerate(parameters) if p.role == 'size']
    grids = [shape_values(parameters[i], model, candidate.where, orders) for i in shapes]
    groups = []
    for values in itertools.product(*grids):
        base = neutral.copy()
        for i, value in zip(shapes, values, strict=True):
            base[i] = value
        linear = []
        for i in sizes:
            p = parameters[i]
            if p.starts:
                # Not linear in this size: every start stands for itself.
                for start in p.starts:
                    point = base.copy()
                    point[i] = start
                    groups.append([point])
            else:
                away = p.high if p.high - p.neutral >= p.neutral - p.low else p.low
                point = base.copy()
                point[i] += TRIAL * (away - p.neutral)
                linear.append(point)
        groups += [linear] if linear else []
    return groups


def orders_shown(
    model: FullModel,
    several: Sequence[EffectAt],
    rows: Sequence[npt.NDArray[np.bool_]],
    change: Callable[[Array], Array],
    free: Array,
    basis: Array,
    clear: bool = False,
) -> list[tuple[float, ...]]:
    """Return the orders of drives' turns with which an effect explains most of a residual.

    One simulation tries an order of every drive: each is seen on the drive's own rows, to which
    the others do little.

    Args:
        model: A model that has the effects.
        several: One effect at several places.
        rows: (R,) for each of them the rows of its place.
        change: (S, P) values of the effects' parameters to (S, R) changes of the residual.
        free: (R,) the residual less what the parameters imitate.
        basis: (R, N) orthonormal basis of what the parameters can imitate.
        clear: Only those that stand out of the orders next to them further than chance takes one.

    Returns:
        Of each place, the best first; none where the effect has no order. Of a long log the lower
        ones.
    """
    parameters = model.scaled(several[0])
    order = [i for i, p in enumerate(parameters) if p.role == 'order']
    sizes = [i for i, p in enumerate(parameters) if p.role == 'size']
    if not order:
        return [()] * len(several)
    own = [model.scaled(at) for at in several]
    grids = [_grid(model, at.where, x[order[0]]) for at, x in zip(several, own, strict=True)]
    grids = [grid[: _MOST // (len(sizes) * free.size)] for grid in grids]
    neutral = np.array([[p.neutral for p in x] for x in own])
    high = np.array([[x[i].high for i in sizes] for x in own])
    shown: list[list[Array]] = [[] for _ in several]
    longest = max(grid.size for grid in grids)
    for begin in range(0, longest, _AT_ONCE):
        count = min(_AT_ONCE, longest - begin)
        points = np.repeat(neutral[None], count * len(sizes), axis=0)
        for place, grid in enumerate(grids):
            chosen = grid[begin : begin + count]
            points[: chosen.size * len(sizes), place, order[0]] = np.repeat(chosen, len(sizes))
            for first, i in enumerate(sizes):
                turn = slice(first, chosen.size * len(sizes), len(sizes))
                points[turn, place, i] += TRIAL * (high[place, first] - neutral[place, i])
        columns = np.nan_to_num(change(points.reshape(len(points), -1)), posinf=0.0, neginf=0.0).T
        columns = columns - basis @ (basis.T @ columns)
        for place, (grid, there) in enumerate(zip(grids, rows, strict=True)):
            pairs = columns[there].reshape(-1, count, len(sizes)).transpose(1, 0, 2)
            q = np.linalg.qr(pairs[: grid[begin : begin + count].size])[0]
            shown[place].append(q.astype(np.float32))
    return [
        tuple(itertools.islice(_best(grid, np.concatenate(q), free[there], clear), _BEST))
        if grid.size
        else ()
        for grid, q, there in zip(grids, shown, rows, strict=True)
    ]


def _best(
    grid: Array, pairs: npt.NDArray[np.float32], left: Array, clear: bool
) -> Iterator[float]:
    """Yield the order with most gain, and each next one in what those before leave.

    An order shows in others, too, where a motion is uneven: what is usual is told without it.

    Args:
        grid: (G,) orders.
        pairs: (G, r, S) orthonormal columns of each.
        left: (r,) what they are to explain.
        clear: As of `orders_shown`.
    """
    sizes = pairs.shape[2]
    # Of white noise a gain is chi-square distributed, with one degree of freedom a size.
    median = 2.0 * scipy.special.gammaincinv(sizes / 2, 0.5)
    least = scipy.special.chdtri(sizes, _CHANCE / grid.size) / median if clear else 0.0
    while True:
        gain = _gains(pairs, left)
        k = int(np.argmax(gain))
        left = left - pairs[k] @ (pairs[k].T @ left)
        if not gain[k] > least * scipy.ndimage.median_filter(_gains(pairs, left), _BESIDE)[k]:
            return
        yield float(grid[k])


def _gains(pairs: npt.NDArray[np.float32], left: Array) -> Array:
    return np.asarray(np.sum((left.astype(np.float32) @ pairs) ** 2, axis=1), dtype=np.float64)


def _grid(model: FullModel, place: str, order: EffectParameter) -> Array:
    """Return the orders that outputs show, so dense that none lies unseen between two."""
    turns = turns_of(model, place)
    if not turns > 0.0:
        return np.empty(0)
    high = min(order.high, model.highest_order(place))
    return np.arange(max(order.low, _PERIODS / turns), high, _DENSE / turns)


def turns_of(model: FullModel, place: str) -> float:
    """Return over how many turns of its motor a place moves; 0 where that is not known."""
    # A joint that turns does so with its motor where nothing else is stated.
    turn = model.motor_turn(place) or float(model.travel[0] == 'rad')
    source = model.data.position
    source = model.data.command_position if source is None else source
    if source is None or place not in model.data.names:
        return 0.0
    row = source[model.data.names.index(place)]
    return turn * float(np.ptp(row[np.isfinite(row)])) / (2.0 * np.pi)


def limits_shown(candidate: EffectAt, models: Sequence[tuple[FullModel, Array]]) -> list[Array]:
    """Return (P,) parameters to start an effort's limit from; none for another effect.

    It acts only below what a drive would do without it: at the highest logged effort; without one
    below what the model makes.

    Args:
        candidate: The effect and its place.
        models: The models without it, one a recording, with the (N,) parameters of each.
    """
    share = share_of_limit(candidate, models[0][0])
    if share is None:
        return []
    row = models[0][0].places.index(candidate.where)
    top = max(_highest(model, row) for model, _ in models)
    if top:
        return [share(top)]
    most = max(float(np.abs(model.simulated_effort(x)[row]).max()) for model, x in models)
    return list(np.unique([share(x * most) for x in _BELOW], axis=0)) if most > 0.0 else []


def _highest(model: FullModel, row: int) -> float:
    """Return the highest mean of a few samples of an output's logged effort, in size; 0 for none.

    Whatever is compared.
    """
    effort, data = model.measured[row], model.data
    if model.outputs[row].quantity != 'effort':
        if data.effort is None:
            return 0.0
        effort = data.effort[data.names.index(model.places[row])]
    logged = effort[np.isfinite(effort)]
    if not logged.size:
        return 0.0
    return float(np.abs(scipy.ndimage.uniform_filter1d(logged, _MEAN)).max())


def share_of_limit(candidate: EffectAt, model: FullModel) -> Callable[[float], Array] | None:
    """Return the map from an effort to a limit's (P,) parameters; None for another effect."""
    if get_effect(candidate.effect).shown_by != 'flat_top':
        return None
    (parameter, *others) = model.scaled(candidate)
    limit = model.effort_limit(candidate.where)
    if others or not np.isfinite(limit):
        return None
    return lambda effort: np.array([min(max(effort / limit, parameter.low), parameter.high)])
