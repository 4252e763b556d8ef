# SPDX-License-Identifier: Apache-2.0
"""The effort is logged late."""

from ros2_ident.effects.effect import Effect, EffectParameter

EFFECT = Effect(
    id='effort_delay',
    group='measurement',
    title='effort delay',
    equation='M_log(t) = M(t - T)',
    source='Ludwig and Gerstmayr 2011, section 4',
    parameters=(
        EffectParameter(
            'delay', 's', 0.0, 0.05, 0.0, target='log_delay', starts=(2e-3,), symbol='T'
        ),
    ),
    family='log timing',
    confusable=('effort_filter', 'current_loop_lag'),
    separated_by='excite {drive} with a chirp: a delay turns the phase linearly',
)
