# SPDX-License-Identifier: Apache-2.0
"""The rails' radius differs from the machine file's."""

from ros2_ident.effects.effect import Effect, EffectParameter, platform

EFFECT = Effect(
    id='rail_radius_error',
    group='structure',
    title='rail-radius error',
    equation='rail radius plus d',
    source='kinematic calibration',
    parameters=(
        EffectParameter('error', 'm', -0.05, 0.05, 0.0, target='rail_radius', symbol='d'),
    ),
    place='all',
    family='geometry',
    confusable=('rod_length_error', 'cable_spring', 'rod_mass'),
    separated_by='hold still at many places of the workspace',
    needs=platform,
)
