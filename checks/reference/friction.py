# SPDX-License-Identifier: Apache-2.0
"""Torque between controller and rotor, and friction torque, of one drive."""

import math

import numpy as np

from checks.reference import layout as at
from checks.reference.compiled import compiled

Array = np.ndarray[tuple[int, ...], np.dtype[np.float64]]


@compiled
def smooth_sign(speed: float, width: float, form: float) -> float:
    """Return a sign that passes zero with slope 1/width: tanh (form 0) or arctan (form 1)."""
    if form == 0.0:
        return math.tanh(speed / width)
    return 2.0 / math.pi * math.atan(0.5 * math.pi * speed / width)


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
    """Return what multiplies the Coulomb torque: the sign, or the bristles where presliding is on.

    Args:
        speed: Motor speed at the rail [m/s].
        sign: The regularised sign of that speed.
        internals: (INTERNALS,) internal states of the drive.
        d: (DRIVE_COLUMNS,) the drive's numbers.

    Returns:
        Dimensionless friction, about -1 to 1.
    """
    length = d[at.PRESLIDE_LENGTH]
    if length == 0.0:
        return sign
    first: float = internals[at.BRISTLE_A]
    if d[at.PRESLIDE_FORM] == 0.0:
        return first
    if d[at.PRESLIDE_FORM] == 1.0:
        # LuGre's micro-damping as a time, falling off with speed to stay passive (Olsson 1996).
        return first + 1e-3 * math.exp(-((speed / 0.01) ** 2)) * bristle_rate(first, speed, length)
    spread: float = 0.4 * first + 0.35 * internals[at.BRISTLE_B] + 0.25 * internals[at.BRISTLE_C]
    return spread


@compiled
def fall_off(speed: float, scale: float, form: float) -> float:
    """Return what is left of friction at a speed; all of it where `scale` is 0."""
    if scale == 0.0:
        return 1.0
    ratio = (speed / scale) ** 2
    return math.exp(-ratio) if form == 0.0 else 1.0 / (1.0 + ratio)


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
    """Return the friction torque of one drive.

    Nominal: M_C tanh(v/v_eps) + M_V v. Beside it every friction effect whose amplitude is not
    zero.

    Args:
        time: Time since the start [s].
        place: Motor position at the rail [m].
        speed: Motor speed at the rail [m/s].
        load: Gear force [N].
        torque: Torque on the rotor [N m].
        internals: (INTERNALS,) internal states; may be empty where no effect needs one.
        d: (DRIVE_COLUMNS,) the drive's numbers.

    Returns:
        Torque against the motion [N m].
    """
    width = d[at.SIGN_WIDTH]
    sign = smooth_sign(speed, width, d[at.SIGN_FORM])
    coulomb: float = d[at.COULOMB]
    friction: float = coulomb * coulomb_sign(speed, sign, internals, d) + d[at.VISCOUS] * speed
    if d[at.EXTRA_COULOMB] != 0.0:
        friction += d[at.EXTRA_COULOMB] * smooth_sign(speed, width, d[at.EXTRA_COULOMB_FORM])
    if d[at.EXTRA_VISCOUS] != 0.0:
        rise = abs(speed) ** d[at.EXTRA_VISCOUS_EXPONENT]
        friction += d[at.EXTRA_VISCOUS] * math.copysign(rise, speed)
    if d[at.STRIBECK_TORQUE] != 0.0:
        ratio = (speed / d[at.STRIBECK_SPEED]) ** 2
        if d[at.STRIBECK_FORM] == 0.0:
            friction += d[at.STRIBECK_TORQUE] * math.exp(-ratio) * sign
        else:
            friction += d[at.STRIBECK_TORQUE] / (1.0 + ratio) * sign
    if d[at.LOAD_FRICTION] != 0.0:
        loaded = load / d[at.GEAR]
        if d[at.LOAD_FRICTION_FORM] == 1.0:
            loaded = 0.5 * (loaded + torque)
        friction += d[at.LOAD_FRICTION] * abs(loaded) * sign
    if d[at.PRESS_MOTOR] != 0.0 or d[at.PRESS_LOAD] != 0.0:
        pressed = abs(d[at.PRESS_MOTOR] * torque + d[at.PRESS_LOAD] * load / d[at.GEAR])
        friction += pressed * fall_off(speed, d[at.PRESS_SPEED], d[at.PRESS_FORM]) * sign
    if d[at.SQUARE_MOTOR] != 0.0 or d[at.SQUARE_LOAD] != 0.0:
        pressed = squared_press(torque, load / d[at.GEAR], d)
        friction += pressed * fall_off(speed, d[at.SQUARE_SPEED], d[at.SQUARE_FORM]) * sign
    if d[at.DRAG] != 0.0:
        friction += d[at.DRAG] * math.copysign(abs(speed) ** d[at.DRAG_EXPONENT], speed)
    if d[at.DEGRESSIVE_TORQUE] != 0.0:
        ratio = speed / d[at.DEGRESSIVE_SPEED]
        if d[at.DEGRESSIVE_FORM] == 0.0:
            friction += d[at.DEGRESSIVE_TORQUE] * math.tanh(ratio)
        else:
            friction += 0.5 * d[at.DEGRESSIVE_TORQUE] * math.asinh(2.0 * ratio)
    if d[at.PLACE_SLOPE] != 0.0:
        away = place - d[at.PLACE_MIDDLE]
        if d[at.PLACE_FORM] == 1.0:
            away = 0.05 * math.tanh(away / 0.05)
        friction += coulomb * d[at.PLACE_SLOPE] * away * sign
    if d[at.ASYMMETRY] != 0.0:
        if d[at.ASYMMETRY_WIDTH] > 0.0:
            friction *= 1.0 + d[at.ASYMMETRY] * smooth_sign(speed, d[at.ASYMMETRY_WIDTH], 1.0)
        else:
            level = coulomb + d[at.VISCOUS] * abs(speed)
            friction += d[at.ASYMMETRY] * level * abs(sign)
    if d[at.DRIFT_RATE] != 0.0:
        friction *= max(0.0, 1.0 + d[at.DRIFT_RATE] * time)
    if d[at.DRIFT_SHARE] != 0.0:
        friction /= 1.0 + d[at.DRIFT_SHARE] * internals[at.HEAT]
    return friction + outside_friction(time, place, speed, sign, internals, d)


@compiled
def outside_friction(
    time: float, place: float, speed: float, sign: float, internals: Array, d: Array
) -> float:
    """Return the friction torque of the effects that no catalogue lists [N m]."""
    friction = 0.0
    if d[at.BUMP_TORQUE] != 0.0:
        friction += (
            d[at.BUMP_TORQUE]
            * math.exp(-(((place - d[at.BUMP_PLACE]) / d[at.BUMP_WIDTH]) ** 2))
            * sign
        )
    if d[at.LAG_TORQUE] != 0.0:
        friction += (
            d[at.LAG_TORQUE] / (1.0 + (internals[at.LAGGED_SPEED] / d[at.LAG_SPEED]) ** 2) * sign
        )
    if d[at.BRAKE_TORQUE] != 0.0:
        friction += (
            d[at.BRAKE_TORQUE] * window(time, d[at.BRAKE_FROM], d[at.BRAKE_UNTIL], 0.15) * sign
        )
    if d[at.DWELL_TORQUE] != 0.0:
        friction += d[at.DWELL_TORQUE] * internals[at.REST] * sign
    return friction


@compiled
def rotor_torque(held: float, place: float, delivered: float, internals: Array, d: Array) -> float:
    """Return the torque on the rotor.

    Args:
        held: The controller's torque of this cycle [N m].
        place: Motor position at the rail [m].
        delivered: Share of the torque that the supply delivers.
        internals: (INTERNALS,) internal states.
        d: (DRIVE_COLUMNS,) the drive's numbers.

    Returns:
        Torque before friction [N m].
    """
    torque: float = held
    if d[at.CURRENT_LAG] > 0.0:
        torque = (
            internals[at.CURRENT_B] if d[at.CURRENT_LAG_FORM] == 1.0 else internals[at.CURRENT_A]
        )
    torque *= (1.0 + d[at.ACTUATOR_GAIN]) * delivered
    ripple: float = 0.0
    if d[at.RIPPLE_TORQUE] != 0.0 or d[at.RIPPLE_CURRENT] != 0.0:
        angle = d[at.RIPPLE_ORDER] * d[at.GEAR] * place
        phase = d[at.RIPPLE_PHASE]
        ripple = d[at.RIPPLE_TORQUE] * (
            math.sin(angle + phase)
            + d[at.RIPPLE_SECOND] * math.sin(2.0 * angle + 2.3 * phase)
            + d[at.RIPPLE_THIRD] * math.sin(3.0 * angle + 0.7 * phase)
        ) + d[at.RIPPLE_CURRENT] * held * math.sin(angle + 1.9 * phase)
    return torque + ripple


@compiled
def internal_rates(
    speed: float,
    rail_speed: float,
    load: float,
    held: float,
    friction: float,
    internals: Array,
    d: Array,
    rates: Array,
) -> None:
    """Write the time derivatives of one drive's internal states.

    Args:
        speed: Motor speed at the rail [m/s].
        rail_speed: Carriage speed relative to the frame [m/s].
        load: Gear force [N].
        held: The controller's torque of this cycle [N m].
        friction: Friction torque [N m].
        internals: (INTERNALS,) internal states.
        d: (DRIVE_COLUMNS,) the drive's numbers.
        rates: (INTERNALS,) output, per second.
    """
    rates[:] = 0.0
    if d[at.PRESLIDE_LENGTH] > 0.0:
        scale = 0.3 if d[at.PRESLIDE_FORM] == 2.0 else 1.0
        rates[at.BRISTLE_A] = bristle_rate(
            internals[at.BRISTLE_A], speed, scale * d[at.PRESLIDE_LENGTH]
        )
        rates[at.BRISTLE_B] = bristle_rate(internals[at.BRISTLE_B], speed, d[at.PRESLIDE_LENGTH])
        rates[at.BRISTLE_C] = bristle_rate(
            internals[at.BRISTLE_C], speed, 3.0 * d[at.PRESLIDE_LENGTH]
        )
    if d[at.CURRENT_LAG] > 0.0:
        lag = d[at.CURRENT_LAG] * (0.5 if d[at.CURRENT_LAG_FORM] == 1.0 else 1.0)
        rates[at.CURRENT_A] = (held - internals[at.CURRENT_A]) / lag
        rates[at.CURRENT_B] = (internals[at.CURRENT_A] - internals[at.CURRENT_B]) / lag
    if d[at.DRIFT_SHARE] != 0.0:
        power = abs(friction * speed * d[at.GEAR]) / d[at.DRIFT_POWER]
        rates[at.HEAT] = (power - internals[at.HEAT]) / d[at.DRIFT_TIME]
    if d[at.CABLE_HYSTERESIS] != 0.0:
        rates[at.CABLE_STATE] = bristle_rate(
            internals[at.CABLE_STATE], rail_speed, d[at.CABLE_LENGTH]
        )
    if d[at.SLIP_FORCE] > 0.0:
        excess = max(0.0, abs(load) / d[at.SLIP_FORCE] - 1.0)
        rates[at.SLIP] = math.copysign(d[at.SLIP_SPEED] * excess, load)
    if d[at.LAG_TORQUE] != 0.0:
        rates[at.LAGGED_SPEED] = (speed - internals[at.LAGGED_SPEED]) / d[at.LAG_TIME]
    if d[at.DWELL_TORQUE] != 0.0:
        still = math.exp(-((speed / d[at.DWELL_SPEED]) ** 2))
        broken = abs(speed) / 1e-3  # a millimetre of travel wears the bond off
        rates[at.REST] = (
            still * (1.0 - internals[at.REST]) / d[at.DWELL_TIME] - broken * internals[at.REST]
        )
