# SPDX-License-Identifier: Apache-2.0
"""Where a machine rests: platform below its rods, gears under their load, controllers holding."""

import numpy as np
from scipy.optimize import brentq

from checks.reference import layout as at
from checks.reference import loop
from checks.reference.drive_law import BESIDE, FORCES, LEVER, LOAD, TORQUE
from checks.reference.dynamics import joint, mass_and_rods, project, weight_of_drive
from checks.reference.plant import Array, Plant
from checks.reference.transmission import pull_of_arm, spring_of_load
from ros2_ident.errors import ErrorCode, IdentError


def platform_at(carriage: Array, shared: Array, drive: Array) -> Array:
    """Return where rods carry the platform (3,): the lower meeting point of three spheres [m].

    Args:
        carriage: (3,) carriage heights [m], or angles of arms [rad].

    Raises:
        IdentError: BAD_VALUES where the rods do not reach.
    """
    places = np.empty((3, 3, 3))
    for i in range(3):
        joint(i, float(carriage[i]), shared, drive, places[i])
    return meeting_point(places[:, 0], drive[:, at.ROD_LENGTH])


def meeting_point(feet: Array, lengths: Array) -> Array:
    """Return the lower meeting point of three spheres (3,) [m].

    Args:
        feet: (3, 3) their middles [m].
        lengths: (3,) their radii [m].

    Raises:
        IdentError: BAD_VALUES where they do not meet.
    """
    across = feet[1:] - feet[0]
    level = 0.5 * (
        np.sum(feet[1:] ** 2, axis=1) - feet[0] @ feet[0] - lengths[1:] ** 2 + lengths[0] ** 2
    )
    normal = np.cross(across[0], across[1])
    normal *= np.sign(normal[2]) / np.linalg.norm(normal)
    base = np.linalg.solve(np.vstack([across, normal]), np.append(level, normal @ feet[0]))
    depth = lengths[0] ** 2 - np.sum((base - feet[0]) ** 2)
    if not depth > 0.0:
        raise IdentError(
            ErrorCode.BAD_VALUES,
            f'the rods do not reach from joints at {feet.tolist()}; keep closer set-points',
        )
    return np.asarray(base - np.sqrt(depth) * normal, dtype=float)


def still(plant: Plant, i: int, place: float, rail: float, held: float = 0.0) -> Array:
    """Return (FORCES,) the forces in drive i while nothing moves, see `drive_law`.

    Args:
        held: The controller's torque [N m].
    """
    forces, own = np.zeros(FORCES), np.zeros(plant.internals)
    if plant.internals:
        own[list(plant.torques)] = held
    motion = np.array([place, 0.0, rail, 0.0])
    rates = np.zeros_like(own)
    plant.law(0.0, held, 1.0, motion, plant.shared, plant.drive[i], own, rates, forces)
    return forces


def static_loads(x: Array, plant: Plant) -> Array:
    """Return the gear forces (D,) that hold the machine still, positive upwards [N].

    Args:
        x: (n,) state with carriages and platform in place and no speed.
    """
    shared, drive = plant.shared, plant.drive
    count = len(plant.names)
    gravity = shared[at.GRAVITY]
    rod = shared[at.ROD_MASS]
    own = [weight_of_drive(i, x[count + i], shared, drive) for i in range(count)]
    load: Array = gravity * np.array(own)
    load = load + [pull_of_arm(x[count + i], drive[i]) for i in range(count)]
    if shared[at.PLATFORM] == 1.0:
        m = 2 * count + 4
        matrix = np.zeros((m, m))
        mass_and_rods(0.0, x, shared, drive, matrix)
        weight = matrix[count, count] + count * rod * (
            shared[at.ROD_CENTRE] - shared[at.ROD_AT_PLATFORM]
        )
        # Platform: sum of mu_i (p - c_i) = weight; carriage i bears mu_i (c_i - p)_z besides.
        pull = np.linalg.solve(
            matrix[count : count + 3, count + 4 :], np.array([0.0, 0.0, -weight * gravity])
        )
        load = load + np.array([matrix[count + 4 + i, i] * pull[i] for i in range(count)])
    for i in range(count):
        load[i] -= still(plant, i, x[count + i], x[count + i])[BESIDE]
    return np.asarray(load, dtype=float)


def motor_ahead(plant: Plant, i: int, rail: float, load: float) -> float:
    """Return the motor position at which the gear of drive i carries a load at rest [m]."""
    d = plant.drive[i]

    def excess(place: float) -> float:
        return float(still(plant, i, place, rail)[LOAD] - load)

    if excess(rail) == 0.0:
        return rail
    reach = (
        2.0 * abs(load) / d[at.STIFFNESS] + d[at.BACKLASH] + 3.0 * abs(d[at.ECCENTRICITY]) + 1e-9
    )
    while excess(rail - reach) * excess(rail + reach) > 0.0:
        reach *= 2.0
    return float(brentq(excess, rail - reach, rail + reach, xtol=1e-16, rtol=1e-15))


def carriages_at(plant: Plant, start: Array) -> Array:
    """Return the state with the carriages at given heights and nothing moving.

    Args:
        start: (D,) carriage heights [m].

    Returns:
        (n,) state; the motors stand with their carriages.
    """
    count = len(plant.names)
    m = 2 * count + 4
    x = np.zeros(2 * m + count * plant.internals)
    x[:count] = x[count : 2 * count] = start
    shared = plant.shared
    if shared[at.PLATFORM] == 1.0:
        x[2 * count : 2 * count + 3] = platform_at(
            np.asarray(start, dtype=float), shared, plant.drive
        )
        project(0.0, x, shared, plant.drive, np.empty((m, m)), np.empty(m))
    return x


def holding_torque(place: float, rail: float, load: float, plant: Plant, i: int) -> float:
    """Return the torque drive i's controller has to ask for to carry a load at rest [N m].

    Args:
        load: Gear force, or the load itself where the gear is rigid [N].
    """
    d = plant.drive[i]
    rest = still(plant, i, place, rail)
    lever, idle = float(rest[LEVER]), float(rest[TORQUE])
    return float((lever * load / d[at.GEAR] - idle) / (1.0 + d[at.ACTUATOR_GAIN]))


def _on_frame(plant: Plant, x: Array, load: Array) -> float:
    """Return what the machine rests on its frame [N]; arms count with the frame.

    Args:
        x: (n,) state at rest.
        load: (D,) gear forces, or torques, at rest.
    """
    count, shared = len(plant.names), plant.shared
    if shared[at.ROTARY] == 1.0:
        return float(shared[at.GRAVITY] * (shared[at.TOOL_MASS] + count * shared[at.ROD_MASS]))
    beside = [still(plant, i, x[count + i], x[count + i])[BESIDE] for i in range(count)]
    return float(sum(load[i] + beside[i] for i in range(count)))


def at_rest(plant: Plant, start: Array, nominal: Plant) -> tuple[Array, Array]:
    """Return state (n,) and controllers' memory (D, MEMORY) of the machine at rest.

    The carriages stand where the set-point is, the motors ahead by what the gear yields under its
    load, the integral parts at the holding torque. Without an integral part the position error has
    to hold the load.

    Args:
        plant: The machine; the frame's preload is written into it.
        start: (D,) first set-point [m].
        nominal: The machine without effects, whose loads count where the plant is not settled.
    """
    count = len(plant.names)
    shared, drive = plant.shared, plant.drive
    m = 2 * count + 4
    x = carriages_at(plant, start)
    memory = np.zeros((count, loop.MEMORY))
    true_load = static_loads(x, plant)
    load = true_load if plant.settled else static_loads(carriages_at(nominal, start), nominal)
    shared[at.FRAME_PRELOAD] = _on_frame(plant, x, true_load)
    without = drive[:, at.LAW] == 1.0
    if without.any():
        gains = drive[:, at.GEAR] * drive[:, at.VELOCITY_GAIN] * drive[:, at.POSITION_GAIN]
        # The platform sinks with what carries it, or the rods would pull it down at once.
        x = carriages_at(plant, start - np.where(without, load / gains, 0.0))
    for i in range(count):
        d = drive[i]
        if shared[at.RIGID] == 0.0:
            x[i] = motor_ahead(plant, i, x[count + i], load[i])
        elif d[at.LOAD_SHARE] > 0.0:
            # The motor bears its own share of a weight, the spring the rest.
            borne = (1.0 - d[at.LOAD_SHARE]) * d[at.CARRIAGE_MASS] * shared[at.GRAVITY]
            x[count + i] = x[i] - (load[i] - borne) / spring_of_load(d)[0]
        hold = load[i] / d[at.GEAR]
        if plant.settled:
            hold = holding_torque(x[i], x[count + i], load[i], plant, i)
        memory[i, loop.INTEGRAL] = hold if d[at.LAW] == 0.0 else 0.0
        quantum = d[at.ENCODER_STEP]
        seen = quantum * np.floor(x[i] / quantum + 0.5) if quantum > 0.0 else x[i]
        memory[i, [loop.SEEN, loop.SEEN_FILTERED]] = seen
        memory[i, loop.SEEN_ERROR] = seen - x[i]
        if plant.internals:
            own = x[2 * m + i * plant.internals : 2 * m + (i + 1) * plant.internals]
            own[list(plant.torques)] = hold
    return x, memory


def set_moving(plant: Plant, x: Array, memory: Array, start: tuple[Array, Array]) -> None:
    """Let the drives of a machine without a platform begin in motion.

    Args:
        memory: (D, MEMORY) controllers' memory, changed in place: the readings before the first
            one are those of a steady motion.
        start: Positions [m] and speeds [m/s], each (D,).
    """
    count = len(plant.names)
    m = 2 * count + 4
    place, speed = (np.asarray(part, dtype=float) for part in start)
    way = speed * plant.shared[at.CYCLE]
    # Where a drive is says its encoder, which a servo has behind the gear.
    behind = plant.drive[:, at.LAW] == 2.0
    shift = place - np.where(behind, x[count : 2 * count], x[:count])
    x[:count] += shift
    x[count : 2 * count] += shift
    x[:count][~behind] = place[~behind]
    x[m : m + count] = x[m + count : m + 2 * count] = speed
    memory[:, loop.SEEN] = place - way
    memory[:, loop.SEEN_FILTERED] = place - 1.5 * way
