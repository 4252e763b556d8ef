# SPDX-License-Identifier: Apache-2.0
"""The efforts that an arm's recorded motion takes, a block of candidates at once.

What the links ask of a joint is a product: terms of the motion, the same for all candidates, times
a candidate's coefficients. Friction, hooks and log are those of any drive. Nothing is integrated.
"""
# mypy: ignore-errors

from ros2_ident.kernel import drive as dk
from ros2_ident.kernel import measurement
from ros2_ident.kernel.hooks import sources_digest
from ros2_ident.kernel.rows import DRIVE, DRIVE_COUNT, MACHINE_COUNT, MEMORY_COUNT
from ros2_ident.lanes import copied, inlined, kernel, load, parted, spread, store, WIDTH

W = WIDTH
# Cycles whose sums are made side by side: a coefficient is loaded once for all of them, and one
# sum does not wait for the last.
SIDE_BY_SIDE = 4


def sizes(drives: int) -> tuple[int, int]:
    """Return how many numbers of a block go on from a part of the log to the next, and of room."""
    state = drives * (MEMORY_COUNT + measurement.KEPT)
    return W * state, W * (state + drives * measurement.PIECE + 1 + measurement.ROOM)


@inlined
def _loads(par, base, terms, first, begun, cycles, loads):
    """Write what the links ask of a joint [N m or N] in `cycles` cycles from `begun` on.

    By its terms (K, B), of which those before `first` are zero; coefficients begin at row `base`.
    """
    count = terms.shape[1]
    whole = cycles - cycles % SIDE_BY_SIDE
    for j in range(0, whole, SIDE_BY_SIDE):
        a = spread(0.0)
        b = spread(0.0)
        c = spread(0.0)
        d = spread(0.0)
        k = begun + j
        for i in range(first, count):
            row = load(par, (base + i) * W)
            a = a + row * terms[k, i]
            b = b + row * terms[k + 1, i]
            c = c + row * terms[k + 2, i]
            d = d + row * terms[k + 3, i]
        store(loads, j * W, a)
        store(loads, (j + 1) * W, b)
        store(loads, (j + 2) * W, c)
        store(loads, (j + 3) * W, d)
    for j in range(whole, cycles):
        a = spread(0.0)
        for i in range(first, count):
            a = a + load(par, (base + i) * W) * terms[begun + j, i]
        store(loads, j * W, a)


@inlined
def _efforts(par, first, mem, on, motion, d, drives, count, begun, cycles, cycle, efforts):
    """Make of what the links ask of a joint the effort that its drive makes, in place."""
    mass = load(par, (first + DRIVE.motor_mass) * W)
    for j in range(cycles):
        k = begun + j
        z = spread(motion[d * count + k])
        v = spread(motion[(drives + d) * count + k])
        acceleration = spread(motion[(2 * drives + d) * count + k])
        time = spread(k * cycle)
        if k > 0:
            # What an effect remembers of the way since the last cycle.
            dk.keep_step(par, first, mem, 0, on, z, v, v <= v)
        force = load(efforts, j * W) - dk.carriage_force(par, first, mem, 0, on, z, v, z, time)
        effort = dk.prescribed_torque(
            par, first, mem, 0, on, z, v, z, mass, acceleration, force, force, time
        )
        store(efforts, j * W, effort)
        dk.keep_cycle(par, first, mem, 0, on, z, v, z, time, cycle)


def _build(digest):
    @kernel
    def simulate(group, room, begin, end, terms, firsts, motion, on, cycle, task):
        """Simulate blocks of candidates; arguments as in the tripod's kernel, but for these.

        Args:
            group: A `Group`, its blocks (G, (R + B) * W), coefficients behind the rows; its state
                and `room` as large as `sizes` has it.
            terms: (D, K, B) what a coefficient of 1 asks of each joint, N m or N.
            firsts: (D,) first of the terms that is not zero for a joint.
            motion: (3 * D * K,) position, velocity and acceleration of the joints.
            on: (D,) flags of the effects.
        """
        _ = digest
        blocks, rows, _, state = group
        drives, count, _ = terms.shape
        base = MACHINE_COUNT + drives * DRIVE_COUNT
        going = room[: state.shape[1]]
        all_mem, more = parted(room, drives * MEMORY_COUNT)
        kept, rest = parted(more, drives * measurement.KEPT)
        efforts, rest = parted(rest, drives * measurement.PIECE)
        mine = MEMORY_COUNT * W
        piece = measurement.PIECE * W
        zero = spread(0.0)
        for g in range(blocks.shape[0]):
            par = blocks[g]
            if begin > 0:
                copied(state[g], going)
            else:
                going[:] = 0.0
                for d in range(drives):
                    z = spread(motion[d * count])
                    v = spread(motion[(drives + d) * count])
                    mem = all_mem[d * mine : (d + 1) * mine]
                    dk.begin(mem, 0, dk.VELOCITY_FROM_STATE, z, v, cycle, zero)
            for begun in range(begin, end, measurement.PIECE):
                cycles = min(measurement.PIECE, end - begun)
                for d in range(drives):
                    first = MACHINE_COUNT + d * DRIVE_COUNT
                    own = efforts[d * piece : (d + 1) * piece]
                    mem = all_mem[d * mine : (d + 1) * mine]
                    flags = on[d]
                    _loads(par, base, terms[d], firsts[d], begun, cycles, own)
                    _efforts(
                        par, first, mem, flags, motion, d, drives, count, begun, cycles, cycle, own
                    )
                if measurement.hand_on(
                    par, efforts, efforts, begun, cycles, cycle, task, rows[g], kept, rest
                ):
                    break
            copied(going, state[g])
            if end == count:
                measurement.conclude(par, room[:0], task, rows[g], kept)

    return simulate


simulate = _build(sources_digest())
