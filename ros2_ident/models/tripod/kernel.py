# SPDX-License-Identifier: Apache-2.0
"""The tripod, all drives coupled, a block of candidates at once.

Coordinates: motors z and carriages s. The platform follows from the carriages in closed form. In a
controller cycle the linkage moves by a fraction of a millimetre while the gear's spring may swing:
geometry, mass matrix and centripetal load are taken once a cycle, at its predicted middle (error
of second order), and the drives are integrated over it by Runge-Kutta steps of fourth order, as
many as a candidate's stiffness asks for.
"""
# mypy: ignore-errors

import numpy as np

from ros2_ident.kernel import drive as dk
from ros2_ident.kernel import measurement
from ros2_ident.kernel import runge_kutta as rk
from ros2_ident.kernel.hooks import sources_digest
from ros2_ident.kernel.rows import DRIVE_COUNT, MACHINE_COUNT, MEMORY_COUNT, row_of
from ros2_ident.lanes import (
    absolute,
    any_lane,
    copied,
    inlined,
    kernel,
    load,
    parted,
    spread,
    sqrt,
    store,
    where,
    WIDTH,
)

W = WIDTH
RADIUS = row_of('rail_radius')
INVERSE_RADIUS = row_of('rail_inverse_radius')
RAIL_X, RAIL_Y = row_of('rail_x'), row_of('rail_y')
RAIL_2_X, RAIL_2_Y = row_of('rail_2_x'), row_of('rail_2_y')
RAIL_3_X, RAIL_3_Y = row_of('rail_3_x'), row_of('rail_3_y')
RAIL_X_2, RAIL_X_3 = row_of('rail_x_2'), row_of('rail_x_3')
RAIL_Y_2, RAIL_Y_3 = row_of('rail_y_2'), row_of('rail_y_3')
LENGTH = row_of('rod_length')
TOOL = row_of('tool_mass')
ROD = row_of('mass_per_rod')
GRAVITY = row_of('gravity')
PAYLOAD = row_of('payload_step')
PAYLOAD_TIME = row_of('payload_time')
PAYLOAD_DURATION = row_of('payload_duration')
FRAME_INVERSE = row_of('frame_inverse_mass')
FRAME_FREQUENCY = row_of('frame_frequency')
FRAME_DAMPING = row_of('frame_damping')

# Coordinates: motors 0-2, carriages 3-5, frame 6.
COORDINATES = 7
MOTOR, CARRIAGE, FRAME = 0, 3, 6
# Rows of the linkage block: inverse mass matrix 0-5 (11 22 33 12 13 23), load 6-8, coupling of the
# frame's acceleration 9-11, its own bias 12, the mass it carries 13.
LINKAGE = 14
# What goes on from a part of the log to the next: as many numbers of each block.
STATE = W * ((2 + rk.STAGES) * COORDINATES + 3 * (1 + MEMORY_COUNT + measurement.KEPT))
ROOM = STATE + W * (
    LINKAGE + 3 * (1 + (1 + measurement.MOTIONS) * measurement.PIECE) + 1 + measurement.ROOM
)


@inlined
def _linkage(par, s1, s2, s3, w1, w2, w3, tool, frame, out):
    """Write mass matrix and load of the linkage at carriages s [m] and rates w [m/s].

    s'' = inverse mass matrix (gear forces - load).
    """
    x, y = load(par, RAIL_X * W), load(par, RAIL_Y * W)
    x_2, x_3 = load(par, RAIL_X_2 * W), load(par, RAIL_X_3 * W)
    y_2, y_3 = load(par, RAIL_Y_2 * W), load(par, RAIL_Y_3 * W)
    radius = load(par, RADIUS * W)
    length = load(par, LENGTH * W)
    rod = load(par, ROD * W)
    gravity = load(par, GRAVITY * W)
    u2 = s2 - s1
    u3 = s3 - s1
    inverse = load(par, INVERSE_RADIUS * W)
    bx = (x_2 * u2 + x_3 * u3) * inverse
    by = (y_2 * u2 + y_3 * u3) * inverse
    h2 = 0.5 * u2 * u2
    h3 = 0.5 * u3 * u3
    qx = (x_2 * h2 + x_3 * h3) * inverse - radius * x
    qy = (y_2 * h2 + y_3 * h3) * inverse - radius * y
    # The rods (x, y, z): |q + b z1|^2 + z1^2 = L^2; the platform hangs below the carriages.
    a = bx * bx + by * by + 1.0
    b = bx * qx + by * qy
    z1 = (sqrt(b * b - a * (qx * qx + qy * qy - length * length)) - b) / a
    z2 = z1 + u2
    z3 = z1 + u3
    x1 = -(qx + bx * z1)
    y1 = -(qy + by * z1)
    x2 = x1 + radius * load(par, RAIL_2_X * W)
    y2 = y1 + radius * load(par, RAIL_2_Y * W)
    x3 = x1 + radius * load(par, RAIL_3_X * W)
    y3 = y1 + radius * load(par, RAIL_3_Y * W)
    # Rows (x, y, z) times the platform's velocity give z s'. The inverse of their matrix, but for
    # its determinant:
    cx1 = y2 * z3 - y3 * z2
    cy1 = z2 * x3 - z3 * x2
    cz1 = x2 * y3 - x3 * y2
    cx2 = y3 * z1 - y1 * z3
    cy2 = z3 * x1 - z1 * x3
    cz2 = x3 * y1 - x1 * y3
    cx3 = y1 * z2 - y2 * z1
    cy3 = z1 * x2 - z2 * x1
    cz3 = x1 * y2 - x2 * y1
    over = 1.0 / (x1 * cx1 + y1 * cy1 + z1 * cz1)
    # Columns of A = dp/ds.
    k1 = z1 * over
    k2 = z2 * over
    k3 = z3 * over
    ax1 = cx1 * k1
    ay1 = cy1 * k1
    az1 = cz1 * k1
    ax2 = cx2 * k2
    ay2 = cy2 * k2
    az2 = cz2 * k2
    ax3 = cx3 * k3
    ay3 = cy3 * k3
    az3 = cz3 * k3
    vx = ax1 * w1 + ax2 * w2 + ax3 * w3
    vy = ay1 * w1 + ay2 * w2 + ay3 * w3
    vz = az1 * w1 + az2 * w2 + az3 * w3
    # The part of the platform's acceleration that the rates make.
    square = vx * vx + vy * vy
    c1 = (square + (w1 - vz) * (w1 - vz)) * over
    c2 = (square + (w2 - vz) * (w2 - vz)) * over
    c3 = (square + (w3 - vz) * (w3 - vz)) * over
    bias_x = cx1 * c1 + cx2 * c2 + cx3 * c3
    bias_y = cy1 * c1 + cy2 * c2 + cy3 * c3
    bias_z = cz1 * c1 + cz2 * c2 + cz3 * c3
    # Each rod's mass is halved between its ends (Codourey 1998).
    mass = tool + 1.5 * rod
    r1 = load(par, (MACHINE_COUNT + dk.RAIL_MASS) * W) + 0.5 * rod
    r2 = load(par, (MACHINE_COUNT + DRIVE_COUNT + dk.RAIL_MASS) * W) + 0.5 * rod
    r3 = load(par, (MACHINE_COUNT + 2 * DRIVE_COUNT + dk.RAIL_MASS) * W) + 0.5 * rod
    lift = bias_z + gravity
    store(out, 6 * W, mass * (ax1 * bias_x + ay1 * bias_y + az1 * lift) + gravity * r1)
    store(out, 7 * W, mass * (ax2 * bias_x + ay2 * bias_y + az2 * lift) + gravity * r2)
    store(out, 8 * W, mass * (ax3 * bias_x + ay3 * bias_y + az3 * lift) + gravity * r3)
    mx1 = mass * ax1
    my1 = mass * ay1
    mz1 = mass * az1
    mx2 = mass * ax2
    my2 = mass * ay2
    mz2 = mass * az2
    m11 = mx1 * ax1 + my1 * ay1 + (mz1 * az1 + r1)
    m22 = mx2 * ax2 + my2 * ay2 + (mz2 * az2 + r2)
    m33 = mass * (ax3 * ax3 + ay3 * ay3 + az3 * az3) + r3
    m12 = mx1 * ax2 + my1 * ay2 + mz1 * az2
    m13 = mx1 * ax3 + my1 * ay3 + mz1 * az3
    m23 = mx2 * ax3 + my2 * ay3 + mz2 * az3
    n11 = m22 * m33 - m23 * m23
    n12 = m13 * m23 - m12 * m33
    n13 = m12 * m23 - m13 * m22
    det = 1.0 / (m11 * n11 + m12 * n12 + m13 * n13)
    store(out, 0, n11 * det)
    store(out, W, (m11 * m33 - m13 * m13) * det)
    store(out, 2 * W, (m11 * m22 - m12 * m12) * det)
    store(out, 3 * W, n12 * det)
    store(out, 4 * W, n13 * det)
    store(out, 5 * W, (m12 * m13 - m11 * m23) * det)
    if frame:
        # The frame lifts everything: what its acceleration does to the carriages is what gravity
        # does.
        store(out, 9 * W, r1 + mass * az1)
        store(out, 10 * W, r2 + mass * az2)
        store(out, 11 * W, r3 + mass * az3)
        store(out, 12 * W, mass * bias_z)
        store(out, 13 * W, r1 + r2 + r3 + mass)


@inlined
def _carriages(par, link, push, sway, sway_rate, frame, bend, at):
    """Write the accelerations of carriages and frame into `bend` from row `at` on."""
    f1 = load(push, 0) - load(link, 6 * W)
    f2 = load(push, W) - load(link, 7 * W)
    f3 = load(push, 2 * W) - load(link, 8 * W)
    i11 = load(link, 0)
    i22 = load(link, W)
    i33 = load(link, 2 * W)
    i12 = load(link, 3 * W)
    i13 = load(link, 4 * W)
    i23 = load(link, 5 * W)
    a1 = i11 * f1 + i12 * f2 + i13 * f3
    a2 = i12 * f1 + i22 * f2 + i23 * f3
    a3 = i13 * f1 + i23 * f2 + i33 * f3
    if frame:
        g1 = load(link, 9 * W)
        g2 = load(link, 10 * W)
        g3 = load(link, 11 * W)
        b1 = i11 * g1 + i12 * g2 + i13 * g3
        b2 = i12 * g1 + i22 * g2 + i23 * g3
        b3 = i13 * g1 + i23 * g2 + i33 * g3
        omega = load(par, FRAME_FREQUENCY * W) * 6.283185307179586
        light = load(par, FRAME_INVERSE * W)
        back = omega * (omega * sway + 2.0 * load(par, FRAME_DAMPING * W) * sway_rate)
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
):  # fmt: skip
    """Write drive `d`'s motor acceleration at a stage into `bend`, its push on the carriage."""
    first = MACHINE_COUNT + d * DRIVE_COUNT
    own = d * MEMORY_COUNT
    z, v = rk.stage_state(place, rate, bend, COORDINATES, MOTOR + d, part, h)
    s, w = rk.stage_state(place, rate, bend, COORDINATES, CARRIAGE + d, part, h)
    force, back = dk.gear_force(par, first, mem, own, flags, z, v, s, w, time)
    if dk.closed_loop(mode, d):
        torque = dk.motor_torque(par, first, mem, own, flags, z, v, s, force, time, elapsed)
        acceleration = dk.motor_acceleration(par, first, mem, own, torque, back)
    else:
        acceleration = spread(motion[(6 + d) * count + k])
    store(bend, (part * COORDINATES + MOTOR + d) * W, acceleration)
    if flags is not None:
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
):  # fmt: skip
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
        blocks,
        rows,
        substeps,
        state,
        room,
        begin,
        end,
        command,
        motion,
        mode,
        on,
        delayed,
        frame,
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
        """Simulate blocks of candidates; see `drives.model.DriveModel`.

        Args:
            blocks: (G, R * W) rows of `kernel.rows`.
            rows: (G, W) row of `out` for each lane, -1 for none; becomes -1 for a lane that is
                given up.
            substeps: (G, 2 * W) Runge-Kutta steps in a cycle: while every drive moves fast, and
                otherwise.
            state: (G, STATE) what goes on from one part of the log to the next; need not be set
                for the first.
            room: (ROOM,) to work in.
            begin: First cycle of this part of the log, a multiple of `measurement.PIECE`.
            end: Cycle behind its last, likewise, or the number of cycles.
            command: (6 * K,) set-point positions of the three drives, then their rates.
            motion: (9 * K,) recorded position, velocity and acceleration of prescribed motors,
                else empty.
            mode: (3,) CLOSED_LOOP or PRESCRIBED; None where all are closed loops.
            on: (3,) flags of the effects; with None no hooks are compiled.
            delayed: Whether command delays are on.
            frame: Whether the frame can move.
            cycle: Controller cycle [s].
            law: (3,) VELOCITY_FROM_STATE or VELOCITY_FROM_POSITIONS.
            wanted, measured, samples, moving, out: As for `measurement.hand_on`.
            weights, limits: As for `measurement.give_up`.
        """
        _ = digest
        count = command.shape[0] // 6
        coordinates = COORDINATES if frame else FRAME
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
        finite, rest = parted(rest, 1)
        rest, moves = parted(rest, measurement.ROOM)
        zero = spread(0.0)
        half = 0.5 * cycle
        for g in range(blocks.shape[0]):
            par = blocks[g]
            # Divided here, not in every cycle.
            quick = cycle / load(substeps[g], 0)
            slow = cycle / load(substeps[g], W)
            tool = load(par, TOOL * W)
            loaded = payload_on(par)
            if begin > 0:
                copied(state[g], going)
            else:
                going[:] = 0.0
                for d in range(3):
                    start = command[d * count] if dk.closed_loop(mode, d) else motion[d * count]
                    store(place, (CARRIAGE + d) * W, spread(start))
                _linkage(
                    par,
                    load(place, CARRIAGE * W),
                    load(place, (CARRIAGE + 1) * W),
                    load(place, (CARRIAGE + 2) * W),
                    zero,
                    zero,
                    zero,
                    tool,
                    frame,
                    link,
                )
                for d in range(3):
                    first = MACHINE_COUNT + d * DRIVE_COUNT
                    own = d * MEMORY_COUNT
                    s = load(place, (CARRIAGE + d) * W)
                    # Gravity only: what else pulls at the start is not known to the integral part.
                    hold = load(link, (6 + d) * W)
                    flags = dk.flags_of(on, d)
                    z = dk.stand(par, first, mem, own, flags, s, hold, 0.0)
                    if not dk.closed_loop(mode, d):
                        # There the recorded motion is the motor's.
                        store(place, (CARRIAGE + d) * W, s - (z - s))
                        z = s
                    store(place, (MOTOR + d) * W, z)
                    moved = load(par, (first + dk.MOTOR_MASS) * W)
                    store(mem, (own + dk.LIGHTNESS) * W, 1.0 / moved)
                    dk.begin(mem, own, z, zero, cycle, dk.at_motor(par, first, hold))
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
                            command, d, 3, count, k, delayed, time,
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
                        mass = load(par, (first + dk.MOTOR_MASS) * W)
                        torque = dk.prescribed_torque(
                            par, first, mem, own, flags, z, v, s, mass,
                            motion[(6 + d) * count + k], force, back, time,
                        )  # fmt: skip
                    store(torques, (d * measurement.PIECE + piece) * W, torque)
                    if moving is not None:
                        store(moves, (d * measurement.PIECE + piece) * W, z)
                        store(moves, ((3 + d) * measurement.PIECE + piece) * W, v)
                # The middle of the cycle, as the present rates predict it.
                w1 = load(rate, CARRIAGE * W)
                w2 = load(rate, (CARRIAGE + 1) * W)
                w3 = load(rate, (CARRIAGE + 2) * W)
                now = tool
                if loaded:
                    start = load(par, PAYLOAD_TIME * W)
                    inside = (time >= start) & (time < start + load(par, PAYLOAD_DURATION * W))
                    now = where(inside, tool + load(par, PAYLOAD * W), tool)
                _linkage(
                    par,
                    load(place, CARRIAGE * W) + half * w1,
                    load(place, (CARRIAGE + 1) * W) + half * w2,
                    load(place, (CARRIAGE + 2) * W) + half * w3,
                    w1 + half * load(drift, 0),
                    w2 + half * load(drift, W),
                    w3 + half * load(drift, 2 * W),
                    now,
                    frame,
                    link,
                )
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
                            dk.keep_step(
                                par,
                                MACHINE_COUNT + d * DRIVE_COUNT,
                                mem,
                                d * MEMORY_COUNT,
                                on[d],
                                load(place, (MOTOR + d) * W),
                                load(rate, (MOTOR + d) * W),
                                active,
                            )
                    last = (rk.STAGES - 1) * COORDINATES + CARRIAGE
                    for d in range(3):
                        newest = where(active, load(bend, (last + d) * W), load(drift, d * W))
                        store(drift, d * W, newest)
                    sub += 1.0
                    active = steps > spread(sub)
                if on is not None:
                    for d in range(3):
                        dk.keep_cycle(
                            par,
                            MACHINE_COUNT + d * DRIVE_COUNT,
                            mem,
                            d * MEMORY_COUNT,
                            on[d],
                            load(place, (MOTOR + d) * W),
                            load(rate, (MOTOR + d) * W),
                            load(place, (CARRIAGE + d) * W),
                            time,
                            cycle,
                        )
                if piece == measurement.PIECE - 1 or k == end - 1:
                    measurement.hand_on(
                        par,
                        torques,
                        moves,
                        k - piece,
                        piece + 1,
                        cycle,
                        wanted,
                        measured,
                        samples,
                        moving,
                        rows[g],
                        kept,
                        rest,
                        out,
                    )
                    if measurement.give_up(samples, weights, rows[g], limits, kept, out):
                        break
            copied(going, state[g])
            if end == count:
                for lane in range(W):
                    finite[lane] = 1.0
                    for r in range(coordinates):
                        if not np.isfinite(place[r * W + lane] + rate[r * W + lane]):
                            finite[lane] = 0.0
                measurement.conclude(par, finite, measured, samples, weights, rows[g], kept, out)

    return simulate


@inlined
def payload_on(par):
    """Return whether any lane's tool changes its mass."""
    found = False
    for lane in range(W):
        found |= par[PAYLOAD * W + lane] != 0.0
    return found


simulate = _build(sources_digest())
