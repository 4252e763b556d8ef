# SPDX-License-Identifier: Apache-2.0
"""A belt whose stiffness changes along the rail."""

from typing import Any

from ros2_ident.effects.effect import along_rail, Effect, EffectParameter, elastic_gear, Hook
from ros2_ident.lanes import inlined, maximum, spread


@inlined
def _kernel(value: Any, drive: Any, p: Any) -> Any:
    return value * maximum(p[0] * (drive.carriage - p[1]) + 1.0, spread(0.05))


EFFECT = Effect(
    id='position_dependent_stiffness',
    group='drive',
    title='position-dependent stiffness',
    equation='c_G (1 + a (s - s_0))',
    source='Ludwig and Gerstmayr 2011, eq. 11; belt length changes with position',
    parameters=(
        EffectParameter('slope', '1/m', -0.5, 0.5, 0.0, symbol='a', meaning='change per length'),
        along_rail('middle', 's_0', 'position without change'),
    ),
    hook=Hook.STIFFNESS,
    kernel=_kernel,
    family='elasticity',
    confusable=('payload_change', 'frame_resonance'),
    separated_by='excite {drive} with the same chirp at three positions',
    needs=elastic_gear,
)
