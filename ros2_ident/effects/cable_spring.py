# SPDX-License-Identifier: Apache-2.0
"""A cable or hose that pulls as a spring."""

from typing import Any

from ros2_ident.effects.effect import along_rail, Effect, EffectParameter, Hook
from ros2_ident.lanes import inlined


@inlined
def _kernel(value: Any, drive: Any, p: Any) -> Any:
    return value - p[0] * (drive.carriage - p[1])


EFFECT = Effect(
    id='cable_spring',
    group='drive',
    title='cable spring',
    equation='-k (s - s_0) on the load side',
    source='Khatib/FloBaRoID catalogue of disturbance forces; Hooke',
    parameters=(
        # One that pushes away is none.
        EffectParameter('stiffness', 'force/m', 0.0, 1.0, 0.0, symbol='k'),
        along_rail('rest', 's_0', 'position without force', 'constant_force'),
    ),
    hook=Hook.CARRIAGE_FORCE,
    kernel=_kernel,
    family='position',
    confusable=('position_dependent_friction', 'rail_radius_error', 'rod_length_error'),
    separated_by='sweep {drive} slowly both ways over its whole stroke',
)
