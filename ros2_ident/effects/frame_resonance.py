# SPDX-License-Identifier: Apache-2.0
"""The frame swings on its feet."""

from ros2_ident.effects.effect import Effect, EffectParameter, platform

EFFECT = Effect(
    id='frame_resonance',
    group='structure',
    title='frame resonance',
    equation=(
        "(1/q) (u'' + 2 zeta omega u' + omega^2 u) = - vertical force of the machine; "
        'omega = 2 pi f'
    ),
    source='structural dynamics, one mode',
    parameters=(
        EffectParameter('inverse_mass', '1/kg', 0.0, 0.2, 0.0, target='frame_inverse_mass',
                        symbol='q', meaning="inverse of the frame's modal mass"),
        EffectParameter('frequency', 'Hz', 3.0, 80.0, 20.0, target='frame_frequency', how='set',
                        role='shape', starts=(6.0, 9.0, 13.0, 18.0, 25.0, 35.0, 50.0), symbol='f'),
        EffectParameter('damping', '1', 0.005, 0.3, 0.05, target='frame_damping', how='set',
                        role='shape', symbol='zeta'),
    ),
    place='all',
    family='elasticity',
    confusable=('position_dependent_stiffness',),
    separated_by='strike the frame at rest; clamp it and repeat the motion',
    needs=platform,
)  # fmt: skip
