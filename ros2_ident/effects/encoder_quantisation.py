# SPDX-License-Identifier: Apache-2.0
"""The controller reads the position in steps."""

from typing import Any

from ros2_ident.effects.effect import closed_loop, Effect, EffectParameter, Hook
from ros2_ident.lanes import floor, inlined, maximum, spread, where


@inlined
def _kernel(value: Any, drive: Any, p: Any) -> Any:
    step = maximum(p[0], spread(1e-12))
    return where(p[0] > spread(1e-9), step * floor(value / step + 0.5), value)


EFFECT = Effect(
    id='encoder_quantisation',
    group='controller',
    title='encoder quantisation',
    equation='position rounded to whole steps',
    source='least significant bit of an encoder',
    parameters=(
        EffectParameter(
            'step', 'm', 0.0, 0.01, 0.0, starts=(1e-4, 7e-4, 3e-3), meaning='step of the encoder'
        ),
    ),
    hook=Hook.READING,
    kernel=_kernel,
    family='reading',
    confusable=(),
    separated_by='creep with {drive} at less than ten steps a second',
    needs=closed_loop,
    shown_by='reading_steps',
)
