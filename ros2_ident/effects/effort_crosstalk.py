# SPDX-License-Identifier: Apache-2.0
"""The effort of the other drives leaks into the logged one."""

from ros2_ident.effects.effect import Effect, EffectParameter

EFFECT = Effect(
    id='effort_crosstalk',
    group='measurement',
    title='effort cross-talk',
    equation='logged effort plus c times the sum of the others',
    source='shared supply or shunt',
    parameters=(
        EffectParameter('coefficient', '1', -0.3, 0.3, 0.0, target='log_crosstalk', symbol='c'),
    ),
    family='coupling',
    confusable=('payload_change', 'rod_mass'),
    separated_by='move the other drives while {drive} rests',
    needs=lambda context: context.drives > 1,
)
