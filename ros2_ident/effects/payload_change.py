# SPDX-License-Identifier: Apache-2.0
"""A tool that changes its mass during the log."""

from ros2_ident.effects.effect import Effect, EffectParameter, platform

EFFECT = Effect(
    id='payload_change',
    group='structure',
    title='payload change',
    equation='m_t plus dm from t_0 to t_0 + T',
    source='gripping and dropping',
    parameters=(
        EffectParameter('mass', 'kg', -1.0, 1.0, 0.0, target='payload_step', symbol='dm'),
        EffectParameter('time', 's', 0.0, 3600.0, 0.0, role='time', target='payload_time',
                        symbol='t_0', meaning='when it is taken up'),
        EffectParameter('duration', 's', 0.05, 3600.0, 3600.0, starts=(1.0, 2.5, 3600.0),
                        role='shape', target='payload_duration', how='set', symbol='T',
                        meaning='how long it is carried'),
    ),
    place='all',
    family='mass',
    confusable=('rod_mass', 'torque_constant_error'),
    separated_by='hold still before and after the change of payload',
    needs=platform,
)  # fmt: skip
