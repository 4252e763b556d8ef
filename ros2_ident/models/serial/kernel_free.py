# SPDX-License-Identifier: Apache-2.0
"""An arm under its controllers, all joints coupled, a block of candidates at once.

A joint and its motor are one mass. Mass matrix and load of the links are taken once a step, at the
mean of its predicted motion, and change over it as they did since the step before (error of second
order); the joints are integrated over it by a Runge-Kutta step of fourth order. A set-point holds
for a cycle; what controllers ask changes with the motion, also where it is asked whether friction
stops a joint within the step.
"""
# mypy: ignore-errors

from ros2_ident.kernel import drive as dk
from ros2_ident.kernel import measurement
from ros2_ident.kernel import runge_kutta as rk
from ros2_ident.kernel.hooks import sources_digest
from ros2_ident.kernel.rows import DRIVE, DRIVE_COUNT, MACHINE_COUNT, MEMORY, MEMORY_COUNT
from ros2_ident.lanes import (
    absolute,
    any_lane,
    called,
    clip,
    copied,
    inlined,
    kernel,
    load,
    maximum,
    parted,
    spread,
    store,
    where,
    WIDTH,
    with_sign,
)
from ros2_ident.models.serial.linkage import inverted, mass_and_load, ROOM

W = WIDTH
# Rounds in which friction of all joints settles at rest, at most: in each an error becomes smaller
# by how little the mass matrix couples them. What counts as settled, as a share of a friction, is
# beyond what a step's position shows.
ROUNDS, SETTLED = 64, 1e-9
# Where friction of a joint may turn over or let go, a cycle has so many times as many steps: the
# instant is known to a step, and the error of what follows falls with its square. A joint rests
# where it is slower than this acceleration [rad/s^2 or m/s^2] makes it in so long. Both by hand.
FINER, RESTS = 2, 1e-3
# Numbers of each joint that only a step needs, see `_step`.
_OF_STEP = 12 + rk.STAGES


def sizes(drives: int) -> tuple[int, int]:
    """Return how many numbers of a block go on from a part of the log to the next, and of room."""
    state = drives * (5 + drives + MEMORY_COUNT + measurement.KEPT) + 1
    own = drives * (_OF_STEP + drives + (1 + measurement.MOTIONS) * measurement.PIECE + ROOM)
    return W * state, W * (state + own + measurement.ROOM)


@inlined
def _of_links(par, d, place):
    """Return where the links are that motor `d` moves, by what its encoder says."""
    return place - load(par, (MACHINE_COUNT + d * DRIVE_COUNT + DRIVE.log_zero) * W)


@inlined
def _push(par, mem, on, z, v, carried, aim, push, pulls, d, now, elapsed):
    """Write the force [N m or N] on joint `d` besides what its links ask, and its part `pulls`.

    What a gear carries is that of the evaluation before; `elapsed` [s] is the cycle's time.
    """
    first = MACHINE_COUNT + d * DRIVE_COUNT
    own = d * MEMORY_COUNT
    torque = dk.motor_torque(
        par, first, mem, own, on[d], z, v, z, load(carried, d * W), now, elapsed,
        load(aim, d * W),
    )  # fmt: skip
    pull = dk.carriage_force(par, first, mem, own, on[d], z, v, z, now)
    store(push, d * W, load(par, (first + DRIVE.gear) * W) * torque + pull)
    store(pulls, d * W, pull)


@called
def _pushes(par, mem, on, mode, place, rate, carried, aim, push, pulls, time, elapsed):
    """Write the force on each joint, see `_push`.

    Joints that follow a recorded motion need none: their acceleration is what their links ask, see
    `_prescribed`.
    """
    # one body for all joints, in place of one each, compiles in four fifths of the time
    for d in range(mode.shape[0]):
        store(push, d * W, spread(0.0))
        store(pulls, d * W, spread(0.0))
        if mode[d] == dk.CLOSED_LOOP:
            z, v = load(place, d * W), load(rate, d * W)
            _push(par, mem, on, z, v, carried, aim, push, pulls, d, time + elapsed, elapsed)


@inlined
def _prescribed(mode, motion, k, count, mass, asked, size):
    """Put the recorded accelerations of joints into mass matrix and load of the others."""
    drives = len(size)
    for d in range(drives):
        if mode[d] != dk.CLOSED_LOOP:
            a = motion[(2 * drives + d) * count + k]
            for e in range(drives):
                shared = load(asked, e * W) + load(mass, (e * drives + d) * W) * a
                store(asked, e * W, shared)
                store(mass, (e * drives + d) * W, spread(0.0))
                store(mass, (d * drives + e) * W, spread(0.0))
            store(mass, (d * drives + d) * W, spread(1.0))
    for d in range(drives):
        if mode[d] != dk.CLOSED_LOOP:
            store(asked, d * W, spread(-motion[(2 * drives + d) * count + k]))


@inlined
def _gains(par, asked, d):
    """Return the gains of a joint's controller by position and rate; 0 where its torque is cut."""
    row = MACHINE_COUNT + d * DRIVE_COUNT
    free = absolute(load(asked, d * W)) < load(par, (row + DRIVE.torque_limit) * W)
    zero = spread(0.0)
    spring = where(free, load(par, (row + DRIVE.position_gain) * W), zero)
    return spring, where(free, load(par, (row + DRIVE.velocity_gain) * W), zero)


@inlined
def _answer(par, mode, asked, d):
    """Return by how much less joint `d` is pushed a unit further on, and how much a unit faster.

    By its controller and viscous friction.
    """
    if mode[d] != dk.CLOSED_LOOP:
        return spread(0.0), spread(0.0)
    row = MACHINE_COUNT + d * DRIVE_COUNT
    gear = load(par, (row + DRIVE.gear) * W)
    spring, brake = _gains(par, asked, d)
    return gear * spring, gear * (brake + load(par, (row + DRIVE.viscous) * W))


@called
def _stage(
    par, mem, on, mode, place, rate, bend, carried, aim, first, asked, commanded, push, pulls,
    size, time, since, part, h,
):  # fmt: skip
    """Write the force on each joint, as `_pushes` does, at a later stage of a step.

    From the step's beginning on a controller's torque changes by its gains. Of a joint without
    effects so does all else. At the first stage, `first` was the force, `asked` the controllers'
    torque, and `commanded` what effects left of it.
    """
    elapsed = since + rk.ahead(part) * h
    for d in range(mode.shape[0]):
        if mode[d] != dk.CLOSED_LOOP:
            continue
        row = MACHINE_COUNT + d * DRIVE_COUNT
        z, v = rk.stage_state(place, rate, bend, len(size), d, part, h)
        further = z - load(place, d * W)
        faster = v - load(rate, d * W)
        spring, brake = _gains(par, asked, d)
        less = spring * further + brake * faster
        if on[d] == 0 and not any_lane(load(par, (row + DRIVE.regularisation) * W) > spread(0.0)):
            less = less + load(par, (row + DRIVE.viscous) * W) * faster
            less = load(par, (row + DRIVE.gear) * W) * less
            store(push, d * W, load(first, d * W) - less)
        else:
            store(mem, (d * MEMORY_COUNT + MEMORY.commanded) * W, load(commanded, d * W) - less)
            _push(
                par, mem, on, z, v, carried, aim, push, pulls, d, time + elapsed, elapsed
            )  # fmt: skip


@inlined
def _of_joint(tree, motors, d):
    """Return position or rate of joint `d` by those of the motors."""
    if not tree.joints.shape[0]:
        return load(motors, d * W)
    total = spread(0.0)
    for e in range(len(tree.size)):
        total = total + tree.drives[d, e] * load(motors, e * W)
    return total


@inlined
def _net(push, asked, net, size):
    """Write the forces on joints less what their links ask."""
    for d in range(len(size)):
        store(net, d * W, load(push, d * W) - load(asked, d * W))


@inlined
def _times(inverse, forces, d, size):
    """Return what forces change of the acceleration of joint `d`."""
    total = spread(0.0)
    for e in range(len(size)):
        total = total + load(inverse, (d * len(size) + e) * W) * load(forces, e * W)
    return total


@called
def _hold(
    par, mem, on, mode, place, rate, carried, aim, shares, push, pulls, most, inverse, asked, size,
    time, since, h,
):  # fmt: skip
    """Write the mean directions of friction, -1..1, over a step of `h` seconds.

    For a share of it, written to `shares`, friction is against the motion at its beginning; from
    there on it stops as many joints at the step's end as it can, all of them together: Coulomb's
    set-valued law in an implicit Euler step, by projected Gauss-Seidel. Source: Kikuuwe et al.,
    Fixed-step friction simulation, IROS 2005. Room: `push`, `pulls` and `most`, for the largest
    friction [N m or N].
    """
    drives = len(size)
    zero = spread(0.0)
    for d in range(drives):
        store(aim, d * W, zero)
    _pushes(par, mem, on, mode, place, rate, carried, aim, most, pulls, time, since)
    _net(most, asked, shares, size)
    for d in range(drives):
        free = load(rate, d * W) + h * _times(inverse, shares, d, size)
        store(aim, d * W, with_sign(spread(1.0), free))
    _pushes(par, mem, on, mode, place, rate, carried, aim, push, pulls, time, since)
    _net(push, asked, shares, size)
    for d in range(drives):
        force = absolute(load(most, d * W) - load(push, d * W))
        sticks = dk.sticks(par, MACHINE_COUNT + d * DRIVE_COUNT)
        store(most, d * W, where(sticks, force, zero))
        # Rates at the step's end with all of it in these directions.
        store(pulls, d * W, load(rate, d * W) + h * _times(inverse, shares, d, size))
    turned = zero >= zero
    turn = 0
    while turn < ROUNDS and any_lane(turned):
        turn += 1
        turned = zero > zero
        for d in range(drives):
            v, limit = load(rate, d * W), load(most, d * W)
            own = h * load(inverse, (d * drives + d) * W)
            old, end = load(aim, d * W) * limit, load(pulls, d * W)
            against = with_sign(limit, v)
            # Until it stops friction is against the motion; that it could turn back tells when.
            reached = end + own * (old - against)
            share = absolute(v) / maximum(absolute(v - reached), spread(1e-300))
            share = where(reached * with_sign(spread(1.0), v) < zero, share, spread(1.0))
            store(shares, d * W, share)
            left = (1.0 - share) * limit
            wanted = old + end / where(own > zero, own, spread(1.0))
            new = clip(wanted, share * against - left, share * against + left)
            turned = turned | (absolute(new - old) > SETTLED * limit)
            share = new / maximum(limit, spread(1e-300))
            store(aim, d * W, where(limit > zero, share, load(aim, d * W)))
            for e in range(drives):
                rest = load(pulls, e * W)
                rest = rest - h * load(inverse, (e * drives + d) * W) * (new - old)
                store(pulls, e * W, rest)


@inlined
def _step(
    par, base, mem, on, mode, law, cycle, command, ahead, motion, delayed, tree, place, rate,
    drift, carried, last, room, torques, k, time, since, step, active,
):  # fmt: skip
    """Integrate over `step` seconds from `since` seconds into cycle `k` on, in active lanes.

    `drift` holds the accelerations at the end of the step before, `carried` what the gears carry,
    `last` the step before: its length, inverse of the mass matrix, and load; `torques` gets what
    the controllers ask for at its beginning.
    """
    size = tree.size
    drives = len(size)
    count = command.shape[0] // (2 * drives)
    aim, rest = parted(room, drives)
    push, rest = parted(rest, drives)
    pulls, rest = parted(rest, drives)
    spare, rest = parted(rest, drives)
    asked, rest = parted(rest, drives)
    first, rest = parted(rest, drives)
    commanded, rest = parted(rest, drives)
    mean, rest = parted(rest, drives)
    slope, rest = parted(rest, drives)
    early, rest = parted(rest, drives)
    net, rest = parted(rest, drives)
    bend, rest = parted(rest, rk.STAGES * drives)
    inverse, links = parted(rest, drives * drives)
    zero = spread(0.0)
    h = where(active, step, zero)
    half = 0.5 * h
    before, there = parted(last[W:], drives * drives)
    for d in range(drives):
        store(aim, d * W, with_sign(spread(1.0), load(rate, d * W)))
        if mode[d] == dk.CLOSED_LOOP:
            torque = dk.control(
                par, MACHINE_COUNT + d * DRIVE_COUNT, mem, d * MEMORY_COUNT, on[d], law[d], cycle,
                load(place, d * W), load(rate, d * W), command, d, drives, count, k, delayed,
                time + since, ahead, step, active,
            )  # fmt: skip
            store(torques, d * W, torque)
            store(commanded, d * W, load(mem, (d * MEMORY_COUNT + MEMORY.commanded) * W))
    # Friction against the motion is right where no joint turns over. Controllers answer to the
    # motion within the step: to the positions as the rates have it, to the rates implicitly.
    _pushes(par, mem, on, mode, place, rate, carried, aim, push, pulls, time, since)
    # Accelerations, and their change by the controllers, by the links of the step before; of a
    # joint that comes to rest those that bring it there.
    _net(push, there, net, size)
    for d in range(drives):
        v, a = load(rate, d * W), load(drift, d * W)
        if mode[d] == dk.CLOSED_LOOP:
            a = _times(before, net, d, size)
        store(slope, d * W, a)
        stops = ((v + h * a) * load(aim, d * W) < zero) | (absolute(v) <= RESTS * h)
        a = where(stops, -v / step, a)
        store(first, d * W, a)
        further, faster = _answer(par, mode, torques, d)
        store(mean, d * W, further * v + faster * a)
    third = h * (1.0 / 3.0)
    for d in range(drives):
        v, a = load(rate, d * W), load(first, d * W)
        jerk = zero
        if mode[d] == dk.CLOSED_LOOP:
            jerk = -_times(before, mean, d, size)
        passed = load(place, d * W) + half * (v + third * (a + 0.25 * h * jerk))
        store(spare, d * W, _of_links(par, d, passed))
        store(first, d * W, v + half * (a + third * jerk))
    mass_and_load(par, base, tree, spare, first, inverse, asked, links)
    for d in range(drives):
        mass = load(par, (MACHINE_COUNT + d * DRIVE_COUNT + DRIVE.motor_mass) * W)
        store(inverse, (d * drives + d) * W, load(inverse, (d * drives + d) * W) + mass)
    _prescribed(mode, motion, k, count, inverse, asked, size)
    heavy = links[: drives * drives * W]
    copied(inverse, heavy)
    inverted(inverse, size, spare)
    # What the links make of a force differs at the step's ends from its middle by this share of
    # the difference from the step before.
    grown = h / (h + load(last, 0))
    store(last, 0, where(active, step, load(last, 0)))
    _net(push, asked, net, size)
    for d in range(drives):
        a = _times(inverse, net, d, size)
        if mode[d] == dk.CLOSED_LOOP:
            a = a - grown * (a - load(slope, d * W))
        store(bend, d * W, a)
        further, _ = _answer(par, mode, torques, d)
        store(mean, d * W, load(asked, d * W) + half * further * load(rate, d * W))
    turned = zero > zero
    _net(push, mean, net, size)
    for d in range(drives):
        reached = load(rate, d * W) + h * _times(inverse, net, d, size)
        store(first, d * W, reached)
        turned = turned | (reached * load(aim, d * W) < zero)
    over = any_lane(turned)
    if over:
        copied(push, early)
        for d in range(drives):
            _, faster = _answer(par, mode, torques, d)
            at = (d * drives + d) * W
            store(heavy, at, load(heavy, at) + half * faster)
        inverted(heavy, size, spare)
        _hold(
            par, mem, on, mode, place, rate, carried, aim, first, push, pulls, spare, heavy, mean,
            size, time, since, h,
        )  # fmt: skip
        for d in range(drives):  # whatever other candidates do
            along = with_sign(spread(1.0), load(rate, d * W))
            store(aim, d * W, where(turned, load(aim, d * W), along))
        _pushes(par, mem, on, mode, place, rate, carried, aim, push, pulls, time, since)
        _net(push, asked, net, size)
        _net(push, there, spare, size)
        for d in range(drives):
            a = _times(inverse, net, d, size)
            if mode[d] == dk.CLOSED_LOOP:
                a = a - grown * (a - _times(before, spare, d, size))
            store(bend, d * W, a)
            # Friction acts before its mean where it turns over or comes to hold: on the way.
            more = load(first, d * W) * (load(early, d * W) - load(push, d * W))
            store(early, d * W, half * h * more)
    copied(push, first)
    for part in range(1, rk.STAGES):
        _stage(
            par, mem, on, mode, place, rate, bend, carried, aim, first, torques, commanded, push,
            pulls, size, time, since, part, h,
        )  # fmt: skip
        _net(push, asked, net, size)
        if part == rk.STAGES - 1:
            _net(push, there, spare, size)
        for d in range(drives):
            a = _times(inverse, net, d, size)
            if part == rk.STAGES - 1 and mode[d] == dk.CLOSED_LOOP:
                a = a + grown * (a - _times(before, spare, d, size))
            store(bend, (part * drives + d) * W, a)
    for n in range(drives * drives):
        store(before, n * W, where(active, load(inverse, n * W), load(before, n * W)))
    for d in range(drives):
        store(there, d * W, where(active, load(asked, d * W), load(there, d * W)))
    rk.finish(place, rate, bend, drives, drives, h)
    if over:
        for d in range(drives):
            store(place, d * W, load(place, d * W) + _times(inverse, early, d, size))
    for d in range(drives):
        a = load(bend, ((rk.STAGES - 1) * drives + d) * W)
        store(drift, d * W, where(active, a, load(drift, d * W)))
        rotor = load(par, (MACHINE_COUNT + d * DRIVE_COUNT + DRIVE.motor_mass) * W) * a
        geared = load(push, d * W) - load(pulls, d * W) - rotor
        store(carried, d * W, where(active, geared, load(carried, d * W)))


@inlined
def _finer(par, mode, on, rate, drift, cycle, size):
    """Return how many times as many steps a cycle has, for what friction may do in it."""
    turns = spread(0.0) > spread(0.0)
    for d in range(len(size)):
        if mode[d] == dk.CLOSED_LOOP:
            first = MACHINE_COUNT + d * DRIVE_COUNT
            slow = absolute(load(rate, d * W)) <= cycle * (absolute(load(drift, d * W)) + RESTS)
            rubs = dk.sticks(par, first)
            if on[d] == 0:
                rubs = rubs & (load(par, (first + DRIVE.coulomb) * W) > spread(0.0))
            turns = turns | (slow & rubs)
    return where(turns, spread(1.0 * FINER), spread(1.0))


@inlined
def _begun(
    par, base, mem, start, command, ahead, tree, law, cycle, place, rate, carried, last, room
):  # fmt: skip
    """Write the state at the log's beginning: gears carry, and integral parts ask, what holds."""
    drives = len(tree.size)
    count = command.shape[0] // (2 * drives)
    spare, links = parted(room, drives)
    mass, asked = parted(last[W:], drives * drives)
    store(last, 0, spread(1e300))  # the links' accelerations are taken to stay
    for d in range(drives):
        store(place, d * W, spread(start[d]))
        store(carried, d * W, _of_links(par, d, spread(start[d])))
    mass_and_load(par, base, tree, carried, rate, mass, asked, links)
    for d in range(drives):
        own = load(par, (MACHINE_COUNT + d * DRIVE_COUNT + DRIVE.motor_mass) * W)
        store(mass, (d * drives + d) * W, load(mass, (d * drives + d) * W) + own)
    inverted(mass, tree.size, spare)
    for d in range(drives):
        first, own = MACHINE_COUNT + d * DRIVE_COUNT, d * MEMORY_COUNT
        hold = load(asked, d * W) + load(par, (first + DRIVE.constant_load) * W)
        torque = dk.at_motor(par, first, hold)
        z, v = load(place, d * W), spread(start[drives + d])
        store(carried, d * W, hold)
        store(rate, d * W, v)
        dk.begin(mem, own, law[d], z, v, cycle, torque)
        error = command[d * count] - z
        wanted = load(par, (first + DRIVE.position_gain) * W) * error
        if ahead.shape[0]:
            wanted = wanted + ahead[d * count]
        there = load(par, (first + DRIVE.integral_gain) * W) > spread(0.0)
        store(mem, (own + MEMORY.integral) * W, where(there, torque - wanted, spread(0.0)))


def _build(digest):
    @kernel
    def simulate(
        group, room, begin, end, command, ahead, motion, start, mode, on, delayed, cycle, law,
        tree, task,
    ):  # fmt: skip
        """Simulate blocks of candidates; arguments as in the tripod's kernel, but for these.

        Args:
            group: A `Group`, its blocks (G, (R + B) * W), links behind the rows as `linkage` has
                them; its state and `room` as large as `sizes` has it.
            command: (2 * D * K,) set-point positions of the drives, then their rates.
            ahead: (D * K,) effort that the controllers add, known along the log; else (0,).
            motion: (3 * D * K,) recorded position, velocity and acceleration of prescribed drives,
                else empty.
            start: (2 * D,) where the drives start, then how fast.
            mode: (D,) CLOSED_LOOP or PRESCRIBED.
            on: (D,) flags of the effects.
            law: (D,) all PID.
            tree: A `linkage.Tree`.
        """
        _ = digest
        blocks, rows, substeps, state = group
        drives = len(tree.size)
        count = command.shape[0] // (2 * drives)
        base = MACHINE_COUNT + drives * DRIVE_COUNT
        going = room[: state.shape[1]]
        place, more = parted(room, drives)
        rate, more = parted(more, drives)
        drift, more = parted(more, drives)
        carried, more = parted(more, drives)
        last, more = parted(more, 1 + drives * (1 + drives))
        mem, more = parted(more, drives * MEMORY_COUNT)
        kept, rest = parted(more, drives * measurement.KEPT)
        torques, rest = parted(rest, drives * measurement.PIECE)
        moves, rest = parted(rest, 2 * drives * measurement.PIECE)
        late, rest = parted(rest, measurement.ROOM)
        logged, spare = parted(rest, drives)
        zero = spread(0.0)
        for g in range(blocks.shape[0]):
            par = blocks[g]
            if begin > 0:
                copied(state[g], going)
            else:
                going[:] = 0.0
                _begun(
                    par, base, mem, start, command, ahead, tree, law, cycle, place, rate, carried,
                    last, spare,
                )  # fmt: skip
            for k in range(begin, end):
                time = spread(k * cycle)
                piece = k % measurement.PIECE
                for d in range(drives):
                    if mode[d] != dk.CLOSED_LOOP:
                        store(place, d * W, spread(motion[d * count + k]))
                        store(rate, d * W, spread(motion[(drives + d) * count + k]))
                        store(drift, d * W, spread(motion[(2 * drives + d) * count + k]))
                if task.wanted.shape[0] > 1:
                    for d in range(drives):
                        at = d * measurement.PIECE + piece
                        store(moves, at * W, _of_joint(tree, place, d))
                        at = at + drives * measurement.PIECE
                        store(moves, at * W, _of_joint(tree, rate, d))
                steps = load(substeps[g], W)
                steps = steps * _finer(par, mode, on, rate, drift, cycle, tree.size)
                whole = cycle / steps
                sub = 0.0
                active = steps > zero
                while any_lane(active):
                    since = sub * whole
                    _step(
                        par, base, mem, on, mode, law, cycle, command, ahead, motion, delayed,
                        tree, place, rate, drift, carried, last, spare, logged, k, time, since,
                        whole, active,
                    )  # fmt: skip
                    if sub == 0.0:
                        for d in range(drives):
                            at = d * measurement.PIECE + piece
                            store(torques, at * W, load(logged, d * W))
                    for d in range(drives):
                        first, own = MACHINE_COUNT + d * DRIVE_COUNT, d * MEMORY_COUNT
                        z, v = load(place, d * W), load(rate, d * W)
                        dk.keep_step(par, first, mem, own, on[d], z, v, active)
                    sub += 1.0
                    active = steps > spread(sub)
                for d in range(drives):
                    first, own = MACHINE_COUNT + d * DRIVE_COUNT, d * MEMORY_COUNT
                    z, v = load(place, d * W), load(rate, d * W)
                    dk.keep_cycle(par, first, mem, own, on[d], z, v, z, time, cycle)
                full = piece == measurement.PIECE - 1 or k == end - 1
                if full and measurement.hand_on(
                    par, torques, moves, k - piece, piece + 1, cycle, task, rows[g], kept, late
                ):
                    break
            copied(going, state[g])
            if end == count:
                measurement.conclude(par, going[: 2 * drives * W], task, rows[g], kept)

    return simulate


simulate = _build(sources_digest())
