# SPDX-License-Identifier: Apache-2.0
"""Quantities of a recording that are compared with the model, and their weights (eq. 2)."""

from collections.abc import Mapping, Sequence
import math

import numpy as np

from ros2_ident.arrays import fast_noise
from ros2_ident.errors import ErrorCode
from ros2_ident.gates.scale import FEWEST
from ros2_ident.gates.signals import step_of
from ros2_ident.kernel.measurement import QUANTITIES
from ros2_ident.recording import Dataset

# What is compared, and its weight; None for one by its noise.
Outputs = Mapping[str, float | None]


def checked(outputs: Outputs | None, otherwise: Sequence[str] = ()) -> Outputs:
    """Return the quantities compared, in the order of `QUANTITIES`; `otherwise` where None.

    Raises:
        IdentError: INVALID_GOAL naming what is wrong.
    """
    given = dict(outputs) if outputs else dict.fromkeys(otherwise)
    for quantity, weight in given.items():
        if quantity not in QUANTITIES:
            raise ErrorCode.INVALID_GOAL.error(
                f'{quantity!r} cannot be compared; choose from {", ".join(QUANTITIES)}'
            )
        if weight is not None and not (math.isfinite(weight) and weight > 0.0):
            raise ErrorCode.INVALID_GOAL.error(
                f'the weight of {quantity} is {weight:g}; give a number above 0'
            )
    return {q: given[q] for q in QUANTITIES if q in given}


def read_outputs(texts: Sequence[str]) -> Outputs | None:
    """Read quantities compared from words as `effort` and `position=1e4`; None for no word.

    Raises:
        IdentError: INVALID_GOAL where one is not understood.
    """
    found: dict[str, float | None] = {}
    for text in texts:
        name, equals, value = text.partition('=')
        try:
            found[name] = float(value) if equals else None
        except ValueError:
            raise ErrorCode.INVALID_GOAL.error(
                f'{text!r} is no output; write its name, or its name and weight as position=1e4'
            ) from None
    return checked(found) if found else None


def weights_of(
    outputs: Outputs, datasets: Sequence[Dataset], drives: Sequence[str], effort_noise: float
) -> tuple[float, ...]:
    """Return the weight of each quantity.

    Where none is given, each counts by what its samples tell: errors are divided by the noise of
    the quantity and multiplied with that of the first one, in whose unit costs then are; where
    that is stated as none, all errors count as they are.

    Args:
        effort_noise: Standard deviation of the logged effort.
    """
    if len(outputs) == 1:
        return tuple(1.0 if weight is None else weight for weight in outputs.values())
    noise = [effort_noise if q == 'effort' else _noise(q, datasets, drives) for q in outputs]
    return tuple(
        (noise[0] / own if own > 0.0 < noise[0] else 1.0) if weight is None else weight
        for weight, own in zip(outputs.values(), noise, strict=True)
    )


def _noise(quantity: str, datasets: Sequence[Dataset], drives: Sequence[str]) -> float:
    """Return the standard deviation of a quantity's noise, the drives' and recordings' median."""
    found = []
    for data in datasets:
        values = getattr(data, quantity)
        for name in drives if values is not None else ():
            there = values[data.names.index(name)]
            if np.isfinite(there).sum() >= FEWEST:
                # Where neighbours are equal, the noise is that of the steps.
                steps = step_of(there) / math.sqrt(12.0)
                found.append(max(fast_noise(there[np.isfinite(there)]), steps))
    return float(np.median(found)) if found else 0.0
