# SPDX-License-Identifier: Apache-2.0
"""The forces in one drive, as the equations of motion ask for them.

A plant carries its law as a value. Whoever writes other physics of a drive gives another function
of this signature; columns and states of its own lie behind those of `layout`.
"""

from numba import float64, types
import numpy as np

from checks.reference import layout as at
from checks.reference.compiled import compiled, settled
from checks.reference.friction import friction_torque, internal_rates, rotor_torque
from checks.reference.transmission import carriage_force, gear_force, load_force, pull_of_arm

Array = np.ndarray[tuple[int, ...], np.dtype[np.float64]]

# What a law writes: torque on the rotor before friction [N m], friction torque [N m], force of the
# gear or of what hangs behind a rigid drive [N], its lever on the motor [1], and the force between
# frame and carriage beside it [N].
TORQUE, FRICTION, LOAD, LEVER, BESIDE, FORCES = range(6)

_ROW = types.Array(float64, 1, 'C')
# (time, held torque, share of it that the supply delivers, motion, shared, drive, states, rates,
# forces)
SIGNATURE = types.void(float64, float64, float64, _ROW, _ROW, _ROW, _ROW, _ROW, _ROW)
LAW = types.FunctionType(SIGNATURE)


@compiled
def drive_law(
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
    """Write the forces of a drive as the reference has them, and the rates of its states.

    Args:
        motion: (4,) motor position at the rail [m], its speed [m/s], and those of the carriage
            relative to the frame.
    """
    place, speed, rail_place, rail_speed = motion[0], motion[1], motion[2], motion[3]
    torque = rotor_torque(held, place, delivered, own, d)
    if d[at.BACK_EMF] != 0.0:
        torque -= d[at.BACK_EMF] * speed
    beside = carriage_force(rail_place, d)
    load, lever = 0.0, 1.0
    if shared[at.RIGID] == 0.0:
        load, lever = gear_force(place, speed, rail_place, rail_speed, d)
    elif d[at.LOAD_SHARE] > 0.0:
        load = load_force(place - rail_place, speed - rail_speed, d)
    elif d[at.LAW] == 2.0:
        # Friction by the load of a servo without a gear of its own.
        load = d[at.CARRIAGE_MASS] * shared[at.GRAVITY] + pull_of_arm(place, d) - beside
    friction = friction_torque(time, place, speed, load, torque, own, d)
    forces[TORQUE], forces[FRICTION] = torque, friction
    forces[LOAD], forces[LEVER] = load, lever
    forces[BESIDE] = beside
    if own.size > 0:
        internal_rates(speed, held, own, d, rates)


settled(drive_law, SIGNATURE)
