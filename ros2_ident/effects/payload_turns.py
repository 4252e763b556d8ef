# SPDX-License-Identifier: Apache-2.0
"""A load taken up and put down repeatedly, at instants found in the log."""

from ros2_ident.effects.effect import Effect, EffectParameter, turns

EFFECT = Effect(
    id='payload_turns',
    group='structure',
    title='payload taken up and put down',
    equation='m_t plus dm whenever the log shows a load',
    source='pick and place',
    parameters=(
        EffectParameter('mass', 'kg', -1.0, 1.0, 0.0, target='payload_turned', symbol='dm'),
    ),
    place='all',
    family='mass',
    confusable=('payload_change', 'rod_mass', 'torque_constant_error'),
    separated_by='hold still before and after each change of payload',
    needs=turns,
    shown_by='load',
    variant_of='payload_change',
)
