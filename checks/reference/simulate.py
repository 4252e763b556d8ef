# SPDX-License-Identifier: Apache-2.0
"""One simulated log: rest, closed loop, and what the log makes of the torque."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from checks.reference import layout as at
from checks.reference import loop
from checks.reference.compiled import settled
from checks.reference.plant import Array, Log, Plant, Unmodelled
from checks.reference.rest import at_rest, set_moving
from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.machine.machine import Machine


def late(torque: Array, delay: Array, cycle: float) -> Array:
    """Return torques as they are logged: M(t - delay), linear between the controllers' instants.

    Returns:
        (D, K) logged torque; before the start it is the first one [N m].
    """
    instants = np.arange(torque.shape[1]) * cycle
    return np.stack(
        [np.interp(instants - delay[i], instants, torque[i]) for i in range(torque.shape[0])]
    )


def with_effects(nominal: Plant, effects: Sequence[Unmodelled]) -> Plant:
    """Return a copy of a machine with effects in it."""
    plant = replace(
        nominal,
        shared=nominal.shared.copy(),
        drive=nominal.drive.copy(),
        delay=nominal.delay.copy(),
        command_filters=list(nominal.command_filters),
        effort_filters=list(nominal.effort_filters),
        log_filters=list(nominal.log_filters),
    )
    for effect in effects:
        effect.apply(plant)
    return plant


def simulate(
    nominal: Plant,
    position: Array,
    velocity: Array,
    effects: Sequence[Unmodelled] = (),
    rtol: float = 1e-11,
    atol: float = 1e-12,
    start: tuple[Array, Array] | None = None,
) -> Log:
    """Simulate one log.

    Args:
        start: Position [m] and speed [m/s] of the drives, each (D,), where the log begins in
            motion; only for machines without a platform.

    Raises:
        IdentError: BAD_VALUES for set-points of the wrong shape or not finite, DIVERGED where the
        machine ran away.
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
            f'set-points have the shapes {target.shape} and {target_speed.shape}; '
            f'both have to be ({count}, cycles)',
        )
    if not (np.isfinite(target).all() and np.isfinite(target_speed).all()):
        raise IdentError(
            ErrorCode.BAD_VALUES, 'the set-point holds NaN or infinity; give finite values'
        )
    # The weight of an arm depends on where it is.
    arms = (plant.drive[:, at.LOAD_MOMENT] != 0.0).any()
    begin = start[0] if start is not None and arms else target[:, 0]
    x, memory = at_rest(plant, begin, nominal)
    cycle = float(plant.shared[at.CYCLE])
    if start is not None:
        set_moving(plant, x, memory, start)
    for command_filter in plant.command_filters:
        target, target_speed = command_filter(target, target_speed, cycle)
    # The loop is compiled for arrays that may be written to.
    target, target_speed = np.array(target, order='C'), np.array(target_speed, order='C')
    cycles = target.shape[1]
    m = 2 * count + 4
    torque: Array = np.zeros((count, cycles))
    states = np.zeros((cycles, 2 * m))
    tally = np.zeros(3)
    settled(loop.run, loop.RUN)
    done = loop.run(
        plant.law,
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
            f'the reference diverged after {done * cycle:.3f} s; use milder parameters',
        )
    effort: Array = torque
    for effort_filter in plant.effort_filters:
        effort = effort_filter(effort, cycle)
    effort = late(effort, plant.delay, cycle)
    for log_filter in plant.log_filters:
        effort = log_filter(effort, cycle)
    motion: Array = np.ascontiguousarray(states.T)
    return Log(
        names=plant.names,
        cycle=cycle,
        effort=effort,
        position=motion[:count],
        velocity=motion[m : m + count],
        torque=torque,
        carriage=motion[count : 2 * count],
        platform=motion[2 * count : 2 * count + 3],
        frame=motion[m - 1],
        carriage_velocity=motion[m + count : m + 2 * count],
        platform_velocity=motion[m + 2 * count : m + 2 * count + 3],
        frame_velocity=motion[2 * m - 1],
        rod_error=float(tally[2]),
    )


def simulate_machine(
    plant_of: Callable[[Machine, Mapping[str, float]], Plant],
    machine: Machine,
    parameters: Mapping[str, float],
    position: Array,
    velocity: Array,
    effects: Sequence[Unmodelled] = (),
    rtol: float = 1e-11,
    atol: float = 1e-12,
    start: tuple[Array, Array] | None = None,
) -> Log:
    """Simulate a machine from its set-points.

    Args:
        start: Position and speed, each (D,), where the log begins in motion.

    Returns:
        The log; `carriage` holds what the drives move, carriages or arms, or the position that a
        servo's encoder sees, and `effort` is a force where the machine has no gear factor, a
        servo's duty.
    """
    return simulate(plant_of(machine, parameters), position, velocity, effects, rtol, atol, start)
