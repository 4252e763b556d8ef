# SPDX-License-Identifier: Apache-2.0
"""The messages of ros2_control that say what joints do, beside sensor_msgs/JointState.

Definitions: control_msgs (noetic-devel, humble, jazzy) and trajectory_msgs. The releases differ
only after what is read here, so that no definition of the bag is needed.
"""

from collections.abc import Mapping, Sequence
from types import MappingProxyType

import numpy as np

from ros2_ident.recording.cdr import Cursor, Layout, Parse, parse_layout
from ros2_ident.recording.cdr import JOINT_STATE as JOINT_STATE
from ros2_ident.recording.streams import FIELDS, IntArray

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

_Places = tuple[IntArray | None, IntArray | None, IntArray | None]


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
        except ValueError:
            return ()
        position, _, effort = layout.places
        wanted = effort if role == 'effort' else position
        if layout.names and wanted is not None and (wanted >= 0).any():
            found.append(role)
    return tuple(found)


def _read_point(cursor: Cursor) -> tuple[IntArray | None, ...]:
    """Pass over a JointTrajectoryPoint; return places of position, velocity, acceleration, effort.

    The cursor stands at its end, 8 bytes after the place of `time_from_start`.
    """
    fields = tuple(cursor.doubles() for _ in range(4))
    cursor.skip(8, 4)
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
    for x in (position, velocity, effort):
        if x is not None and x.size != len(names):
            raise ValueError(f'{len(names)} names but an array of {x.size} values')
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
    table = np.array(rows, dtype=np.int64).reshape(len(rows), len(FIELDS)).T
    position, velocity, effort = (x if (x >= 0).any() else None for x in table)
    return Layout(tuple(names), (position, velocity, effort), cursor.fixed, cursor.big)


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
    table = np.full((len(FIELDS), len(joints)), -1)
    for (joint, field), place in zip(named, found, strict=True):
        table[FIELDS.index(field), joints.index(joint)] = place
    position, velocity, effort = (x if (x >= 0).any() else None for x in table)
    return Layout(tuple(joints), (position, velocity, effort), cursor.fixed, cursor.big, None)
