# SPDX-License-Identifier: Apache-2.0
"""Gear, motor and carriage of one drive with the forms in them; sources stand with the forms."""

import math

import numpy as np

from checks.blind.forms import columns as at
from checks.blind.forms.compiled import compiled
from checks.reference import layout as nominal

Array = np.ndarray[tuple[int, ...], np.dtype[np.float64]]

TURN = 2.0 * math.pi
STEEPEST = 3.0  # 1/m


@compiled
def wave(angle: float, first: int, d: Array) -> tuple[float, float]:
    """Return three harmonics of an angle, and their derivative by it.

    Args:
        angle: Of the fundamental [rad].
        first: Column of its phase; behind it share and phase of the second and third harmonic.
    """
    value = math.sin(angle + d[first])
    slope = math.cos(angle + d[first])
    for number in range(2, 4):
        share, phase = d[first + 2 * number - 3], d[first + 2 * number - 2]
        value += share * math.sin(number * angle + phase)
        slope += number * share * math.cos(number * angle + phase)
    return value, slope


@compiled
def stiffness_factor(place: float, rail_place: float, d: Array) -> float:
    """Return by what a belt's two spans and its teeth change the gear's stiffness."""
    out = 1.0
    slope = d[at.SPAN_SLOPE]
    if slope != 0.0:
        lower, upper = d[at.SPAN_LOWER], d[at.SPAN_UPPER]
        # Shares of the spans that give the steepest slope at the place; the belt's part of the
        # gear makes it what it is.
        steepest = math.copysign(STEEPEST, slope)
        share = (1.0 / upper - steepest) / (1.0 / lower + 1.0 / upper)
        away = rail_place - d[at.SPAN_PLACE]
        away = min(0.7 * upper, max(-0.7 * lower, away))
        spans = share * lower / (lower + away) + (1.0 - share) * upper / (upper - away)
        out += slope / steepest * (spans - 1.0)
    if d[at.MESH_SHARE] != 0.0:
        out *= 1.0 + d[at.MESH_SHARE] * math.sin(
            TURN * place / d[at.MESH_PITCH] + d[at.MESH_PHASE]
        )
    return out


@compiled
def contact(stretch: float, rate: float, stiffness: float, damping: float, d: Array) -> float:
    """Return the force of a gear with play [N]."""
    gap: float = d[at.GAP]
    half = 0.5 * gap
    if d[at.GAP_KIND] == 2.0:
        ground = d[at.GAP_SHAPE] * gap
        right, left = math.hypot(stretch - half, ground), math.hypot(stretch + half, ground)
        share: float = 1.0 + 0.5 * ((stretch - half) / right - (stretch + half) / left)
        return stiffness * (stretch + 0.5 * (right - left)) + damping * share * rate
    depth = abs(stretch) - half
    if depth <= 0.0:
        return 0.0
    side = math.copysign(1.0, stretch)
    damping *= min(1.0, depth / (d[at.GAP_SHAPE] * gap))
    return side * max(0.0, stiffness * depth + damping * rate * side)


@compiled
def gear_with_forms(
    place: float, speed: float, rail_place: float, rail_speed: float, d: Array
) -> tuple[float, float]:
    """Return the gear's force on the carriage [N] and its lever on the motor."""
    error, lever = 0.0, 1.0
    if d[at.ERROR_LENGTH] != 0.0:
        value, slope = wave(d[nominal.GEAR] * place, at.ERROR_PHASE, d)
        error = d[at.ERROR_LENGTH] * value
        lever += d[at.ERROR_LENGTH] * d[nominal.GEAR] * slope
    stretch = place + error - rail_place
    rate = lever * speed - rail_speed
    stiffness = d[nominal.STIFFNESS] * stiffness_factor(place, rail_place, d)
    if d[at.GAP] > 0.0:
        return contact(stretch, rate, stiffness, d[nominal.DAMPING], d), lever
    return stiffness * stretch + d[nominal.DAMPING] * rate, lever


@compiled
def rotor_with_forms(held: float, place: float, delivered: float, own: Array, d: Array) -> float:
    """Return the torque on the rotor before friction [N m]."""
    torque: float = own[at.CURRENT] if d[at.CURRENT_RATE] > 0.0 else held
    torque *= 1.0 - d[at.FLUX_SHARE] - d[at.FLUX_SATURATION] * abs(torque)
    torque *= delivered * (1.0 - d[at.COPPER_SHARE] * own[at.COPPER])
    if d[at.COGGING] != 0.0:
        angle = d[at.COGGING_ORDER] * d[nominal.GEAR] * place
        torque += d[at.COGGING] * wave(angle, at.COGGING_PHASE, d)[0]
    return torque


@compiled
def beside_with_forms(
    time: float, rail_place: float, rail_speed: float, gravity: float, own: Array, d: Array
) -> float:
    """Return the force between frame and carriage beside the gear's [N]."""
    force: float = -d[nominal.CONSTANT_FORCE]
    if d[at.HOSE_STIFFNESS] != 0.0:
        length = d[at.HOSE_LENGTH]
        stretch = (rail_place - d[at.HOSE_PLACE]) / length
        force -= d[at.HOSE_STIFFNESS] * length * (math.exp(stretch) - 1.0)
    if d[at.GAS_FORCE] != 0.0:
        length = d[at.GAS_LENGTH]
        left = max(0.2 * length, length - (rail_place - d[at.GAS_PLACE]))
        force -= d[at.GAS_FORCE] * (length / left) ** d[at.GAS_EXPONENT]
    if d[at.STOP_STIFFNESS] != 0.0:
        depth = rail_place - d[at.STOP_PLACE]
        if depth > 0.0:
            pressed = d[at.STOP_STIFFNESS] * depth**1.5
            force -= max(0.0, pressed * (1.0 + d[at.STOP_DAMPING] * rail_speed))
    if d[at.HUNG_MASS] != 0.0:
        rate = d[at.HUNG_RATE]
        pull = rate**2 * own[at.HUNG]
        pull += 2.0 * d[at.HUNG_DAMPING] * rate * (own[at.HUNG_SPEED] - rail_speed)
        force += d[at.HUNG_MASS] * (pull - gravity)
    if d[at.SHAKE_FORCE] != 0.0:
        force += d[at.SHAKE_FORCE] * math.sin(d[at.SHAKE_RATE] * time + d[at.SHAKE_PHASE])
    return force
