# SPDX-License-Identifier: Apache-2.0
"""The forces in one drive with every form in it, in place of `reference.drive_law`."""

import numpy as np

from checks.blind.forms import columns as at
from checks.blind.forms.compiled import compiled
from checks.blind.forms.force_law import beside_with_forms, gear_with_forms, rotor_with_forms
from checks.blind.forms.friction_law import bristle_rates, friction_with_forms
from checks.reference import layout as nominal
from checks.reference.compiled import settled
from checks.reference.drive_law import BESIDE, FRICTION, LEVER, LOAD, SIGNATURE, TORQUE
from checks.reference.plant import Plant
from checks.reference.transmission import load_force

Array = np.ndarray[tuple[int, ...], np.dtype[np.float64]]


@compiled
def rates_with_forms(
    speed: float, rail_speed: float, held: float, friction: float, d: Array, own: Array,
    rates: Array,
) -> None:  # fmt: skip
    """Write the rates of a drive's states."""
    rates[:] = 0.0
    if d[at.BRISTLE_KIND] != 0.0:
        bristle_rates(speed, own, d, rates)
    if d[at.CURRENT_RATE] > 0.0:
        rate = d[at.CURRENT_RATE]
        rates[at.CURRENT] = own[at.CURRENT_SPEED]
        rates[at.CURRENT_SPEED] = (
            rate**2 * (held - own[at.CURRENT])
            - 2.0 * d[at.CURRENT_DAMPING] * rate * own[at.CURRENT_SPEED]
        )
    if d[at.OIL_SHARE] != 0.0:
        power = abs(friction * speed * d[nominal.GEAR]) / d[at.OIL_POWER]
        rates[at.OIL] = (power - own[at.OIL]) / d[at.OIL_TIME]
    if d[at.MEMORY_TORQUE] != 0.0:
        lag = 0.5 * d[at.MEMORY_TIME]
        rates[at.REMEMBERED_1] = (speed - own[at.REMEMBERED_1]) / lag
        rates[at.REMEMBERED_2] = (own[at.REMEMBERED_1] - own[at.REMEMBERED_2]) / lag
    if d[at.REST_TORQUE] != 0.0:
        still = np.exp(-((speed / 1.5e-3) ** 2))
        rates[at.BOND] = still - abs(speed) / d[at.REST_WAY] * own[at.BOND]
    if d[at.HUNG_MASS] != 0.0:
        rate, across = d[at.HUNG_RATE], own[at.HUNG_SPEED] - rail_speed
        rates[at.HUNG] = across
        rates[at.HUNG_SPEED] = -(rate**2) * own[at.HUNG] - 2.0 * d[at.HUNG_DAMPING] * rate * across
    if d[at.COPPER_SHARE] != 0.0:
        heat = (held / d[at.COPPER_TORQUE]) ** 2
        rates[at.COPPER] = (heat - own[at.COPPER]) / d[at.COPPER_TIME]


@compiled
def law_with_forms(
    time: float,
    held: float,
    delivered: float,
    motion: Array,
    shared: Array,
    d: Array,
    own: Array,
    rates: Array,
    forces: Array,
) -> None:
    """Write forces and rates of a drive; arguments as of `reference.drive_law.drive_law`."""
    place, speed, rail_place, rail_speed = motion[0], motion[1], motion[2], motion[3]
    load, lever = 0.0, 1.0
    if shared[nominal.RIGID] == 0.0:
        load, lever = gear_with_forms(place, speed, rail_place, rail_speed, d)
    elif d[nominal.LOAD_SHARE] > 0.0:
        load = load_force(place - rail_place, speed - rail_speed, d)
    friction = friction_with_forms(time, place, speed, load, own, d)
    forces[TORQUE] = rotor_with_forms(held, place, delivered, own, d)
    forces[FRICTION] = friction
    forces[LOAD], forces[LEVER] = load, lever
    forces[BESIDE] = beside_with_forms(
        time, rail_place, rail_speed, shared[nominal.GRAVITY], own, d
    )
    rates_with_forms(speed, rail_speed, held, friction, d, own, rates)


def take_law(plant: Plant) -> None:
    """Give a plant this law, with room for its columns and states."""
    if plant.law is law_with_forms:
        return
    settled(law_with_forms, SIGNATURE)
    room = np.zeros((len(plant.names), at.COLUMNS))
    plant.drive = np.hstack([plant.drive, room])
    plant.law = law_with_forms
    plant.internals = at.STATES
    plant.torques = (*plant.torques, at.CURRENT)
