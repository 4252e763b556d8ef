# SPDX-License-Identifier: Apache-2.0
"""A gear, screw or belt that gives, where the nominal model moves motor and load as one mass."""

from ros2_ident.effects.effect import Effect, EffectParameter

EFFECT = Effect(
    id='gear_flexibility',
    group='drive',
    title='gear flexibility',
    equation='a share of the moved mass hangs on a spring-damper behind the motor',
    source='Spong, J. Dyn. Syst. Meas. Control 109(4), 1987',
    parameters=(
        EffectParameter('share', '1', 0.0, 0.95, 0.0, target='load_share',
                        meaning='share of the mass behind the spring'),
        EffectParameter('frequency', 'Hz', 3.0, 150.0, 30.0,
                        starts=(8.0, 13.0, 20.0, 30.0, 45.0, 70.0), role='shape',
                        target='load_frequency', how='set',
                        meaning='frequency with the motor held'),
        EffectParameter('damping', '1', 0.001, 1.0, 0.05, role='shape', target='load_damping',
                        how='set', meaning='damping ratio'),
    ),
    family='elasticity',
    confusable=('current_loop_lag', 'command_delay'),
    separated_by='excite {drive} with a chirp to three times the resonance, with two payloads',
    # What hangs behind a flexible gear would carry the weight alone.
    needs=lambda context: not context.elastic and not context.lifted,
)  # fmt: skip
