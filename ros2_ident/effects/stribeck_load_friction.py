# SPDX-License-Identifier: Apache-2.0
"""Friction of a loaded gear that falls off as it turns faster."""

from typing import Any

from ros2_ident.effects.effect import Effect, fading, Hook, motor_torque, pressing
from ros2_ident.lanes import absolute, exp, inlined


@inlined
def _kernel(value: Any, drive: Any, p: Any) -> Any:
    ratio = drive.velocity / p[2]
    pressed = absolute(p[0] * drive.torque + p[1] * drive.load / drive.gear)
    return value + pressed * exp(-ratio * ratio) * drive.direction


EFFECT = Effect(
    id='stribeck_load_friction',
    group='drive',
    title='Stribeck load friction',
    equation='|mu_M M + mu_F F / gear| exp(-(v/v_S)^2) sgn v added to the friction torque',
    source='Duclusaud, Passault, Padois, Ly, ICRA 2025, models M4 (mu_M = mu_F) and M5',
    parameters=(*pressing('1', 1.0, 'mu'), fading()),
    hook=Hook.FRICTION,
    kernel=_kernel,
    family='load friction',
    confusable=('directional_load_friction', 'load_dependent_friction', 'stribeck'),
    separated_by='lift and lower a weight with {drive} at five speeds, the slowest at creep',
    needs=motor_torque,
)
