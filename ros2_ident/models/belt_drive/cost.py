# SPDX-License-Identifier: Apache-2.0
"""The belt drive's cost, eq. 2, summed while the drive moves: no trajectory is stored.

Candidates share vector registers, see `ros2_ident.lanes`; the GIL is released. With the
distance y = phi1 - phi1d the two residuals are (phi1_measured - phi1d) - y and M1_measured + P y.
"""
# mypy: disable-error-code="operator,no-untyped-call,call-arg,var-annotated"
# `Lanes` values exist in compiled code only; to mypy they are untyped.

import math

from numba import njit
import numpy as np

from ros2_ident.arrays import Array
from ros2_ident.lanes import load, spread, store, WIDTH
from ros2_ident.models.belt_drive.kernels import cached, Flags, Index, one_mode_set, P

BLOCK = 16
# Rows of a block's table: cosines, sines and weights of three modes, then the gain.
COS, SIN, WEIGHT, GAIN, ROWS = 0, 3 * BLOCK, 6 * BLOCK, 9 * BLOCK, 10
# The recurrence d_(k+1) = 2 cos(w h) d_k - d_(k-1) loses digits as 1/sin(w h).
LEAST_SINE = 1e-2


@cached
def _fill(constants: Array, first: int, cycle: float, table: Array, ok: Flags) -> float:
    """Write one block's table and validity; return the least |sine| in it."""
    square = np.empty(3)
    part = np.empty(3)
    least = 1.0
    for lane in range(BLOCK):
        s = min(first + lane, constants.shape[0] - 1)
        good = one_mode_set(constants[s], square, part)
        ok[lane] = good
        for i in range(3):
            angle = math.sqrt(square[i]) * cycle if good else 1.0
            table[COS + i * BLOCK + lane] = math.cos(angle)
            table[SIN + i * BLOCK + lane] = math.sin(angle)
            table[WEIGHT + i * BLOCK + lane] = part[i] if good else 0.0
            least = min(least, abs(math.sin(angle)))
        table[GAIN + lane] = constants[s, P]
    return least


@njit(nogil=True, inline='always')
def _recurrence(
    t: Array, at: int, phi1: Array, torque: Array, step_at: Index, step_by: Array, sums: Array
) -> None:
    """Sum the candidates' squared residuals; three multiplications a sample move the modes."""
    zero = spread(0.0)
    c0 = load(t, COS + at)
    c1 = load(t, COS + BLOCK + at)
    c2 = load(t, COS + 2 * BLOCK + at)
    gain = load(t, GAIN + at)
    double0, double1, double2 = c0 + c0, c1 + c1, c2 + c2
    d0, d1, d2 = zero, zero, zero
    v0, v1, v2 = zero, zero, zero
    sum_phi1, sum_torque = zero, zero
    k = 0
    for segment in range(step_at.size):
        n0 = c0 * d0 + load(t, SIN + at) * v0
        n1 = c1 * d1 + load(t, SIN + BLOCK + at) * v1
        n2 = c2 * d2 + load(t, SIN + 2 * BLOCK + at) * v2
        for j in range(k, step_at[segment]):
            y = d0 + d1 + d2
            error = spread(phi1[j]) - y
            sum_phi1 = sum_phi1 + error * error
            error = spread(torque[j]) + gain * y
            sum_torque = sum_torque + error * error
            d0, n0 = n0, double0 * n0 - d0
            d1, n1 = n1, double1 * n1 - d1
            d2, n2 = n2, double2 * n2 - d2
        k = step_at[segment]
        by = spread(step_by[segment])
        # Back to the phase plane, where the step is a shift.
        v0 = (n0 - c0 * d0) / load(t, SIN + at)
        v1 = (n1 - c1 * d1) / load(t, SIN + BLOCK + at)
        v2 = (n2 - c2 * d2) / load(t, SIN + 2 * BLOCK + at)
        d0 = d0 - by * load(t, WEIGHT + at)
        d1 = d1 - by * load(t, WEIGHT + BLOCK + at)
        d2 = d2 - by * load(t, WEIGHT + 2 * BLOCK + at)
    store(sums, at, sum_phi1)
    store(sums, BLOCK + at, sum_torque)


@njit(nogil=True)
def _rotation(
    t: Array, at: int, phi1: Array, torque: Array, step_at: Index, step_by: Array, sums: Array
) -> None:
    """Do the same by turning the phase planes: for restless set-points, and any sine."""
    zero = spread(0.0)
    c0 = load(t, COS + at)
    c1 = load(t, COS + BLOCK + at)
    c2 = load(t, COS + 2 * BLOCK + at)
    s0 = load(t, SIN + at)
    s1 = load(t, SIN + BLOCK + at)
    s2 = load(t, SIN + 2 * BLOCK + at)
    gain = load(t, GAIN + at)
    d0, d1, d2 = zero, zero, zero
    v0, v1, v2 = zero, zero, zero
    sum_phi1, sum_torque = zero, zero
    k = 0
    for segment in range(step_at.size):
        for j in range(k, step_at[segment]):
            y = d0 + d1 + d2
            error = spread(phi1[j]) - y
            sum_phi1 = sum_phi1 + error * error
            error = spread(torque[j]) + gain * y
            sum_torque = sum_torque + error * error
            d0, v0 = c0 * d0 + s0 * v0, c0 * v0 - s0 * d0
            d1, v1 = c1 * d1 + s1 * v1, c1 * v1 - s1 * d1
            d2, v2 = c2 * d2 + s2 * v2, c2 * v2 - s2 * d2
        k = step_at[segment]
        by = spread(step_by[segment])
        d0 = d0 - by * load(t, WEIGHT + at)
        d1 = d1 - by * load(t, WEIGHT + BLOCK + at)
        d2 = d2 - by * load(t, WEIGHT + 2 * BLOCK + at)
    store(sums, at, sum_phi1)
    store(sums, BLOCK + at, sum_torque)


@cached
def modal_cost(
    constants: Array, cycle: float, phi1: Array, torque: Array, step_at: Index, step_by: Array
) -> Array:
    """Return the costs of candidates on the modal path.

    Args:
        constants: (S, 10).
        cycle: Sampling interval, s.
        phi1: (K,) measured phi1 less phi1d, rad.
        torque: (K,) measured M1, Nm.
        step_at: (C,) rising samples from which on the set-point is another; the last one is K.
        step_by: (C,) changes of the set-point there, rad.

    Returns:
        (S,) eq. 2; inf for a candidate that is no stable drive.
    """
    count, samples = constants.shape[0], phi1.size
    out = np.empty(count)
    table = np.empty(ROWS * BLOCK)
    sums = np.empty(2 * BLOCK)
    ok = np.empty(BLOCK, dtype=np.bool_)
    restless = step_at.size > samples // 8
    for first in range(0, count, BLOCK):
        least = _fill(constants, first, cycle, table, ok)
        if restless or least < LEAST_SINE:
            for at in range(0, BLOCK, WIDTH):
                _rotation(table, at, phi1, torque, step_at, step_by, sums)
        else:
            for at in range(0, BLOCK, WIDTH):
                _recurrence(table, at, phi1, torque, step_at, step_by, sums)
        for lane in range(min(BLOCK, count - first)):
            cost = math.sqrt(sums[lane] / samples) + math.sqrt(sums[BLOCK + lane] / samples)
            out[first + lane] = 0.5 * cost if ok[lane] else math.inf
    return out
