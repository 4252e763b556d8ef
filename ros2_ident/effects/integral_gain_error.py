# SPDX-License-Identifier: Apache-2.0
"""The integral gain differs from the machine file's."""

from ros2_ident.effects.effect import Effect, EffectParameter

EFFECT = Effect(
    id='integral_gain_error',
    group='controller',
    title='integral-gain error',
    equation='k_I times g',
    source='controller law against log',
    parameters=(
        EffectParameter(
            'factor', '1', 0.1, 5.0, 1.0, target='integral_gain', how='scale', symbol='g'
        ),
    ),
    family='loop gains',
    confusable=('velocity_gain_error', 'position_gain_error'),
    separated_by='compare the logged effort of {drive} with the law: no motion needed',
    needs=lambda context: context.closed_loop and context.integral,
)
