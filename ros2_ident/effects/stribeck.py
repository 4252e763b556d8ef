# SPDX-License-Identifier: Apache-2.0
"""Stribeck friction: more friction near standstill than at speed."""

from typing import Any

from ros2_ident.effects.effect import Effect, EffectParameter, fading, Hook
from ros2_ident.lanes import exp, inlined


@inlined
def _kernel(value: Any, drive: Any, p: Any) -> Any:
    ratio = drive.velocity / p[1]
    return value + p[0] * exp(-ratio * ratio) * drive.direction


EFFECT = Effect(
    id='stribeck',
    group='drive',
    title='Stribeck friction',
    equation='M_S exp(-(v/v_S)^2) sgn v added to the friction torque',
    source='Armstrong-Helouvry, Dupont, Canudas de Wit, Automatica 30(7), 1994',
    parameters=(
        EffectParameter(
            'torque', 'effort', 0.0, 0.25, 0.0, symbol='M_S', meaning='friction added at rest'
        ),
        fading(),
    ),
    hook=Hook.FRICTION,
    kernel=_kernel,
    family='friction at reversals',
    confusable=('presliding', 'backlash', 'coulomb_friction'),
    separated_by='creep {drive} both ways at 5 to 30 mm/s, with at least five speeds',
)
