# SPDX-License-Identifier: Apache-2.0
"""Friction that changes while the machine warms up."""

from typing import Any

from ros2_ident.effects.effect import Effect, EffectParameter, Hook
from ros2_ident.lanes import inlined


@inlined
def _kernel(value: Any, drive: Any, p: Any) -> Any:
    return value * (1.0 + p[0] * drive.time)


EFFECT = Effect(
    id='friction_drift',
    group='drive',
    title='drifting friction',
    equation='friction torque times 1 + r t',
    source='Bittencourt and Gunnarsson, J. Dyn. Syst. Meas. Control 134(5), 2012, linearised',
    parameters=(EffectParameter('rate', '1/s', -0.1, 0.1, 0.0),),
    hook=Hook.FRICTION,
    kernel=_kernel,
    place='drive',
    family='time',
    confusable=('stribeck',),
    separated_by='repeat the same motion of {drive} at the start and after ten minutes',
)
