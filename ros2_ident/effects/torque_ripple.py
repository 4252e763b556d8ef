# SPDX-License-Identifier: Apache-2.0
"""Torque that ripples with the motor angle: cogging."""

from typing import Any

from ros2_ident.effects.effect import Effect, EffectParameter, Hook
from ros2_ident.lanes import cosine, inlined, sine


@inlined
def _kernel(value: Any, drive: Any, p: Any) -> Any:
    angle = p[2] * drive.turn * drive.position
    return value + p[0] * sine(angle) + p[1] * cosine(angle)


EFFECT = Effect(
    id='torque_ripple',
    group='drive',
    title='torque ripple',
    equation='A sin(n gear z) + B cos(n gear z) added to the motor torque',
    source='Holtz and Springob, IEEE TIE 43(2), 1996',
    parameters=(
        # The whole effort: it may be all that a motor without a load makes effort for.
        EffectParameter('sine', 'effort', -1.0, 1.0, 0.0, symbol='A', meaning='sine part'),
        EffectParameter('cosine', 'effort', -1.0, 1.0, 0.0, symbol='B', meaning='cosine part'),
        EffectParameter('order', '1', 0.5, 24.5, 1.0,
                        starts=tuple(float(n) for n in (*range(1, 9), *range(10, 21, 2), 24)),
                        role='order', limit='cable_spring', symbol='n',
                        meaning='periods per motor turn; where no gear is stated, per turn of the '
                        'joint, as many as the log resolves'),
    ),
    hook=Hook.TORQUE,
    kernel=_kernel,
    family='motor angle',
    confusable=('transmission_eccentricity',),
    separated_by='turn {drive} slowly at constant speed over many motor turns',
    bent=True,
    # Those of slots, of poles and of both together. By hand.
    most=3,
)  # fmt: skip
