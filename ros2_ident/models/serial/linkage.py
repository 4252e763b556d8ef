# SPDX-License-Identifier: Apache-2.0
"""The rigid bodies of an arm in one instant, a block of candidates at once: mass matrix and load.

Every vector is in the frame of its own joint, whose z axis the joint turns about or slides along.
Load by recursive Newton-Euler, mass matrix by composite bodies. Source: Featherstone, Rigid Body
Dynamics Algorithms, Springer 2008, sections 5.3 and 6.2.
"""
# mypy: ignore-errors

from collections import namedtuple

from ros2_ident.lanes import (
    called,
    combined,
    cosine,
    inlined,
    load,
    load_three,
    sine_and_cosine,
    spread,
    sqrt,
    store,
    WIDTH,
)

W = WIDTH

# A tree of D joints, each behind the one that carries it.
#   size: (D,) a tuple, whose length the compiler knows: loops over joints are unrolled.
#   parents: (D,) joint that carries each, -1 for the base.
#   turns: (D, 9) orientation of a joint's frame in its parent's at position 0, row by row.
#   places: (D, 3) its origin there, m.
#   slides: (D,) whether it slides.
#   fall: (3,) acceleration of free fall in the base, m/s^2.
#   joints: (D, D) positions of the joints, in this order, by those of the motors; (0, 0)
#       where they are the same.
#   drives: (D, D) likewise in the order of the drives.
#   balances: (P, 5) counterbalances: joint, base, arm [m], angle [rad] and stroke [m], see
#       `parameters.Transmission`.
Tree = namedtuple('Tree', 'size parents turns places slides fall joints drives balances')

# Numbers of a link's inertial parameters: mass, first moments, inertias xx xy yy xz yz zz.
INERTIALS = 10
# Rows of a joint's room: two columns of its orientation, its origin, angular velocity and
# acceleration, acceleration of the origin, force, moment, and the composite body.
_TURN, _PLACE, _OMEGA, _ALPHA, _ACCELERATION, _FORCE, _MOMENT, _BODY = 0, 6, 9, 12, 15, 18, 21, 24
_ROWS = _BODY + INERTIALS
# Rows for each joint that `mass_and_load` works in.
ROOM = _ROWS + 3


@inlined
def _put(room, row, vector):
    store(room, row * W, vector[0])
    store(room, (row + 1) * W, vector[1])
    store(room, (row + 2) * W, vector[2])


@inlined
def _cross(a, b):
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@inlined
def _sum(a, b):
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@inlined
def _outwards(x, y, z, v):
    """Return a vector of the parent's frame in the joint's, whose axes are x, y and z there."""
    return (
        x[0] * v[0] + x[1] * v[1] + x[2] * v[2],
        y[0] * v[0] + y[1] * v[1] + y[2] * v[2],
        z[0] * v[0] + z[1] * v[1] + z[2] * v[2],
    )


@inlined
def _axes(tree, room, j):
    """Return the axes of a joint's frame in its parent's."""
    at = j * _ROWS + _TURN
    turn = tree.turns[j]
    z = spread(turn[2]), spread(turn[5]), spread(turn[8])
    return load_three(room, at), load_three(room, at + 3), z


@inlined
def _forces(par, base, j, omega, alpha, acceleration):
    """Return force and moment that move a link, about its joint's origin."""
    at = base + j * INERTIALS
    mass = load(par, at * W)
    centre = load_three(par, at + 1)
    xx, xy, yy = load_three(par, at + 4)
    xz, yz, zz = load_three(par, at + 7)
    turning = _cross(omega, centre)
    swung = _sum(_cross(alpha, centre), _cross(omega, turning))
    force = (
        mass * acceleration[0] + swung[0],
        mass * acceleration[1] + swung[1],
        mass * acceleration[2] + swung[2],
    )
    spin = (
        xx * omega[0] + xy * omega[1] + xz * omega[2],
        xy * omega[0] + yy * omega[1] + yz * omega[2],
        xz * omega[0] + yz * omega[1] + zz * omega[2],
    )
    turned = (
        xx * alpha[0] + xy * alpha[1] + xz * alpha[2],
        xy * alpha[0] + yy * alpha[1] + yz * alpha[2],
        xz * alpha[0] + yz * alpha[1] + zz * alpha[2],
    )
    moment = _sum(turned, _sum(_cross(omega, spin), _cross(centre, acceleration)))
    return force, moment


@inlined
def _motions(par, base, tree, place, rate, room):
    """Write orientations, motions and forces of all links whose joints do not accelerate."""
    for j in range(len(tree.size)):
        at = j * _ROWS
        turn = tree.turns[j]
        shift = tree.places[j]
        q = load(place, j * W)
        w = load(rate, j * W)
        z = spread(turn[2]), spread(turn[5]), spread(turn[8])
        if tree.slides[j]:
            x = spread(turn[0]), spread(turn[3]), spread(turn[6])
            y = spread(turn[1]), spread(turn[4]), spread(turn[7])
            r = shift[0] + q * turn[2], shift[1] + q * turn[5], shift[2] + q * turn[8]
        else:
            s, c = sine_and_cosine(q)
            x = c * turn[0] + s * turn[1], c * turn[3] + s * turn[4], c * turn[6] + s * turn[7]
            y = c * turn[1] - s * turn[0], c * turn[4] - s * turn[3], c * turn[7] - s * turn[6]
            r = spread(shift[0]), spread(shift[1]), spread(shift[2])
        _put(room, at + _TURN, x)
        _put(room, at + _TURN + 3, y)
        _put(room, at + _PLACE, r)
        parent = tree.parents[j]
        zero = spread(0.0)
        omega = zero, zero, zero
        alpha = zero, zero, zero
        moved = spread(-tree.fall[0]), spread(-tree.fall[1]), spread(-tree.fall[2])
        if parent >= 0:
            before = parent * _ROWS
            omega = load_three(room, before + _OMEGA)
            alpha = load_three(room, before + _ALPHA)
            swung = _sum(_cross(alpha, r), _cross(omega, _cross(omega, r)))
            moved = _sum(load_three(room, before + _ACCELERATION), swung)
            omega = _outwards(x, y, z, omega)
            alpha = _outwards(x, y, z, alpha)
        moved = _outwards(x, y, z, moved)
        if tree.slides[j]:
            moved = moved[0] + 2.0 * w * omega[1], moved[1] - 2.0 * w * omega[0], moved[2]
        else:
            alpha = alpha[0] + w * omega[1], alpha[1] - w * omega[0], alpha[2]
            omega = omega[0], omega[1], omega[2] + w
        _put(room, at + _OMEGA, omega)
        _put(room, at + _ALPHA, alpha)
        _put(room, at + _ACCELERATION, moved)
        force, moment = _forces(par, base, j, omega, alpha, moved)
        _put(room, at + _FORCE, force)
        _put(room, at + _MOMENT, moment)
        for n in range(INERTIALS):
            store(room, (at + _BODY + n) * W, load(par, (base + j * INERTIALS + n) * W))


@inlined
def _added(room, at, before, x, y, z, r):
    """Add a composite body to its parent's."""
    mass = load(room, (at + _BODY) * W)
    centre = combined(x, y, z, load_three(room, at + _BODY + 1))
    xx, xy, yy = load_three(room, at + _BODY + 4)
    xz, yz, zz = load_three(room, at + _BODY + 7)
    # Rows of the inertia, then columns, into the parent's axes.
    first = combined(x, y, z, (xx, xy, xz))
    second = combined(x, y, z, (xy, yy, yz))
    third = combined(x, y, z, (xz, yz, zz))
    a = combined(x, y, z, (first[0], second[0], third[0]))
    b = combined(x, y, z, (first[1], second[1], third[1]))
    c = combined(x, y, z, (first[2], second[2], third[2]))
    # About the parent's origin: h' = h + m r, and 2 h.r + m r.r less the products of both.
    half = centre[0] + mass * r[0], centre[1] + mass * r[1], centre[2] + mass * r[2]
    px = (centre[0] + half[0]) * r[0]
    py = (centre[1] + half[1]) * r[1]
    pz = (centre[2] + half[2]) * r[2]
    body = before + _BODY
    store(room, body * W, load(room, body * W) + mass)
    _put(room, body + 1, _sum(load_three(room, body + 1), half))
    upper = (
        a[0] + py + pz,
        a[1] - centre[0] * r[1] - half[1] * r[0],
        b[1] + px + pz,
    )
    lower = (
        a[2] - centre[0] * r[2] - half[2] * r[0],
        b[2] - centre[1] * r[2] - half[2] * r[1],
        c[2] + px + py,
    )
    _put(room, body + 4, _sum(load_three(room, body + 4), upper))
    _put(room, body + 7, _sum(load_three(room, body + 7), lower))


@inlined
def _column(tree, room, j, mass):
    """Write row and column `j` of the mass matrix, from the base up to the diagonal."""
    drives = len(tree.size)
    at = j * _ROWS + _BODY
    zero = spread(0.0)
    hx = load(room, (at + 1) * W)
    hy = load(room, (at + 2) * W)
    if tree.slides[j]:
        own = load(room, at * W)
        force = zero, zero, own
        moment = hy, -hx, zero
    else:
        own = load(room, (at + 9) * W)
        force = -hy, hx, zero
        moment = load(room, (at + 7) * W), load(room, (at + 8) * W), own
    for i in range(j):
        store(mass, (j * drives + i) * W, zero)
        store(mass, (i * drives + j) * W, zero)
    store(mass, (j * drives + j) * W, own)
    i = j
    while tree.parents[i] >= 0:
        x, y, z = _axes(tree, room, i)
        force = combined(x, y, z, force)
        pulled = _cross(load_three(room, i * _ROWS + _PLACE), force)
        moment = _sum(combined(x, y, z, moment), pulled)
        i = tree.parents[i]
        shared = force[2] if tree.slides[i] else moment[2]
        store(mass, (j * drives + i) * W, shared)
        store(mass, (i * drives + j) * W, shared)


@inlined
def _balance(par, base, tree, place, asked):
    """Add what counterbalances ask of their joints."""
    for n in range(tree.balances.shape[0]):
        joint = int(tree.balances[n, 0])
        a = tree.balances[n, 1]
        b = tree.balances[n, 2]
        force = load(par, (base + 2 * n) * W)
        rate = load(par, (base + 2 * n + 1) * W)
        turned = load(place, joint * W) - tree.balances[n, 3]
        length = sqrt(a * a + b * b - 2.0 * a * b * cosine(turned))
        sine_of, _ = sine_and_cosine(turned)
        way = length - abs(a - b)
        pull = force / (1.0 - way / tree.balances[n, 4]) + rate * way
        pulled = load(asked, joint * W) + a * b * sine_of * pull / (length + 1e-9)
        store(asked, joint * W, pulled)


@inlined
def _at_motors(tree, mass, asked, room):
    """Refer mass matrix and load of the joints to the motors, in place."""
    joints, drives = tree.joints, len(tree.size)
    for d in range(drives):
        total = spread(0.0)
        for e in range(drives):
            total = total + joints[e, d] * load(asked, e * W)
        store(room, d * W, total)
    for d in range(drives):
        store(asked, d * W, load(room, d * W))
    for side in range(2):
        for d in range(drives):
            for e in range(drives):
                total = spread(0.0)
                for n in range(drives):
                    total = total + load(mass, (d * drives + n) * W) * joints[n, e]
                store(room, e * W, total)
            for e in range(drives):
                store(mass, (d * drives + e) * W, load(room, e * W))
        if side == 0:
            for d in range(drives):
                for e in range(d):
                    kept = load(mass, (d * drives + e) * W)
                    store(mass, (d * drives + e) * W, load(mass, (e * drives + d) * W))
                    store(mass, (e * drives + d) * W, kept)


@called
def mass_and_load(par, base, tree, place, rate, mass, asked, room):
    """Write the mass matrix and the load of an arm whose joints do not accelerate.

    Args:
        par: (R * W,) rows of the candidates.
        base: Row of the first link's inertial parameters; behind those of all links follow force
            and rate of each counterbalance.
        tree: A `Tree`.
        place: (D * W,) positions of the motors, rad or m.
        rate: (D * W,) their rates.
        mass: (D * D * W,) gets the mass matrix, without rotors.
        asked: (D * W,) gets what the links ask of the motors, N m or N.
        room: (D * ROOM * W,) to work in.
    """
    drives = len(tree.size)
    spare = room[drives * _ROWS * W :]
    if tree.joints.shape[0]:
        for j in range(drives):
            q = spread(0.0)
            w = spread(0.0)
            for d in range(drives):
                q = q + tree.joints[j, d] * load(place, d * W)
                w = w + tree.joints[j, d] * load(rate, d * W)
            store(spare, j * W, q)
            store(spare, (drives + j) * W, w)
        place = spare[: drives * W]
        rate = spare[drives * W : 2 * drives * W]
    _motions(par, base, tree, place, rate, room)
    for back in range(drives):
        j = drives - 1 - back
        at = j * _ROWS
        force = load_three(room, at + _FORCE)
        moment = load_three(room, at + _MOMENT)
        store(asked, j * W, force[2] if tree.slides[j] else moment[2])
        _column(tree, room, j, mass)
        if tree.parents[j] >= 0:
            before = tree.parents[j] * _ROWS
            x, y, z = _axes(tree, room, j)
            r = load_three(room, at + _PLACE)
            force = combined(x, y, z, force)
            moment = _sum(combined(x, y, z, moment), _cross(r, force))
            _put(room, before + _FORCE, _sum(load_three(room, before + _FORCE), force))
            _put(room, before + _MOMENT, _sum(load_three(room, before + _MOMENT), moment))
            _added(room, at, before, x, y, z, r)
    _balance(par, base + drives * INERTIALS, tree, place, asked)
    if tree.joints.shape[0]:
        _at_motors(tree, mass, asked, spare[2 * drives * W :])


@called
def inverted(mass, size, room):
    """Turn a symmetric positive definite matrix (D * D * W,) into its inverse, in place.

    Row by row by the sweep operator; where it is not definite, what comes out is no number or
    diverges. Source: Goodnight, The American Statistician 33(3), 1979.

    Args:
        size: (D,) of a `Tree`.
        room: (D * W,) to work in.
    """
    drives = len(size)
    # Only the upper half is looked at; what comes out is less than nothing until the end.
    for k in range(drives):
        over = 1.0 / load(mass, (k * drives + k) * W)
        for i in range(k):
            store(room, i * W, load(mass, (i * drives + k) * W))
        for i in range(k + 1, drives):
            store(room, i * W, load(mass, (k * drives + i) * W))
        store(room, k * W, spread(0.0))
        for i in range(drives):
            share = load(room, i * W) * over
            for j in range(i, drives):
                left = load(mass, (i * drives + j) * W) - share * load(room, j * W)
                store(mass, (i * drives + j) * W, left)
        for i in range(k):
            store(mass, (i * drives + k) * W, load(room, i * W) * over)
        for i in range(k + 1, drives):
            store(mass, (k * drives + i) * W, load(room, i * W) * over)
        store(mass, (k * drives + k) * W, -over)
    for i in range(drives):
        for j in range(i, drives):
            entry = -load(mass, (i * drives + j) * W)
            store(mass, (i * drives + j) * W, entry)
            store(mass, (j * drives + i) * W, entry)
