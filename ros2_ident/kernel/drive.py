# SPDX-License-Identifier: Apache-2.0
"""One drive in one instant: controller, motor, friction and gear, with whichever effects are on.

Every function works on a block of candidates (see `ros2_ident.lanes`). Units are those of the
rows. `on` holds the flags of a drive's effects; None leaves their hooks out of what is compiled.
"""
# mypy: ignore-errors

from numba import types
from numba.extending import overload

from ros2_ident.effects import DriveState
from ros2_ident.kernel import hooks
from ros2_ident.kernel.hooks import KEEPING, MASK
from ros2_ident.kernel.rows import DRIVE, MEMORY
from ros2_ident.lanes import (
    absolute,
    clip,
    floor,
    INLINED,
    inlined,
    load,
    maximum,
    minimum,
    product,
    spread,
    store,
    take,
    tanh,
    where,
    WIDTH,
    with_sign,
)

W = WIDTH
CLOSED_LOOP, PRESCRIBED = 0, 1
VELOCITY_FROM_STATE, VELOCITY_FROM_POSITIONS, POSITION, PID = range(4)
# A motor this many regularisations fast does not feel how steep friction is at standstill.
FAST = 8.0
# Rounds to where a motor stands at rest: a wavering gear leaves a tenth of the error each.
STANDING = 6


def flags_of(on, d):
    """Return drive `d`'s flags; None where `on` is None, a type of its own to numba."""
    raise NotImplementedError('for kernels only')


@overload(flags_of, jit_options=INLINED)
def _flags_of(on, d):
    if isinstance(on, types.NoneType):
        return lambda on, d: None
    return lambda on, d: on[d]


@inlined
def closed_loop(mode, d):
    """Return whether drive `d` is a closed loop; all are where `mode` is None, when compiling."""
    if mode is None:
        return True
    return mode[d] == CLOSED_LOOP


@inlined
def drive_state(par, first, mem, own, z, v, s, force, direction, time, elapsed):
    """Collect what the kernels of effects see; the hooks add each effect's own memory."""
    return DriveState(
        z,
        v,
        s,
        force,
        direction,
        load(par, (first + DRIVE.coulomb) * W),
        load(par, (first + DRIVE.viscous) * W),
        load(par, (first + DRIVE.gear) * W),
        load(par, (first + DRIVE.motor_turn) * W),
        time,
        elapsed,
        z - load(mem, (own + MEMORY.anchor) * W),
        load(mem, (own + MEMORY.commanded) * W) - load(mem, (own + MEMORY.braking) * W) * v,
        spread(0.0),
    )


@inlined
def gear_force(par, first, mem, own, on, z, v, s, w, time):
    """Return the force [N] the gear passes to the carriage, and its reaction on the motor.

    By deflection and its rate. The two differ where the motor's lever on the gear wavers: the gear
    passes on power, not force.
    """
    x = z - s
    c = load(par, (first + DRIVE.gear_stiffness) * W)
    d = load(par, (first + DRIVE.gear_damping) * W)
    if on is not None and on & (MASK.DEFLECTION | MASK.STIFFNESS):
        zero = spread(0.0)
        state = drive_state(par, first, mem, own, z, v, s, zero, zero, time, zero)
        c = hooks.stiffness_hook(c, state, on, par, first, mem, own)
        if on & MASK.DEFLECTION:
            x, lever = hooks.deflection_hook((x, spread(1.0)), state, on, par, first, mem, own)
            # Teeth that do not touch do not damp.
            d = where(absolute(x) > zero, d, zero)
            force = c * x + d * (lever * v - w)
            return force, lever * force
    force = c * x + d * (v - w)
    return force, force


@inlined
def stand(par, first, mem, own, on, s, hold, far):
    """Return where a motor rests [m] whose gear carries `hold` [N] with its carriage at s.

    Looked for from `far` [m] ahead of the load: beyond a gap that is wide beside the gear's
    wind-up and, from nearby, would be crossed by no more than that in a round.
    """
    c = load(par, (first + DRIVE.gear_stiffness) * W)
    z = s + hold / c
    if on is not None and on & (MASK.DEFLECTION | MASK.STIFFNESS):
        zero = spread(0.0)
        z = z + with_sign(spread(far), hold)
        for _ in range(STANDING):
            state = drive_state(par, first, mem, own, z, zero, s, zero, zero, zero, zero)
            stiffness = hooks.stiffness_hook(c, state, on, par, first, mem, own)
            x, _ = hooks.deflection_hook((z - s, spread(1.0)), state, on, par, first, mem, own)
            z = z + hold / stiffness - x
    return z


@inlined
def motor_torque(par, first, mem, own, on, z, v, s, force, time, elapsed, held):
    """Return the torque [N m] that moves the motor and its gear: applied less friction.

    Whose direction is `held` where that is not None and friction has no regularisation.
    """
    direction = tanh(v * load(par, (first + DRIVE.friction_slope) * W))
    if held is not None:
        direction = where(sticks(par, first), held, direction)
    torque = load(mem, (own + MEMORY.commanded) * W)
    friction = (
        load(par, (first + DRIVE.coulomb) * W) * direction
        + load(par, (first + DRIVE.viscous) * W) * v
    )
    if on is not None and on:
        if on & MASK.SIGN:
            state = drive_state(par, first, mem, own, z, v, s, force, direction, time, elapsed)
            direction = hooks.sign_hook(direction, state, on, par, first, mem, own)
            friction = state.coulomb * direction + state.viscous * v
        state = drive_state(par, first, mem, own, z, v, s, force, direction, time, elapsed)
        friction = hooks.friction_hook(friction, state, on, par, first, mem, own)
        if on & MASK.TORQUE:
            state = drive_state(par, first, mem, own, z, v, s, force, direction, time, elapsed)
            torque = hooks.torque_hook(torque, state, on, par, first, mem, own)
    return torque - friction


@inlined
def sticks(par, first):
    """Return where friction holds at rest: it has no regularisation."""
    return load(par, (first + DRIVE.regularisation) * W) <= spread(0.0)


@inlined
def holding(par, first, mem, own, on, z, v, s, force, back, time, elapsed, drag, h):
    """Return the direction of friction, -1..1, over a step of `h` seconds.

    That which stops the motor at the step's end, as far as friction can: Coulomb's set-valued law
    in an implicit Euler step. Source: Kikuuwe et al., Fixed-step friction simulation, IROS 2005.

    Args:
        drag: What else brakes the motor [N m s/rad].
    """
    end = spread(0.0)
    free = v
    reached = v
    for turn in range(2):
        torque = motor_torque(par, first, mem, own, on, z, v, s, force, time, elapsed, end)
        bend = motor_acceleration(par, first, mem, own, torque - drag * v, back)
        reached = v + h * bend
        if turn == 0:
            free = reached
            end = with_sign(spread(1.0), free)
    most = maximum(absolute(free - reached), spread(1e-300))
    return end * minimum(absolute(free) / most, spread(1.0))


@inlined
def at_motor(par, first, force):
    """Return the torque [N m] at the motor that makes a force [N] at the rail."""
    return force * load(par, (first + DRIVE.gear_inverse) * W)


@inlined
def motor_acceleration(par, first, mem, own, torque, back):
    """Return the acceleration [m/s^2] of a motor on which the gear pushes back with `back` [N]."""
    force = load(par, (first + DRIVE.gear) * W) * torque - back
    return force * load(mem, (own + MEMORY.lightness) * W)


@inlined
def prescribed_torque(
    par, first, mem, own, on, z, v, s, mass, acceleration, force, back, time
):  # fmt: skip
    """Return the torque [N m] that it takes to follow a recorded motion; none is commanded."""
    zero = spread(0.0)
    store(mem, (own + MEMORY.commanded) * W, zero)
    friction = -motor_torque(par, first, mem, own, on, z, v, s, force, time, zero, None)
    return at_motor(par, first, mass * acceleration + back) + friction


@inlined
def carriage_force(par, first, mem, own, on, z, v, s, time):
    """Return the force [N] on the carriage besides gear, gravity and rod."""
    force = -load(par, (first + DRIVE.constant_load) * W)
    if on is not None and on & MASK.CARRIAGE_FORCE:
        zero = spread(0.0)
        state = drive_state(par, first, mem, own, z, v, s, zero, zero, time, zero)
        force = hooks.carriage_hook(force, state, on, par, first, mem, own)
    return force


@inlined
def keep_step(par, first, mem, own, on, z, v, active):
    """Write, after a step, what effects on friction's direction remember, in active lanes."""
    if on & KEEPING.SIGN:
        zero = spread(0.0)
        state = drive_state(par, first, mem, own, z, v, z, zero, zero, zero, zero)
        direction = tanh(v * load(par, (first + DRIVE.friction_slope) * W))
        hooks.sign_keeps(direction, state, on, par, first, mem, own, active)
        anchor = load(mem, (own + MEMORY.anchor) * W)
        store(mem, (own + MEMORY.anchor) * W, where(active, z, anchor))


@inlined
def keep_cycle(par, first, mem, own, on, z, v, s, time, cycle):
    """Write, at a cycle's end, what effects on friction remember."""
    if on & KEEPING.FRICTION:
        zero = spread(0.0)
        direction = tanh(v * load(par, (first + DRIVE.friction_slope) * W))
        state = drive_state(par, first, mem, own, z, v, s, zero, direction, time, spread(cycle))
        friction = state.coulomb * direction + state.viscous * v
        hooks.friction_keeps(friction, state, on, par, first, mem, own, None)


@inlined
def fast_from(par, first):
    """Return the rate [m/s] from which a motor does not feel how steep friction is."""
    return FAST * load(par, (first + DRIVE.regularisation) * W)


@inlined
def set_point(command, base, count, k, delay, cycle, delayed):
    """Return the set-point of cycle `k`, late by `delay` seconds where a delay is on."""
    if not delayed:
        return spread(command[base + k])
    at = clip(spread(float(k)) - delay * (1.0 / cycle), spread(0.0), spread(count - 1.000001))
    whole = floor(at)
    before = take(command, whole + float(base))
    after = take(command, whole + float(base + 1))
    return before + (after - before) * (at - whole)


@inlined
def sag(par, first, law, hold):
    """Return how far [m] below its set-point a motor rests whose gear carries `hold` [N].

    Without an integral part the position error has to hold a load.
    """
    if law != VELOCITY_FROM_POSITIONS:
        return spread(0.0)
    gain = load(par, (first + DRIVE.position_gain) * W)
    return at_motor(par, first, hold) / (gain * load(par, (first + DRIVE.velocity_gain) * W))


@inlined
def begin(mem, own, law, z, v, cycle, torque):
    """Write what a drive remembers: it came to z at rate v, and `torque` [N m] was commanded."""
    integral = spread(0.0) if law == VELOCITY_FROM_POSITIONS else torque
    store(mem, (own + MEMORY.integral) * W, integral)
    hooks.command_begun(mem, own, torque)
    store(mem, (own + MEMORY.anchor) * W, z)
    store(mem, (own + MEMORY.last_read) * W, z - v * cycle)
    store(mem, (own + MEMORY.last_but_one) * W, z - 2.0 * v * cycle)


@inlined
def _kept(mem, row, value, active):
    """Write a number that is remembered, in active lanes; in all of them where None."""
    if active is not None:
        value = where(active, value, load(mem, row * W))
    store(mem, row * W, value)


@inlined
def control(
    par, first, mem, own, on, law, cycle, z, v, command, d, drives, count, k, delayed, time, ahead,
    step, active,
):  # fmt: skip
    """Run cycle `k` of drive `d`'s controller; return the torque it logs, keep what it asks.

    Under the law POSITION that is a share of the supply voltage.

    `command` (2 * drives * count,) holds the set-points of all drives, then their rates. `ahead`
    (drives * count,) is what the controllers add to their torque; empty or None for nothing.
    The law runs every `step` seconds; but for what is asked, only lanes that are `active`
    remember, all of them where None.
    """
    delay = load(par, (first + DRIVE.set_point_delay) * W)
    zc = set_point(command, d * count, count, k, delay, cycle, delayed)
    vc = set_point(command, (drives + d) * count, count, k, delay, cycle, delayed)
    read = z
    rate = v
    if on is not None and on & MASK.READING:
        zero = spread(0.0)
        state = drive_state(par, first, mem, own, z, v, z, zero, zero, time, zero)
        read = hooks.reading_hook(z, state, on, par, first, mem, own)
        error = read - z
        rate = v + (error - load(mem, (own + MEMORY.read_error) * W)) * (1.0 / step)
        _kept(mem, own + MEMORY.read_error, error, active)
    if law == VELOCITY_FROM_POSITIONS:
        # Half the sum of two readings, differenced over a cycle: (q[k] - q[k-2]) / (2 cycle).
        rate = (read - load(mem, (own + MEMORY.last_but_one) * W)) * (0.5 / cycle)
        store(mem, (own + MEMORY.last_but_one) * W, load(mem, (own + MEMORY.last_read) * W))
        store(mem, (own + MEMORY.last_read) * W, read)
    # Not fused: which of the two products the compiler would fuse is its own choice.
    wanted = product(load(par, (first + DRIVE.position_gain) * W), zc - read)
    within = spread(0.0)
    if law in (POSITION, PID):
        late = load(par, (first + DRIVE.feedforward) * W) * vc - rate
        torque = wanted + load(par, (first + DRIVE.velocity_gain) * W) * late
        if law == PID:
            torque = torque + load(mem, (own + MEMORY.integral) * W)
            growth = load(par, (first + DRIVE.integral_gain) * W) * step
            growth = growth * (zc - read - (0.5 * step) * v)
            within = 0.5 * growth
            integral = load(mem, (own + MEMORY.integral) * W) + growth
            _kept(mem, own + MEMORY.integral, integral, active)
    else:
        error = wanted + load(par, (first + DRIVE.feedforward) * W) * vc - rate
        before = load(mem, (own + MEMORY.integral) * W)
        integral = before + load(par, (first + DRIVE.integral_gain) * W) * cycle * error
        store(mem, (own + MEMORY.integral) * W, integral)
        torque = load(par, (first + DRIVE.velocity_gain) * W) * error + integral
    if ahead is not None and ahead.shape[0]:
        torque = torque + ahead[d * count + k]
    limit = load(par, (first + DRIVE.torque_limit) * W)
    torque = clip(torque, -limit, limit)
    # What is integrated within the step acts in it, by half.
    meant = clip(torque + within, -limit, limit)
    asked = meant
    if on is not None and on & MASK.COMMAND:
        zero = spread(0.0)
        state = drive_state(par, first, mem, own, z, v, z, zero, zero, time, spread(step))
        asked = hooks.command_hook(meant, state, on, par, first, mem, own)
        hooks.command_keeps(meant, state, on, par, first, mem, own, active)
    store(mem, (own + MEMORY.commanded) * W, asked)
    return torque
