# SPDX-License-Identifier: Apache-2.0
"""The closed loop: discrete controllers, and the plant between their instants."""

import math

from numba import float64, int64
import numpy as np

from checks.reference import layout as at
from checks.reference.compiled import compiled
from checks.reference.drive_law import LAW
from checks.reference.dynamics import DriveLaw
from checks.reference.stepper import advance, STAGES

Array = np.ndarray[tuple[int, ...], np.dtype[np.float64]]

# Memory of one drive's controller.
INTEGRAL, SEEN, SEEN_ERROR, SEEN_FILTERED, SEEN_SPEED, MEMORY = range(6)


@compiled
def limited(torque: float, limit: float, knee: float) -> float:
    """Return a torque within +-limit: clipped (knee 0), or bent with the exponent `knee`."""
    if knee == 0.0:
        return min(limit, max(-limit, torque))
    bend: float = (1.0 + abs(torque / limit) ** knee) ** (1.0 / knee)
    return torque / bend


@compiled
def control(
    position: float, speed: float, target: float, target_speed: float, cycle: float,
    memory: Array, d: Array,
) -> float:  # fmt: skip
    """Run one controller cycle of one drive.

    Law 0: e_v = k_p (z_cmd - z) + k_ff z_cmd' - z', I += k_I e_v T, M = k_v e_v + I, limited.
    Law 1: M = k_v (k_p (z_cmd - z) + k_ff z_cmd' - w), limited; w is the backward difference of
    the mean of the last two readings (EMPS: Janot, Gautier, Brunot 2019).
    Law 2: u = k_p (q_ref - q) + k_v (k_ff q_ref' - q'), limited, a share of the supply.

    Args:
        position: Motor position read from the encoder [m].

    Returns:
        Torque [N m]; under law 2 the share of the supply [1].
    """
    law = d[at.LAW]
    seen = position
    quantum = d[at.ENCODER_STEP]
    if quantum > 0.0:
        seen = quantum * math.floor(position / quantum + 0.5 + d[at.ENCODER_PHASE])
        if d[at.ENCODER_VELOCITY] > 0.0:
            # The speed suffers, too: the reading's error is differentiated and smoothed by a lag.
            share = 1.0 - math.exp(-cycle / d[at.ENCODER_VELOCITY])
            error = seen - position
            memory[SEEN_SPEED] += share * (
                (error - memory[SEEN_ERROR]) / cycle - memory[SEEN_SPEED]
            )
            memory[SEEN_ERROR] = error
            speed += memory[SEEN_SPEED]
    if law == 1.0:
        mean = 0.5 * (seen + memory[SEEN])
        speed = (mean - memory[SEEN_FILTERED]) / cycle
        memory[SEEN_FILTERED] = mean
    memory[SEEN] = seen
    if law == 1.0:
        ahead = d[at.FEEDFORWARD] * target_speed
        torque = d[at.VELOCITY_GAIN] * (d[at.POSITION_GAIN] * (target - seen) + ahead - speed)
    elif law == 2.0:
        ahead = d[at.FEEDFORWARD] * target_speed
        torque = d[at.POSITION_GAIN] * (target - seen) + d[at.VELOCITY_GAIN] * (ahead - speed)
    else:
        error = d[at.POSITION_GAIN] * (target - seen) + d[at.FEEDFORWARD] * target_speed - speed
        memory[INTEGRAL] += d[at.INTEGRAL_GAIN] * error * cycle
        torque = d[at.VELOCITY_GAIN] * error + memory[INTEGRAL]
    limit = d[at.TORQUE_LIMIT]
    if d[at.TORQUE_FADE] != 0.0 or d[at.TORQUE_SKEW] != 0.0:
        fade = max(0.1, 1.0 - d[at.TORQUE_FADE] * abs(speed))
        limit *= fade * (1.0 + math.copysign(d[at.TORQUE_SKEW], torque))
    return limited(torque, limit, d[at.TORQUE_KNEE])


@compiled
def run(
    law: DriveLaw,
    target: Array,
    target_speed: Array,
    x: Array,
    memory: Array,
    shared: Array,
    drive: Array,
    rtol: float,
    atol: float,
    torque: Array,
    states: Array,
    tally: Array,
) -> int:
    """Simulate the closed loop.

    Args:
        x: (n,) state at the start, changed in place.
        memory: (D, MEMORY) controllers' memory at the start, changed in place.
        drive: (D, DRIVE_COLUMNS) the drives' numbers; the braking of a servo that is switched off
            is taken away.
        torque: (D, K) output: the controllers' torque [N m].
        states: (K, 2 (2D + 4)) output: positions and velocities at the controllers' instants.
        tally: (3,) output, see `stepper.advance`.

    Returns:
        Cycles done: fewer than K where the plant ran away.
    """
    count, cycles = target.shape
    m = 2 * count + 4
    cycle = shared[at.CYCLE]
    slopes = np.empty((STAGES + 1, x.size))
    matrix = np.empty((m, m))
    side = np.empty(m)
    held = np.empty(count)
    step = cycle
    for k in range(cycles):
        states[k] = x[: 2 * m]
        for i in range(count):
            # The encoder of a servo sits behind its gear.
            seen = i + count if drive[i, at.LAW] == 2.0 else i
            torque[i, k] = control(
                x[seen], x[m + seen], target[i, k], target_speed[i, k], cycle, memory[i], drive[i]
            )
            held[i] = torque[i, k]
            if drive[i, at.LAW] == 2.0:
                off = shared[at.RELEASE] > 0.0 and k * cycle >= shared[at.RELEASE] - 0.5 * cycle
                held[i] *= drive[i, at.DRIVE_GAIN]
                if off:
                    held[i] = torque[i, k] = drive[i, at.BACK_EMF] = 0.0
        if k + 1 < cycles:
            step = advance(
                law,
                k * cycle,
                (k + 1) * cycle,
                x,
                held,
                shared,
                drive,
                step,
                rtol,
                atol,
                slopes,
                matrix,
                side,
                tally,
            )
            if step < 0.0:
                return k + 1
    return cycles


_ROW, _TABLE = float64[::1], float64[:, ::1]
# What `compiled.settled` needs of `run`, before its first call.
RUN = int64(
    LAW, _TABLE, _TABLE, _ROW, _TABLE, _ROW, _TABLE, float64, float64, _TABLE, _TABLE, _ROW
)
