# SPDX-License-Identifier: Apache-2.0
"""A machine with its parameters as arrays, its rest position, and one simulated log of it."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

import numpy as np
from scipy.optimize import brentq

from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.reference import layout as at
from ros2_ident.reference import loop
from ros2_ident.reference.dynamics import mass_and_rods, project
from ros2_ident.reference.friction import rotor_torque
from ros2_ident.reference.transmission import carriage_force, gear_force

Array = np.ndarray[tuple[int, ...], np.dtype[np.float64]]
CommandFilter = Callable[[Array, Array, float], tuple[Array, Array]]
EffortFilter = Callable[[Array, float], Array]


@dataclass(frozen=True)
class Log:
    """What a simulated machine did, at every controller cycle.

    Attributes:
        names: Joint names of the drives.
        cycle: Controller cycle [s].
        effort: (D, K) logged effort, late by the measurement delay [N m, or N].
        position: (D, K) motor position at the rail [m].
        velocity: (D, K) its speed [m/s].
        torque: (D, K) the controllers' torque at its own instant [N m, or N].
        carriage: (D, K) carriage position in space [m].
        platform: (3, K) platform position [m]; zeros without a platform.
        frame: (K,) height of the frame [m].
        steps: Integration steps taken.
        rod_error: Largest error of a rod's length before it was corrected [m].
    """

    names: tuple[str, ...]
    cycle: float
    effort: Array
    position: Array
    velocity: Array
    torque: Array
    carriage: Array
    platform: Array
    frame: Array
    steps: int
    rod_error: float


@dataclass
class Plant:
    """A machine as the compiled functions see it, open to effects.

    Attributes:
        names: Joint names of the drives.
        shared: (SHARED_COLUMNS,) numbers of the machine.
        drive: (D, DRIVE_COLUMNS) numbers of the drives.
        delay: (D,) delay of the effort log [s].
        command_filters: What the set-point passes on its way to the controllers.
        effort_filters: What the torque passes on its way into the log.
        internals: Whether any effect has a state of its own.
        settled: False: the run starts as the nominal machine would rest, so that unmodelled loads make the
            controllers catch up in the first tenths of a second. True: the machine has stood long enough.
    """

    names: tuple[str, ...]
    shared: Array
    drive: Array
    delay: Array
    command_filters: list[CommandFilter] = field(default_factory=list)
    effort_filters: list[EffortFilter] = field(default_factory=list)
    internals: bool = False
    settled: bool = False


class Unmodelled(Protocol):
    """Something that changes a plant: an effect."""

    def apply(self, plant: Plant) -> None:
        """Write the effect into the plant."""


def section(machine: Any, key: str) -> Any:
    """Return a part of a machine: an attribute of a `Machine`, or an entry of a machine file's mapping."""
    if isinstance(machine, Mapping):
        return machine.get('machine' if key == 'kind' else key, {})
    return getattr(machine, key)


def value(
    name: str,
    drive: str,
    parameters: Mapping[str, float],
    constants: Mapping[str, Any],
    default: float | None = None,
) -> float:
    """Look a number up: the drive's own parameter, the shared one, the machine file's constant.

    Args:
        name: `gear_stiffness`.
        drive: `drive_1`.
        parameters: Parameters by name.
        constants: A section of the machine file.
        default: What it is where nobody says.

    Returns:
        The number, in SI units.

    Raises:
        IdentError: UNKNOWN_PARAMETER where it has no value.
    """
    for source, key in ((parameters, f'{drive}.{name}'), (parameters, name), (constants, name)):
        if key in source:
            return float(source[key])
    if default is None:
        raise IdentError(
            ErrorCode.UNKNOWN_PARAMETER,
            f'the reference needs a value of {name}; give {name} or {drive}.{name}',
        )
    return default


def known_names(
    parameters: Mapping[str, float], names: Sequence[str], known: Sequence[str]
) -> None:
    """Raise an IdentError (UNKNOWN_PARAMETER) where a parameter is not one that the machine has."""
    for key in parameters:
        head, _, tail = key.rpartition('.')
        if (tail or key) not in known or (head and head not in names):
            raise IdentError(
                ErrorCode.UNKNOWN_PARAMETER,
                f'parameter {key} is not one of this machine; it has {", ".join(known)}',
            )


def read_controller(plant: Plant, controller: Mapping[str, Any]) -> None:
    """Write the controller's constants of a machine file into a plant."""
    law = str(controller.get('law', 'cascade_pi'))
    if law not in ('cascade_pi', 'cascade_p'):
        raise IdentError(
            ErrorCode.BAD_MACHINE_FILE, f'controller.law is {law!r}; write cascade_pi or cascade_p'
        )
    plant.shared[at.LAW] = 1.0 if law == 'cascade_p' else 0.0
    plant.shared[at.CYCLE] = float(controller['cycle'])
    plant.drive[:, at.POSITION_GAIN] = float(controller['position_gain'])
    plant.drive[:, at.VELOCITY_GAIN] = float(controller['velocity_gain'])
    plant.drive[:, at.INTEGRAL_GAIN] = float(controller.get('integral_gain', 0.0))
    plant.drive[:, at.FEEDFORWARD] = float(controller.get('velocity_feedforward', 0.0))
    plant.drive[:, at.TORQUE_LIMIT] = float(controller['torque_limit'])


def platform_at(carriage: Array, drive: Array) -> Array:
    """Return where three rods carry the platform: the lower meeting point of three spheres [m].

    Args:
        carriage: (3,) carriage heights [m].
        drive: (3, DRIVE_COLUMNS) numbers of the drives.

    Returns:
        (3,) platform position [m].

    Raises:
        IdentError: BAD_VALUES where the rods do not reach.
    """
    feet = np.column_stack([drive[:, at.RAIL_X], drive[:, at.RAIL_Y], carriage])
    lengths = drive[:, at.ROD_LENGTH]
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
            f'the rods do not reach from the carriages {carriage}; keep closer set-points',
        )
    return np.asarray(base - np.sqrt(depth) * normal, dtype=float)


def static_loads(x: Array, plant: Plant) -> Array:
    """Return the gear forces that hold the machine still.

    Args:
        x: (n,) state with carriages and platform in place and no speed.
        plant: The machine.

    Returns:
        (D,) gear force, positive upwards [N].
    """
    shared, drive = plant.shared, plant.drive
    count = len(plant.names)
    gravity = shared[at.GRAVITY]
    rod = shared[at.ROD_MASS]
    load: Array = (drive[:, at.CARRIAGE_MASS] + rod * (1.0 - shared[at.ROD_CENTRE])) * gravity
    if shared[at.PLATFORM] == 1.0:
        m = 2 * count + 4
        matrix = np.zeros((m, m))
        mass_and_rods(0.0, x, shared, drive, matrix)
        weight = matrix[count, count] + count * rod * (
            shared[at.ROD_CENTRE] - shared[at.ROD_AT_PLATFORM]
        )
        # Platform: sum of mu_i (p - c_i) = weight; carriage i bears mu_i (c_i - p)_z on top of its own weight.
        pull = np.linalg.solve(
            matrix[count : count + 3, count + 4 :], np.array([0.0, 0.0, -weight * gravity])
        )
        load = load + np.array([matrix[count + 4 + i, i] * pull[i] for i in range(count)])
    for i in range(count):
        load[i] -= carriage_force(x[count + i], 0.0, 0.0, drive[i])
    return np.asarray(load, dtype=float)


def motor_ahead(rail: float, load: float, d: Array) -> float:
    """Return the motor position at which the gear carries a load at rest [m]."""

    def excess(place: float) -> float:
        return gear_force(place, 0.0, rail, 0.0, 0.0, d)[0] - load

    if excess(rail) == 0.0:
        return rail
    reach = (
        2.0 * abs(load) / d[at.STIFFNESS] + d[at.BACKLASH] + 3.0 * abs(d[at.ECCENTRICITY]) + 1e-9
    )
    while excess(rail - reach) * excess(rail + reach) > 0.0:
        reach *= 2.0
    return float(brentq(excess, rail - reach, rail + reach, xtol=1e-16, rtol=1e-15))


def carriages_at(plant: Plant, start: Array) -> Array:
    """Return the state with the carriages at given heights, the platform below them, and nothing moving.

    Args:
        plant: The machine.
        start: (D,) carriage heights [m].

    Returns:
        (n,) state; the motors stand with their carriages.
    """
    count = len(plant.names)
    m = 2 * count + 4
    x = np.zeros(2 * m + (count * at.INTERNALS if plant.internals else 0))
    x[:count] = x[count : 2 * count] = start
    if plant.shared[at.PLATFORM] == 1.0:
        x[2 * count : 2 * count + 3] = platform_at(np.asarray(start, dtype=float), plant.drive)
        project(0.0, x, plant.shared, plant.drive, np.empty((m, m)), np.empty(m))
    return x


def holding_torque(place: float, rail: float, load: float, plant: Plant, i: int) -> float:
    """Return the torque drive i's controller has to ask for to carry a load at rest [N m].

    Args:
        place: Motor position [m].
        rail: Carriage position [m].
        load: Gear force, or the load itself where the gear is rigid [N].
        plant: The machine.
        i: Index of the drive.

    Returns:
        Torque [N m].
    """
    d = plant.drive[i]
    lever = 1.0 if plant.shared[at.RIGID] == 1.0 else gear_force(place, 0.0, rail, 0.0, 0.0, d)[1]
    nothing = np.zeros(at.INTERNALS)
    idle = rotor_torque(0.0, place, 1.0, nothing, d)
    order = d[at.RIPPLE_ORDER] * d[at.GEAR] * place + 1.9 * d[at.RIPPLE_PHASE]
    gain = 1.0 + d[at.ACTUATOR_GAIN] + d[at.RIPPLE_CURRENT] * np.sin(order)
    return float((lever * load / d[at.GEAR] - idle) / gain)


def at_rest(plant: Plant, start: Array, nominal: Plant) -> tuple[Array, Array]:
    """Return state and controllers' memory of the machine at rest.

    The carriages stand where the set-point is, the motors ahead by what the gear yields under its load, the
    integral parts at the holding torque. Without an integral part the position error has to hold the load.

    Args:
        plant: The machine; the frame's preload is written into it.
        start: (D,) first set-point [m].
        nominal: The machine without effects, whose loads count where the plant is not settled.

    Returns:
        State (n,) and memory (D, MEMORY).
    """
    count = len(plant.names)
    shared, drive = plant.shared, plant.drive
    m = 2 * count + 4
    x = carriages_at(plant, start)
    memory = np.zeros((count, loop.MEMORY))
    true_load = static_loads(x, plant)
    load = true_load if plant.settled else static_loads(carriages_at(nominal, start), nominal)
    shared[at.FRAME_PRELOAD] = sum(
        true_load[i] + carriage_force(x[count + i], 0.0, 0.0, drive[i]) for i in range(count)
    )
    for i in range(count):
        d = drive[i]
        if shared[at.LAW] == 1.0:
            stiffness = d[at.GEAR] * d[at.VELOCITY_GAIN] * d[at.POSITION_GAIN]
            x[i] = x[count + i] = start[i] - load[i] / stiffness
        if shared[at.RIGID] == 0.0:
            x[i] = motor_ahead(x[count + i], load[i], d)
        hold = load[i] / d[at.GEAR]
        if plant.settled:
            hold = holding_torque(x[i], x[count + i], load[i], plant, i)
        memory[i, loop.INTEGRAL] = hold if shared[at.LAW] == 0.0 else 0.0
        memory[i, loop.LAST_TORQUE] = hold
        quantum = d[at.ENCODER_STEP]
        seen = quantum * np.floor(x[i] / quantum + 0.5) if quantum > 0.0 else x[i]
        memory[i, loop.SEEN : loop.SEEN_FILTERED + 1] = seen
        if plant.internals:
            own = x[2 * m + i * at.INTERNALS : 2 * m + (i + 1) * at.INTERNALS]
            own[at.CURRENT_A] = own[at.CURRENT_B] = hold
            own[at.REST] = 1.0
    return x, memory


def set_moving(plant: Plant, x: Array, memory: Array, start: tuple[Array, Array]) -> None:
    """Let the drives of a machine without a platform begin in motion.

    Args:
        plant: The machine.
        x: (n,) state at rest, changed in place.
        memory: (D, MEMORY) controllers' memory, changed in place: the readings before the first one are those
            of a steady motion.
        start: Positions [m] and speeds [m/s], each (D,).
    """
    count = len(plant.names)
    m = 2 * count + 4
    place, speed = (np.asarray(part, dtype=float) for part in start)
    way = speed * plant.shared[at.CYCLE]
    x[count : 2 * count] += place - x[:count]
    x[:count] = place
    x[m : m + count] = x[m + count : m + 2 * count] = speed
    memory[:, loop.SEEN] = place - way
    memory[:, loop.SEEN_FILTERED] = place - 1.5 * way
    memory[:, loop.SEEN_SPEED] = speed


def late(torque: Array, delay: Array, cycle: float) -> Array:
    """Return torques as they are logged: M(t - delay), linear between the controllers' instants.

    Args:
        torque: (D, K) torque [N m].
        delay: (D,) delay [s].
        cycle: Controller cycle [s].

    Returns:
        (D, K) logged torque; before the start it is the first one [N m].
    """
    instants = np.arange(torque.shape[1]) * cycle
    return np.stack(
        [np.interp(instants - delay[i], instants, torque[i]) for i in range(torque.shape[0])]
    )


def with_effects(nominal: Plant, effects: Sequence['Unmodelled']) -> Plant:
    """Return a copy of a machine with effects in it."""
    plant = replace(
        nominal,
        shared=nominal.shared.copy(),
        drive=nominal.drive.copy(),
        delay=nominal.delay.copy(),
        command_filters=list(nominal.command_filters),
        effort_filters=list(nominal.effort_filters),
    )
    for effect in effects:
        effect.apply(plant)
    return plant


def simulate(
    nominal: Plant,
    position: Array,
    velocity: Array,
    effects: Sequence['Unmodelled'] = (),
    rtol: float = 1e-11,
    atol: float = 1e-12,
    start: tuple[Array, Array] | None = None,
) -> Log:
    """Simulate one log.

    Args:
        nominal: The machine without effects.
        position: (D, K) set-point at every controller cycle [m].
        velocity: (D, K) its derivative [m/s].
        effects: What the machine has beside the nominal physics.
        rtol: Relative tolerance of an integration step.
        atol: Absolute tolerance of an integration step, in the unit of each state.
        start: Position [m] and speed [m/s] of the drives, each (D,), where the log begins in motion; only for
            machines without a platform.

    Returns:
        The log.

    Raises:
        IdentError: BAD_VALUES for set-points of the wrong shape or not finite, DIVERGED where the machine ran away.
    """
    plant = with_effects(nominal, effects)
    count = len(plant.names)
    target: Array = np.ascontiguousarray(position, dtype=float)
    target_speed: Array = np.ascontiguousarray(velocity, dtype=float)
    if (
        target.ndim != 2
        or target.shape[0] != count
        or target_speed.shape != target.shape
        or not target.shape[1]
    ):
        raise IdentError(
            ErrorCode.BAD_VALUES,
            f'set-points have the shapes {target.shape} and {target_speed.shape}; both have to be ({count}, cycles)',
        )
    if not (np.isfinite(target).all() and np.isfinite(target_speed).all()):
        raise IdentError(
            ErrorCode.BAD_VALUES, 'the set-point holds NaN or infinity; give finite values'
        )
    x, memory = at_rest(plant, target[:, 0], nominal)
    cycle = float(plant.shared[at.CYCLE])
    if start is not None:
        set_moving(plant, x, memory, start)
    for command_filter in plant.command_filters:
        target, target_speed = command_filter(target, target_speed, cycle)
    cycles = target.shape[1]
    m = 2 * count + 4
    torque: Array = np.zeros((count, cycles))
    states = np.zeros((cycles, 2 * m))
    tally = np.zeros(3)
    done = loop.run(
        target,
        target_speed,
        x,
        memory,
        plant.shared,
        plant.drive,
        rtol,
        atol,
        torque,
        states,
        tally,
    )
    if done < cycles or not np.isfinite(states).all():
        raise IdentError(
            ErrorCode.DIVERGED,
            f'the reference ran away after {done * cycle:.3f} s; use milder parameters',
        )
    effort: Array = torque
    for effort_filter in plant.effort_filters:
        effort = effort_filter(effort, cycle)
    motion: Array = np.ascontiguousarray(states.T)
    return Log(
        names=plant.names,
        cycle=cycle,
        effort=late(effort, plant.delay, cycle),
        position=motion[:count],
        velocity=motion[m : m + count],
        torque=torque,
        carriage=motion[count : 2 * count],
        platform=motion[2 * count : 2 * count + 3],
        frame=motion[m - 1],
        steps=int(tally[0]),
        rod_error=float(tally[2]),
    )
