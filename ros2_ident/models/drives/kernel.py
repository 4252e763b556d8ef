# SPDX-License-Identifier: Apache-2.0
"""Drives that do not know of each other, a block of candidates at once: axes and servos.

Each drive moves one carriage, through a gear's spring or, rigid, as one mass with it. Integration
as in the tripod's kernel: Runge-Kutta of fourth order, its steps within a cycle chosen by
stiffness.

A servo is a drive that turns. What its controller asks is a share of the supply voltage, its
encoder sits behind the gear, and its load is an arm that gravity turns. `supply` is None for an
axis; nothing of a servo is compiled then.
"""
# mypy: ignore-errors

from ros2_ident.kernel import drive as dk
from ros2_ident.kernel import measurement
from ros2_ident.kernel import runge_kutta as rk
from ros2_ident.kernel.hooks import sources_digest
from ros2_ident.kernel.rows import DRIVE, DRIVE_COUNT, MACHINE, MACHINE_COUNT, MEMORY, MEMORY_COUNT
from ros2_ident.lanes import (
    absolute,
    any_lane,
    copied,
    inlined,
    kernel,
    load,
    parted,
    sine,
    spread,
    store,
    where,
    WIDTH,
)

W = WIDTH

# Coordinates of one drive.
MOTOR, CARRIAGE = 0, 1
COORDINATES = 2


def sizes(drives: int) -> tuple[int, int]:
    """Return how many numbers of a block go on from a part of the log to the next, and of room."""
    state = drives * (2 * COORDINATES + MEMORY_COUNT + measurement.KEPT)
    own = drives * (1 + measurement.MOTIONS) * measurement.PIECE + rk.STAGES * COORDINATES
    return W * state, W * (state + own + measurement.ROOM)


@inlined
def _weight(par, first, supply, s):
    """Return the force [N] with which gravity pulls a carriage at `s` back."""
    if supply is not None:
        return load(par, (first + DRIVE.load_moment) * W) * sine(
            s - load(par, (first + DRIVE.load_angle) * W)
        )
    return load(par, (first + DRIVE.rail_mass) * W) * load(par, MACHINE.gravity * W)


@inlined
def _rigid_force(par, first, mem, own, on, supply, z, v, time):
    """Return the force [N] on motor and carriage as one mass, without the motor's own torque."""
    weight = _weight(par, first, supply, z)
    return weight - dk.carriage_force(par, first, mem, own, on, z, v, z, time)


@inlined
def _gear(par, first, mem, on, supply, rigid, z, v, s, w, time):
    """Return where the carriage is, the force [N] on it and its reaction on the motor."""
    if rigid:
        force = _rigid_force(par, first, mem, 0, on, supply, z, v, time)
        return z, force, force
    force, back = dk.gear_force(par, first, mem, 0, on, z, v, s, w, time)
    return s, force, back


@inlined
def _energise(par, first, mem, duty, v, share):
    """Turn the share of the supply that was asked into a torque; return the effort that is logged.

    `duty` is what was asked but for effects, `v` the motor's rate [rad/s]. A `share` of 0 of the
    supply voltage is a motor that is switched off, and does not brake either.
    """
    asked = load(mem, MEMORY.commanded * W) * share
    store(mem, MEMORY.commanded * W, asked * load(par, (first + DRIVE.drive_gain) * W))
    braking = 1.0 if share > 0.0 else 0.0
    store(mem, MEMORY.braking * W, load(par, (first + DRIVE.back_emf) * W) * braking)
    speed = load(par, (first + DRIVE.log_speed) * W) * v
    return load(par, (first + DRIVE.log_duty) * W) * duty * share - speed * braking


@inlined
def _step(
    par, first, mem, on, supply, rigid, mode, acceleration, place, rate, bend, time, since, h
):
    """Integrate one drive over a step of `h` seconds that begins `since` seconds into a cycle."""
    held = spread(0.0)
    if mode == dk.CLOSED_LOOP and any_lane(dk.sticks(par, first)):
        z, v = load(place, MOTOR * W), load(rate, MOTOR * W)
        s, w = load(place, CARRIAGE * W), load(rate, CARRIAGE * W)
        now = time + since
        s, force, back = _gear(par, first, mem, on, supply, rigid, z, v, s, w, now)
        drag = spread(0.0) if supply is None else load(mem, MEMORY.braking * W)
        held = dk.holding(par, first, mem, 0, on, z, v, s, force, back, now, since, drag, h)
    for part in range(rk.STAGES):
        at = part * COORDINATES
        elapsed = since + rk.ahead(part) * h
        now = time + elapsed
        z, v = rk.stage_state(place, rate, bend, COORDINATES, MOTOR, part, h)
        if rigid:
            s = z
            force = _rigid_force(par, first, mem, 0, on, supply, z, v, now)
            back = force
        else:
            s, w = rk.stage_state(place, rate, bend, COORDINATES, CARRIAGE, part, h)
            force, back = dk.gear_force(par, first, mem, 0, on, z, v, s, w, now)
            rail = load(par, (first + DRIVE.rail_mass) * W)
            push = force + dk.carriage_force(par, first, mem, 0, on, z, v, s, now)
            if supply is not None:
                fall = _weight(par, first, supply, s) / rail
            else:
                fall = load(par, MACHINE.gravity * W)
            store(bend, (at + CARRIAGE) * W, push / rail - fall)
        if mode == dk.CLOSED_LOOP:
            torque = dk.motor_torque(par, first, mem, 0, on, z, v, s, force, now, elapsed, held)
            if supply is not None:
                torque = torque - load(mem, MEMORY.braking * W) * v
            store(bend, at * W, dk.motor_acceleration(par, first, mem, 0, torque, back))
        else:
            store(bend, at * W, spread(acceleration))
    rk.finish(place, rate, bend, COORDINATES, 1 if rigid else COORDINATES, h)


def _build(digest):
    @kernel
    def simulate(
        group, room, begin, end, command, motion, start, mode, on, supply, delayed, rigid, cycle,
        law, task,
    ):  # fmt: skip
        """Simulate blocks of candidates; arguments as in the tripod's kernel, but for these.

        Args:
            group: A `Group`, its state and `room` as large as `sizes` has it.
            command: (2 * D * K,) set-point positions of the drives, then their rates.
            motion: (3 * D * K,) recorded position, velocity and acceleration of prescribed motors,
                else empty.
            start: (2 * D,) where the motors start, then how fast.
            mode: (D,) CLOSED_LOOP or PRESCRIBED.
            on: (D,) flags of the effects.
            supply: (D * K,) share of the supply voltage at every cycle, 0 where a motor is
                switched off; None for axes, whose controllers ask for a torque.
            rigid: (D,) whether motor and carriage are one mass.
        """
        _ = digest
        blocks, rows, substeps, state = group
        drives = mode.shape[0]
        count = task.wanted.shape[2]
        going = room[: state.shape[1]]
        all_place, more = parted(room, drives * COORDINATES)
        all_rate, more = parted(more, drives * COORDINATES)
        all_mem, more = parted(more, drives * MEMORY_COUNT)
        kept, rest = parted(more, drives * measurement.KEPT)
        bend, rest = parted(rest, rk.STAGES * COORDINATES)
        torques, rest = parted(rest, drives * measurement.PIECE)
        rest, moves = parted(rest, measurement.ROOM)
        own = COORDINATES * W
        mine = MEMORY_COUNT * W
        zero = spread(0.0)
        for g in range(blocks.shape[0]):
            par = blocks[g]
            # Divided here, not in every cycle.
            quick = cycle / load(substeps[g], 0)
            slow = cycle / load(substeps[g], W)
            # Another group's may hold NaN, which a factor of zero would not take away.
            bend[:] = 0.0
            if begin > 0:
                copied(state[g], going)
            else:
                going[:] = 0.0
                for d in range(drives):
                    first = MACHINE_COUNT + d * DRIVE_COUNT
                    place = all_place[d * own : (d + 1) * own]
                    rate = all_rate[d * own : (d + 1) * own]
                    mem = all_mem[d * mine : (d + 1) * mine]
                    at = spread(start[d])
                    v = spread(start[drives + d])
                    constant = load(par, (first + DRIVE.constant_load) * W)
                    hold = _weight(par, first, supply, at) + constant
                    if mode[d] == dk.CLOSED_LOOP and start[drives + d] == 0.0:
                        at = at - dk.sag(par, first, law[d], hold)
                    stretch = zero
                    if not rigid[d]:
                        far = 0.0 if supply is None else 1.0
                        stretch = dk.stand(par, first, mem, 0, on[d], at, hold, far) - at
                    z = at + stretch if mode[d] == dk.CLOSED_LOOP else at
                    store(place, MOTOR * W, z)
                    store(rate, MOTOR * W, v)
                    store(place, CARRIAGE * W, z - stretch)
                    store(rate, CARRIAGE * W, v)
                    moved = load(par, (first + DRIVE.motor_mass) * W)
                    if rigid[d]:
                        moved = moved + load(par, (first + DRIVE.rail_mass) * W)
                    store(mem, MEMORY.lightness * W, 1.0 / moved)
                    dk.begin(mem, 0, law[d], z, v, cycle, dk.at_motor(par, first, hold))
            for begun in range(begin, end, measurement.PIECE):
                cycles = min(measurement.PIECE, end - begun)
                for d in range(drives):
                    first = MACHINE_COUNT + d * DRIVE_COUNT
                    flags = on[d]
                    one = rigid[d]
                    place = all_place[d * own : (d + 1) * own]
                    rate = all_rate[d * own : (d + 1) * own]
                    mem = all_mem[d * mine : (d + 1) * mine]
                    for piece in range(cycles):
                        k = begun + piece
                        time = spread(k * cycle)
                        acceleration = 0.0
                        z = load(place, MOTOR * W)
                        v = load(rate, MOTOR * W)
                        fast = absolute(v) > dk.fast_from(par, first)
                        if mode[d] == dk.CLOSED_LOOP:
                            turning = v
                            if supply is not None and not one:
                                z = load(place, CARRIAGE * W)
                                v = load(rate, CARRIAGE * W)
                            torque = dk.control(
                                par, first, mem, 0, flags, law[d], cycle, z, v,
                                command, d, drives, count, k, delayed, time, None, cycle, None,
                            )  # fmt: skip
                            if supply is not None:
                                share = supply[d * count + k]
                                torque = _energise(par, first, mem, torque, turning, share)
                        else:
                            acceleration = motion[(2 * drives + d) * count + k]
                            z = spread(motion[d * count + k])
                            v = spread(motion[(drives + d) * count + k])
                            store(place, MOTOR * W, z)
                            store(rate, MOTOR * W, v)
                            s, w = load(place, CARRIAGE * W), load(rate, CARRIAGE * W)
                            s, force, back = _gear(
                                par, first, mem, flags, supply, one, z, v, s, w, time
                            )
                            mass = load(par, (first + DRIVE.motor_mass) * W)
                            if one:
                                mass = mass + load(par, (first + DRIVE.rail_mass) * W)
                            torque = dk.prescribed_torque(
                                par, first, mem, 0, flags, z, v, s, mass, acceleration, force,
                                back, time,
                            )  # fmt: skip
                        store(torques, (d * measurement.PIECE + piece) * W, torque)
                        if task.wanted.shape[0] > 1:
                            store(moves, (d * measurement.PIECE + piece) * W, z)
                            store(moves, ((drives + d) * measurement.PIECE + piece) * W, v)
                        steps = where(fast, load(substeps[g], 0), load(substeps[g], W))
                        whole = where(fast, quick, slow)
                        sub = 0.0
                        active = steps > zero
                        while any_lane(active):
                            # A lane that is through makes steps of no length.
                            h = where(active, whole, zero)
                            _step(
                                par, first, mem, flags, supply, one, mode[d], acceleration,
                                place, rate, bend, time, sub * whole, h,
                            )  # fmt: skip
                            z, v = load(place, MOTOR * W), load(rate, MOTOR * W)
                            dk.keep_step(par, first, mem, 0, flags, z, v, active)
                            sub += 1.0
                            active = steps > spread(sub)
                        dk.keep_cycle(par, first, mem, 0, flags, z, v, z, time, cycle)
                if measurement.hand_on(
                    par, torques, moves, begun, cycles, cycle, task, rows[g], kept, rest
                ):
                    break
            copied(going, state[g])
            if end == count:
                measurement.conclude(par, going[: 2 * drives * own], task, rows[g], kept)

    return simulate


simulate = _build(sources_digest())
