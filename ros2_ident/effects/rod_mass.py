# SPDX-License-Identifier: Apache-2.0
"""Rods with a mass of their own."""

from ros2_ident.effects.effect import Effect, EffectParameter, platform

EFFECT = Effect(
    id='rod_mass',
    group='structure',
    title='rod mass',
    equation='half of each rod at the carriage, half at the platform',
    source='Codourey, IJRR 17(12), 1998',
    parameters=(EffectParameter('mass', 'kg', 0.0, 0.5, 0.0, target='mass_per_rod'),),
    place='all',
    family='mass',
    confusable=('payload_change', 'torque_constant_error'),
    separated_by='make the same acceleration at the rim and in the middle of the workspace',
    needs=platform,
)
