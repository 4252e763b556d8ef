# SPDX-License-Identifier: Apache-2.0
"""Coulomb friction, where the nominal model has none."""

from ros2_ident.effects.effect import Effect, EffectParameter

EFFECT = Effect(
    id='coulomb_friction',
    group='drive',
    title='Coulomb friction',
    equation='M_C sgn v',
    source='Armstrong-Helouvry, Dupont, Canudas de Wit, Automatica 30(7), 1994',
    parameters=(
        EffectParameter('torque', 'effort', 0.0, 1.0, 0.0, target='coulomb', symbol='M_C'),
    ),
    family='dry friction',
    confusable=('stribeck', 'presliding'),
    separated_by='move {drive} both ways at three speeds or more, with equal dwell',
)
