# SPDX-License-Identifier: Apache-2.0
"""The rods' length differs from the machine file's."""

from ros2_ident.effects.effect import Effect, EffectParameter, platform

EFFECT = Effect(
    id='rod_length_error',
    group='structure',
    title='rod-length error',
    equation='rod length plus d',
    source='kinematic calibration',
    parameters=(EffectParameter('error', 'm', -0.05, 0.05, 0.0, target='rod_length', symbol='d'),),
    place='all',
    family='geometry',
    confusable=('rail_radius_error', 'cable_spring', 'rod_mass'),
    separated_by='hold still at many places of the workspace',
    needs=platform,
)
