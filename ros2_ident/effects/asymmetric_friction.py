# SPDX-License-Identifier: Apache-2.0
"""Friction that differs between the two directions."""

from typing import Any

from ros2_ident.effects.effect import Effect, EffectParameter, Hook
from ros2_ident.lanes import absolute, inlined


@inlined
def _kernel(value: Any, drive: Any, p: Any) -> Any:
    return value + (p[0] + p[1] * absolute(drive.velocity)) * absolute(drive.direction)


EFFECT = Effect(
    id='asymmetric_friction',
    group='drive',
    title='asymmetric friction',
    equation='M_a + V_a |v| added to the friction torque in either direction',
    source='Janot, Gautier, Brunot 2019; Elhami and Brookfield, Proc. IMechE C 210, 1996',
    parameters=(
        EffectParameter('coulomb', 'effort', -0.5, 0.5, 0.0, symbol='M_a',
                        meaning='half the difference in Coulomb friction'),
        EffectParameter('viscous', 'effort s/m', -0.5, 0.5, 0.0, symbol='V_a',
                        meaning='half the difference in viscous friction'),
    ),
    hook=Hook.FRICTION,
    kernel=_kernel,
    family='direction',
    confusable=('constant_force', 'effort_bias'),
    separated_by='turn {drive} over: a force turns with it; go at several speeds both ways',
    # Its Coulomb part moves both ends of the friction, at rest too, as a force does.
    holds=('constant_force',),
)  # fmt: skip
