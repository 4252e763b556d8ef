# SPDX-License-Identifier: Apache-2.0
"""The log of a machine with known parameters and effects, from the model that identifies it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
import math

import numpy as np

from ros2_ident.arrays import Array
from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.machine.machine import Machine
from ros2_ident.models.planned import drives_moved, planned_model
from ros2_ident.models.protocol import FullModel
from ros2_ident.models.recorded import effort_range
from ros2_ident.recording import Dataset
from ros2_ident.simulate.effects import Added
from ros2_ident.simulate.motions import Motion


@dataclass(frozen=True)
class Log:
    """Motion and efforts of a machine at every controller cycle.

    Attributes:
        names: Joint names of the drives.
        cycle: Controller cycle [s].
        effort: (D, K) logged effort, late by the measurement delay [N m, or N].
        position: (D, K) position of the drives [m, or rad].
        velocity: (D, K) its derivative.
        effects: Values of the effects' parameters by their full names, as they were drawn.
    """

    names: tuple[str, ...]
    cycle: float
    effort: Array
    position: Array
    velocity: Array
    effects: Mapping[str, float] = field(default_factory=dict, kw_only=True)


def simulate(
    machine: Machine,
    parameters: Mapping[str, float],
    motion: Motion,
    effects: Sequence[Added] = (),
    rng: np.random.Generator | None = None,
) -> Log:
    """Simulate a log.

    Args:
        machine: The machine.
        parameters: Parameters by name, SI units; `gear_stiffness` is that of every drive. What a
            description holds is as described where not given.
        motion: Set-points of the drives.
        effects: What the machine has beside the nominal physics.
        rng: Source of chance of effects that are given by their size.

    Returns:
        The log; what the kind does not simulate is as planned.

    Raises:
        IdentError: INVALID_GOAL for an effect that has no place in the machine, UNKNOWN_PARAMETER
        for a parameter without a value, DIVERGED where the machine runs away.
    """
    if 'bandwidth' in machine.constants:
        # A log holds all frequencies, whatever is compared of it.
        machine = machine.with_constants(bandwidth=math.inf)
    model = planned_model(machine, motion.position, motion.velocity)
    values = {**parameters, **model.as_described(parameters)}
    log = _log(machine, motion, model, values)
    if not effects:
        return log
    there = [at for added in effects for at in added.places(machine)]
    offered = model.extensions()
    for at in there:
        if at not in offered:
            raise IdentError(
                ErrorCode.INVALID_GOAL,
                f'{at.effect} has no place on {at.where} of this machine; choose from '
                f'{", ".join(dict.fromkeys(x.effect for x in offered)) or "none"}',
            )
    # Sizes of effects are shares of the efforts that the machine has without them.
    data = Dataset(machine.drives, log.cycle, 0, None, None, None, None, log.effort)
    efforts = effort_range(machine, [data])
    model = planned_model(
        machine, motion.position, motion.velocity, effects=there, efforts=efforts
    )
    rng = rng or np.random.default_rng(0)
    drawn: dict[str, float] = {}
    for added in effects:
        for at in added.places(machine):
            drawn |= added.values_at(at, model.scaled(at), motion, machine, rng)
    return replace(_log(machine, motion, model, values | drawn), effects=drawn)


def _log(
    machine: Machine, motion: Motion, model: FullModel, values: Mapping[str, float]
) -> Log:
    told = model.simulate(_theta(model, values)[None])[0]
    if not np.isfinite(told).all():
        raise IdentError(
            ErrorCode.DIVERGED, 'the simulation diverged; set milder parameters or effects'
        )
    rows = drives_moved(model, motion.position, motion.velocity, told)
    quantities = {output.quantity for output in model.outputs}
    if 'position' in quantities and 'velocity' not in quantities:
        rows['velocity'] = np.gradient(rows['position'], model.cycle, axis=1)
    return Log(machine.drives, model.cycle, rows['effort'], rows['position'], rows['velocity'])


def _theta(model: FullModel, values: Mapping[str, float]) -> Array:
    """Return (N,) the parameters of a model by their names, or by those that all drives share."""
    out = []
    for p in model.parameters:
        base = p.name.rpartition('.')[2]
        if p.name not in values and base not in values:
            raise IdentError(
                ErrorCode.UNKNOWN_PARAMETER, f'{p.name} has no value; give {p.name} or {base}'
            )
        out.append(values.get(p.name, values.get(base, math.nan)))
    return np.array(out)


