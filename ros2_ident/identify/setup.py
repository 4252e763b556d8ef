# SPDX-License-Identifier: Apache-2.0
"""From a machine and its data to a problem."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ros2_ident.identify.data import chosen_drives, Data
from ros2_ident.identify.layout import Conditions
from ros2_ident.identify.outputs import checked, Outputs
from ros2_ident.identify.problem import Problem, Setup
from ros2_ident.machine.machine import Machine
from ros2_ident.models import Model
from ros2_ident.models.registry import compared_of
from ros2_ident.recording import Dataset
from ros2_ident.recording.quality import standing


def problem_of(
    machine: Machine,
    data: Data,
    *,
    conditions: Conditions | None = None,
    outputs: Outputs | None = None,
    **asked: Any,
) -> Problem:
    """Return a machine's model on every segment, as one problem.

    Args:
        machine: The machine.
        data: The segments.
        conditions: How the recordings differ.
        outputs: What is compared; what the kind of machine compares where None.
        asked: Other attributes of `Setup`.

    Raises:
        IdentError: INVALID_GOAL, UNKNOWN_PARAMETER, NO_DATA, or as `make_model`.
    """
    differ, compared = conditions or Conditions(), checked(outputs, compared_of(machine))
    differ.check(data.labels)
    setup = Setup(machine, data, conditions=differ, outputs=compared, **asked)
    machine, drives = at_rest(machine, data.datasets, setup.drives)
    if machine.stands and drives != setup.drives:
        names = ', '.join(machine.stands)
        said = f'{names} stood still: nothing is found of their friction and rotors; their links '
        data = replace(data, warnings=(*data.warnings, f'{said}count as they stood'))
    return replace(setup, machine=machine, data=data, drives=drives).problem()


def at_rest(
    machine: Machine, datasets: Sequence[Dataset], drives: Sequence[str] | None = None
) -> tuple[Machine, tuple[str, ...]]:
    """Return a machine that knows where drives stand in all data, and the drives to compare.

    What a drive's effort is at rest, friction decides: where no drive is chosen, or all are, those
    that stand are not compared.
    """
    chosen = chosen_drives(machine, drives)
    rows = {}
    for name in machine.drives:
        here = [d.position[d.names.index(name)] for d in datasets
                if d.position is not None and name in d.names]  # fmt: skip
        if here and np.isfinite(here[0]).any():
            rows[name] = np.concatenate(here)
    strokes = {name: float(np.nanmax(x) - np.nanmin(x)) for name, x in rows.items()}
    still = standing(strokes)
    if chosen == machine.drives:
        chosen = tuple(name for name in chosen if name not in still)
    stands = {n: float(np.nanmedian(rows[n])) for n in still if n not in chosen}
    return replace(machine, stands=stands), chosen


def problem_of_models(
    models: Model | Sequence[Model],
    *,
    fixed: Mapping[str, float] | None = None,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    conditions: Conditions | None = None,
) -> Problem:
    """Return a user's own models as one problem.

    Args:
        models: One, or one for each recording; a parameter of one name is one parameter.
        fixed: Parameters held at a value, by name.
        bounds: (low, high) instead of the parameters' own, by name.
        conditions: What differs between the recordings, which are called `1`, `2` and so on.

    Raises:
        IdentError: INVALID_GOAL, UNKNOWN_PARAMETER or NO_DATA with the remedy.
    """
    several = models if isinstance(models, Sequence) else [models]
    labels = [str(number) for number in range(1, len(several) + 1)]
    differ = conditions or Conditions()
    differ.check(labels)
    return Problem(several, labels, differ, fixed=fixed, bounds=bounds)
