# SPDX-License-Identifier: Apache-2.0
"""The set-point reaches the controller late."""

from ros2_ident.effects.effect import closed_loop, Effect, EffectParameter

EFFECT = Effect(
    id='command_delay',
    group='controller',
    title='command delay',
    equation='z_cmd(t - T)',
    source='Ludwig and Gerstmayr 2011; PACE delay model',
    parameters=(
        EffectParameter(
            'delay', 's', 0.0, 0.03, 0.0, target='set_point_delay', starts=(3e-3,), symbol='T'
        ),
    ),
    family='loop timing',
    confusable=('current_loop_lag', 'effort_delay'),
    separated_by='compare set-point and measured position of {drive} in a chirp',
    needs=closed_loop,
    shown_by='late_set_point',
)
