# SPDX-License-Identifier: Apache-2.0
"""Values of an effect's parameters to try: few that show what it can do to an output.

What is between a ripple and the log turns its phase with the speed, and an order of the motor's
turn that is missed by a little explains nothing: only a simulation of each tells.
"""

from collections.abc import Callable
import itertools

import numpy as np
import scipy

from ros2_ident.arrays import Array
from ros2_ident.effects import EffectParameter
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
# How many orders are next to one; how often chance alone may make one stand out of all.
_BESIDE, _CHANCE = 41, 1e-4


def shape_values(
    parameter: EffectParameter, model: FullModel, where: str, orders: tuple[float, ...] = ()
) -> tuple[float, ...]:
    """Return the values of a shape parameter to start from, in its own unit."""
    if parameter.role == 'order':
        # With fewer periods it is a spring or a constant force.
        return (*(n for n in parameter.starts if n * _turns(model, where) >= _PERIODS), *orders)
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
    at: EffectAt,
    change: Callable[[Array], Array],
    free: Array,
    basis: Array,
    clear: bool = False,
) -> tuple[float, ...]:
    """Return the orders of a drive's turn with which an effect explains most of a residual.

    Args:
        model: A model that has the effect.
        at: The effect and its place.
        change: (S, P) values of the effect's parameters to (S, R) changes of the residual.
        free: (R,) the residual less what the parameters imitate.
        basis: (R, N) orthonormal basis of what the parameters can imitate.
        clear: Only those that stand out of the orders next to them further than chance takes one.

    Returns:
        The best first; none where the effect has no order. Of a long log the lower ones.
    """
    parameters = model.scaled(at)
    order = [i for i, p in enumerate(parameters) if p.role == 'order']
    sizes = [i for i, p in enumerate(parameters) if p.role == 'size']
    grid = _grid(model, at.where, parameters[order[0]]) if order else np.empty(0)
    grid = grid[: _MOST // (len(sizes) * free.size)]
    if not grid.size:
        return ()
    neutral = np.array([p.neutral for p in parameters])
    gains = []
    for chosen in np.array_split(grid, -(-grid.size // _AT_ONCE)):
        points = np.repeat(neutral[None], chosen.size * len(sizes), axis=0)
        points[:, order[0]] = np.repeat(chosen, len(sizes))
        for first, i in enumerate(sizes):
            points[first :: len(sizes), i] += TRIAL * (parameters[i].high - neutral[i])
        columns = np.nan_to_num(change(points), posinf=0.0, neginf=0.0).T
        columns = columns - basis @ (basis.T @ columns)
        for pair in np.split(columns, chosen.size, axis=1):
            along = np.linalg.qr(pair)[0].T @ free
            gains.append(float(along @ along))
    gain = np.array(gains)
    best = np.argsort(gain)[: -_BEST - 1 : -1]
    if clear:
        # Of white noise a gain is chi-square distributed, with one degree of freedom a size.
        usual = scipy.ndimage.median_filter(gain, _BESIDE)
        usual = usual / (2.0 * scipy.special.gammaincinv(len(sizes) / 2, 0.5))
        least = usual * scipy.special.chdtri(len(sizes), _CHANCE / gain.size)
        best = best[gain[best] > least[best]]
    return tuple(float(grid[i]) for i in best)


def _grid(model: FullModel, place: str, order: EffectParameter) -> Array:
    """Return orders so dense that none lies unseen between two."""
    turns = _turns(model, place)
    if not turns > 0.0:
        return np.empty(0)
    return np.arange(max(order.low, _PERIODS / turns), order.high, _DENSE / turns)


def _turns(model: FullModel, place: str) -> float:
    """Return over how many turns of its motor a place moves; 0 where that is not known."""
    # A joint that turns does so with its motor where nothing else is stated.
    turn = model.motor_turn(place) or float(model.travel[0] == 'rad')
    source = model.data.position
    source = model.data.command_position if source is None else source
    if source is None or place not in model.data.names:
        return 0.0
    row = source[model.data.names.index(place)]
    return turn * float(np.ptp(row[np.isfinite(row)])) / (2.0 * np.pi)
