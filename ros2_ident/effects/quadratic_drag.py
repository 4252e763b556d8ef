# SPDX-License-Identifier: Apache-2.0
"""Drag that grows with the square of speed."""

from typing import Any

from ros2_ident.effects.effect import Effect, EffectParameter, Hook
from ros2_ident.lanes import absolute, inlined


@inlined
def _kernel(value: Any, drive: Any, p: Any) -> Any:
    return value + p[0] * drive.velocity * absolute(drive.velocity)


EFFECT = Effect(
    id='quadratic_drag',
    group='drive',
    title='quadratic drag',
    equation='Q v |v| added to the friction torque',
    source='MuJoCo dcmotor note; nonlinear viscous friction',
    parameters=(
        EffectParameter(
            'torque', 'effort s^2/m^2', 0.0, 0.5, 0.0, symbol='Q', meaning='coefficient'
        ),
    ),
    hook=Hook.FRICTION,
    kernel=_kernel,
    family='speed-dependent friction',
    confusable=('viscous_friction', 'velocity_gain_error'),
    separated_by='run {drive} at five constant speeds over its whole range, both ways',
)
