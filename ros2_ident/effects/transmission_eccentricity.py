# SPDX-License-Identifier: Apache-2.0
"""A pulley or pinion off centre: travel that wavers once a motor turn."""

from typing import Any

from ros2_ident.effects.effect import Effect, EffectParameter, elastic_gear, Hook
from ros2_ident.lanes import cosine, inlined, sine


@inlined
def _kernel(value: Any, drive: Any, p: Any) -> Any:
    x, slope = value
    sin, cos = sine(drive.turn * drive.position), cosine(drive.turn * drive.position)
    return x + p[0] * sin + p[1] * cos, slope + drive.turn * (p[0] * cos - p[1] * sin)


EFFECT = Effect(
    id='transmission_eccentricity',
    group='drive',
    title='transmission eccentricity',
    equation='e = A sin(gear z) + B cos(gear z) added to the gear deflection; lever 1 + de/dz',
    source='Tuttle and Seering, IEEE T-RA 12(3), 1996',
    parameters=(
        EffectParameter('sine', 'm', -0.02, 0.02, 0.0, symbol='A', meaning='sine part'),
        EffectParameter('cosine', 'm', -0.02, 0.02, 0.0, symbol='B', meaning='cosine part'),
    ),
    hook=Hook.DEFLECTION,
    kernel=_kernel,
    family='motor angle',
    confusable=('torque_ripple',),
    separated_by='turn {drive} at constant speeds that cross the resonance, both ways',
    needs=elastic_gear,
)
