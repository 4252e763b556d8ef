# SPDX-License-Identifier: Apache-2.0
"""The belt drive by the matrix exponential of its first-order system, for any linear drive.

A check of the modal path of `models/belt_drive`, and a measure of what that gains.
"""
# mypy: disable-error-code="operator,no-untyped-call,call-arg,var-annotated"
# `Lanes` values exist in compiled code only; to mypy they are untyped.

from functools import partial
import math
from pathlib import Path
from typing import Any

from numba import njit
import numpy as np

from ros2_ident import lanes
from ros2_ident.arrays import Array
from ros2_ident.compiled import compiled, digest_of
from ros2_ident.lanes import load, spread, store, WIDTH
from ros2_ident.models.belt_drive import kernels
from ros2_ident.models.belt_drive.kernels import J1, J2, MASS, P, RADIUS, stiffnesses
from ros2_ident.models.belt_drive.model import BeltDrive

_SOURCES = digest_of(Path(__file__), Path(kernels.__file__), Path(lanes.__file__))
cached = partial(compiled, sources=_SOURCES)
fused = partial(compiled, sources=_SOURCES, fastmath={'contract'})


def step_reference(
    *, cycle: float = 2e-4, duration: float = 1.0, steps: int = 9, height: float = np.pi / 1800.0
) -> tuple[float, Array]:
    """Return a step-like set-point as in Fig. 5, its steps evenly spread over the duration.

    Args:
        cycle: Sampling interval, s.
        duration: Length, s.
        steps: Number of steps upwards.
        height: Height of a step, rad; 0.1 degrees by default.

    Returns:
        The interval, and (K,) the set-point from 0 to `duration`, both included.
    """
    count = round(duration / cycle) + 1
    at = [round(duration / cycle * (i + 1) / (steps + 1)) for i in range(steps)]
    change = np.zeros(count)
    np.add.at(change, at, height)
    return cycle, np.cumsum(change)


@cached
def modes(constants: Array) -> tuple[Array, Array]:
    """Return squared angular eigenfrequencies [1/s^2] and weights, each (S, 3), of (S, 10)."""
    square = np.empty((constants.shape[0], 3))
    weight = np.empty((constants.shape[0], 3))
    for s in range(constants.shape[0]):
        kernels.one_mode_set(constants[s], square[s], weight[s])
    return square, weight


def eigenfrequencies(belt: BeltDrive, theta: Array) -> Array:
    """Return the eigenfrequencies (S, 3) [Hz], rising, of candidates (S, N), eq. 22."""
    return np.sqrt(modes(belt.constants(theta))[0]) / (2.0 * np.pi)


def simulate_generic(belt: BeltDrive, theta: Array) -> Array:
    """Return (S, 2, K) as `BeltDrive.simulate` of candidates (S, N)."""
    full = belt.constants(theta)
    return matrix_response(transition_rows(full, belt.cycle), full[:, 1].copy(), belt.reference)


def cost_generic(belt: BeltDrive, theta: Array, measured: Array) -> Array:
    """Return (S,) as `BeltDrive.cost` of candidates (S, N) and measured outputs (2, K)."""
    full = belt.constants(theta)
    return matrix_cost(
        transition_rows(full, belt.cycle),
        full[:, 1].copy(),
        belt.reference,
        np.ascontiguousarray(measured[0]),
        np.ascontiguousarray(measured[1]),
        belt.reference[0],
    )


@cached
def matrices(constants: Array) -> tuple[Array, Array]:
    """Return the inertias (S, 3) and the stiffness matrix (S, 3, 3) of eq. 21, of (S, 10)."""
    count = constants.shape[0]
    mass, stiffness = np.empty((count, 3)), np.empty((count, 3, 3))
    for s in range(count):
        c = constants[s]
        k1, k2, k3 = stiffnesses(c)
        r = c[RADIUS]
        mass[s, 0], mass[s, 1], mass[s, 2] = c[J1], c[J2], c[MASS]
        stiffness[s, 0, 0] = r * r * (k1 + k3) + c[P]
        stiffness[s, 1, 1] = r * r * (k2 + k3)
        stiffness[s, 2, 2] = k1 + k2
        stiffness[s, 0, 1] = stiffness[s, 1, 0] = -r * r * k3
        # The sign of x as eqs. 10 and 21 are printed: the mass moves against the gears.
        stiffness[s, 0, 2] = stiffness[s, 2, 0] = r * k1
        stiffness[s, 1, 2] = stiffness[s, 2, 1] = r * k2
    return mass, stiffness


@cached
def _multiply(a: Array, b: Array, factor: float, out: Array) -> None:
    """Write factor a b, of square matrices; plain loops compile quickest."""
    size = a.shape[0]
    for i in range(size):
        for j in range(size):
            total = 0.0
            for k in range(size):
                total += a[i, k] * b[k, j]
            out[i, j] = total * factor


@cached
def matrix_exponential(matrix: Array) -> Array:
    """Return e^A of (S, n, n) matrices by scaling, a Taylor series and squaring.

    Reference:
        Moler and Van Loan (2003), SIAM Review 45, method 3. With the scaled norm below 1/4 the
        remainder after the 13th power is below 1e-19.
    """
    count, size = matrix.shape[0], matrix.shape[1]
    result = np.empty((count, size, size))
    scaled, power = np.empty((size, size)), np.empty((size, size))
    total = np.empty((size, size))
    for s in range(count):
        norm = 0.0
        for i in range(size):
            row = 0.0
            for j in range(size):
                row += abs(matrix[s, i, j])
            norm = max(norm, row)
        # A norm that is no number makes no squarings, and the result is none either.
        squarings = 0
        if math.isfinite(norm) and norm > 0.25:
            squarings = int(math.ceil(math.log2(norm * 4.0)))
        for i in range(size):
            for j in range(size):
                scaled[i, j] = matrix[s, i, j] * 0.5**squarings
                total[i, j] = 1.0 if i == j else 0.0
        # Horner: e^A = 1 + A (1 + A/2 (1 + A/3 (...))).
        for n in range(13, 0, -1):
            _multiply(scaled, total, 1.0 / n, power)
            for i in range(size):
                power[i, i] += 1.0
            total, power = power, total
        for _ in range(squarings):
            _multiply(total, total, 1.0, power)
            total, power = power, total
        for i in range(size):
            for j in range(size):
                result[s, i, j] = total[i, j]
    return result


@cached
def transition_rows(constants: Array, cycle: float) -> Array:
    """Return A and b side by side, (S, 6, 7), of z_(k+1) = A z_k + b phi1d_k.

    z holds the coordinates and the velocities over `speed`, which makes both alike in size: the
    exponential then needs few squarings.
    """
    count = constants.shape[0]
    mass, stiffness = matrices(constants)
    system = np.zeros((count, 7, 7))
    for s in range(count):
        # Nearly the geometric mean of the accelerations; a power of two keeps the scaling exact.
        largest = 1.0
        for i in range(3):
            largest = max(largest, abs(stiffness[s, i, i] / mass[s, i]))
        speed = 2.0 ** round(0.5 * math.log2(largest)) if math.isfinite(largest) else 1.0
        for i in range(3):
            system[s, i, 3 + i] = cycle * speed
            for j in range(3):
                system[s, 3 + i, j] = -stiffness[s, i, j] / mass[s, i] * (cycle / speed)
        # The set-point is a seventh state that stays constant over the sample.
        system[s, 3, 6] = constants[s, P] / mass[s, 0] * (cycle / speed)
    step = matrix_exponential(system)
    rows = np.empty((count, 6, 7))
    for s in range(count):
        for i in range(6):
            for j in range(7):
                rows[s, i, j] = step[s, i, j]
    return rows


@fused
def matrix_response(rows: Array, gain: Array, reference: Array) -> Array:
    """Return phi1 and M1, (S, 2, K), from `transition_rows` and the gains (S,)."""
    count, samples = rows.shape[0], reference.size
    out = np.empty((count, 2, samples))
    state, moved = np.empty(6), np.empty(6)
    start = reference[0]
    for s in range(count):
        for i in range(6):
            state[i] = 0.0
        for k in range(samples):
            u = reference[k] - start
            torque = gain[s] * (u - state[0])
            good = math.isfinite(torque)
            out[s, 0, k] = start + state[0] if good else math.inf
            out[s, 1, k] = torque if good else math.inf
            for i in range(6):
                total = rows[s, i, 6] * u
                for j in range(6):
                    total += rows[s, i, j] * state[j]
                moved[i] = total
            state, moved = moved, state
    return out


@njit(nogil=True, inline='always')
def _row(a: Array, at: int, z0: Any, z1: Any, z2: Any, z3: Any, z4: Any, z5: Any, u: Any) -> Any:
    """Return one row of A z + b u for a block's candidates; its numbers are rows from `at` on."""
    # Two short sums instead of a long one: the processor works on both at once.
    at = at * WIDTH
    left = load(a, at) * z0 + load(a, at + WIDTH) * z1 + load(a, at + 2 * WIDTH) * z2
    right = load(a, at + 3 * WIDTH) * z3 + load(a, at + 4 * WIDTH) * z4
    right = right + load(a, at + 5 * WIDTH) * z5
    return left + (right + load(a, at + 6 * WIDTH) * u)


@cached
def matrix_cost(
    rows: Array, gain: Array, reference: Array, phi1: Array, torque: Array, start: float
) -> Array:
    """Return the costs of candidates on the matrix path.

    Args:
        rows: (S, 6, 7) A and b side by side.
        gain: (S,) P, Nm/rad.
        reference: (K,) phi1d, rad.
        phi1: (K,) measured, rad.
        torque: (K,) measured, Nm.
        start: phi1d before the first sample: the drive rests there, rad.

    Returns:
        (S,) eq. 2; inf where the numbers overflow or are none.
    """
    count, samples = rows.shape[0], reference.size
    out = np.empty(count)
    a = np.empty(42 * WIDTH)
    p = np.empty(WIDTH)
    sums = np.empty(2 * WIDTH)
    for first in range(0, count, WIDTH):
        for lane in range(WIDTH):
            s = min(first + lane, count - 1)
            p[lane] = gain[s]
            for i in range(6):
                for j in range(7):
                    a[(i * 7 + j) * WIDTH + lane] = rows[s, i, j]
        g = load(p, 0)
        zero = spread(0.0)
        # Deviations from the first set-point, so that rest is zero whatever the candidate's
        # radius.
        z0, z1, z2, z3, z4, z5 = zero, zero, zero, zero, zero, zero
        sum_phi1, sum_torque = zero, zero
        for k in range(samples):
            u = spread(reference[k] - start)
            error = spread(phi1[k] - start) - z0
            sum_phi1 = sum_phi1 + error * error
            error = spread(torque[k]) - g * (u - z0)
            sum_torque = sum_torque + error * error
            n0 = _row(a, 0, z0, z1, z2, z3, z4, z5, u)
            n1 = _row(a, 7, z0, z1, z2, z3, z4, z5, u)
            n2 = _row(a, 14, z0, z1, z2, z3, z4, z5, u)
            n3 = _row(a, 21, z0, z1, z2, z3, z4, z5, u)
            n4 = _row(a, 28, z0, z1, z2, z3, z4, z5, u)
            n5 = _row(a, 35, z0, z1, z2, z3, z4, z5, u)
            z0, z1, z2, z3, z4, z5 = n0, n1, n2, n3, n4, n5
        store(sums, 0, sum_phi1)
        store(sums, WIDTH, sum_torque)
        for lane in range(min(WIDTH, count - first)):
            cost = math.sqrt(sums[lane] / samples) + math.sqrt(sums[WIDTH + lane] / samples)
            out[first + lane] = 0.5 * cost if math.isfinite(cost) else math.inf
    return out
