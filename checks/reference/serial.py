# SPDX-License-Identifier: Apache-2.0
"""Arms whose joints follow their set-points: what their motors make, instant by instant.

Of every motor: (what links and counterbalance ask of it + J G^2 theta'') / G + friction, late in
the log. Links by recursive Newton-Euler (`arm.py`), counterbalances by the way of their two
anchors, couplings by the work that motors and joints have in common.
"""

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.interpolate import CubicSpline

from checks.reference import arm
from checks.reference.plant import Array, known_names, Log, Plant, Unmodelled
from checks.reference.simulate import late
from checks.reference.twin import Twin
from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.machine.machine import Machine

LINKS = (
    'link_mass',
    *(f'link_moment_{axis}' for axis in 'xyz'),
    *(f'link_inertia_{axes}' for axes in ('xx', 'xy', 'yy', 'xz', 'yz', 'zz')),
)
_DRIVES = (
    'drive_inertia',
    'coulomb_torque',
    'viscous_torque',
    'constant_force',
    'balance_force',
    'balance_rate',
)
_PAYLOAD = ('payload_mass', 'payload_x', 'payload_y', 'payload_z')


def serial_plant(machine: Machine, parameters: Mapping[str, float]) -> Plant:
    """Refuse: the motion of an arm is given here, so no effect can change it.

    Raises:
        IdentError: INVALID_GOAL.
    """
    raise IdentError(
        ErrorCode.INVALID_GOAL,
        'the joints of a simulated arm follow their set-points whatever acts on them, so effects '
        'have no place there; leave --effect out',
    )


def bodies_of(machine: Machine, parameters: Mapping[str, float]) -> tuple[arm.Body, ...]:
    """Return the links as described, with what parameters say otherwise.

    Args:
        parameters: `elbow.link_mass`, `elbow.link_moment_x` and so on, each as it is, not as far
            from the description's; `payload_mass` and its place.

    Raises:
        IdentError: BAD_MACHINE_FILE for a description that is no URDF.
    """
    text = machine.described(None).text('description')
    if text and '<robot' not in text:
        raise IdentError(
            ErrorCode.BAD_MACHINE_FILE,
            'geometry.description is no URDF, and an arm is simulated from a URDF or a table; '
            'give one',
        )
    bodies = arm.read_urdf(text, machine.drives) if text else _by_table(machine)
    values = np.array([_inertials(body) for body in bodies])
    for d, name in enumerate(machine.drives):
        for n, link in enumerate(LINKS):
            values[d, n] = parameters.get(f'{name}.{link}', values[d, n])
    mass, *place = (parameters.get(name, 0.0) for name in _PAYLOAD)
    cross = arm.skew(np.array(place))
    carried = arm.Body(
        -1, np.eye(3), np.zeros(3), np.zeros(3), False, mass, mass * np.array(place),
        -mass * cross @ cross,
    )  # fmt: skip
    values[-1] += _inertials(carried)
    return arm.with_inertials(bodies, values)


def _by_table(machine: Machine) -> tuple[arm.Body, ...]:
    rows = [
        {key: machine.number(f'dh_{key}', name) for key in ('a', 'alpha', 'd', 'theta')}
        for name in machine.drives
    ]
    return arm.by_table(rows, [kind == 'prismatic' for kind in machine.texts('joint')])


def _inertials(body: arm.Body) -> Array:
    i = body.inertia
    several = (i[0, 0], i[0, 1], i[1, 1], i[0, 2], i[1, 2], i[2, 2])
    return np.array([body.mass, *body.moment, *several])


def simulate_serial(
    machine: Machine,
    parameters: Mapping[str, float],
    position: Array,
    velocity: Array,
    effects: Sequence[Unmodelled] = (),
    rtol: float = 0.0,
    atol: float = 0.0,
    start: tuple[Array, Array] | None = None,
) -> Log:
    """Return what an arm's log holds whose joints follow set-points.

    Raises:
        IdentError: INVALID_GOAL with effects, UNKNOWN_PARAMETER, or as `bodies_of`.
    """
    if effects:
        serial_plant(machine, parameters)
    known_names(parameters, machine, ('measurement_delay', *_PAYLOAD, *_DRIVES, *LINKS))
    cycle = machine.number('cycle')
    time = cycle * np.arange(position.shape[1])
    acceleration = CubicSpline(time, velocity, axis=1)(time, 1)
    bodies = bodies_of(machine, parameters)
    fall = (machine.number(name) for name in ('free_fall', 'base_roll', 'base_pitch'))
    down = arm.gravity_in_base(*fall)
    asked = arm.inverse_dynamics(bodies, down, position, velocity, acceleration)
    joints = asked + _balance(machine, parameters, position)
    effort = _motors(machine, parameters, joints, velocity, acceleration)
    delay = np.full(len(machine.drives), parameters.get('measurement_delay', 0.0))
    logged = late(effort, delay, cycle)
    return Log(machine.drives, cycle, logged, position, velocity, effort, position)


def _own(machine: Machine, parameters: Mapping[str, float], name: str) -> Array:
    """Return (D,) a parameter of every drive, the machine file's where none is given."""
    stated = name in machine.constants and machine.stated(name)
    return np.array(
        [
            parameters.get(
                f'{drive}.{name}',
                parameters.get(name, machine.number(name, drive) if stated else 0.0),
            )
            for drive in machine.drives
        ]
    )


def _balance(machine: Machine, parameters: Mapping[str, float], position: Array) -> Array:
    """Return (D, K) what counterbalances ask, from the places of their anchors in a plane."""
    out = np.zeros_like(position)
    force, rate = (_own(machine, parameters, f'balance_{x}') for x in ('force', 'rate'))
    for d, drive in enumerate(machine.drives):
        base, reach, angle, stroke = (
            machine.number(f'balance_{x}', drive) for x in ('base', 'arm', 'angle', 'stroke')
        )
        if not base * reach:
            continue
        turned = position[d] - angle
        anchor = np.stack([reach * np.cos(turned), reach * np.sin(turned)])
        towards = np.array([[base], [0.0]]) - anchor
        length = np.hypot(*towards)
        way = length - abs(base - reach)
        pull = force[d] / (1.0 - way / stroke) + rate[d] * way
        line = towards / length
        # Moment of the pull on the link about the axis; the motor makes as much against it.
        out[d] = -pull * (anchor[0] * line[1] - anchor[1] * line[0])
    return out


def _motors(
    machine: Machine,
    parameters: Mapping[str, float],
    joints: Array,
    velocity: Array,
    acceleration: Array,
) -> Array:
    """Return (D, K) efforts of the motors by what is asked at the joints (D, K)."""
    drives = machine.drives
    efforts, speed, bend = joints.copy(), velocity.copy(), acceleration.copy()
    ratio = np.zeros((len(drives), len(drives)))
    for d, drive in enumerate(drives):
        if (other := machine.text('coupled_to', drive)) != 'none':
            ratio[d, drives.index(other)] = machine.number('coupling', drive)
    speed, bend = speed + ratio @ velocity, bend + ratio @ acceleration
    efforts[:] = np.linalg.solve(np.eye(len(drives)) + ratio.T, joints)
    gear = machine.numbers('gear_factor')[:, None]
    gear = np.where(np.isfinite(gear), gear, 1.0)
    inertia, coulomb, viscous, offset = (
        _own(machine, parameters, name)[:, None]
        for name in ('drive_inertia', 'coulomb_torque', 'viscous_torque', 'constant_force')
    )
    width = machine.numbers('coulomb_regularisation')[:, None]
    friction = coulomb * np.tanh(speed / width) + viscous * speed
    return np.asarray((efforts + inertia * gear**2 * bend) / gear + friction + offset)


TWIN = Twin('serial', serial_plant, simulate_serial)
