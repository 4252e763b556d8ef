# SPDX-License-Identifier: Apache-2.0
"""The logged effort is off by a constant."""

from ros2_ident.effects.effect import Effect, EffectParameter

EFFECT = Effect(
    id='effort_bias',
    group='measurement',
    title='effort bias',
    equation='logged effort plus b',
    source='offset of a current sensor',
    parameters=(EffectParameter('bias', 'effort', -0.5, 0.5, 0.0, target='log_bias', symbol='b'),),
    family='offset',
    confusable=('constant_force', 'asymmetric_friction'),
    separated_by='no motion can: turn the axis over, or log the effort with the motor off',
    twins=('constant_force',),
    needs=lambda context: 'constant_load' not in context.identified,
)
