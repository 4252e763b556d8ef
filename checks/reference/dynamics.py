# SPDX-License-Identifier: Apache-2.0
"""Equations of motion in redundant coordinates with the multipliers of the rods.

Coordinates of D drives: q = (z_1..D, S_1..D, p_x, p_y, p_z, y): motors relative to the frame,
carriages and platform in space, height of the frame. State x = (q, q', internal states of each
drive). Each rod asks for Phi_i = (|p - c_i|^2 - L_i^2) / 2 = 0; the accelerations and multipliers
mu_i = tension / L_i solve

    [ M  G^T ] [ a  ]   [ Q                 ]
    [ G  0   ] [ mu ] = [ -|p' - c_i'|^2    ]

with G the derivative of Phi. A uniform rod of mass m between points of velocity v_c and v_p has
the kinetic energy m/6 (v_c^2 + v_c v_p + v_p^2), so the mass matrix M stays constant in these
coordinates. Where the drives turn arms, S_i is the angle of an arm relative to the frame: the
joint c_i moves on a circle about a shaft that the frame lifts, which couples S_i, p and y in M.
"""

from collections.abc import Callable
import math

import numpy as np

from checks.reference import layout as at
from checks.reference.compiled import compiled
from checks.reference.drive_law import BESIDE, FORCES, FRICTION, LEVER, LOAD, TORQUE
from checks.reference.friction import window
from checks.reference.transmission import pull_of_arm

Array = np.ndarray[tuple[int, ...], np.dtype[np.float64]]
DriveLaw = Callable[[float, float, float, Array, Array, Array, Array, Array, Array], None]


@compiled
def eliminate(a: Array, b: Array) -> None:
    """Solve a x = b in place by Gauss's elimination with column pivots; b becomes x.

    Args:
        a: (n, n) matrix, overwritten.
        b: (n,) right side, overwritten by the solution.
    """
    n = b.size
    for c in range(n):
        pivot = c
        for r in range(c + 1, n):
            if abs(a[r, c]) > abs(a[pivot, c]):
                pivot = r
        if pivot != c:
            for j in range(c, n):
                a[c, j], a[pivot, j] = a[pivot, j], a[c, j]
            b[c], b[pivot] = b[pivot], b[c]
        for r in range(c + 1, n):
            factor = a[r, c] / a[c, c]
            if factor != 0.0:
                for j in range(c, n):
                    a[r, j] -= factor * a[c, j]
                b[r] -= factor * b[c]
    for r in range(n - 1, -1, -1):
        for j in range(r + 1, n):
            b[r] -= a[r, j] * b[j]
        b[r] /= a[r, r]


@compiled
def joint(i: int, place: float, shared: Array, drive: Array, out: Array) -> None:
    """Write where the joint of drive i and its rod is, relative to the frame.

    Args:
        out: (3, 3) output: the joint [m], its first and its second derivative by S_i.
    """
    d = drive[i]
    out[0, 0], out[0, 1], out[0, 2] = d[at.RAIL_X], d[at.RAIL_Y], place
    out[1:, :] = 0.0
    out[1, 2] = 1.0
    if shared[at.ROTARY] == 1.0:
        angle = place - d[at.ARM_ZERO]
        ahead, up = math.cos(angle), math.sin(angle)
        for j, length in enumerate((d[at.ARM_X], d[at.ARM_Y])):
            out[0, j] += length * ahead
            out[1, j] = -length * up
            out[2, j] = -length * ahead
        out[0, 2], out[1, 2] = d[at.ARM_RISE] * up, d[at.ARM_RISE] * ahead
        out[2, 2] = -d[at.ARM_RISE] * up


@compiled
def _height(above: float, q: Array, count: int, shared: Array) -> float:
    """Return the height of a joint in space [m]: carriages are there already, arms ride along."""
    height: float = above + q[2 * count + 3] if shared[at.ROTARY] == 1.0 else above
    return height


@compiled
def mass_and_rods(time: float, q: Array, shared: Array, drive: Array, matrix: Array) -> None:
    """Write the matrix [[M, G^T], [G, 0]] over (S_i, p, y, mu_i)."""
    count = drive.shape[0]
    rod = shared[at.ROD_MASS]
    height = count + 2  # row of p_z
    frame = count + 3
    matrix[:, :] = 0.0
    tool = shared[at.TOOL_MASS] + count * rod * shared[at.ROD_AT_PLATFORM]
    if shared[at.PAYLOAD] != 0.0:
        for turn in range(at.PAYLOAD_TURNS):
            begin, end = shared[at.PAYLOAD_FROM + 2 * turn], shared[at.PAYLOAD_FROM + 2 * turn + 1]
            if end > begin:
                tool += shared[at.PAYLOAD] * window(time, begin, end, shared[at.PAYLOAD_RAMP])
    for j in range(3):
        matrix[count + j, count + j] = tool
    matrix[frame, frame] = shared[at.FRAME_MASS] if shared[at.FRAME_MASS] > 0.0 else 1.0
    place = np.empty((3, 3))
    moved = shared[at.FRAME_MASS] > 0.0 and shared[at.ROTARY] == 1.0
    for i in range(count):
        joint(i, q[count + i], shared, drive, place)
        tangent = place[1]
        square = tangent[0] ** 2 + tangent[1] ** 2 + tangent[2] ** 2
        matrix[i, i] = drive[i, at.CARRIAGE_MASS] + rod * shared[at.ROD_AT_CARRIAGE] * square
        row = frame + 1 + i
        along = (
            q[2 * count] - place[0, 0],
            q[2 * count + 1] - place[0, 1],
            q[2 * count + 2] - _height(place[0, 2], q, count, shared),
        )
        reach = 0.0
        for j in range(3):
            reach += along[j] * tangent[j]
            matrix[i, count + j] = matrix[count + j, i] = rod * shared[at.ROD_BETWEEN] * tangent[j]
            matrix[row, count + j] = matrix[count + j, row] = along[j]
        matrix[row, i] = matrix[i, row] = -reach
        if moved:
            lifted = drive[i, at.ARM_MOMENT] * math.cos(q[count + i] - drive[i, at.ARM_ZERO])
            lifted += rod * shared[at.ROD_AT_CARRIAGE] * tangent[2]
            matrix[i, frame] = matrix[frame, i] = lifted
            matrix[frame, frame] += rod * shared[at.ROD_AT_CARRIAGE]
            matrix[frame, height] += rod * shared[at.ROD_BETWEEN]
            matrix[height, frame] = matrix[frame, height]
            matrix[row, frame] = matrix[frame, row] = -along[2]


@compiled
def weight_of_drive(i: int, place: float, shared: Array, drive: Array) -> float:
    """Return what gravity does to a drive's own body and its rod's end, per its acceleration.

    Returns:
        Mass [kg] of a carriage, first moment [kg m] of an arm, against the coordinate.
    """
    end = shared[at.ROD_MASS] * (1.0 - shared[at.ROD_CENTRE])
    d = drive[i]
    weight: float = d[at.CARRIAGE_MASS] + end
    if shared[at.ROTARY] == 1.0:
        weight = (d[at.ARM_MOMENT] + end * d[at.ARM_RISE]) * math.cos(place - d[at.ARM_ZERO])
    return weight


@compiled
def _turn(x: Array, shared: Array, drive: Array, side: Array) -> None:
    """Write what the rates make: of the rods' accelerations, and of the loads of turning arms.

    Args:
        side: (2D + 4,) loads; the rods' part is set, the others' changed.
    """
    count = drive.shape[0]
    m = 2 * count + 4
    frame = count + 3
    rod = shared[at.ROD_MASS]
    place = np.empty((3, 3))
    for i in range(count):
        joint(i, x[count + i], shared, drive, place)
        rate = x[m + count + i]
        row = frame + 1 + i
        for j in range(3):
            along = x[2 * count + j] - place[0, j]
            speed = x[m + 2 * count + j] - place[1, j] * rate
            if j == 2:
                along = x[2 * count + j] - _height(place[0, j], x, count, shared)
                speed -= x[2 * m - 1] if shared[at.ROTARY] == 1.0 else 0.0
            side[row] += along * place[2, j] * rate**2 - speed**2
            side[count + j] -= rod * shared[at.ROD_BETWEEN] * place[2, j] * rate**2
        if shared[at.ROTARY] == 1.0 and shared[at.FRAME_MASS] > 0.0:
            up = math.sin(x[count + i] - drive[i, at.ARM_ZERO])
            swing = -drive[i, at.ARM_MOMENT] * up + rod * shared[at.ROD_AT_CARRIAGE] * place[2, 2]
            side[frame] -= swing * rate**2
            side[frame] -= shared[at.GRAVITY] * rod * (1.0 - shared[at.ROD_CENTRE])


@compiled
def derivative(
    law: DriveLaw,
    time: float,
    x: Array,
    held: Array,
    shared: Array,
    drive: Array,
    matrix: Array,
    side: Array,
    dx: Array,
) -> None:
    """Write the time derivative of the state.

    Args:
        x: (n,) state; n = 2 (2D + 4), and where an effect has internal states those of each
            drive behind that.
        side: (2D + 4,) work space; holds the multipliers behind the accelerations on return.
    """
    count = drive.shape[0]
    m = 2 * count + 4
    dx[:m] = x[m : 2 * m]
    dx[m : 2 * m] = 0.0
    y = x[m - 1]
    y_rate = x[2 * m - 1]
    gravity = shared[at.GRAVITY]
    frame = count + 3
    rotary = shared[at.ROTARY] == 1.0
    side[:] = 0.0
    frame_load = 0.0
    delivered = 1.0
    if shared[at.SAG] != 0.0:
        power = 0.0
        for i in range(count):
            power += max(0.0, held[i] * x[m + i] * drive[i, at.GEAR])
        delivered = 1.0 / (1.0 + shared[at.SAG] * power)
    width = (x.size - 2 * m) // count
    motion = np.empty(4)
    forces = np.empty(FORCES)
    for i in range(count):
        d = drive[i]
        own = slice(2 * m + i * width, 2 * m + (i + 1) * width)
        motion[0] = x[i]
        motion[1] = x[m + i]
        motion[2] = x[count + i] - (0.0 if rotary else y)
        motion[3] = x[m + count + i] - (0.0 if rotary else y_rate)
        law(time, held[i], delivered, motion, shared, d, x[own], dx[own], forces)
        torque, friction, load = forces[TORQUE], forces[FRICTION], forces[LOAD]
        beside = forces[BESIDE]
        if shared[at.RIGID] == 1.0:
            moved = d[at.MOTOR_MASS] + d[at.CARRIAGE_MASS]
            weight = d[at.CARRIAGE_MASS] * gravity + pull_of_arm(motion[0], d)
            share = d[at.LOAD_SHARE]
            if share > 0.0:
                dx[m + count + i] = (load + beside) / (share * moved) - weight / moved
                beside = -load
                weight *= 1.0 - share
            force = d[at.GEAR] * (torque - friction) + beside - weight
            dx[m + i] = force / (moved * (1.0 - share))
            if share == 0.0:
                dx[m + count + i] = dx[m + i]
        else:
            driven = d[at.GEAR] * (torque - friction) - forces[LEVER] * load
            dx[m + i] = driven / d[at.MOTOR_MASS]
            held_up = gravity * weight_of_drive(i, x[count + i], shared, drive)
            side[i] = load + beside - held_up - pull_of_arm(motion[2], d)
            frame_load += 0.0 if rotary else load + beside
    if shared[at.RIGID] == 1.0:
        return
    if shared[at.PLATFORM] == 0.0:
        for i in range(count):
            dx[m + count + i] = side[i] / drive[i, at.CARRIAGE_MASS]
        return
    mass_and_rods(time, x, shared, drive, matrix)
    weight = matrix[count, count] + count * shared[at.ROD_MASS] * (
        shared[at.ROD_CENTRE] - shared[at.ROD_AT_PLATFORM]
    )
    side[count + 2] = -weight * gravity
    if shared[at.FRAME_MASS] > 0.0:
        softer = 0.0
        if shared[at.FRAME_SOFTENING] != 0.0:
            softer = shared[at.FRAME_SOFTENING] * y**2 / (shared[at.FRAME_GIVE] ** 2 + y**2)
        side[frame] = (
            shared[at.FRAME_PRELOAD]
            - frame_load
            - shared[at.FRAME_STIFFNESS] * y * (1.0 - softer)
            - (shared[at.FRAME_DAMPING] + shared[at.FRAME_QUADRATIC] * abs(y_rate)) * y_rate
        )
    _turn(x, shared, drive, side)
    eliminate(matrix, side)
    for j in range(count + 4):
        dx[m + count + j] = side[j]


@compiled
def project(
    time: float, x: Array, shared: Array, drive: Array, matrix: Array, side: Array
) -> float:
    """Pull positions and velocities back onto the rods by the shortest way, weighed by mass.

    Args:
        x: (n,) state, changed in place.

    Returns:
        The largest error of a rod's length before the correction [m].
    """
    count = drive.shape[0]
    m = 2 * count + 4
    worst = 0.0
    place = np.empty((3, 3))
    for sweep in range(3):
        mass_and_rods(time, x, shared, drive, matrix)
        side[:] = 0.0
        error = 0.0
        for i in range(count):
            length = drive[i, at.ROD_LENGTH]
            joint(i, x[count + i], shared, drive, place)
            square = (
                (x[2 * count] - place[0, 0]) ** 2
                + (x[2 * count + 1] - place[0, 1]) ** 2
                + (x[2 * count + 2] - _height(place[0, 2], x, count, shared)) ** 2
            )
            side[count + 4 + i] = 0.5 * (length * length - square)
            error = max(error, abs(side[count + 4 + i]) / length)
        if sweep == 0:
            worst = error
        if error < 2e-16:
            break
        eliminate(matrix, side)
        for j in range(count + 4):
            x[count + j] += side[j]
    mass_and_rods(time, x, shared, drive, matrix)
    side[:] = 0.0
    for i in range(count):
        row = count + 4 + i
        for j in range(count + 4):
            side[row] -= matrix[row, j] * x[m + count + j]
    eliminate(matrix, side)
    for j in range(count + 4):
        x[m + count + j] += side[j]
    return worst
