# SPDX-License-Identifier: Apache-2.0
"""Friction that grows with the force the gear carries."""

from typing import Any

from ros2_ident.effects.effect import Effect, EffectParameter, Hook
from ros2_ident.lanes import absolute, inlined


@inlined
def _kernel(value: Any, drive: Any, p: Any) -> Any:
    return value + p[0] * absolute(drive.load) / drive.gear * drive.direction


EFFECT = Effect(
    id='load_dependent_friction',
    group='drive',
    title='load-dependent friction',
    equation='mu |F| / gear sgn v added to the friction torque',
    source='Hamon, Gautier, Garrec, Janot, IROS 2010; Duclusaud et al., ICRA 2025, model M3',
    parameters=(EffectParameter('coefficient', '1', 0.0, 0.4, 0.0, symbol='mu'),),
    hook=Hook.FRICTION,
    kernel=_kernel,
    family='load friction',
    confusable=('coulomb_friction', 'asymmetric_friction'),
    separated_by='repeat the motion of {drive} with two payloads',
)
