# SPDX-License-Identifier: Apache-2.0
"""A constant force or torque on the load side, a weight or a spring far from rest."""

from typing import Any

from ros2_ident.effects.effect import Effect, EffectParameter, Hook
from ros2_ident.lanes import inlined


@inlined
def _kernel(value: Any, drive: Any, p: Any) -> Any:
    return value - p[0]


EFFECT = Effect(
    id='constant_force',
    group='drive',
    title='constant force',
    equation='F on the load side, against the positive direction',
    source='Janot, Gautier, Brunot 2019, offset',
    parameters=(
        EffectParameter(
            'force', 'force', -1.0, 1.0, 0.0, symbol='F', meaning='force, or torque of a joint'
        ),
    ),
    hook=Hook.CARRIAGE_FORCE,
    kernel=_kernel,
    family='offset',
    confusable=('effort_bias', 'asymmetric_friction'),
    separated_by='no motion can: turn the axis over, or log the effort with the motor off',
    needs=lambda context: not {'constant_load', 'log_bias'} & context.identified,
    twins=('effort_bias',),
)
