# SPDX-License-Identifier: Apache-2.0
"""An end stop that a drive runs into, at one end of its way or at both."""

from typing import Any

from ros2_ident.effects.effect import Effect, EffectParameter, Hook
from ros2_ident.lanes import inlined, maximum, spread


@inlined
def _kernel(value: Any, drive: Any, p: Any) -> Any:
    below, above = p[1] - drive.carriage, drive.carriage - p[2]
    zero = spread(0.0)
    return value + p[0] * (maximum(below, zero) - maximum(above, zero))


def _end(name: str, symbol: str, *starts: float) -> EffectParameter:
    """Return a stop that is looked for from beyond one end of the motion to its middle."""
    far = starts[0]
    return EffectParameter(
        name, 'm', min(far, 0.5), max(far, 0.5), far, starts, 'position',
        limit='cable_spring', symbol=symbol, meaning=f'where the {name} stop begins',
    )  # fmt: skip


EFFECT = Effect(
    id='end_stop',
    group='drive',
    title='end stop',
    equation='k (max(0, s_1 - s) - max(0, s - s_2)) on the load side',
    source='Hooke; Gilardi and Sharf, Mechanism and Machine Theory 37(10), 2002',
    parameters=(
        # A drive's effort presses its stop in by its stroke over this, at the upper end by less
        # than shows beside an encoder's steps. By hand.
        EffectParameter('stiffness', 'force/m', 0.0, 1e4, 0.0, (10.0, 100.0, 1000.0), symbol='k'),
        _end('lower', 's_1', -0.25, 0.02, 0.2),
        _end('upper', 's_2', 1.25, 0.98, 0.8),
    ),
    hook=Hook.CARRIAGE_FORCE,
    kernel=_kernel,
    family='position',
    confusable=('cable_spring', 'torque_saturation', 'position_dependent_friction'),
    separated_by='move {drive} over the middle of its way only, then a little into either stop',
    bent=True,
)
