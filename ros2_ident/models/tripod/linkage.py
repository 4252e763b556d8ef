# SPDX-License-Identifier: Apache-2.0
"""Platform on three rods, seen from its drives: mass matrix and load, a block of candidates.

The drives' coordinates are the heights of carriages, or the angles of arms on shafts. Each drive's
joint moves along a tangent t; a rod r from the platform to it asks for r . p' = (r . t) s'.
"""
# mypy: ignore-errors

from ros2_ident.kernel.rows import DRIVE, DRIVE_COUNT, MACHINE, MACHINE_COUNT
from ros2_ident.lanes import combined, inlined, load, sine_and_cosine, sqrt, store, WIDTH

W = WIDTH

# Rows of the linkage block: inverse mass matrix 0-5 (11 22 33 12 13 23), load 6-8, coupling of the
# frame's acceleration 9-11, its own bias 12, the mass it carries 13.
LINKAGE = 14


@inlined
def _times(a, factor):
    return a[0] * factor, a[1] * factor, a[2] * factor


@inlined
def _dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@inlined
def _platform(par, mass, a1, a2, a3, bias, inertia, weight, frame, out):
    """Write the drives' mass matrix, inverted, their load and what a lifted frame does to them.

    All but the last two rows of `out` (LINKAGE * W,), where `frame` says that the frame can move.

    Args:
        par: Rows of the candidates.
        mass: Of the platform with its share of the rods [kg].
        a1: (3,) the platform's velocity per rate of the first drive; a2, a3: of the others.
        bias: (3,) the part of the platform's acceleration that the rates make [m/s^2].
        inertia: (3,) of the drives' own bodies [kg, or kg m^2].
        weight: (3,) what gravity does to them, per its acceleration [kg, or kg m].
    """
    gravity = load(par, MACHINE.gravity * W)
    r1, r2, r3 = inertia
    g1, g2, g3 = weight
    lifted = (bias[0], bias[1], bias[2] + gravity)
    store(out, 6 * W, mass * _dot(a1, lifted) + gravity * g1)
    store(out, 7 * W, mass * _dot(a2, lifted) + gravity * g2)
    store(out, 8 * W, mass * _dot(a3, lifted) + gravity * g3)
    p1, p2 = _times(a1, mass), _times(a2, mass)
    m11 = p1[0] * a1[0] + p1[1] * a1[1] + (p1[2] * a1[2] + r1)
    m22 = p2[0] * a2[0] + p2[1] * a2[1] + (p2[2] * a2[2] + r2)
    m33 = mass * _dot(a3, a3) + r3
    m12, m13, m23 = _dot(p1, a2), _dot(p1, a3), _dot(p2, a3)
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
        # The frame lifts everything: what its acceleration does to the drives is what gravity
        # does.
        store(out, 9 * W, g1 + mass * a1[2])
        store(out, 10 * W, g2 + mass * a2[2])
        store(out, 11 * W, g3 + mass * a3[2])


@inlined
def _inverse(rod1, rod2, rod3):
    """Return the columns of the inverse of the matrix of the rods, less its 1 / det, and that."""
    x1, y1, z1 = rod1
    x2, y2, z2 = rod2
    x3, y3, z3 = rod3
    first = (y2 * z3 - y3 * z2, z2 * x3 - z3 * x2, x2 * y3 - x3 * y2)
    second = (y3 * z1 - y1 * z3, z3 * x1 - z1 * x3, x3 * y1 - x1 * y3)
    third = (y1 * z2 - y2 * z1, z1 * x2 - z2 * x1, x1 * y2 - x2 * y1)
    return first, second, third, 1.0 / (x1 * first[0] + y1 * first[1] + z1 * first[2])


@inlined
def _depth(bx, by, qx, qy, length):
    """Return how far the first joint is above the platform, which hangs below all three.

    The rods (x, y, z): |q + b z|^2 + z^2 = L^2.
    """
    a = bx * bx + by * by + 1.0
    b = bx * qx + by * qy
    return (sqrt(b * b - a * (qx * qx + qy * qy - length * length)) - b) / a


@inlined
def on_rails(par, place, rate, tool, frame, out):
    """Write mass matrix and load of the linkage at carriages (3,) [m] and rates (3,) [m/s].

    s'' = inverse mass matrix (gear forces - load).
    """
    w1, w2, w3 = rate
    x, y = load(par, MACHINE.rail_x * W), load(par, MACHINE.rail_y * W)
    x_2, x_3 = load(par, MACHINE.rail_x_2 * W), load(par, MACHINE.rail_x_3 * W)
    y_2, y_3 = load(par, MACHINE.rail_y_2 * W), load(par, MACHINE.rail_y_3 * W)
    radius = load(par, MACHINE.rail_radius * W)
    length = load(par, MACHINE.rod_length * W)
    rod = load(par, MACHINE.mass_per_rod * W)
    u2 = place[1] - place[0]
    u3 = place[2] - place[0]
    inverse = load(par, MACHINE.rail_inverse_radius * W)
    bx = (x_2 * u2 + x_3 * u3) * inverse
    by = (y_2 * u2 + y_3 * u3) * inverse
    h2 = 0.5 * u2 * u2
    h3 = 0.5 * u3 * u3
    qx = (x_2 * h2 + x_3 * h3) * inverse - radius * x
    qy = (y_2 * h2 + y_3 * h3) * inverse - radius * y
    z1 = _depth(bx, by, qx, qy, length)
    z2 = z1 + u2
    z3 = z1 + u3
    x1 = -(qx + bx * z1)
    y1 = -(qy + by * z1)
    x2 = x1 + radius * load(par, MACHINE.rail_2_x * W)
    y2 = y1 + radius * load(par, MACHINE.rail_2_y * W)
    x3 = x1 + radius * load(par, MACHINE.rail_3_x * W)
    y3 = y1 + radius * load(par, MACHINE.rail_3_y * W)
    c1, c2, c3, over = _inverse((x1, y1, z1), (x2, y2, z2), (x3, y3, z3))
    # Columns of A = dp/ds.
    a1, a2, a3 = _times(c1, z1 * over), _times(c2, z2 * over), _times(c3, z3 * over)
    (ax1, ay1, az1), (ax2, ay2, az2), (ax3, ay3, az3) = a1, a2, a3
    vx = ax1 * w1 + ax2 * w2 + ax3 * w3
    vy = ay1 * w1 + ay2 * w2 + ay3 * w3
    vz = az1 * w1 + az2 * w2 + az3 * w3
    # The part of the platform's acceleration that the rates make.
    square = vx * vx + vy * vy
    e1 = (square + (w1 - vz) * (w1 - vz)) * over
    e2 = (square + (w2 - vz) * (w2 - vz)) * over
    e3 = (square + (w3 - vz) * (w3 - vz)) * over
    bias = combined(c1, c2, c3, (e1, e2, e3))
    # Each rod's mass is halved between its ends (Codourey 1998).
    mass = tool + 1.5 * rod
    r1 = load(par, (MACHINE_COUNT + DRIVE.rail_mass) * W) + 0.5 * rod
    r2 = load(par, (MACHINE_COUNT + DRIVE_COUNT + DRIVE.rail_mass) * W) + 0.5 * rod
    r3 = load(par, (MACHINE_COUNT + 2 * DRIVE_COUNT + DRIVE.rail_mass) * W) + 0.5 * rod
    _platform(par, mass, a1, a2, a3, bias, (r1, r2, r3), (r1, r2, r3), frame, out)
    if frame:
        store(out, 12 * W, mass * bias[2])
        store(out, 13 * W, r1 + r2 + r3 + mass)


@inlined
def _arm(par, d, angle, x, y):
    """Return foot, tangent and its derivative of an arm in the direction (x, y), and its weight.

    Its own first moment and half a rod's, times the share at which gravity turns it [kg m].
    """
    first = MACHINE_COUNT + d * DRIVE_COUNT
    arm = load(par, MACHINE.arm_length * W)
    sense = load(par, MACHINE.arm_sense * W)
    turned = angle - load(par, (first + DRIVE.arm_zero) * W)
    up, out = sine_and_cosine(turned)
    reach = arm * out
    rise = arm * up
    far = load(par, MACHINE.rail_radius * W) + reach
    foot = (far * x, far * y, sense * rise)
    tangent = (-rise * x, -rise * y, sense * reach)
    bend = (-reach * x, -reach * y, -sense * rise)
    own = load(par, (first + DRIVE.arm_moment) * W)
    moment = own + 0.5 * load(par, MACHINE.mass_per_rod * W) * arm
    return foot, tangent, bend, sense * moment * out, sense * moment * up


@inlined
def _reaction(rod, tangent, bend, v, w, over):
    """Return the share of a drive's rate in the platform's, and of its square in its bias."""
    x, y, z = v[0] - tangent[0] * w, v[1] - tangent[1] * w, v[2] - tangent[2] * w
    return (x * x + y * y + z * z + _dot(rod, bend) * w * w) * over


@inlined
def on_arms(par, place, rate, tool, frame, out):
    """Write mass matrix and load of the linkage at arms' angles (3,) [rad] and rates (3,) [rad/s].

    q'' = inverse mass matrix (gear torques - load).
    """
    w1, w2, w3 = rate
    x1, y1 = load(par, MACHINE.rail_x * W), load(par, MACHINE.rail_y * W)
    x2, y2 = x1 + load(par, MACHINE.rail_2_x * W), y1 + load(par, MACHINE.rail_2_y * W)
    x3, y3 = x1 + load(par, MACHINE.rail_3_x * W), y1 + load(par, MACHINE.rail_3_y * W)
    f1, t1, b1, g1, u1 = _arm(par, 0, place[0], x1, y1)
    f2, t2, b2, g2, u2 = _arm(par, 1, place[1], x2, y2)
    f3, t3, b3, g3, u3 = _arm(par, 2, place[2], x3, y3)
    across2 = (f2[0] - f1[0], f2[1] - f1[1], f2[2] - f1[2])
    across3 = (f3[0] - f1[0], f3[1] - f1[1], f3[2] - f1[2])
    # All rods have one length: the first one's product with the way to another foot is known.
    h2 = 0.5 * _dot(across2, across2)
    h3 = 0.5 * _dot(across3, across3)
    inverse = 1.0 / (across2[0] * across3[1] - across2[1] * across3[0])
    qx = (across3[1] * h2 - across2[1] * h3) * inverse
    qy = (across2[0] * h3 - across3[0] * h2) * inverse
    bx = (across3[1] * across2[2] - across2[1] * across3[2]) * inverse
    by = (across2[0] * across3[2] - across3[0] * across2[2]) * inverse
    z = _depth(bx, by, qx, qy, load(par, MACHINE.rod_length * W))
    rod1 = (-(qx + bx * z), -(qy + by * z), z)
    rod2 = (rod1[0] + across2[0], rod1[1] + across2[1], z + across2[2])
    rod3 = (rod1[0] + across3[0], rod1[1] + across3[1], z + across3[2])
    c1, c2, c3, over = _inverse(rod1, rod2, rod3)
    a1 = _times(c1, _dot(rod1, t1) * over)
    a2 = _times(c2, _dot(rod2, t2) * over)
    a3 = _times(c3, _dot(rod3, t3) * over)
    v = combined(a1, a2, a3, rate)
    e1 = _reaction(rod1, t1, b1, v, w1, over)
    e2 = _reaction(rod2, t2, b2, v, w2, over)
    e3 = _reaction(rod3, t3, b3, v, w3, over)
    bias = combined(c1, c2, c3, (e1, e2, e3))
    # Each rod's mass is halved between its ends (Codourey 1998).
    rod = load(par, MACHINE.mass_per_rod * W)
    arm = load(par, MACHINE.arm_length * W)
    half = 0.5 * rod * arm * arm
    mass = tool + 1.5 * rod
    r1 = load(par, (MACHINE_COUNT + DRIVE.rail_mass) * W) + half
    r2 = load(par, (MACHINE_COUNT + DRIVE_COUNT + DRIVE.rail_mass) * W) + half
    r3 = load(par, (MACHINE_COUNT + 2 * DRIVE_COUNT + DRIVE.rail_mass) * W) + half
    _platform(par, mass, a1, a2, a3, bias, (r1, r2, r3), (g1, g2, g3), frame, out)
    if frame:
        # The arms themselves count with the frame, but for what their turning makes.
        swing = u1 * w1 * w1 + u2 * w2 * w2 + u3 * w3 * w3
        store(out, 12 * W, mass * bias[2] - swing)
        store(out, 13 * W, mass + 1.5 * rod)
