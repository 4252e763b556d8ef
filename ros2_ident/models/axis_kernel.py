# SPDX-License-Identifier: Apache-2.0
"""Linear axes that do not know of each other, eight candidates at once.

Each drive moves one carriage, through a gear's spring or, rigid, as one mass with it. Integration
as in `tripod_kernel`: Runge-Kutta of fourth order, its steps within a controller cycle chosen by
stiffness.
"""
# mypy: ignore-errors

from numba import njit
import numpy as np

from ros2_ident.lanes import inlined, load, spread, store, WIDTH
from ros2_ident.models import drive_kernel as dk
from ros2_ident.models.hooks import sources_digest
from ros2_ident.models.rows import DRIVE_COUNT, MACHINE_COUNT, row_of

W = WIDTH
GRAVITY = row_of('gravity')

# State rows of one drive: motor, its rate, carriage, its rate.
STATES = 4


@inlined
def _rigid_force(par, first, mem, own, on, gear, z, v, time):
    """Return the force [N] on motor and carriage as one mass, without the motor's own torque."""
    weight = load(par, (first + dk.RAIL_MASS) * W) * load(par, GRAVITY * W)
    return weight - dk.carriage_force(par, first, mem, own, on, gear, z, v, z, time)


@inlined
def _derivative(
    par, first, mem, own, on, rigid, mode, acceleration, gear, eps, y, out, time, elapsed
):
    """Write the derivative of one drive's state `y` into `out`."""
    z = load(y, 0)
    v = load(y, W)
    if rigid:
        s = z
        w = v
        force = _rigid_force(par, first, mem, own, on, gear, z, v, time)
    else:
        s = load(y, 2 * W)
        w = load(y, 3 * W)
        force = dk.gear_force(par, first, mem, own, on, gear, z, v, s, w, time)
        rail = load(par, (first + dk.RAIL_MASS) * W)
        push = force + dk.carriage_force(par, first, mem, own, on, gear, z, v, s, time)
        store(out, 2 * W, w)
        store(out, 3 * W, push / rail - load(par, GRAVITY * W))
    store(out, 0, v)
    if mode == dk.CLOSED_LOOP:
        torque = dk.motor_torque(
            par, first, mem, own, on, gear, eps, z, v, s, force, time, elapsed
        )
        store(out, W, (gear * torque - force) * load(mem, (own + dk.LIGHTNESS) * W))
    else:
        store(out, W, spread(acceleration))


def _build(digest):
    @njit(nogil=True, cache=True)
    def simulate(
        blocks,
        substeps,
        command,
        motion,
        begin,
        mode,
        on,
        delayed,
        rigid,
        gear,
        eps,
        cycle,
        law,
        feedforward,
        out,
        finite,
    ):
        """Simulate blocks of eight candidates; arguments as in `tripod_kernel.simulate`.

        Args:
            blocks: (G, R * 8) rows of `models.rows`.
            substeps: (G,) Runge-Kutta steps in a cycle.
            command: (2 * D * K,) set-point positions of the drives, then their rates.
            motion: (3 * D * K,) recorded position, velocity and acceleration of prescribed motors,
                else empty.
            begin: (2 * D,) where the motors start, then how fast.
            mode: (D,) CLOSED_LOOP or PRESCRIBED.
            on: (D,) flags of the effects.
            delayed: Whether command delays are on.
            rigid: (D,) whether motor and carriage are one mass.
            gear: Motor angle per travel [rad/m].
            eps: Regularisation of Coulomb friction [m/s].
            cycle: Controller cycle [s].
            law: VELOCITY_FROM_STATE or VELOCITY_FROM_POSITIONS.
            feedforward: Weight of the velocity feed-forward.
            out: (G, D, K, 8) torque of every cycle, written.
            finite: (G, 8) 1.0 where the candidate stayed finite, written.
        """
        _ = digest
        drives = mode.shape[0]
        count = out.shape[2]
        y = np.zeros(STATES * W)
        stage = np.zeros(STATES * W)
        slope = np.zeros(STATES * W)
        total = np.zeros(STATES * W)
        mem = np.zeros(dk.MEMORY_COUNT * W)
        zero = spread(0.0)
        for g in range(blocks.shape[0]):
            par = blocks[g]
            steps = substeps[g]
            h = cycle / steps
            for lane in range(W):
                finite[g, lane] = 1.0
            for d in range(drives):
                first = MACHINE_COUNT + d * DRIVE_COUNT
                flags = on[d]
                driven = mode[d] == dk.CLOSED_LOOP
                one = rigid[d]
                states = 2 if one else STATES
                mem[:] = 0.0
                y[:] = 0.0
                start = spread(begin[d])
                rate = spread(begin[drives + d])
                hold = load(par, (first + dk.RAIL_MASS) * W) * load(par, GRAVITY * W)
                stretch = zero if one else hold / load(par, (first + dk.STIFFNESS) * W)
                z = start + stretch if driven else start
                store(y, 0, z)
                store(y, W, rate)
                store(y, 2 * W, z - stretch)
                store(y, 3 * W, rate)
                moved = load(par, (first + dk.MOTOR_MASS) * W)
                if one:
                    moved = moved + load(par, (first + dk.RAIL_MASS) * W)
                store(mem, dk.LIGHTNESS * W, 1.0 / moved)
                store(mem, dk.INTEGRAL * W, hold * (1.0 / gear))
                store(mem, dk.APPLIED * W, hold * (1.0 / gear))
                store(mem, dk.ANCHOR * W, z)
                store(mem, dk.LAST_READ * W, z - rate * cycle)
                store(mem, dk.LAST_BUT_ONE * W, z - 2.0 * rate * cycle)
                delay = load(par, (first + dk.COMMAND_DELAY) * W)
                for k in range(count):
                    time = k * cycle
                    acceleration = 0.0
                    if driven:
                        zc = dk.set_point(command, d * count, count, k, delay, cycle, delayed)
                        vc = dk.set_point(
                            command, (drives + d) * count, count, k, delay, cycle, delayed
                        )
                        torque = dk.control(
                            par,
                            first,
                            mem,
                            0,
                            flags,
                            law,
                            feedforward,
                            cycle,
                            gear,
                            load(y, 0),
                            load(y, W),
                            zc,
                            vc,
                            time,
                        )
                    else:
                        acceleration = motion[(2 * drives + d) * count + k]
                        z = spread(motion[d * count + k])
                        v = spread(motion[(drives + d) * count + k])
                        store(y, 0, z)
                        store(y, W, v)
                        mass = load(par, (first + dk.MOTOR_MASS) * W)
                        if one:
                            s = z
                            force = _rigid_force(par, first, mem, 0, flags, gear, z, v, time)
                            mass = mass + load(par, (first + dk.RAIL_MASS) * W)
                        else:
                            s = load(y, 2 * W)
                            force = dk.gear_force(
                                par, first, mem, 0, flags, gear, z, v, s, load(y, 3 * W), time
                            )
                        store(mem, dk.COMMANDED * W, zero)
                        friction = -dk.motor_torque(
                            par, first, mem, 0, flags, gear, eps, z, v, s, force, time, 0.0
                        )
                        torque = (mass * acceleration + force) * (1.0 / gear) + friction
                    store(out, ((g * drives + d) * count + k) * W, torque)
                    for r in range(states):
                        store(stage, r * W, load(y, r * W))
                        store(total, r * W, zero)
                    for sub in range(steps):
                        since = sub * h
                        for part in range(4):
                            at = 0.0 if part == 0 else (h if part == 3 else 0.5 * h)
                            _derivative(
                                par,
                                first,
                                mem,
                                0,
                                flags,
                                one,
                                mode[d],
                                acceleration,
                                gear,
                                eps,
                                stage,
                                slope,
                                time + since + at,
                                since + at,
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
                        dk.keep_bristle(
                            par, first, mem, 0, flags, gear, eps, load(y, 0), load(y, W)
                        )
                    dk.keep_torque(
                        par,
                        first,
                        mem,
                        0,
                        flags,
                        gear,
                        load(y, 0),
                        load(y, W),
                        load(y, 0),
                        time,
                        cycle,
                    )
                for lane in range(W):
                    for r in range(states):
                        if not np.isfinite(y[r * W + lane]):
                            finite[g, lane] = 0.0

    return simulate


simulate = _build(sources_digest())
