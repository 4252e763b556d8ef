# SPDX-License-Identifier: Apache-2.0
"""The effort is low-pass filtered before it is logged."""

from ros2_ident.effects.effect import Effect, EffectParameter

EFFECT = Effect(
    id='effort_filter',
    group='measurement',
    title='effort filter',
    equation="tau M_log' = M - M_log",
    source='first-order low-pass',
    parameters=(
        EffectParameter(
            'time_constant', 's', 0.0, 0.02, 0.0, target='log_lag', starts=(2e-3,), symbol='tau'
        ),
    ),
    family='log timing',
    confusable=('effort_delay', 'current_loop_lag'),
    separated_by='excite {drive} with a chirp: a filter loses gain',
)
