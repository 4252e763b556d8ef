# SPDX-License-Identifier: Apache-2.0
"""The tripod, all drives coupled, eight candidates at once.

Coordinates: motors z and carriages s. The platform follows from the carriages in closed form. In a
controller cycle
the linkage moves by a fraction of a millimetre while the gear's spring may swing: geometry, mass
    matrix and
centripetal load are taken once a cycle, at its predicted middle (error of second order), and the
drives are integrated over it by Runge-Kutta steps of fourth order, as many as a candidate's
stiffness asks for.
"""
# mypy: ignore-errors

from numba import njit
import numpy as np

from ros2_ident.lanes import inlined, load, spread, sqrt, store, where, WIDTH
from ros2_ident.models import drive_kernel as dk
from ros2_ident.models.hooks import sources_digest
from ros2_ident.models.rows import DRIVE_COUNT, MACHINE_COUNT, row_of

W = WIDTH
RADIUS = row_of('rail_radius')
LENGTH = row_of('rod_length')
TOOL = row_of('tool_mass')
ROD = row_of('rod_mass')
GRAVITY = row_of('gravity')
PAYLOAD = row_of('payload_step')
PAYLOAD_TIME = row_of('payload_time')
PAYLOAD_DURATION = row_of('payload_duration')
FRAME_INVERSE = row_of('frame_inverse_mass')
FRAME_FREQUENCY = row_of('frame_frequency')
FRAME_DAMPING = row_of('frame_damping')

# State rows: motors 0-2, their rates 3-5, carriages 6-8, their rates 9-11, frame 12, its rate 13.
STATES = 14
# Rows of the linkage block: inverse mass matrix 0-5 (11 22 33 12 13 23), load 6-8, coupling of the
# frame's
# acceleration 9-11, its own bias 12, the mass it carries 13.
LINKAGE = 14


@inlined
def _linkage(par, s1, s2, s3, w1, w2, w3, grid, tool, frame, out):
    """Write mass matrix and load of the linkage at carriages s [m] and rates w [m/s].

    s'' = inverse mass matrix (gear forces - load). `grid` holds the inverse of the two rail
    directions' differences from the first (2x2) and the directions themselves (3x2).
    """
    radius = load(par, RADIUS * W)
    length = load(par, LENGTH * W)
    rod = load(par, ROD * W)
    gravity = load(par, GRAVITY * W)
    u2 = s2 - s1
    u3 = s3 - s1
    inverse = 1.0 / radius
    bx = (grid[0] * u2 + grid[1] * u3) * inverse
    by = (grid[2] * u2 + grid[3] * u3) * inverse
    h2 = 0.5 * u2 * u2
    h3 = 0.5 * u3 * u3
    qx = (grid[0] * h2 + grid[1] * h3) * inverse - radius * grid[4]
    qy = (grid[2] * h2 + grid[3] * h3) * inverse - radius * grid[5]
    # |q + b zeta|^2 + zeta^2 = L^2 for the height zeta of carriage 1 above the platform; the
    # platform hangs below.
    a = bx * bx + by * by + 1.0
    b = bx * qx + by * qy
    zeta = (sqrt(b * b - a * (qx * qx + qy * qy - length * length)) - b) / a
    px = qx + bx * zeta + radius * grid[4]
    py = qy + by * zeta + radius * grid[5]
    i1 = 1.0 / zeta
    i2 = 1.0 / (zeta + u2)
    i3 = 1.0 / (zeta + u3)
    x1 = (radius * grid[4] - px) * i1
    y1 = (radius * grid[5] - py) * i1
    x2 = (radius * grid[6] - px) * i2
    y2 = (radius * grid[7] - py) * i2
    x3 = (radius * grid[8] - px) * i3
    y3 = (radius * grid[9] - py) * i3
    # Columns of A = dp/ds.
    over = 1.0 / ((x2 - x1) * (y3 - y1) - (x3 - x1) * (y2 - y1))
    ax1 = (y2 - y3) * over
    ay1 = (x3 - x2) * over
    az1 = (x2 * y3 - x3 * y2) * over
    ax2 = (y3 - y1) * over
    ay2 = (x1 - x3) * over
    az2 = (x3 * y1 - x1 * y3) * over
    ax3 = (y1 - y2) * over
    ay3 = (x2 - x1) * over
    az3 = (x1 * y2 - x2 * y1) * over
    vx = ax1 * w1 + ax2 * w2 + ax3 * w3
    vy = ay1 * w1 + ay2 * w2 + ay3 * w3
    vz = az1 * w1 + az2 * w2 + az3 * w3
    square = vx * vx + vy * vy
    c1 = (square + (w1 - vz) * (w1 - vz)) * i1
    c2 = (square + (w2 - vz) * (w2 - vz)) * i2
    c3 = (square + (w3 - vz) * (w3 - vz)) * i3
    # Each rod's mass is halved between its ends (Codourey 1998).
    mass = tool + 1.5 * rod
    m11 = mass * (ax1 * ax1 + ay1 * ay1 + az1 * az1)
    m22 = mass * (ax2 * ax2 + ay2 * ay2 + az2 * az2)
    m33 = mass * (ax3 * ax3 + ay3 * ay3 + az3 * az3)
    m12 = mass * (ax1 * ax2 + ay1 * ay2 + az1 * az2)
    m13 = mass * (ax1 * ax3 + ay1 * ay3 + az1 * az3)
    m23 = mass * (ax2 * ax3 + ay2 * ay3 + az2 * az3)
    # The bias of the platform's acceleration is A c, hence m A' A c in the carriages' directions.
    f1 = m11 * c1 + m12 * c2 + m13 * c3
    f2 = m12 * c1 + m22 * c2 + m23 * c3
    f3 = m13 * c1 + m23 * c2 + m33 * c3
    r1 = load(par, (MACHINE_COUNT + dk.RAIL_MASS) * W)
    r2 = load(par, (MACHINE_COUNT + DRIVE_COUNT + dk.RAIL_MASS) * W)
    r3 = load(par, (MACHINE_COUNT + 2 * DRIVE_COUNT + dk.RAIL_MASS) * W)
    g1 = r1 + 0.5 * rod + mass * az1
    g2 = r2 + 0.5 * rod + mass * az2
    g3 = r3 + 0.5 * rod + mass * az3
    store(out, 6 * W, f1 + gravity * g1)
    store(out, 7 * W, f2 + gravity * g2)
    store(out, 8 * W, f3 + gravity * g3)
    m11 = m11 + r1 + 0.5 * rod
    m22 = m22 + r2 + 0.5 * rod
    m33 = m33 + r3 + 0.5 * rod
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
        store(out, 9 * W, g1)
        store(out, 10 * W, g2)
        store(out, 11 * W, g3)
        store(out, 12 * W, mass * (az1 * c1 + az2 * c2 + az3 * c3))
        store(out, 13 * W, r1 + r2 + r3 + 1.5 * rod + mass)


@inlined
def _carriage_accelerations(par, link, push, y, frame, out):
    """Write the accelerations of carriages (rows 9-11) and frame (13) into `out`."""
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
        back = omega * (
            omega * load(y, 12 * W) + 2.0 * load(par, FRAME_DAMPING * W) * load(y, 13 * W)
        )
        push_back = g1 * a1 + g2 * a2 + g3 * a3 + load(link, 12 * W)
        carried = load(link, 13 * W) - (g1 * b1 + g2 * b2 + g3 * b3)
        lift = -(back + light * push_back) / (light * carried + 1.0)
        a1 = a1 - b1 * lift
        a2 = a2 - b2 * lift
        a3 = a3 - b3 * lift
        store(out, 12 * W, load(y, 13 * W))
        store(out, 13 * W, lift)
    store(out, 9 * W, a1)
    store(out, 10 * W, a2)
    store(out, 11 * W, a3)


@inlined
def _derivative(
    par, mem, link, y, push, out, on, mode, motion, k, count, gear, eps, time, elapsed, frame
):
    """Write the derivative of the state `y` into `out`."""
    for d in range(3):
        first = MACHINE_COUNT + d * DRIVE_COUNT
        own = d * dk.MEMORY_COUNT
        z = load(y, d * W)
        v = load(y, (3 + d) * W)
        s = load(y, (6 + d) * W)
        w = load(y, (9 + d) * W)
        flags = on[d]
        force = dk.gear_force(par, first, mem, own, flags, gear, z, v, s, w, time)
        if mode[d] == dk.CLOSED_LOOP:
            torque = dk.motor_torque(
                par, first, mem, own, flags, gear, eps, z, v, s, force, time, elapsed
            )
            acceleration = (gear * torque - force) * load(mem, (own + dk.LIGHTNESS) * W)
        else:
            acceleration = spread(motion[(6 + d) * count + k])
        store(out, d * W, v)
        store(out, (3 + d) * W, acceleration)
        store(out, (6 + d) * W, w)
        store(
            push,
            d * W,
            force + dk.carriage_force(par, first, mem, own, flags, gear, z, v, s, time),
        )
    _carriage_accelerations(par, link, push, y, frame, out)


def _build(digest):
    @njit(nogil=True, cache=True)
    def simulate(
        blocks,
        substeps,
        command,
        motion,
        mode,
        on,
        delayed,
        frame,
        grid,
        gear,
        eps,
        cycle,
        law,
        feedforward,
        out,
        finite,
    ):
        """Simulate blocks of eight candidates; see `tripod.Tripod.simulate`.

        Args:
            blocks: (G, R * 8) rows of `models.rows`.
            substeps: (G,) Runge-Kutta steps in a cycle.
            command: (6 * K,) set-point positions of the three drives, then their rates.
            motion: (9 * K,) recorded position, velocity and acceleration of prescribed motors,
                else empty.
            mode: (3,) CLOSED_LOOP or PRESCRIBED.
            on: (3,) flags of the effects.
            delayed: Whether command delays are on.
            frame: Whether the frame can move.
            grid: (10,) inverse of the rail directions' differences, then the directions.
            gear: Motor angle per travel [rad/m].
            eps: Regularisation of Coulomb friction [m/s].
            cycle: Controller cycle [s].
            law: VELOCITY_FROM_STATE or VELOCITY_FROM_POSITIONS.
            feedforward: Weight of the velocity feed-forward.
            out: (G, 3, K, 8) torque of every cycle, written.
            finite: (G, 8) 1.0 where the candidate stayed finite, written.
        """
        _ = digest
        count = command.shape[0] // 6
        states = STATES if frame else STATES - 2
        y = np.zeros(STATES * W)
        stage = np.zeros(STATES * W)
        slope = np.zeros(STATES * W)
        total = np.zeros(STATES * W)
        push = np.zeros(3 * W)
        link = np.zeros(LINKAGE * W)
        mem = np.zeros(3 * dk.MEMORY_COUNT * W)
        zero = spread(0.0)
        for g in range(blocks.shape[0]):
            par = blocks[g]
            y[:] = 0.0
            mem[:] = 0.0
            slope[:] = 0.0
            tool = load(par, TOOL * W)
            for d in range(3):
                start = command[d * count] if mode[d] == dk.CLOSED_LOOP else motion[d * count]
                store(y, (6 + d) * W, spread(start))
            _linkage(
                par,
                load(y, 6 * W),
                load(y, 7 * W),
                load(y, 8 * W),
                zero,
                zero,
                zero,
                grid,
                tool,
                frame,
                link,
            )
            for d in range(3):
                first = MACHINE_COUNT + d * DRIVE_COUNT
                own = d * dk.MEMORY_COUNT
                s = load(y, (6 + d) * W)
                # Gravity only: what else pulls at the start is not known to the integral part.
                hold = load(link, (6 + d) * W)
                stretch = hold / load(par, (first + dk.STIFFNESS) * W)
                if mode[d] == dk.CLOSED_LOOP:
                    store(y, d * W, s + stretch)
                else:
                    store(y, d * W, s)
                    store(y, (6 + d) * W, s - stretch)
                z = load(y, d * W)
                store(mem, (own + dk.LIGHTNESS) * W, 1.0 / load(par, (first + dk.MOTOR_MASS) * W))
                store(mem, (own + dk.INTEGRAL) * W, hold * (1.0 / gear))
                store(mem, (own + dk.APPLIED) * W, hold * (1.0 / gear))
                store(mem, (own + dk.ANCHOR) * W, z)
                store(mem, (own + dk.LAST_READ) * W, z)
                store(mem, (own + dk.LAST_BUT_ONE) * W, z)
            steps = substeps[g]
            h = cycle / steps
            for k in range(count):
                time = k * cycle
                for d in range(3):
                    first = MACHINE_COUNT + d * DRIVE_COUNT
                    own = d * dk.MEMORY_COUNT
                    z = load(y, d * W)
                    v = load(y, (3 + d) * W)
                    if mode[d] == dk.CLOSED_LOOP:
                        delay = load(par, (first + dk.COMMAND_DELAY) * W)
                        zc = dk.set_point(command, d * count, count, k, delay, cycle, delayed)
                        vc = dk.set_point(
                            command, (3 + d) * count, count, k, delay, cycle, delayed
                        )
                        torque = dk.control(
                            par,
                            first,
                            mem,
                            own,
                            on[d],
                            law,
                            feedforward,
                            cycle,
                            gear,
                            z,
                            v,
                            zc,
                            vc,
                            time,
                        )
                    else:
                        z = spread(motion[d * count + k])
                        v = spread(motion[(3 + d) * count + k])
                        store(y, d * W, z)
                        store(y, (3 + d) * W, v)
                        s = load(y, (6 + d) * W)
                        w = load(y, (9 + d) * W)
                        force = dk.gear_force(par, first, mem, own, on[d], gear, z, v, s, w, time)
                        store(mem, (own + dk.COMMANDED) * W, zero)
                        friction = -dk.motor_torque(
                            par, first, mem, own, on[d], gear, eps, z, v, s, force, time, 0.0
                        )
                        inertia = (
                            load(par, (first + dk.MOTOR_MASS) * W) * motion[(6 + d) * count + k]
                        )
                        torque = (inertia + force) * (1.0 / gear) + friction
                    store(out, ((g * 3 + d) * count + k) * W, torque)
                # The middle of the cycle, as the present rates predict it.
                half = 0.5 * cycle
                w1 = load(y, 9 * W)
                w2 = load(y, 10 * W)
                w3 = load(y, 11 * W)
                now = tool
                if payload_on(par):
                    now = where(
                        (spread(time) >= load(par, PAYLOAD_TIME * W))
                        & (
                            spread(time)
                            < load(par, PAYLOAD_TIME * W) + load(par, PAYLOAD_DURATION * W)
                        ),
                        tool + load(par, PAYLOAD * W),
                        tool,
                    )
                _linkage(
                    par,
                    load(y, 6 * W) + half * w1,
                    load(y, 7 * W) + half * w2,
                    load(y, 8 * W) + half * w3,
                    w1 + half * load(slope, 9 * W),
                    w2 + half * load(slope, 10 * W),
                    w3 + half * load(slope, 11 * W),
                    grid,
                    now,
                    frame,
                    link,
                )
                for r in range(states):
                    store(stage, r * W, load(y, r * W))
                    store(total, r * W, zero)
                for sub in range(steps):
                    since = sub * h
                    for part in range(4):
                        # Classical Runge-Kutta: slopes at 0, h/2, h/2, h, weighted 1, 2, 2, 1.
                        at = 0.0 if part == 0 else (h if part == 3 else 0.5 * h)
                        _derivative(
                            par,
                            mem,
                            link,
                            stage,
                            push,
                            slope,
                            on,
                            mode,
                            motion,
                            k,
                            count,
                            gear,
                            eps,
                            time + since + at,
                            since + at,
                            frame,
                        )
                        weight = 1.0 if part == 0 or part == 3 else 2.0
                        ahead = h if part == 2 else 0.5 * h
                        for r in range(states):
                            value = load(slope, r * W)
                            store(total, r * W, load(total, r * W) + weight * value)
                            store(stage, r * W, load(y, r * W) + ahead * value)
                    for r in range(states):
                        value = load(y, r * W) + (h / 6.0) * load(total, r * W)
                        store(y, r * W, value)
                        store(stage, r * W, value)
                        store(total, r * W, zero)
                    for d in range(3):
                        dk.keep_bristle(
                            par,
                            MACHINE_COUNT + d * DRIVE_COUNT,
                            mem,
                            d * dk.MEMORY_COUNT,
                            on[d],
                            gear,
                            eps,
                            load(y, d * W),
                            load(y, (3 + d) * W),
                        )
                for d in range(3):
                    dk.keep_torque(
                        par,
                        MACHINE_COUNT + d * DRIVE_COUNT,
                        mem,
                        d * dk.MEMORY_COUNT,
                        on[d],
                        gear,
                        load(y, d * W),
                        load(y, (3 + d) * W),
                        load(y, (6 + d) * W),
                        time,
                        cycle,
                    )
            for lane in range(W):
                good = 1.0
                for r in range(states):
                    if not np.isfinite(y[r * W + lane]):
                        good = 0.0
                finite[g, lane] = good

    return simulate


@inlined
def payload_on(par):
    """Return whether any lane's tool changes its mass."""
    found = False
    for lane in range(W):
        found |= par[PAYLOAD * W + lane] != 0.0
    return found


simulate = _build(sources_digest())
