# SPDX-License-Identifier: Apache-2.0
"""Friction that changes while the machine warms up."""

from typing import Any

from ros2_ident.effects.effect import Effect, EffectParameter, Hook
from ros2_ident.lanes import absolute, exp, inlined


@inlined
def _factor(time: Any, warmth: Any, p: Any) -> Any:
    return (1.0 + p[0] * (1.0 - exp(-time / p[2]))) * exp(p[1] * warmth)


@inlined
def _kernel(value: Any, drive: Any, p: Any) -> Any:
    return value * _factor(drive.time, drive.memory, p)


@inlined
def _keeps(value: Any, drive: Any, p: Any) -> Any:
    friction = value * _factor(drive.time, drive.memory, p)
    power = absolute(friction * drive.velocity) * drive.gear
    return power + (drive.memory - power) * exp(-drive.elapsed / p[2])


EFFECT = Effect(
    id='friction_drift',
    group='drive',
    title='drifting friction',
    equation='friction times (1 + a (1 - exp(-t/T))) exp(b w); T dw/dt = friction power - w',
    source='Bittencourt and Gunnarsson, J. Dyn. Syst. Meas. Control 134(5), 2012',
    parameters=(
        EffectParameter('share', '1', -0.9, 1.0, 0.0, symbol='a',
                        meaning='share by which friction ends up changed'),
        EffectParameter('heating', '1/W', -300.0, 100.0, 0.0, symbol='b',
                        meaning='change per power of friction'),
        EffectParameter('time_constant', 's', 2.0, 1000.0, 10.0, starts=(3.0, 8.0, 100.0),
                        role='shape', symbol='T'),
    ),
    hook=Hook.FRICTION,
    kernel=_kernel,
    keeps=_keeps,
    family='time',
    confusable=('stribeck',),
    separated_by='repeat one motion of {drive} at the start and after ten minutes',
)  # fmt: skip
