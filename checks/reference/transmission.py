# SPDX-License-Identifier: Apache-2.0
"""Force of the elastic gear, and forces between frame and carriage, of one drive."""

import math

import numpy as np

from checks.reference import layout as at
from checks.reference.compiled import compiled

Array = np.ndarray[tuple[int, ...], np.dtype[np.float64]]


@compiled
def kinematic_error(place: float, d: Array) -> tuple[float, float]:
    """Return the transmission's kinematic error e(z) [m] and its slope e'(z)."""
    amplitude = d[at.ECCENTRICITY]
    if amplitude == 0.0:
        return 0.0, 0.0
    gear = d[at.GEAR]
    angle = gear * place + d[at.ECCENTRICITY_PHASE]
    return amplitude * math.sin(angle), amplitude * gear * math.cos(angle)


@compiled
def gear_force(
    place: float, speed: float, rail_place: float, rail_speed: float, d: Array
) -> tuple[float, float]:
    """Return the force that the gear passes to the carriage [N], and its lever on the motor [1].

    Nominal: F = c_G (z - s) + d_G (z' - s'). The lever is 1 + e'(z), so that the gear's ideal part
    passes power without loss.
    """
    error, slope = kinematic_error(place, d)
    lever = 1.0 + slope
    stretch = place + error - rail_place
    rate = lever * speed - rail_speed
    stiffness = d[at.STIFFNESS]
    damping = d[at.DAMPING]
    if d[at.STIFFNESS_SLOPE] != 0.0:
        stiffness *= 1.0 + d[at.STIFFNESS_SLOPE] * (rail_place - d[at.STIFFNESS_PLACE])
    if d[at.BACKLASH] == 0.0:
        return stiffness * stretch + damping * rate, lever
    depth = abs(stretch) - 0.5 * d[at.BACKLASH]
    if depth <= 0.0:
        return 0.0, lever
    return math.copysign(stiffness * depth, stretch) + damping * rate, lever


@compiled
def spring_of_load(d: Array) -> tuple[float, float]:
    """Return stiffness [N/m] and damping [N s/m] behind which a rigid drive's load hangs."""
    share = d[at.LOAD_SHARE]
    reduced = share * (1.0 - share) * (d[at.MOTOR_MASS] + d[at.CARRIAGE_MASS])
    rate = d[at.LOAD_RATE]
    return reduced * rate**2, 2.0 * d[at.LOAD_DAMPING] * reduced * rate


@compiled
def load_force(stretch: float, rate: float, d: Array) -> float:
    """Return the force that a rigid drive passes to its flexible load [N].

    Args:
        stretch: Motor position less the load's [m].
    """
    stiffness, damping = spring_of_load(d)
    force: float = stiffness * stretch * (1.0 + d[at.LOAD_HARDENING] * stretch**2) + damping * rate
    return force


@compiled
def carriage_force(rail_place: float, d: Array) -> float:
    """Return the force on the carriage beside the gear's [N]: offset, cable, end stops."""
    force: float = -d[at.CABLE_STIFFNESS] * (rail_place - d[at.CABLE_PLACE])
    force -= d[at.CONSTANT_FORCE]
    if d[at.STOP_STIFFNESS] != 0.0:
        reached = min(max(rail_place, d[at.STOP_LOWER]), d[at.STOP_UPPER])
        force += d[at.STOP_STIFFNESS] * (reached - rail_place)
    return force


@compiled
def pull_of_arm(place: float, d: Array) -> float:
    """Return the torque with which gravity pulls a servo's arm back [N m]."""
    if d[at.LOAD_MOMENT] == 0.0:
        return 0.0
    return float(d[at.LOAD_MOMENT] * math.sin(place - d[at.LOAD_ANGLE]))
