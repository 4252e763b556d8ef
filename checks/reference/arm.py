# SPDX-License-Identifier: Apache-2.0
"""An arm's inverse dynamics, plainly: recursive Newton-Euler, every vector in the base's frame.

Own readers of URDF and of modified Denavit-Hartenberg tables, nothing of the fast model's: what
the two share is the physics. Source: Luh, Walker, Paul, J. Dyn. Syst. Meas. Control 102(2), 1980;
conventions of the table: Craig, Introduction to Robotics, section 3.4.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
import xml.etree.ElementTree as ElementTree

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Body:
    """What a joint carries as one rigid body, and how it hangs on the one before.

    Attributes:
        parent: Number of the body before, -1 for the base.
        turn: (3, 3) orientation of the joint's frame in the parent's where its position is 0.
        place: (3,) its origin there, m.
        axis: (3,) along which the joint acts, in its own frame.
        slides: Whether it slides along it instead of turning about it.
        mass: kg.
        moment: (3,) mass times centre of mass, kg m, in the joint's frame.
        inertia: (3, 3) about the joint's origin, kg m^2.
    """

    parent: int
    turn: Array
    place: Array
    axis: Array
    slides: bool = False
    mass: float = 0.0
    moment: Array = field(default_factory=lambda: np.zeros(3))
    inertia: Array = field(default_factory=lambda: np.zeros((3, 3)))


def about(axis: Array, angle: float | Array) -> Array:
    """Return (..., 3, 3) rotations by angles (...) [rad] about an axis of length 1 (Rodrigues)."""
    cross, turn = skew(axis), np.asarray(angle, dtype=float)[..., None, None]
    out: Array = np.eye(3) + np.sin(turn) * cross + (1.0 - np.cos(turn)) * (cross @ cross)
    return out


def skew(vector: Array) -> Array:
    """Return the matrix of the cross product with a vector (3,)."""
    x, y, z = vector
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def roll_pitch_yaw(angles: Sequence[float]) -> Array:
    """Return the rotation by roll, pitch and yaw [rad] about fixed axes, as a URDF means it."""
    out = np.eye(3)
    for axis, angle in zip(np.eye(3), angles, strict=True):
        out = about(axis, angle) @ out
    return out


def by_table(rows: Sequence[Mapping[str, float]], slides: Sequence[bool]) -> tuple[Body, ...]:
    """Return the bodies, without masses, of rows `a`, `alpha`, `d` and `theta` [m, rad]."""
    x, _, z = np.eye(3)
    return tuple(
        Body(
            number - 1,
            about(x, row['alpha']) @ about(z, row['theta']),
            row['a'] * x + about(x, row['alpha']) @ (row['d'] * z),
            z,
            sliding,
        )
        for number, (row, sliding) in enumerate(zip(rows, slides, strict=True))
    )


def with_inertials(bodies: Sequence[Body], values: Array) -> tuple[Body, ...]:
    """Return the bodies with mass, moments x y z and inertias xx xy yy xz yz zz, (N, 10)."""
    return tuple(
        Body(b.parent, b.turn, b.place, b.axis, b.slides, v[0], v[1:4], _symmetric(v[4:]))
        for b, v in zip(bodies, values, strict=True)
    )


def _symmetric(values: Array) -> Array:
    xx, xy, yy, xz, yz, zz = values
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def read_urdf(text: str, names: Sequence[str]) -> tuple[Body, ...]:
    """Return the bodies of a URDF; joints that are not named are locked at zero.

    Args:
        names: Joints, each behind the one that carries it.
    """
    root = ElementTree.fromstring(text)
    joints = [joint for joint in root.findall('joint') if joint.find('parent') is not None]
    above = {_end(joint, 'child'): joint for joint in joints}
    links = {str(link.get('name')): link for link in root.findall('link')}
    bodies: list[Body] = []
    for name in names:
        joint = next(j for j in joints if j.get('name') == name)
        parent, turn, place = _hung(_end(joint, 'parent'), above, names)
        own_turn, own_place = _origin(joint)
        axis = _numbers(joint.find('axis'), 'xyz', (1.0, 0.0, 0.0))
        bodies.append(
            Body(
                parent,
                turn @ own_turn,
                place + turn @ own_place,
                axis / np.linalg.norm(axis),
                joint.get('type') == 'prismatic',
                *_masses(name, links, above, names),
            )
        )
    return tuple(bodies)


def _hung(
    link: str, above: Mapping[str, ElementTree.Element], names: Sequence[str]
) -> tuple[int, Array, Array]:
    """Return the moving body that carries a link, and where the link is in its frame."""
    turn, place = np.eye(3), np.zeros(3)
    while link in above:
        joint = above[link]
        if joint.get('name') in names:
            return names.index(str(joint.get('name'))), turn, place
        own_turn, own_place = _origin(joint)
        turn, place = own_turn @ turn, own_place + own_turn @ place
        link = _end(joint, 'parent')
    return -1, turn, place


def _masses(
    name: str,
    links: Mapping[str, ElementTree.Element],
    above: Mapping[str, ElementTree.Element],
    names: Sequence[str],
) -> tuple[float, Array, Array]:
    """Return mass, moment and inertia of all links that hang fixed behind a joint."""
    mass, moment, inertia = 0.0, np.zeros(3), np.zeros((3, 3))
    for link, element in links.items():
        own = element.find('inertial')
        carrier, turn, place = _hung(link, above, names)
        if own is None or carrier != names.index(name):
            continue
        own_turn, own_place = _origin(own)
        m = float(_found(own.find('mass')).get('value', '0'))
        values = _found(own.find('inertia'))
        about_centre = _symmetric(
            np.array(
                [float(values.get(f'i{k}', '0')) for k in ('xx', 'xy', 'yy', 'xz', 'yz', 'zz')]
            )
        )
        whole = turn @ own_turn
        centre = place + turn @ own_place
        mass += m
        moment = moment + m * centre
        inertia = inertia + whole @ about_centre @ whole.T - m * skew(centre) @ skew(centre)
    return mass, moment, inertia


def _found(element: ElementTree.Element | None) -> ElementTree.Element:
    assert element is not None
    return element


def _end(joint: ElementTree.Element, which: str) -> str:
    return str(_found(joint.find(which)).get('link'))


def _numbers(element: ElementTree.Element | None, key: str, default: Sequence[float]) -> Array:
    text = None if element is None else element.get(key)
    return np.array(default if text is None else [float(part) for part in text.split()])


def _origin(element: ElementTree.Element) -> tuple[Array, Array]:
    origin = element.find('origin')
    angles = _numbers(origin, 'rpy', (0.0, 0.0, 0.0))
    return roll_pitch_yaw(list(angles)), _numbers(origin, 'xyz', (0.0, 0.0, 0.0))


def gravity_in_base(size: float, roll: float, pitch: float) -> Array:
    """Return the (3,) acceleration of free fall [m/s^2] in a base tilted by roll, then pitch."""
    down: Array = roll_pitch_yaw((roll, pitch, 0.0)).T @ np.array([0.0, 0.0, -size])
    return down


def inverse_dynamics(
    bodies: Sequence[Body], gravity: Array, position: Array, velocity: Array, acceleration: Array
) -> Array:
    """Return what the bodies ask of the joints, in one instant or in several.

    Args:
        bodies: Each behind the one that carries it.
        gravity: (3,) acceleration of free fall in the base, m/s^2.
        position: (D,) or (D, K), rad or m.

    Returns:
        (D,) or (D, K) N m or N.
    """
    count, instants = len(bodies), position.shape[1:]
    still = np.zeros((*instants, 3))
    frames: list[Array] = []
    origins: list[Array] = []
    axes: list[Array] = []
    # Angular velocity and acceleration of each frame, and its origin's acceleration less gravity.
    omegas: list[Array] = []
    alphas: list[Array] = []
    accels: list[Array] = []
    for n, body in enumerate(bodies):
        if body.parent < 0:
            frame, origin, omega, alpha, accel = np.eye(3), still, still, still, still - gravity
        else:
            p = body.parent
            frame, origin = frames[p], origins[p]
            omega, alpha, accel = omegas[p], alphas[p], accels[p]
        at, rate, change = (x[n][..., None] for x in (position, velocity, acceleration))
        turned = frame @ body.turn
        axis = turned @ body.axis + still
        arm = frame @ body.place + (axis * at if body.slides else still)
        accel = accel + np.cross(alpha, arm) + np.cross(omega, np.cross(omega, arm))
        if body.slides:
            accel = accel + axis * change + 2.0 * np.cross(omega, axis) * rate
        else:
            turned = turned @ about(body.axis, position[n])
            alpha = alpha + axis * change + np.cross(omega, axis) * rate
            omega = omega + axis * rate
        frames.append(turned)
        origins.append(origin + arm)
        axes.append(axis)
        omegas.append(omega)
        alphas.append(alpha)
        accels.append(accel)
    forces, torques = np.zeros((count, *instants, 3)), np.zeros((count, *instants, 3))
    out = np.empty((count, *instants))
    for n in reversed(range(count)):
        body, omega, alpha = bodies[n], omegas[n], alphas[n]
        moment = frames[n] @ body.moment
        inertia = frames[n] @ body.inertia @ np.swapaxes(frames[n], -1, -2)
        force = (
            body.mass * accels[n]
            + np.cross(alpha, moment)
            + np.cross(omega, np.cross(omega, moment))
        )
        swung = _times(inertia, omega)
        torque = _times(inertia, alpha) + np.cross(omega, swung) + np.cross(moment, accels[n])
        forces[n] += force
        torques[n] += torque
        out[n] = (axes[n] * (forces[n] if body.slides else torques[n])).sum(axis=-1)
        if body.parent >= 0:
            p = body.parent
            forces[p] += forces[n]
            torques[p] += torques[n] + np.cross(origins[n] - origins[p], forces[n])
    return out


def _times(matrix: Array, vector: Array) -> Array:
    """Return products of matrices (..., 3, 3) and vectors (..., 3)."""
    return np.asarray((matrix @ vector[..., None])[..., 0])
