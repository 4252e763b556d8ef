# SPDX-License-Identifier: Apache-2.0
"""The gates on the recordings of a diagnosis, and the one that takes a fitted model."""

from collections.abc import Sequence
import math

import numpy as np

from ros2_ident.arrays import Array
from ros2_ident.gap.floor import Floor
from ros2_ident.gates import examine, Gate, GateReport, Level
from ros2_ident.models import FullModel

# The simulation's own error, as a share of the noise floor.
STEP_ERROR = 0.1


def run_gates(
    models: Sequence[FullModel], theta: Array | None = None, floor: Floor | None = None
) -> GateReport:
    """Run all gates on the recordings of models.

    Args:
        models: A model of each recording.
        theta: (N,) a candidate of the first one, for the check of the integration step; left out
            where None.
        floor: The noise floor; the machine file's noise where None.

    Returns:
        The findings, worst first.
    """
    machine = models[0].machine
    report = GateReport()
    if machine is not None:
        # What the gates hold against noise is the effort.
        of_effort = models[0].outputs[0].quantity == 'effort'
        noise = floor.per_drive if floor is not None and of_effort else None
        report = examine(machine, [m.data for m in models], models[0].places, noise)
    steps = [] if theta is None else check_step(models[0], theta, floor)
    return GateReport((*report.gates, *steps), report.laws, report.asked)


def check_step(model: FullModel, theta: Array, floor: Floor | None = None) -> list[Gate]:
    """Compare the simulation with one of half the step: its error has to drown in the noise.

    Args:
        model: The model.
        theta: (N,) a candidate.
        floor: The noise floor; the machine file's noise where None.
    """
    row = np.atleast_2d(np.asarray(theta, dtype=float))
    finer = model.finer(row[0])
    if finer is None:
        return []
    error = np.sqrt(np.mean((model.simulate(row)[0] - finer.simulate(row)[0]) ** 2, axis=1))
    noise: Sequence[float] | Array = (
        [model.noise] * len(error) if floor is None else floor.per_drive
    )
    found = []
    what = model.outputs[0].quantity
    for drive, off, under in zip(model.places, error, noise, strict=True):
        share = float(off / under) if under > 0.0 else math.inf
        level: Level = 'ok' if share <= STEP_ERROR else 'warn' if share <= 0.5 else 'fail'
        text = f'{drive}: half the integration step changes the {what} by {share:.2g} of the noise'
        if level != 'ok':
            text += '; the step is too long to tell physics from numerics, raise substeps'
        found.append(Gate('step', drive, level, share, '1', text))
    return found
