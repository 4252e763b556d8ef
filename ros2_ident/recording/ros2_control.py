# SPDX-License-Identifier: Apache-2.0
"""The messages of ros2_control that say what joints do, beside sensor_msgs/JointState.

Definitions: control_msgs (noetic-devel, humble, jazzy) and trajectory_msgs. The releases differ
only after what is read here, so that no definition of the bag is needed.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any

import numpy as np
from scipy.interpolate import BPoly

from ros2_ident.errors import IdentError
from ros2_ident.recording.cdr import Block, Cursor, Layout, Parse, parse_layout, typestore
from ros2_ident.recording.cdr import JOINT_STATE as JOINT_STATE
from ros2_ident.recording.limits import require_memory
from ros2_ident.recording.streams import FIELDS, FloatArray, IntArray

CONTROLLER_STATE = 'control_msgs/msg/JointTrajectoryControllerState'
DYNAMIC_STATE = 'control_msgs/msg/DynamicJointState'
ARRAY = 'std_msgs/msg/Float64MultiArray'
TRAJECTORY = 'trajectory_msgs/msg/JointTrajectory'

# Roles that each kind of message can have; the first kinds are taken first where one is missing.
ROLES_OF: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        JOINT_STATE: ('state', 'effort', 'command'),
        DYNAMIC_STATE: ('state', 'effort'),
        CONTROLLER_STATE: ('state', 'effort', 'command'),
        TRAJECTORY: ('command',),
        ARRAY: ('command', 'effort', 'state'),
    }
)

def parser(kind: str, role: str, names: Sequence[str] = ()) -> Parse:
    """Return what finds a role's values in messages of a kind.

    Args:
        kind: One of `ROLES_OF`, but for trajectories, which are no samples.
        names: What the numbers of an array are: joints, or `joint/velocity` as ros2_control has
            it. By itself a joint is its position, in an array of efforts its effort.
    """
    if kind == CONTROLLER_STATE:
        return lambda data: _controller_state(data, role)
    if kind == DYNAMIC_STATE:
        return _dynamic_state
    if kind == ARRAY:
        named = _array_names(names, 'effort' if role == 'effort' else 'position')
        return lambda data: _array(data, named)
    return parse_layout


def offers(kind: str, data: bytes) -> tuple[str, ...]:
    """Return the roles for which a message holds values without being told anything.

    Args:
        kind: One of `ROLES_OF`.
    """
    if kind == TRAJECTORY:
        return ROLES_OF[kind]
    found = []
    for role in ROLES_OF.get(kind, ()):
        try:
            layout = parser(kind, role)(data)
        except (ValueError, IdentError):
            return ()
        position, _, effort = layout.places
        wanted = effort if role == 'effort' else position
        if layout.names and wanted is not None and (wanted >= 0).any():
            found.append(role)
    return tuple(found)


def _read_point(cursor: Cursor) -> tuple[IntArray | None, ...]:
    """Pass over a JointTrajectoryPoint; return places of its fields, the effort last."""
    fields = tuple(cursor.doubles() for _ in range(4))
    cursor.skip(8, 4)  # time_from_start
    return fields


def _controller_state(data: bytes, role: str) -> Layout:
    """Find a role in a controller's state: set-point, measured values, error, output.

    The set-point was called `desired` and the measured values `actual`; there was no output then,
    and the message ended after the error.
    """
    cursor = Cursor(data)
    cursor.header()
    names = cursor.names()
    points = [_read_point(cursor) for _ in range(3)]
    if len(data) - cursor.at > 8:
        points.append(_read_point(cursor))
    which = {'command': 0, 'state': 1, 'effort': 3}[role]
    position, velocity, _, effort = points[which] if which < len(points) else (None,) * 4
    if role == 'effort':
        position = velocity = None
    return Layout(names, (position, velocity, effort), cursor.fixed, cursor.big)


def _dynamic_state(data: bytes) -> Layout:
    """Find what each joint's interfaces hold; other hardware than joints is left out."""
    cursor = Cursor(data)
    cursor.header()
    joints = cursor.names()
    if cursor.count() != len(joints):
        raise ValueError('not as many interfaces as joints')
    rows: list[list[int]] = []
    names: list[str] = []
    for joint in joints:
        interfaces, values = cursor.names(), cursor.doubles()
        where = {} if values is None else dict(zip(interfaces, values.tolist(), strict=True))
        if any(x in where for x in FIELDS):
            names.append(joint)
            rows.append([where.get(x, -1) for x in FIELDS])
    cursor.end()
    return _layout(names, np.reshape(rows, (-1, len(FIELDS))).astype(np.int64), cursor)


def _array_names(names: Sequence[str], default: str) -> list[tuple[str, str]]:
    """Return joint and field of each number of an array."""
    pairs = []
    for name in names:
        joint, _, field = name.rpartition('/')
        pairs.append((joint, field) if joint and field in FIELDS else (name, default))
    return pairs


def _array(data: bytes, named: Sequence[tuple[str, str]]) -> Layout:
    """Find the numbers of an array, which has neither names nor a stamp."""
    cursor = Cursor(data)
    for _ in range(cursor.count()):  # the dimensions
        cursor.text(free=True)
        cursor.skip(8, 4)
    cursor.skip(4, 4)
    values = cursor.doubles()
    cursor.end()
    found = [] if values is None else values.tolist()
    if len(found) != len(named):
        raise ValueError(f'{len(named)} names but an array of {len(found)} values')
    joints = list(dict.fromkeys(joint for joint, _ in named))
    table = np.full((len(joints), len(FIELDS)), -1)
    for (joint, field), place in zip(named, found, strict=True):
        table[joints.index(joint), FIELDS.index(field)] = place
    return replace(_layout(joints, table, cursor), stamp=None)


def _layout(joints: Sequence[str], places: IntArray, cursor: Cursor) -> Layout:
    """Return a layout by the places (D, 3) of fields, -1 where there is none."""
    position, velocity, effort = (x if (x >= 0).any() else None for x in places.T)
    return Layout(tuple(joints), (position, velocity, effort), cursor.fixed, cursor.big)


# A trajectory is a few points; joint_trajectory_controller runs through them by a polynomial
# through all that two neighbouring points state (linear, cubic or quintic), from the last
# set-point on and until the next trajectory begins (ros2_controllers, trajectory.cpp).

# The set-point is sampled so often, ns.
PERIOD = 1_000_000
# Points closer than this stand at one time, s.
_CLOSE = 1e-9


@dataclass(frozen=True)
class Trajectory:
    """A trajectory for some joints.

    Attributes:
        start: When it begins, ns; its arrival where the message does not say.
        names: The D joints.
        time: Times of its points (P,), s after the start, increasing.
        knots: Position, and velocity and acceleration where stated, (P, 1 to 3, D), in rad or m
            and s.
    """

    start: int
    names: tuple[str, ...]
    time: FloatArray
    knots: FloatArray


def parse_trajectory(data: bytes, arrival: int) -> Trajectory:
    """Read one serialised JointTrajectory.

    Args:
        data: The message with its four bytes of encapsulation.
        arrival: When it came, ns.

    Raises:
        ValueError: The bytes are no JointTrajectory, or it can not be followed.
    """
    try:
        sent: Any = typestore().deserialize_cdr(data, TRAJECTORY)
    except Exception as exc:  # generated code lets whatever damaged bytes cause through
        raise ValueError('no JointTrajectory') from exc
    names, stamp = tuple(sent.joint_names), sent.header.stamp
    if not sent.points or not names or len(set(names)) != len(names):
        raise ValueError('no points or joints')
    after = [x.time_from_start for x in sent.points]
    time = np.array([x.sec + 1e-9 * x.nanosec for x in after])
    stated = [(x.positions, x.velocities, x.accelerations) for x in sent.points]
    # as many derivatives as every point states, from the position on
    depth = min(next((k for k in range(3) if not x[k].size), 3) for x in stated)
    sizes = {row.size for x in stated for row in x[:depth]}
    if sizes != {len(names)}:
        said = ' and '.join(map(str, sorted(sizes))) or 'no'
        raise ValueError(f'{len(names)} names but positions of {said} joints')
    knots = np.array([x[:depth] for x in stated])
    if not np.isfinite(knots).all() or (np.diff(time) < _CLOSE).any() or time[0] < 0.0:
        raise ValueError('times of points that do not increase, or values that are no numbers')
    return Trajectory(stamp.sec * 1_000_000_000 + stamp.nanosec or arrival, names, time, knots)


def set_points(trajectories: Sequence[Trajectory]) -> list[Block]:
    """Return the set-point that a controller makes of trajectories, sampled evenly.

    Args:
        trajectories: In the order in which they came; those for the same joints replace each
            other from their start on.

    Returns:
        One block for each set of joints: stamps, positions (T, D) and velocities (T, D).

    Raises:
        IdentError: BAD_VALUES where it would take more memory than allowed.
    """
    groups: dict[tuple[str, ...], list[Trajectory]] = {}
    for trajectory in trajectories:
        groups.setdefault(trajectory.names, []).append(trajectory)
    return [_followed(group) for group in groups.values()]


def _followed(trajectories: Sequence[Trajectory]) -> Block:
    """Return the set-point made of trajectories for the same joints."""
    names = trajectories[0].names
    last = max(x.start + round(1e9 * x.time[-1]) for x in trajectories)
    first = trajectories[0].start + round(1e9 * trajectories[0].time[0])
    needed = 3 * (16 * len(names) * (last - first) // PERIOD)
    require_memory('the set-point of the trajectories takes', needed)
    stamp = np.arange(first, last + 1, PERIOD, dtype=np.int64)
    position = np.tile(trajectories[0].knots[0, 0], (stamp.size, 1))
    velocity = np.zeros_like(position)
    for number, trajectory in enumerate(trajectories):
        begin = int(np.searchsorted(stamp, trajectory.start)) if number else 0
        if begin >= stamp.size:
            continue
        origin = position[begin - 1] if begin else None
        after = 1e-9 * (stamp[begin:] - trajectory.start)
        position[begin:], velocity[begin:] = _run_through(trajectory, origin, after)
    return Block(np.arange(stamp.size), stamp, names, (position, velocity, None))


def _run_through(
    trajectory: Trajectory, origin: FloatArray | None, after: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return position and velocity (T, D) at times (T,) after a trajectory's start, s.

    From the set-point before, `origin` (D,), it goes to its first point; None to hold that.
    """
    time, knots = trajectory.time, trajectory.knots
    if origin is not None and time[0] > _CLOSE:
        still = np.zeros((1, *knots.shape[1:]))
        still[0, 0] = origin
        time, knots = np.concatenate(([0.0], time)), np.concatenate((still, knots))
    held = np.clip(after, time[0], time[-1])
    if time.size == 1:
        return np.tile(knots[0, 0], (after.size, 1)), np.zeros((after.size, knots.shape[2]))
    path = BPoly.from_derivatives(time, list(knots))
    moving = (held == after)[:, None]
    return path(held), np.where(moving, path.derivative()(held), 0.0)
