# SPDX-License-Identifier: Apache-2.0
"""Linear axes that do not know of each other, a block of candidates at once.

Each drive moves one carriage, through a gear's spring or, rigid, as one mass with it. Integration
as in the tripod's kernel: Runge-Kutta of fourth order, its steps within a cycle chosen by
stiffness.
"""
# mypy: ignore-errors

from ros2_ident.kernel import drive as dk
from ros2_ident.kernel import loop, measurement
from ros2_ident.kernel import runge_kutta as rk
from ros2_ident.kernel.hooks import sources_digest
from ros2_ident.kernel.rows import DRIVE_COUNT, MACHINE_COUNT, MEMORY_COUNT, row_of
from ros2_ident.lanes import (
    absolute,
    any_lane,
    inlined,
    kernel,
    load,
    parted,
    spread,
    store,
    where,
    WIDTH,
)

W = WIDTH
GRAVITY = row_of('gravity')

# Coordinates of one drive.
MOTOR, CARRIAGE = 0, 1
COORDINATES = 2


def state_for(drives: int) -> int:
    """Return how many numbers of each block go on from a part of the log to the next."""
    own = 2 * COORDINATES + MEMORY_COUNT + measurement.KEPT
    return W * (drives * own + rk.STAGES * COORDINATES)


def room_for(drives: int) -> int:
    """Return how many numbers of room the kernel needs for so many drives."""
    own = drives * (1 + measurement.MOTIONS) * measurement.PIECE + 1 + measurement.ROOM
    return state_for(drives) + W * own


@inlined
def _rigid_force(par, first, mem, own, on, z, v, time):
    """Return the force [N] on motor and carriage as one mass, without the motor's own torque."""
    weight = load(par, (first + dk.RAIL_MASS) * W) * load(par, GRAVITY * W)
    return weight - dk.carriage_force(par, first, mem, own, on, z, v, z, time)


@inlined
def _step(par, first, mem, on, rigid, mode, acceleration, place, rate, bend, time, since, h):
    """Integrate one drive over a step of `h` seconds that begins `since` seconds into a cycle."""
    for part in range(rk.STAGES):
        at = part * COORDINATES
        elapsed = since + rk.ahead(part) * h
        now = time + elapsed
        z, v = rk.stage_state(place, rate, bend, COORDINATES, MOTOR, part, h)
        if rigid:
            s = z
            force = _rigid_force(par, first, mem, 0, on, z, v, now)
            back = force
        else:
            s, w = rk.stage_state(place, rate, bend, COORDINATES, CARRIAGE, part, h)
            force, back = dk.gear_force(par, first, mem, 0, on, z, v, s, w, now)
            rail = load(par, (first + dk.RAIL_MASS) * W)
            push = force + dk.carriage_force(par, first, mem, 0, on, z, v, s, now)
            store(bend, (at + CARRIAGE) * W, push / rail - load(par, GRAVITY * W))
        if mode == dk.CLOSED_LOOP:
            torque = dk.motor_torque(par, first, mem, 0, on, z, v, s, force, now, elapsed)
            store(bend, at * W, dk.motor_acceleration(par, first, mem, 0, torque, back))
        else:
            store(bend, at * W, spread(acceleration))
    rk.finish(place, rate, bend, COORDINATES, 1 if rigid else COORDINATES, h)


@inlined
def _start(
    par, cycle, count, all_place, all_rate, all_mem, bend, torques, moves, command, motion,
    start, mode, on, delayed, rigid, law, moving,
):  # fmt: skip
    """Put the motors where they start; see `loop.simulate`."""
    drives = mode.shape[0]
    own = COORDINATES * W
    mine = MEMORY_COUNT * W
    zero = spread(0.0)
    for d in range(drives):
        first = MACHINE_COUNT + d * DRIVE_COUNT
        place = all_place[d * own : (d + 1) * own]
        rate = all_rate[d * own : (d + 1) * own]
        mem = all_mem[d * mine : (d + 1) * mine]
        at = spread(start[d])
        v = spread(start[drives + d])
        hold = load(par, (first + dk.RAIL_MASS) * W) * load(par, GRAVITY * W)
        stretch = zero
        if not rigid[d]:
            mem = all_mem[d * mine : (d + 1) * mine]
            flags = dk.flags_of(on, d)
            stretch = dk.stand(par, first, mem, 0, flags, at, hold) - at
        z = at + stretch if mode[d] == dk.CLOSED_LOOP else at
        store(place, MOTOR * W, z)
        store(rate, MOTOR * W, v)
        store(place, CARRIAGE * W, z - stretch)
        store(rate, CARRIAGE * W, v)
        moved = load(par, (first + dk.MOTOR_MASS) * W)
        if rigid[d]:
            moved = moved + load(par, (first + dk.RAIL_MASS) * W)
        store(mem, dk.LIGHTNESS * W, 1.0 / moved)
        dk.begin(mem, 0, z, v, cycle, dk.at_motor(par, first, hold))


@inlined
def _advance(
    par, substeps, begun, cycles, cycle, count, all_place, all_rate, all_mem, bend, torques, moves,
    command, motion, start, mode, on, delayed, rigid, law, moving,
):  # fmt: skip
    """Simulate `cycles` cycles from `begun` on, drive by drive; see `loop.simulate`."""
    drives = mode.shape[0]
    own = COORDINATES * W
    mine = MEMORY_COUNT * W
    zero = spread(0.0)
    # Divided here, not in every cycle.
    quick = cycle / load(substeps, 0)
    slow = cycle / load(substeps, W)
    for d in range(drives):
        first = MACHINE_COUNT + d * DRIVE_COUNT
        flags = dk.flags_of(on, d)
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
                torque = dk.control(
                    par, first, mem, 0, flags, law[d], cycle, z, v,
                    command, d, drives, count, k, delayed, time,
                )  # fmt: skip
            else:
                acceleration = motion[(2 * drives + d) * count + k]
                z = spread(motion[d * count + k])
                v = spread(motion[(drives + d) * count + k])
                store(place, MOTOR * W, z)
                store(rate, MOTOR * W, v)
                mass = load(par, (first + dk.MOTOR_MASS) * W)
                if one:
                    s = z
                    force = _rigid_force(par, first, mem, 0, flags, z, v, time)
                    back = force
                    mass = mass + load(par, (first + dk.RAIL_MASS) * W)
                else:
                    s = load(place, CARRIAGE * W)
                    w = load(rate, CARRIAGE * W)
                    force, back = dk.gear_force(par, first, mem, 0, flags, z, v, s, w, time)
                torque = dk.prescribed_torque(
                    par, first, mem, 0, flags, z, v, s, mass, acceleration, force, back, time
                )
            store(torques, (d * measurement.PIECE + piece) * W, torque)
            if moving is not None:
                store(moves, (d * measurement.PIECE + piece) * W, z)
                store(moves, ((drives + d) * measurement.PIECE + piece) * W, v)
            steps = where(fast, load(substeps, 0), load(substeps, W))
            whole = where(fast, quick, slow)
            sub = 0.0
            active = steps > zero
            while any_lane(active):
                # A lane that is through makes steps of no length.
                h = where(active, whole, zero)
                _step(
                    par, first, mem, flags, one, mode[d], acceleration,
                    place, rate, bend, time, sub * whole, h,
                )  # fmt: skip
                if on is not None:
                    dk.keep_step(
                        par,
                        first,
                        mem,
                        0,
                        flags,
                        load(place, MOTOR * W),
                        load(rate, MOTOR * W),
                        active,
                    )
                sub += 1.0
                active = steps > spread(sub)
            if on is not None:
                dk.keep_cycle(
                    par,
                    first,
                    mem,
                    0,
                    flags,
                    load(place, MOTOR * W),
                    load(rate, MOTOR * W),
                    load(place, MOTOR * W),
                    time,
                    cycle,
                )


def _build(digest):
    @kernel
    def simulate(
        blocks,
        rows,
        substeps,
        state,
        room,
        begin,
        end,
        command,
        motion,
        start,
        mode,
        on,
        delayed,
        rigid,
        cycle,
        law,
        wanted,
        measured,
        samples,
        weights,
        moving,
        limits,
        out,
    ):
        """Simulate blocks of candidates; arguments as in the tripod's kernel, but for these.

        Args:
            state: (G, state_for(D)).
            room: (room_for(D),) to work in.
            command: (2 * D * K,) set-point positions of the drives, then their rates.
            motion: (3 * D * K,) recorded position, velocity and acceleration of prescribed motors,
                else empty.
            start: (2 * D,) where the motors start, then how fast.
            mode: (D,) CLOSED_LOOP or PRESCRIBED.
            on: (D,) flags of the effects, or None.
            rigid: (D,) whether motor and carriage are one mass.
        """
        _ = digest
        drives = mode.shape[0]
        going = room[: state.shape[1]]
        place, more = parted(room, drives * COORDINATES)
        rate, more = parted(more, drives * COORDINATES)
        mem, more = parted(more, drives * MEMORY_COUNT)
        bend, more = parted(more, rk.STAGES * COORDINATES)
        kept, rest = parted(more, drives * measurement.KEPT)
        torques, rest = parted(rest, drives * measurement.PIECE)
        finite, rest = parted(rest, 1)
        rest, moves = parted(rest, measurement.ROOM)
        loop.simulate(
            _start, _advance,
            (place, rate, mem, bend, torques, moves, command, motion, start, mode, on, delayed,
             rigid, law, moving),
            blocks, rows, substeps, state, going, begin, end, cycle, place, rate, kept, torques,
            moves, finite, rest, wanted, measured, samples, weights, moving, limits, out,
        )  # fmt: skip

    return simulate


simulate = _build(sources_digest())
