# SPDX-License-Identifier: Apache-2.0
"""Small questions that many tests ask of machines and results."""

from collections.abc import Mapping
from dataclasses import replace

from ros2_ident.identify.result import Identification, ParameterEstimate
from ros2_ident.models import Machine


def with_bounds(machine: Machine, bounds: Mapping[str, tuple[float, float, str]]) -> Machine:
    """Return the same machine with another box, the same for all drives."""
    return replace(machine, bounds=dict(bounds), own_bounds={})


def parameter(result: Identification, name: str) -> ParameterEstimate:
    """Return one estimate by its name."""
    return next(p for p in result.parameters if p.name == name)
