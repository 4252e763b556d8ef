# SPDX-License-Identifier: Apache-2.0
"""Small questions that many tests ask of machines and results."""

from collections.abc import Mapping
from dataclasses import replace

from ros2_ident.identify.result import Identification, ParameterEstimate
from ros2_ident.models import Machine

# The tripod's parameters as published, table 5.
TABLE_5 = {
    'measurement_delay': 0.024903,
    'gear_stiffness': 232139.0,
    'gear_damping_ratio': 0.396306,
    'tool_mass': 1.76244,
    'drive_inertia': 89.0817e-6,
    'coulomb_torque': 0.05,
    'viscous_torque': 0.05,
}


def with_bounds(machine: Machine, bounds: Mapping[str, tuple[float, float, str]]) -> Machine:
    """Return the same machine with another box, the same for all drives."""
    return replace(machine, bounds=dict(bounds), own_bounds={})


def parameter(result: Identification, name: str) -> ParameterEstimate:
    """Return one estimate by its name."""
    return next(p for p in result.parameters if p.name == name)
