# SPDX-License-Identifier: Apache-2.0
"""Compiled kernels of the belt drive; the GIL is released in all of them.

Every candidate's numbers depend on itself only, not on its neighbours in the batch. Its cost,
eq. 2, is summed while the drive moves: no trajectory is stored. With y = phi1 - phi1d the
residuals are (phi1_measured - phi1d) - y and M1_measured + P y.
"""
# mypy: disable-error-code="operator,no-untyped-call,call-arg,var-annotated"
# `Lanes` values exist in compiled code only; to mypy they are untyped.

from functools import partial
import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ros2_ident import lanes
from ros2_ident.arrays import Array
from ros2_ident.compiled import compiled, digest_of
from ros2_ident.lanes import inlined, load, spread, store, WIDTH

Flags = NDArray[np.bool_]
Index = NDArray[np.intp]

_SOURCES = digest_of(Path(__file__).parent, Path(lanes.__file__))
cached = partial(compiled, sources=_SOURCES)
fused = partial(compiled, sources=_SOURCES, fastmath={'contract'})

# Columns of the constants, in the order of `belt_drive.CONSTANTS`.
EA, P, J1, J2, MASS, RADIUS, X0, L1, L2, L3 = range(10)
BLOCK = 16
# Rows of a block's table: cosines, sines and weights of three modes, then the gain.
COS, SIN, WEIGHT, GAIN, ROWS = 0, 3 * BLOCK, 6 * BLOCK, 9 * BLOCK, 10
# The recurrence d_(k+1) = 2 cos(w h) d_k - d_(k-1) loses digits as 1/sin(w h).
LEAST_SINE = 1e-2


@cached
def stiffnesses(c: Array) -> tuple[float, float, float]:
    """Return k_i r^2-free belt stiffnesses, eq. 11, of one candidate's constants (10,)."""
    return c[EA] / (c[L1] + c[X0]), c[EA] / (c[L2] - c[X0]), c[EA] / c[L3]


@cached
def one_mode_set(c: Array, square: Array, weight: Array) -> bool:
    """Write squared angular eigenfrequencies and weights (3,) of one candidate; False if unstable.

    det(K - w^2 M) = 0 is a cubic in w^2, eq. 22. Its coefficients are written out with the rigid
    motion's cancellation done by hand: without a controller the belt alone has a zero eigenvalue.
    Weight i is the part of mode i in the response of phi1 to a step of phi1d; they add up to 1.
    Without a controller the rigid motion has them all: phi1 stays where it is.
    """
    k1, k2, k3 = stiffnesses(c)
    r2 = c[RADIUS] * c[RADIUS]
    good = c[J1] > 0.0 and c[J2] > 0.0 and c[MASS] > 0.0 and c[P] >= 0.0 and r2 > 0.0
    if not (good and k1 > 0.0 and k2 > 0.0 and k3 > 0.0):
        for i in range(3):
            square[i] = math.nan
            weight[i] = math.nan
        return False
    # Entries of K, eq. 21, over the inertias: the matrix D = M^-1 K.
    p = c[P] / c[J1]
    d11 = r2 * (k1 + k3) / c[J1]
    d22 = r2 * (k2 + k3) / c[J2]
    d33 = (k1 + k2) / c[MASS]
    # Principal minors of the belt alone; each is a sum of positive terms.
    ring = k1 * k2 + k1 * k3 + k2 * k3
    m12 = r2 * r2 * ring / (c[J1] * c[J2])
    m13 = r2 * ring / (c[J1] * c[MASS])
    m23 = r2 * ring / (c[J2] * c[MASS])
    a = d11 + p + d22 + d33
    b = m12 + m13 + m23 + p * (d22 + d33)
    d = p * m23
    # Three real roots: the trigonometric form, then Newton's steps for the last digits.
    shift = a / 3.0
    q = max((a * a - 3.0 * b) / 9.0, 0.0)
    h = (2.0 * a * a * a - 9.0 * a * b + 27.0 * d) / 54.0
    root = math.sqrt(q)
    angle = math.acos(min(1.0, max(-1.0, h / (q * root)))) if q > 0.0 else 0.0
    for i in range(3):
        w = shift + 2.0 * root * math.cos((angle + 2.0 * math.pi * (i + 1)) / 3.0)
        w = max(w, 0.0)
        for _ in range(3):
            slope = (3.0 * w - 2.0 * a) * w + b
            if slope != 0.0:
                w -= (((w - a) * w + b) * w - d) / slope
        square[i] = w
    for i in range(2):
        for j in range(2 - i):
            if square[j] > square[j + 1]:
                square[j], square[j + 1] = square[j + 1], square[j]
    if p == 0.0:
        square[0] = 0.0
        weight[0], weight[1], weight[2] = 1.0, 0.0, 0.0
        return True
    # Squared first component of the unit eigenvectors from the minor without phi1:
    # v_i^2 = (w_i^2 - n1)(w_i^2 - n2) / prod (w_i^2 - w_j^2), n the minor's eigenvalues.
    for i in range(3):
        w = square[i]
        minor = (w - (d22 + d33)) * w + m23
        others = (w - square[(i + 1) % 3]) * (w - square[(i + 2) % 3])
        weight[i] = p / w * (minor / others if others != 0.0 else math.nan)
    return square[0] > 0.0 and math.isfinite(weight[0] + weight[1] + weight[2])


@fused
def modal_response(
    constants: Array, cycle: float, reference: Array, step_at: Index, step_by: Array
) -> Array:
    """Return phi1 and M1, (S, 2, K), of candidates (S, 10).

    Each mode's distance from the set-point, times its weight, turns in its phase plane; a step of
    the set-point shifts it. Their sum is phi1 - phi1d.
    """
    count, samples = constants.shape[0], reference.size
    out = np.empty((count, 2, samples))
    square, weight = np.empty(3), np.empty(3)
    for s in range(count):
        if not one_mode_set(constants[s], square, weight):
            out[s] = math.inf
            continue
        angle = np.sqrt(square) * cycle
        c0, c1, c2 = math.cos(angle[0]), math.cos(angle[1]), math.cos(angle[2])
        s0, s1, s2 = math.sin(angle[0]), math.sin(angle[1]), math.sin(angle[2])
        gain = constants[s, P]
        d0 = d1 = d2 = v0 = v1 = v2 = 0.0
        k = 0
        for segment in range(step_at.size):
            while k < step_at[segment]:
                y = d0 + d1 + d2
                out[s, 0, k] = reference[k] + y
                out[s, 1, k] = -gain * y
                d0, v0 = c0 * d0 + s0 * v0, c0 * v0 - s0 * d0
                d1, v1 = c1 * d1 + s1 * v1, c1 * v1 - s1 * d1
                d2, v2 = c2 * d2 + s2 * v2, c2 * v2 - s2 * d2
                k += 1
            by = step_by[segment]
            d0 -= by * weight[0]
            d1 -= by * weight[1]
            d2 -= by * weight[2]
    return out


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


@inlined
def _three(t, row, at):  # type: ignore[no-untyped-def]
    """Return a number of each mode."""
    return load(t, row + at), load(t, row + BLOCK + at), load(t, row + 2 * BLOCK + at)


@inlined
def _squares(t, at, phi1, torque, step_at, step_by, sums, turning):  # type: ignore[no-untyped-def]
    """Sum the candidates' squared residuals; three multiplications a sample move the modes.

    Where `turning` is True and not None, their phase planes turn: for restless set-points, and any
    sine.
    """
    zero = spread(0.0)
    c0, c1, c2 = _three(t, COS, at)
    s0, s1, s2 = _three(t, SIN, at)
    w0, w1, w2 = _three(t, WEIGHT, at)
    gain = load(t, GAIN + at)
    double0, double1, double2 = c0 + c0, c1 + c1, c2 + c2
    d0, d1, d2 = zero, zero, zero
    v0, v1, v2 = zero, zero, zero
    n0, n1, n2 = zero, zero, zero
    sum_phi1, sum_torque = zero, zero
    k = 0
    for segment in range(step_at.size):
        if turning is None:
            n0, n1, n2 = c0 * d0 + s0 * v0, c1 * d1 + s1 * v1, c2 * d2 + s2 * v2
        for j in range(k, step_at[segment]):
            y = d0 + d1 + d2
            error = spread(phi1[j]) - y
            sum_phi1 = sum_phi1 + error * error
            error = spread(torque[j]) + gain * y
            sum_torque = sum_torque + error * error
            if turning is None:
                d0, n0 = n0, double0 * n0 - d0
                d1, n1 = n1, double1 * n1 - d1
                d2, n2 = n2, double2 * n2 - d2
            else:
                d0, v0 = c0 * d0 + s0 * v0, c0 * v0 - s0 * d0
                d1, v1 = c1 * d1 + s1 * v1, c1 * v1 - s1 * d1
                d2, v2 = c2 * d2 + s2 * v2, c2 * v2 - s2 * d2
        k = step_at[segment]
        by = spread(step_by[segment])
        if turning is None:
            # Back to the phase plane, where the step is a shift.
            v0, v1, v2 = (n0 - c0 * d0) / s0, (n1 - c1 * d1) / s1, (n2 - c2 * d2) / s2
        d0, d1, d2 = d0 - by * w0, d1 - by * w1, d2 - by * w2
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
                _squares(table, at, phi1, torque, step_at, step_by, sums, True)
        else:
            for at in range(0, BLOCK, WIDTH):
                _squares(table, at, phi1, torque, step_at, step_by, sums, None)
        for lane in range(min(BLOCK, count - first)):
            cost = math.sqrt(sums[lane] / samples) + math.sqrt(sums[BLOCK + lane] / samples)
            out[first + lane] = 0.5 * cost if ok[lane] else math.inf
    return out
