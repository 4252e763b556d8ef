# SPDX-License-Identifier: Apache-2.0
"""The drive cannot make the torque its controller may ask for."""

from ros2_ident.effects.effect import closed_loop, Effect, EffectParameter

EFFECT = Effect(
    id='torque_saturation',
    group='controller',
    title='torque saturation',
    equation='commanded torque clipped at a share of its limit',
    source='Rhoban BAM; MuJoCo dcmotor note',
    parameters=(
        EffectParameter('share', '1', 0.02, 1.0, 1.0, target='torque_limit', how='scale',
                        starts=(0.04, 0.06, 0.09, 0.13, 0.2, 0.3, 0.45),
                        meaning='share of the torque limit'),
    ),
    family='saturation',
    confusable=('current_loop_lag',),
    separated_by='accelerate {drive} harder, until the torque has flat tops',
    needs=closed_loop,
    shown_by='flat_top',
)  # fmt: skip
