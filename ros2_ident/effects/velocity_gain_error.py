# SPDX-License-Identifier: Apache-2.0
"""The velocity gain differs from the machine file's."""

from ros2_ident.effects.effect import closed_loop, Effect, EffectParameter

EFFECT = Effect(
    id='velocity_gain_error',
    group='controller',
    title='velocity-gain error',
    equation='k_v times g',
    source='controller law against log',
    parameters=(
        EffectParameter(
            'factor', '1', 0.3, 3.0, 1.0, target='velocity_gain', how='scale', symbol='g'
        ),
    ),
    family='loop gains',
    confusable=('position_gain_error', 'integral_gain_error', 'viscous_friction'),
    separated_by='compare the logged effort of {drive} with the law: no motion needed',
    needs=closed_loop,
)
