# SPDX-License-Identifier: Apache-2.0
"""The model of a machine on a motion that is planned and not yet recorded."""

from collections.abc import Sequence
from contextlib import suppress
from typing import Any

import numpy as np

from ros2_ident.arrays import Array
from ros2_ident.errors import IdentError
from ros2_ident.machine.machine import Machine
from ros2_ident.models.protocol import FullModel
from ros2_ident.models.registry import compared_of, make_model
from ros2_ident.recording import Dataset

# Outputs of a planned motion, the more the better.
_TOLD = (('effort', 'position', 'velocity'), ('effort', 'position'))


def planned_model(
    machine: Machine,
    position: Array,
    velocity: Array,
    quantities: Sequence[str] | None = None,
    **more: Any,
) -> FullModel:
    """Return a model of set-points that the drives follow as well as the model lets them.

    Args:
        machine: The machine.
        position: (D, K) set-points, rad or m.
        velocity: (D, K) their derivatives.
        quantities: Its outputs; all that its kind can simulate where None.
        more: As of `make_model`.

    Raises:
        IdentError: As `make_model`.
    """
    data = Dataset(
        machine.drives,
        machine.number('cycle'),
        0,
        position,
        velocity,
        position,
        velocity,
        np.full_like(position, np.nan),
    )
    for wanted in _TOLD if quantities is None else ():
        with suppress(IdentError):
            return make_model(machine, data, quantities=wanted, **more)
    return make_model(machine, data, quantities=quantities or compared_of(machine), **more)


def drives_moved(
    model: FullModel, position: Array, velocity: Array, told: Array
) -> dict[str, Array]:
    """Return (D, K) positions, velocities and efforts: what a model does not tell is as planned.

    Args:
        model: A planned model.
        position: (D, K) its set-points, rad or m.
        velocity: (D, K) their derivatives.
        told: (O, K) its outputs.
    """
    rows = {
        'position': position.copy(),
        'velocity': velocity.copy(),
        'effort': np.zeros_like(position),
    }
    for output, row in zip(model.outputs, told, strict=True):
        rows[output.quantity][model.data.names.index(output.place or output.name)] = row
    return rows
