# SPDX-License-Identifier: Apache-2.0
"""A wrong torque constant: the motor makes another torque than asked, or the log shows another."""

from typing import Any

from ros2_ident.effects.effect import Effect, EffectParameter, Hook
from ros2_ident.lanes import inlined


@inlined
def _kernel(value: Any, drive: Any, p: Any) -> Any:
    return value * p[1]


EFFECT = Effect(
    id='torque_constant_error',
    group='measurement',
    title='torque constant error',
    equation='logged effort times g; motor torque a times the commanded one',
    source='MuJoCo dcmotor note; gap between current and torque',
    parameters=(
        EffectParameter('factor', '1', 0.7, 1.4, 1.0, target='log_gain', how='scale', symbol='g',
                        meaning='factor on the logged effort'),
        EffectParameter(
            'actuator', '1', 0.7, 1.4, 1.0, symbol='a', meaning='factor on the motor torque'
        ),
    ),
    hook=Hook.COMMAND,
    kernel=_kernel,
    family='scale of effort',
    confusable=('velocity_gain_error', 'load_dependent_friction'),
    separated_by='repeat the motion of {drive} with a weighed mass added',
)  # fmt: skip
