# SPDX-License-Identifier: Apache-2.0
"""Friction of a gear that motor and load press together, each by a share of its own."""

from typing import Any

from ros2_ident.effects.effect import Effect, Hook, motor_torque, pressing
from ros2_ident.lanes import absolute, inlined


@inlined
def _kernel(value: Any, drive: Any, p: Any) -> Any:
    pressed = absolute(p[0] * drive.torque + p[1] * drive.load / drive.gear)
    return value + pressed * drive.direction


EFFECT = Effect(
    id='directional_load_friction',
    group='drive',
    title='directional load friction',
    equation='|mu_M M + mu_F F / gear| sgn v added to the friction torque',
    source='Duclusaud, Passault, Padois, Ly, ICRA 2025, models M3 (mu_M = mu_F) and M5',
    parameters=pressing('1', 0.95, 'mu'),
    hook=Hook.FRICTION,
    kernel=_kernel,
    family='load friction',
    confusable=('load_dependent_friction', 'coulomb_friction', 'stribeck_load_friction'),
    separated_by='lift and lower a weight slowly with {drive}, then another of half the size',
    needs=motor_torque,
)
