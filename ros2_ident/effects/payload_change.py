# SPDX-License-Identifier: Apache-2.0
"""The tool changes its mass during the log."""

from ros2_ident.effects.effect import Effect, EffectParameter, Hook

EFFECT = Effect(
    id='payload_change',
    group='structure',
    title='payload change',
    equation='m_t plus dm from t_0 on',
    source='gripping and dropping',
    parameters=(
        EffectParameter('mass', 'kg', -1.0, 1.0, 0.0, target='payload_step'),
        EffectParameter('time', 's', 0.0, 60.0, 0.0, target='payload_time', role='time'),
    ),
    hook=Hook.PARAMETER,
    kernel=None,
    place='all',
    family='mass',
    confusable=(
        'rod_mass',
        'torque_constant_error',
    ),
    separated_by='hold still before and after the change of payload',
)
