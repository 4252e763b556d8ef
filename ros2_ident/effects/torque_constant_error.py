# SPDX-License-Identifier: Apache-2.0
"""A wrong torque constant: the logged effort is off by a factor."""

from ros2_ident.effects.effect import Effect, EffectParameter, Hook

EFFECT = Effect(
    id='torque_constant_error',
    group='measurement',
    title='torque constant error',
    equation='logged effort times g',
    source='MuJoCo dcmotor note; gap between current and torque',
    parameters=(EffectParameter('factor', '1', 0.7, 1.4, 1.0, target='effort_gain', how='scale'),),
    hook=Hook.PARAMETER,
    kernel=None,
    place='drive',
    family='scale of effort',
    confusable=(
        'velocity_gain_error',
        'load_dependent_friction',
    ),
    separated_by='repeat the motion of {drive} with a weighed mass added',
    # The motor's own constant may be off, or only what the log makes of the current.
    controller_blind=True,
)
