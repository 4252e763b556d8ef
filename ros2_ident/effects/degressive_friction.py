# SPDX-License-Identifier: Apache-2.0
"""Friction that rises with speed and levels off, as of a lubricant that thins."""

from typing import Any

from ros2_ident.effects.effect import Effect, EffectParameter, Hook
from ros2_ident.lanes import inlined, tanh


@inlined
def _kernel(value: Any, drive: Any, p: Any) -> Any:
    return value + p[0] * tanh(drive.velocity / p[1])


EFFECT = Effect(
    id='degressive_friction',
    group='drive',
    title='degressive friction',
    equation='M_D tanh(v/v_D) added to the friction torque, v_D well above the regularisation',
    source='Weigand, Ulmen, Janot, Ruskowski 2021, friction model of the KR 300',
    parameters=(
        EffectParameter('torque', 'effort', 0.0, 0.5, 0.0, symbol='M_D',
                        meaning='friction once it has levelled off'),
        EffectParameter('velocity', 'm/s', 0.01, 1.0, 0.1, starts=(0.03, 0.1, 0.3), role='shape',
                        symbol='v_D', meaning='speed at which it levels off'),
    ),
    hook=Hook.FRICTION,
    kernel=_kernel,
    family='speed-dependent friction',
    confusable=('quadratic_drag', 'viscous_friction', 'stribeck'),
    separated_by='run {drive} at five constant speeds over its whole range, both ways',
)  # fmt: skip
