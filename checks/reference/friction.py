# SPDX-License-Identifier: Apache-2.0
"""Torque between controller and rotor, and friction torque, of one drive."""

import math

import numpy as np

from checks.reference import layout as at
from checks.reference.compiled import compiled

Array = np.ndarray[tuple[int, ...], np.dtype[np.float64]]


@compiled
def smooth_sign(speed: float, width: float) -> float:
    """Return a sign that passes zero with slope 1/width."""
    return math.tanh(speed / width)


@compiled
def window(time: float, begin: float, end: float, ramp: float) -> float:
    """Return 1 between two times, 0 outside, with a cosine flank of `ramp` seconds behind each."""
    if time <= begin or time >= end + ramp:
        return 0.0
    if time < begin + ramp:
        return 0.5 - 0.5 * math.cos(math.pi * (time - begin) / ramp)
    if time > end:
        return 0.5 + 0.5 * math.cos(math.pi * (time - end) / ramp)
    return 1.0


@compiled
def bristle_rate(state: float, speed: float, length: float) -> float:
    """Return da/dt = (v - |v| a) / length of one dimensionless bristle (Dahl 1968, exponent 1)."""
    return (speed - abs(speed) * state) / length


@compiled
def coulomb_sign(speed: float, sign: float, internals: Array, d: Array) -> float:
    """Return what multiplies the Coulomb torque: the sign, or bristles where presliding is on."""
    length = d[at.PRESLIDE_LENGTH]
    if length == 0.0:
        return sign
    bristle: float = internals[at.BRISTLE]
    damping: float = d[at.PRESLIDE_DAMPING] * math.exp(-((speed / 0.01) ** 2))
    return bristle + damping * bristle_rate(bristle, speed, length)


@compiled
def fall_off(speed: float, scale: float) -> float:
    """Return what is left of friction at a speed; all of it where `scale` is 0."""
    return 1.0 if scale == 0.0 else math.exp(-((speed / scale) ** 2))


@compiled
def squared_press(torque: float, load: float, d: Array) -> float:
    """Return the friction torque by the square of the weaker side, where both press [N m]."""
    if torque * load <= 0.0:
        return 0.0
    if abs(load) < abs(torque):
        return float(d[at.SQUARE_LOAD] * load**2)
    return float(d[at.SQUARE_MOTOR] * torque**2)


@compiled
def friction_torque(
    time: float, place: float, speed: float, load: float, torque: float, internals: Array, d: Array
) -> float:
    """Return the friction torque of one drive, against the motion [N m].

    Nominal: M_C tanh(v/v_eps) + M_V v. Beside it every friction effect whose amplitude is not
    zero.
    """
    sign = smooth_sign(speed, d[at.SIGN_WIDTH])
    coulomb: float = d[at.COULOMB]
    friction: float = coulomb * coulomb_sign(speed, sign, internals, d) + d[at.VISCOUS] * speed
    if d[at.EXTRA_COULOMB] != 0.0:
        friction += d[at.EXTRA_COULOMB] * sign
    if d[at.EXTRA_VISCOUS] != 0.0:
        friction += d[at.EXTRA_VISCOUS] * speed
    if d[at.STRIBECK_TORQUE] != 0.0:
        friction += d[at.STRIBECK_TORQUE] * fall_off(speed, d[at.STRIBECK_SPEED]) * sign
    if d[at.LOAD_FRICTION] != 0.0:
        friction += d[at.LOAD_FRICTION] * abs(load / d[at.GEAR]) * sign
    if d[at.PRESS_MOTOR] != 0.0 or d[at.PRESS_LOAD] != 0.0:
        pressed = abs(d[at.PRESS_MOTOR] * torque + d[at.PRESS_LOAD] * load / d[at.GEAR])
        friction += pressed * fall_off(speed, d[at.PRESS_SPEED]) * sign
    if d[at.SQUARE_MOTOR] != 0.0 or d[at.SQUARE_LOAD] != 0.0:
        pressed = squared_press(torque, load / d[at.GEAR], d)
        friction += pressed * fall_off(speed, d[at.SQUARE_SPEED]) * sign
    if d[at.DRAG] != 0.0:
        friction += d[at.DRAG] * abs(speed) * speed
    if d[at.DEGRESSIVE_TORQUE] != 0.0:
        friction += d[at.DEGRESSIVE_TORQUE] * math.tanh(speed / d[at.DEGRESSIVE_SPEED])
    if d[at.PLACE_SLOPE] != 0.0:
        friction += coulomb * d[at.PLACE_SLOPE] * (place - d[at.PLACE_MIDDLE]) * sign
    if d[at.ASYMMETRY] != 0.0:
        level = coulomb + d[at.VISCOUS] * abs(speed)
        friction += d[at.ASYMMETRY] * level * abs(sign)
    if d[at.DRIFT_RATE] != 0.0:
        friction *= max(0.0, 1.0 + d[at.DRIFT_RATE] * time)
    return friction


@compiled
def rotor_torque(held: float, place: float, delivered: float, internals: Array, d: Array) -> float:
    """Return the torque on the rotor before friction [N m]."""
    torque: float = internals[at.CURRENT] if d[at.CURRENT_LAG] > 0.0 else held
    torque *= (1.0 + d[at.ACTUATOR_GAIN]) * delivered
    if d[at.RIPPLE_TORQUE] != 0.0:
        angle = d[at.RIPPLE_ORDER] * d[at.GEAR] * place + d[at.RIPPLE_PHASE]
        torque += d[at.RIPPLE_TORQUE] * math.sin(angle)
    return torque


@compiled
def internal_rates(speed: float, held: float, internals: Array, d: Array, rates: Array) -> None:
    """Write the time derivatives of one drive's internal states."""
    rates[:] = 0.0
    if d[at.PRESLIDE_LENGTH] > 0.0:
        rates[at.BRISTLE] = bristle_rate(internals[at.BRISTLE], speed, d[at.PRESLIDE_LENGTH])
    if d[at.CURRENT_LAG] > 0.0:
        rates[at.CURRENT] = (held - internals[at.CURRENT]) / d[at.CURRENT_LAG]
