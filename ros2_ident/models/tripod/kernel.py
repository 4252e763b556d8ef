# SPDX-License-Identifier: Apache-2.0
"""The tripod, all drives coupled, a block of candidates at once.

Coordinates: motors z and carriages s. The platform follows from the carriages in closed form. In a
controller cycle the linkage moves by a fraction of a millimetre while the gear's spring may swing:
geometry, mass matrix and centripetal load are taken once a cycle, at its predicted middle (error
of second order), and the drives are integrated over it by Runge-Kutta steps of fourth order, as
many as a candidate's stiffness asks for.
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
    load_three,
    parted,
    spread,
    store,
    where,
    WIDTH,
)
from ros2_ident.models.tripod.linkage import LINKAGE, on_arms, on_rails

W = WIDTH

# Coordinates: motors 0-2, carriages 3-5, frame 6.
COORDINATES = 7
MOTOR, CARRIAGE, FRAME = 0, 3, 6
# What goes on from a part of the log to the next: as many numbers of each block.
STATE = W * ((2 + rk.STAGES) * COORDINATES + 3 * (1 + MEMORY_COUNT + measurement.KEPT))
ROOM = STATE + W * (
    LINKAGE + 3 * (1 + (1 + measurement.MOTIONS) * measurement.PIECE) + 1 + measurement.ROOM
)


@inlined
def _linkage(par, arms, place, rate, tool, frame, out):
    """Write mass matrix and load of the linkage at the drives' places and rates, (3,) each."""
    if arms is not None:
        on_arms(par, place, rate, tool, frame, out)
    else:
        on_rails(par, place, rate, tool, frame, out)


@inlined
def _carriages(par, link, push, sway, sway_rate, frame, bend, at):
    """Write the accelerations of carriages and frame into `bend` from row `at` on."""
    f1 = load(push, 0) - load(link, 6 * W)
    f2 = load(push, W) - load(link, 7 * W)
    f3 = load(push, 2 * W) - load(link, 8 * W)
    i11, i22, i33 = load_three(link, 0)
    i12, i13, i23 = load_three(link, 3)
    a1 = i11 * f1 + i12 * f2 + i13 * f3
    a2 = i12 * f1 + i22 * f2 + i23 * f3
    a3 = i13 * f1 + i23 * f2 + i33 * f3
    if frame:
        g1, g2, g3 = load_three(link, 9)
        b1 = i11 * g1 + i12 * g2 + i13 * g3
        b2 = i12 * g1 + i22 * g2 + i23 * g3
        b3 = i13 * g1 + i23 * g2 + i33 * g3
        omega = load(par, MACHINE.frame_frequency * W) * 6.283185307179586
        light = load(par, MACHINE.frame_inverse_mass * W)
        back = omega * (omega * sway + 2.0 * load(par, MACHINE.frame_damping * W) * sway_rate)
        push_back = g1 * a1 + g2 * a2 + g3 * a3 + load(link, 12 * W)
        carried = load(link, 13 * W) - (g1 * b1 + g2 * b2 + g3 * b3)
        lift = -(back + light * push_back) / (light * carried + 1.0)
        a1 = a1 - b1 * lift
        a2 = a2 - b2 * lift
        a3 = a3 - b3 * lift
        store(bend, (at + FRAME) * W, lift)
    store(bend, (at + CARRIAGE) * W, a1)
    store(bend, (at + CARRIAGE + 1) * W, a2)
    store(bend, (at + CARRIAGE + 2) * W, a3)


@inlined
def _drive(
    par, mem, place, rate, bend, push, d, flags, mode, motion, k, count, time, elapsed, part, h
):
    """Write drive `d`'s motor acceleration at a stage into `bend`, its push on the carriage."""
    first = MACHINE_COUNT + d * DRIVE_COUNT
    own = d * MEMORY_COUNT
    z, v = rk.stage_state(place, rate, bend, COORDINATES, MOTOR + d, part, h)
    s, w = rk.stage_state(place, rate, bend, COORDINATES, CARRIAGE + d, part, h)
    force, back = dk.gear_force(par, first, mem, own, flags, z, v, s, w, time)
    if dk.closed_loop(mode, d):
        torque = dk.motor_torque(
            par, first, mem, own, flags, z, v, s, force, time, elapsed, None
        )  # fmt: skip
        acceleration = dk.motor_acceleration(par, first, mem, own, torque, back)
    else:
        acceleration = spread(motion[(6 + d) * count + k])
    store(bend, (part * COORDINATES + MOTOR + d) * W, acceleration)
    force = force + dk.carriage_force(par, first, mem, own, flags, z, v, s, time)
    store(push, d * W, force)


@inlined
def _stage(
    par, mem, link, place, rate, bend, push, on, mode, motion, k, count, time, since, part, h,
    frame,
):  # fmt: skip
    """Write the accelerations at stage `part` of a step into `bend`."""
    elapsed = since + rk.ahead(part) * h
    now = time + elapsed
    if on is not None:
        for d in range(3):
            _drive(par, mem, place, rate, bend, push, d, on[d], mode, motion, k, count, now,
                   elapsed, part, h)  # fmt: skip
    else:
        # Written out, so that addresses are constants.
        _drive(par, mem, place, rate, bend, push, 0, None, mode, motion, k, count, now,
               elapsed, part, h)  # fmt: skip
        _drive(par, mem, place, rate, bend, push, 1, None, mode, motion, k, count, now,
               elapsed, part, h)  # fmt: skip
        _drive(par, mem, place, rate, bend, push, 2, None, mode, motion, k, count, now,
               elapsed, part, h)  # fmt: skip
    sway = spread(0.0)
    sway_rate = sway
    if frame:
        sway, sway_rate = rk.stage_state(place, rate, bend, COORDINATES, FRAME, part, h)
    _carriages(par, link, push, sway, sway_rate, frame, bend, part * COORDINATES)


@inlined
def _step(
    par, mem, link, place, rate, bend, push, on, mode, motion, k, count, time, since, h, frame
):
    """Integrate over a step of `h` seconds that begins `since` seconds into cycle `k`.

    `on` is None where no effect is.
    """
    for part in range(rk.STAGES):
        _stage(par, mem, link, place, rate, bend, push, on, mode, motion, k, count, time,
               since, part, h, frame)  # fmt: skip
    rk.finish(place, rate, bend, COORDINATES, COORDINATES if frame else FRAME, h)


def _build(digest):
    @kernel
    def simulate(
        group, room, begin, end, command, motion, mode, on, delayed, frame, arms, cycle, law, task
    ):
        """Simulate blocks of candidates; see `drives.model.DriveModel`.

        Args:
            group: A `Group`; its rows become -1 for lanes that are given up, its state (G, STATE)
                need not be set for the first part of the log.
            room: (ROOM,) to work in.
            begin: First cycle of this part of the log, a multiple of `measurement.PIECE`.
            end: Cycle behind its last, likewise, or the number of cycles.
            command: (7 * K,) set-point positions of the three drives, their rates, and the share
                of a payload that is carried.
            motion: (9 * K,) recorded position, velocity and acceleration of prescribed motors,
                else empty.
            mode: (3,) CLOSED_LOOP or PRESCRIBED; None where all are closed loops.
            on: (3,) flags of the effects; with None no hooks are compiled.
            delayed: Whether command delays are on.
            frame: Whether the frame can move.
            arms: True where the drives turn arms; None where they move carriages on rails.
            cycle: Controller cycle [s].
            law: (3,) VELOCITY_FROM_STATE or VELOCITY_FROM_POSITIONS.
            task: A `Task`.
        """
        _ = digest
        blocks, rows, substeps, state = group
        count = command.shape[0] // 7
        # One array for all: the compiler sees then that its parts do not overlap.
        going = room[:STATE]
        place, more = parted(room, COORDINATES)
        rate, more = parted(more, COORDINATES)
        bend, more = parted(more, rk.STAGES * COORDINATES)
        mem, more = parted(more, 3 * MEMORY_COUNT)
        drift, more = parted(more, 3)
        kept, rest = parted(more, 3 * measurement.KEPT)
        push, rest = parted(rest, 3)
        link, rest = parted(rest, LINKAGE)
        torques, rest = parted(rest, 3 * measurement.PIECE)
        rest, moves = parted(rest, measurement.ROOM)
        zero = spread(0.0)
        half = 0.5 * cycle
        for g in range(blocks.shape[0]):
            par = blocks[g]
            # Divided here, not in every cycle.
            quick = cycle / load(substeps[g], 0)
            slow = cycle / load(substeps[g], W)
            tool = load(par, MACHINE.tool_mass * W)
            loaded = measurement.any_nonzero(par, MACHINE.payload_step)
            loaded |= measurement.any_nonzero(par, MACHINE.payload_turned)
            if begin > 0:
                copied(state[g], going)
            else:
                going[:] = 0.0
                for d in range(3):
                    start = command[d * count] if dk.closed_loop(mode, d) else motion[d * count]
                    store(place, (CARRIAGE + d) * W, spread(start))
                still = zero, zero, zero
                _linkage(par, arms, load_three(place, CARRIAGE), still, tool, frame, link)
                for d in range(3):
                    first = MACHINE_COUNT + d * DRIVE_COUNT
                    own = d * MEMORY_COUNT
                    s = load(place, (CARRIAGE + d) * W)
                    # What effects pull with at the start is not known to the integral part.
                    constant = load(par, (first + DRIVE.constant_load) * W)
                    hold = load(link, (6 + d) * W) + constant
                    flags = dk.flags_of(on, d)
                    if dk.closed_loop(mode, d):
                        s = s - dk.sag(par, first, law[d], hold)
                        store(place, (CARRIAGE + d) * W, s)
                    z = dk.stand(par, first, mem, own, flags, s, hold, 0.0)
                    if not dk.closed_loop(mode, d):
                        # There the recorded motion is the motor's.
                        store(place, (CARRIAGE + d) * W, s - (z - s))
                        z = s
                    store(place, (MOTOR + d) * W, z)
                    moved = load(par, (first + DRIVE.motor_mass) * W)
                    store(mem, (own + MEMORY.lightness) * W, 1.0 / moved)
                    dk.begin(mem, own, law[d], z, zero, cycle, dk.at_motor(par, first, hold))
            for k in range(begin, end):
                time = spread(k * cycle)
                piece = k % measurement.PIECE
                fast = zero >= zero
                for d in range(3):
                    first = MACHINE_COUNT + d * DRIVE_COUNT
                    own = d * MEMORY_COUNT
                    flags = dk.flags_of(on, d)
                    z = load(place, (MOTOR + d) * W)
                    v = load(rate, (MOTOR + d) * W)
                    if dk.closed_loop(mode, d):
                        torque = dk.control(
                            par, first, mem, own, flags, law[d], cycle, z, v,
                            command, d, 3, count, k, delayed, time, None, cycle, None,
                        )  # fmt: skip
                        fast = fast & (absolute(v) > dk.fast_from(par, first))
                    else:
                        z = spread(motion[d * count + k])
                        v = spread(motion[(3 + d) * count + k])
                        store(place, (MOTOR + d) * W, z)
                        store(rate, (MOTOR + d) * W, v)
                        s = load(place, (CARRIAGE + d) * W)
                        w = load(rate, (CARRIAGE + d) * W)
                        force, back = dk.gear_force(par, first, mem, own, flags, z, v, s, w, time)
                        mass = load(par, (first + DRIVE.motor_mass) * W)
                        torque = dk.prescribed_torque(
                            par, first, mem, own, flags, z, v, s, mass,
                            motion[(6 + d) * count + k], force, back, time,
                        )  # fmt: skip
                    store(torques, (d * measurement.PIECE + piece) * W, torque)
                    if task.wanted.shape[0] > 1:
                        store(moves, (d * measurement.PIECE + piece) * W, z)
                        store(moves, ((3 + d) * measurement.PIECE + piece) * W, v)
                # The middle of the cycle, as the present rates predict it.
                s1, s2, s3 = load_three(place, CARRIAGE)
                w1, w2, w3 = load_three(rate, CARRIAGE)
                b1, b2, b3 = load_three(drift, 0)
                now = tool
                if loaded:
                    start = load(par, MACHINE.payload_time * W)
                    until = start + load(par, MACHINE.payload_duration * W)
                    inside = (time >= start) & (time < until)
                    now = where(inside, tool + load(par, MACHINE.payload_step * W), tool)
                    now = now + command[6 * count + k] * load(par, MACHINE.payload_turned * W)
                middle = s1 + half * w1, s2 + half * w2, s3 + half * w3
                there = w1 + half * b1, w2 + half * b2, w3 + half * b3
                _linkage(par, arms, middle, there, now, frame, link)
                steps = where(fast, load(substeps[g], 0), load(substeps[g], W))
                whole = where(fast, quick, slow)
                sub = 0.0
                active = steps > zero
                while any_lane(active):
                    # A lane that is through makes steps of no length.
                    h = where(active, whole, zero)
                    since = sub * whole
                    _step(
                        par, mem, link, place, rate, bend, push, on, mode, motion, k, count,
                        time, since, h, frame,
                    )  # fmt: skip
                    if on is not None:
                        for d in range(3):
                            first, own = MACHINE_COUNT + d * DRIVE_COUNT, d * MEMORY_COUNT
                            z, v = load(place, (MOTOR + d) * W), load(rate, (MOTOR + d) * W)
                            dk.keep_step(par, first, mem, own, on[d], z, v, active)
                    last = (rk.STAGES - 1) * COORDINATES + CARRIAGE
                    for d in range(3):
                        newest = where(active, load(bend, (last + d) * W), load(drift, d * W))
                        store(drift, d * W, newest)
                    sub += 1.0
                    active = steps > spread(sub)
                if on is not None:
                    for d in range(3):
                        first, own = MACHINE_COUNT + d * DRIVE_COUNT, d * MEMORY_COUNT
                        z, v = load(place, (MOTOR + d) * W), load(rate, (MOTOR + d) * W)
                        s = load(place, (CARRIAGE + d) * W)
                        dk.keep_cycle(par, first, mem, own, on[d], z, v, s, time, cycle)
                full = piece == measurement.PIECE - 1 or k == end - 1
                if full and measurement.hand_on(
                    par, torques, moves, k - piece, piece + 1, cycle, task, rows[g], kept, rest
                ):
                    break
            copied(going, state[g])
            if end == count:
                measurement.conclude(par, going[: 2 * COORDINATES * W], task, rows[g], kept)

    return simulate


simulate = _build(sources_digest())
