# SPDX-License-Identifier: Apache-2.0
"""Dry friction that changes along the rail."""

from typing import Any

from ros2_ident.effects.effect import along_rail, Effect, EffectParameter, Hook
from ros2_ident.lanes import inlined


@inlined
def _kernel(value: Any, drive: Any, p: Any) -> Any:
    return value + drive.coulomb * drive.direction * p[0] * (drive.position - p[1])


EFFECT = Effect(
    id='position_dependent_friction',
    group='drive',
    title='position-dependent friction',
    equation='Coulomb torque times 1 + a (z - z_0) added',
    source='Armstrong-Helouvry, Dupont, Canudas de Wit, Automatica 30(7), 1994',
    parameters=(
        EffectParameter('slope', '1/m', -2.0, 2.0, 0.0, symbol='a', meaning='change per length'),
        along_rail('middle', 'z_0', 'position without change', 'coulomb_friction'),
    ),
    hook=Hook.FRICTION,
    kernel=_kernel,
    family='position',
    confusable=('cable_spring', 'load_dependent_friction'),
    separated_by='sweep {drive} slowly both ways over its whole stroke',
)
