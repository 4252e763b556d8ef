# SPDX-License-Identifier: Apache-2.0
"""Machines, their parameters and their compiled simulations."""

from collections.abc import Mapping, Sequence

from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.machine.file import load_machine, machine_from_mapping
from ros2_ident.machine.machine import Machine
from ros2_ident.machine.parameter import Parameter
from ros2_ident.models.drives.model import Array, DriveModel
from ros2_ident.models.linear_axis.model import LinearAxis
from ros2_ident.models.protocol import complete, EffectAt, FullModel, Model, Output
from ros2_ident.models.tripod.model import Tripod
from ros2_ident.recording import Dataset

DRIVE_MODELS: Mapping[str, type[DriveModel]] = {
    model.name: model for model in (Tripod, LinearAxis)
}


def make_model(
    machine: Machine,
    data: Dataset,
    *,
    drives: Sequence[str] | None = None,
    effects: Sequence[EffectAt] = (),
    fixed: Mapping[str, float] | None = None,
    cutoff: float = 100.0,
    efforts: Array | None = None,
    quantities: Sequence[str] = ('effort',),
    weights: Sequence[float] | None = None,
) -> DriveModel:
    """Return the model of a machine on a recording; the arguments are `DriveModel`'s.

    Raises:
        IdentError: UNKNOWN_MODEL where the machine's kind has no drives to simulate, or as
        `DriveModel`.
    """
    try:
        kind = DRIVE_MODELS[machine.kind]
    except KeyError:
        raise IdentError(
            ErrorCode.UNKNOWN_MODEL,
            f'a {machine.kind} has no drive model; use one of {", ".join(DRIVE_MODELS)}',
        ) from None
    return kind(
        machine,
        data,
        drives=drives,
        effects=effects,
        fixed=fixed,
        cutoff=cutoff,
        efforts=efforts,
        quantities=quantities,
        weights=weights,
    )


__all__ = [
    'DRIVE_MODELS',
    'DriveModel',
    'EffectAt',
    'FullModel',
    'LinearAxis',
    'Machine',
    'Model',
    'Output',
    'Parameter',
    'Tripod',
    'complete',
    'load_machine',
    'machine_from_mapping',
    'make_model',
]
