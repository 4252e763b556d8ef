# SPDX-License-Identifier: Apache-2.0
"""Values of an effect's parameters to try: few that show what it can do to an output."""

import itertools

import numpy as np

from ros2_ident.arrays import Array
from ros2_ident.effects import EffectParameter
from ros2_ident.models.protocol import EffectAt, FullModel

# Share of a size's range that is tried where the output is linear in it.
TRIAL = 0.03
# Share that counts as a large effect.
LARGE = 0.17


def shape_values(
    parameter: EffectParameter,
    model: FullModel,
    where: str,
    orders: tuple[float, ...] = (),
) -> tuple[float, ...]:
    """Return the values of a shape parameter to start from, in its own unit."""
    if parameter.role == 'order':
        return (*parameter.starts, *orders)
    if parameter.role == 'position':
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
    candidate: EffectAt,
    model: FullModel,
    orders: tuple[float, ...] = (),
) -> list[list[Array]]:
    """Return groups of values of an effect's parameters: within one, sizes superpose.

    Args:
        candidate: The effect and its place.
        model: The model on the first recording, for what the starts depend on.
        orders: Orders of the drive's turn that the residual shows, see `orders_shown`.

    Returns:
        Groups of (P,) vectors in physical units.
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
        if linear:
            groups.append(linear)
    return groups
