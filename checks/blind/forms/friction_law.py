# SPDX-License-Identifier: Apache-2.0
"""Friction torque of one drive with the forms in it; sources stand in `friction` and `outside`."""

import math

import numpy as np

from checks.blind.forms import columns as at
from checks.blind.forms.compiled import compiled
from checks.reference import layout as nominal
from checks.reference.friction import smooth_sign

Array = np.ndarray[tuple[int, ...], np.dtype[np.float64]]

DAHL, ELASTO_PLASTIC, ELEMENTS, LUGRE = 1.0, 2.0, 3.0, 4.0
TURN = 2.0 * math.pi


@compiled
def power(speed: float, exponent: float) -> float:
    """Return |v|^exponent sgn(v)."""
    out: float = math.copysign(abs(speed) ** exponent, speed)
    return out


@compiled
def element_length(number: int, d: Array) -> float:
    """Return the presliding way of one of four slip elements, spread evenly in the logarithm."""
    length: float = d[at.BRISTLE_LENGTH] * d[at.BRISTLE_SHAPE] ** (number - 1.5)
    return length


@compiled
def bristle_rate(z: float, speed: float, length: float, kind: float, shape: float) -> float:
    """Return dz/dt of a bristle whose deflection is 1 while it slides [1/s].

    Args:
        z: Its deflection.
        speed: [m/s].
        length: Way after which it would slide [m].
        kind: DAHL: (1 - z sgn v)^shape; ELASTO_PLASTIC: 1 - alpha(z) |z|, elastic up to `shape`;
            ELEMENTS: 1 - |z|^6 while it is loaded; LUGRE: 1 - z sgn v.
        shape: See there.
    """
    along = z * math.copysign(1.0, speed)
    left = 1.0 - along
    if kind == DAHL:
        left = power(left, shape)
    elif kind == ELASTO_PLASTIC:
        if along < shape:
            left = 1.0
        elif along < 1.0:
            middle = (along - 0.5 * (1.0 + shape)) / (1.0 - shape)
            left = 1.0 - 0.5 * (1.0 + math.sin(math.pi * middle)) * along
    elif kind == ELEMENTS:
        left = 1.0 - max(0.0, along) ** 6
    return speed / length * left


@compiled
def dry_sign(speed: float, own: Array, d: Array) -> float:
    """Return what multiplies the Coulomb torque, about -1 to 1."""
    kind = d[at.BRISTLE_KIND]
    if kind == 0.0:
        return smooth_sign(speed, d[nominal.SIGN_WIDTH])
    z: float = own[at.BRISTLE_1]
    if kind == ELEMENTS:
        for number in range(1, 4):
            z += own[at.BRISTLE_1 + number]
        return 0.25 * z
    if kind == LUGRE:
        z += d[at.BRISTLE_TIME] * bristle_rate(z, speed, d[at.BRISTLE_LENGTH], kind, 0.0)
    return z


@compiled
def bristle_rates(speed: float, own: Array, d: Array, rates: Array) -> None:
    """Write the rates of the bristles."""
    kind, shape = d[at.BRISTLE_KIND], d[at.BRISTLE_SHAPE]
    for number in range(4 if kind == ELEMENTS else 1):
        z = own[at.BRISTLE_1 + number]
        length = element_length(number, d) if kind == ELEMENTS else d[at.BRISTLE_LENGTH]
        rates[at.BRISTLE_1 + number] = bristle_rate(z, speed, length, kind, shape)


@compiled
def speed_friction(speed: float, load: float, sign: float, d: Array) -> float:
    """Return friction that goes by speed and load, beside the nominal one [N m]."""
    out = 0.0
    if d[at.STRIBECK_TORQUE] != 0.0:
        ratio = abs(speed) / d[at.STRIBECK_SPEED]
        exponent = d[at.STRIBECK_EXPONENT]
        fall = math.exp(-(ratio**exponent)) if exponent > 0.0 else 1.0 / (1.0 + ratio)
        out += d[at.STRIBECK_TORQUE] * fall * sign
    if d[at.LOAD_SHARE_TORQUE] != 0.0:
        loaded = abs(load / d[nominal.GEAR])
        out += d[at.LOAD_SHARE_TORQUE] * loaded ** d[at.LOAD_EXPONENT] * sign
    if d[at.DRAG] != 0.0:
        out += d[at.DRAG] * power(speed, d[at.DRAG_EXPONENT])
    if d[at.THINNING_TORQUE] != 0.0:
        ratio = abs(speed) / d[at.THINNING_SPEED]
        exponent = d[at.THINNING_EXPONENT]
        # Both are 1/2 at the speed; the power law is made smooth below a hundredth of it.
        rise = ratio / (1.0 + ratio)
        if exponent > 0.0:
            rise = 0.5 * (ratio * ratio + 1e-4) ** (0.5 * exponent - 0.5) * ratio
        out += d[at.THINNING_TORQUE] * math.copysign(rise, speed)
    if d[at.DRY_EXTRA] != 0.0:
        out += d[at.DRY_EXTRA] * speed / math.hypot(speed, d[at.DRY_EXTRA_WIDTH])
    if d[at.VISCOUS_EXTRA] != 0.0:
        out += d[at.VISCOUS_EXTRA] * power(speed, d[at.VISCOUS_EXPONENT])
    if d[at.ASYMMETRY] != 0.0:
        rise = abs(speed) ** d[at.ASYMMETRY_EXPONENT]
        level = d[nominal.COULOMB] + d[nominal.VISCOUS] * rise
        width = d[at.ASYMMETRY_WIDTH]
        out += d[at.ASYMMETRY] * level * speed**2 / (speed**2 + width**2)
    return out


@compiled
def remembered_friction(sign: float, own: Array, d: Array) -> float:
    """Return the friction outside the catalogue that has a memory [N m]."""
    out = 0.0
    if d[at.MEMORY_TORQUE] != 0.0:
        ratio = abs(own[at.REMEMBERED_2]) / d[at.MEMORY_SPEED]
        out += d[at.MEMORY_TORQUE] * math.exp(-ratio) * sign
    if d[at.REST_TORQUE] != 0.0:
        rested = max(0.0, own[at.BOND]) / d[at.REST_TIME]
        out += d[at.REST_TORQUE] * (1.0 - math.exp(-(rested**0.6))) * sign
    return out


@compiled
def warmed(time: float, d: Array) -> float:
    """Return the factor of a drive that runs in, with two time constants."""
    fast = d[at.WARMING_SPLIT] * (1.0 - math.exp(-time / d[at.WARMING_FAST]))
    slow = (1.0 - d[at.WARMING_SPLIT]) * (1.0 - math.exp(-time / d[at.WARMING_SLOW]))
    factor: float = 1.0 - d[at.WARMING_SHARE] * (fast + slow)
    return factor


@compiled
def friction_with_forms(
    time: float, place: float, speed: float, load: float, own: Array, d: Array
) -> float:
    """Return the friction torque of one drive, against the motion [N m]."""
    sign = smooth_sign(speed, d[nominal.SIGN_WIDTH])
    dry: float = d[nominal.COULOMB] * dry_sign(speed, own, d)
    if d[at.PLACE_SHARE] != 0.0:
        dry *= 1.0 + d[at.PLACE_SHARE] * math.sin(
            TURN * place / d[at.PLACE_LENGTH] + d[at.PLACE_PHASE]
        )
    if d[at.BALL_SHARE] != 0.0:
        dry *= 1.0 + d[at.BALL_SHARE] * math.sin(
            TURN * place / d[at.BALL_PITCH] + d[at.BALL_PHASE]
        )
    viscous: float = d[nominal.VISCOUS] * speed
    if d[at.OIL_SHARE] != 0.0:
        viscous *= math.exp(-d[at.OIL_SHARE] * own[at.OIL])
    out = dry + viscous + speed_friction(speed, load, sign, d)
    out += remembered_friction(sign, own, d)
    if d[at.WARMING_SHARE] != 0.0:
        out *= warmed(time, d)
    return out
