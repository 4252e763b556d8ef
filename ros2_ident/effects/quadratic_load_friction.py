# SPDX-License-Identifier: Apache-2.0
"""Friction of a gear that grows with the square of what presses it, while it hardly turns."""

from typing import Any

from ros2_ident.effects.effect import Effect, fading, Hook, motor_torque, pressing
from ros2_ident.lanes import absolute, exp, inlined, spread, where


@inlined
def _kernel(value: Any, drive: Any, p: Any) -> Any:
    ratio = drive.velocity / p[2]
    load = drive.load / drive.gear
    # The weaker side is the one that is carried along; both have to press against each other.
    square = where(
        absolute(load) < absolute(drive.torque),
        p[1] * load * load,
        p[0] * drive.torque * drive.torque,
    )
    pressed = where(load * drive.torque > spread(0.0), square, spread(0.0))
    return value + pressed * exp(-ratio * ratio) * drive.direction


EFFECT = Effect(
    id='quadratic_load_friction',
    group='drive',
    title='quadratic load friction',
    equation='c_F F^2 where |F| < |M|, else c_M M^2, times exp(-(v/v_S)^2) sgn v, M against F',
    source='Duclusaud, Passault, Padois, Ly, ICRA 2025, model M6',
    parameters=(*pressing('1/(effort)', 1.0, 'c'), fading()),
    hook=Hook.FRICTION,
    kernel=_kernel,
    family='load friction',
    confusable=('stribeck_load_friction', 'directional_load_friction', 'stribeck'),
    separated_by='lift and lower three weights slowly with {drive}, the largest it can hold',
    needs=motor_torque,
)
