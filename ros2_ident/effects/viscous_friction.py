# SPDX-License-Identifier: Apache-2.0
"""Viscous friction, where the nominal model has none."""

from ros2_ident.effects.effect import Effect, EffectParameter

EFFECT = Effect(
    id='viscous_friction',
    group='drive',
    title='viscous friction',
    equation='M_V v',
    source='Armstrong-Helouvry, Dupont, Canudas de Wit, Automatica 30(7), 1994',
    parameters=(
        EffectParameter('torque', 'effort s/m', 0.0, 1.0, 0.0, target='viscous', symbol='M_V'),
    ),
    family='speed-dependent friction',
    confusable=('quadratic_drag', 'velocity_gain_error'),
    separated_by='run {drive} at five constant speeds over its whole range, both ways',
)
