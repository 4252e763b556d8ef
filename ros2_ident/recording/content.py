# SPDX-License-Identifier: Apache-2.0
"""Content of a bag: messages by topic, decoded piece by piece."""

from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any

import numpy as np
import scipy

from ros2_ident.errors import IdentError
from ros2_ident.recording import cdr
from ros2_ident.recording.cdr import Block, Cursor, Layout, Parse, parse_layout, typestore
from ros2_ident.recording.cdr import JOINT_STATE as JOINT_STATE
from ros2_ident.recording.limits import limit, require_memory
from ros2_ident.recording.storage import Budget, Damage, inflate, ZSTD
from ros2_ident.recording.streams import FIELDS, FloatArray, IntArray, LATEST_STAMP

# The messages of ros2_control that state what joints do, beside sensor_msgs/JointState, of
# control_msgs (noetic-devel, humble, jazzy) and trajectory_msgs. The releases differ only after
# what is read here, so that no definition of the bag is needed.
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
        usual = 'effort' if role == 'effort' else 'position'
        parts = [name.rpartition('/') for name in names]
        named = [(x[0], x[2]) if x[0] and x[2] in FIELDS else (''.join(x), usual) for x in parts]
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
    for (joint, kind), place in zip(named, found, strict=True):
        table[joints.index(joint), FIELDS.index(kind)] = place
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
    path = scipy.interpolate.BPoly.from_derivatives(time, list(knots))
    moving = (held == after)[:, None]
    return path(held), np.where(moving, path.derivative()(held), 0.0)


# Bytes of messages that are decoded at once; fewer would take longer.
_HELD = 1 << 22
# Messages of a topic that is not read, which show what could be read there.
_SHOWN = 10

# What a message of a kind has to be.
WHY = {
    cdr.JOINT_STATE: 'arrays have to be empty or as long as the names',
    ARRAY: 'it has to hold a number for each of the joint names given',
}
OTHERWISE = 'a value for each joint, and times that increase'
# Takes messages of a topic: log times, ns, and serialised bytes.
Sink = Callable[[Sequence[int], Sequence[bytes]], None]


class Messages:
    """The messages of a topic in the order of the file, decoded piece by piece.

    A message as an object takes some hundred bytes; hours of them at 1 kHz would fill the memory.

    Args:
        parse: Finds the values in a message; those of a JointState by default.

    Attributes:
        count: Messages that came.
        lost: Those that are no valid ones of their type.
        blocks: What is decoded, with log times as stamps of those that have none.
        unstamped: Whether there are such.
    """

    def __init__(self, parse: cdr.Parse = cdr.parse_layout) -> None:
        self.count = 0
        self.lost = 0
        self.blocks: deque[cdr.Block] = deque()
        self.unstamped = False
        self._parse = parse
        self._times: list[int] = []
        self._data: list[bytes] = []
        self._held = 0
        self._bytes = 0

    def take(self, times: Sequence[int], data: Sequence[bytes]) -> None:
        """Take messages: log times [ns] and serialised bytes."""
        self.count += len(data)
        self._held += sum(map(len, data))
        self._times += times
        self._data += data
        if self._held > _HELD:
            self.decode()

    def _fresh(self) -> tuple[list[int], list[bytes]]:
        """Return what has come since the last time; what cannot be unpacked is empty."""
        times, data = self._times, self._data
        self._times, self._data, self._held = [], [], 0
        if any(x.startswith(ZSTD) for x in data[:_SHOWN]):  # compressed one by one
            budget = Budget(sum(map(len, data)))
            data = [_unpacked(x, budget) if x.startswith(ZSTD) else x for x in data]
        return times, data

    def decode(self) -> None:
        """Decode what has come since the last time; what is no such message is counted.

        Raises:
            IdentError: BAD_VALUES where the values take more memory than allowed.
        """
        times, data = self._fresh()
        if not data:
            return
        try:
            if max(times) >= LATEST_STAMP or min(times) <= -LATEST_STAMP:
                raise ValueError
            found = cdr.decode(data, self._parse)
        except (ValueError, IndexError):
            whole = [pair for pair in zip(times, data, strict=True) if self._is_whole(*pair)]
            self.lost += len(data) - len(whole)
            times = [x[0] for x in whole]
            found = cdr.decode([x[1] for x in whole], self._parse)
        clock = np.array(times, dtype=np.int64)
        for block in found:
            self._bytes += sum(x.nbytes for x in block.fields if x is not None)
            if not block.stamp.any():
                block, self.unstamped = replace(block, stamp=clock[block.rows]), True
            self.blocks.append(block)
        # the builder needs them twice while it puts them together
        require_memory('the values of one topic take', 3 * self._bytes)

    def _is_whole(self, log_time: int, message: bytes) -> bool:
        """Say whether a message decodes by itself."""
        try:
            (block,) = cdr.decode([message], self._parse)
        except (ValueError, IndexError):
            return False
        names = block.names
        return bool(names) and len(set(names)) == len(names) and abs(log_time) < LATEST_STAMP

    def finish(self) -> None:
        """Decode the remaining messages into blocks."""
        self.decode()


class Trajectories(Messages):
    """The trajectories sent on a topic; their blocks are the set-point that follows them."""

    def __init__(self) -> None:
        super().__init__()
        self.sent: list[tuple[int, Trajectory]] = []

    def decode(self) -> None:
        """Decode what has come since the last time."""
        for when, data in zip(*self._fresh(), strict=True):
            try:
                self.sent.append((when, parse_trajectory(data, when)))
            except ValueError:
                self.lost += 1

    def finish(self) -> None:
        """Follow the trajectories in the order in which they came."""
        self.decode()
        self.blocks += set_points([x for _, x in sorted(self.sent, key=lambda pair: pair[0])])
        self.sent = []


def messages_of(kind: str, role: str, names: Sequence[str]) -> Messages:
    """Return what decodes a role's messages of a kind; see `parser`."""
    return Trajectories() if kind == TRAJECTORY else Messages(parser(kind, role, names))


def _unpacked(packed: bytes, budget: Budget) -> bytes:
    raw, sound = inflate('zstd', packed, budget.chunk)
    try:
        budget.take(len(raw))
    except Damage:
        return b''
    return raw if sound else b''


@dataclass
class Content:
    """Content of a bag.

    Attributes:
        wanted: Roles of each topic to read.
        names: What the numbers of arrays are; see `parser`.
        messages: By topic and role, of those wanted that can be read.
        types: Message type of every topic of the bag.
        counts: Messages of every topic of the bag.
        warnings: What could not be read.
    """

    wanted: Mapping[str, tuple[str, ...]]
    names: tuple[str, ...] = ()
    messages: dict[tuple[str, str], Messages] = field(default_factory=dict)
    types: dict[str, str] = field(default_factory=dict)
    counts: dict[str, int] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)
    _first: dict[str, list[bytes]] = field(default_factory=dict)

    def open(self, topic: str, kind: str) -> Sink | None:
        """Note a topic and its type; return where its messages go, None where they are unwanted.

        Raises:
            Damage: There are more topics than any machine has.
        """
        if topic not in self.types:
            if len(self.types) >= 100 * limit('joints'):
                raise Damage('it names more topics than are allowed')
            self.types[topic] = kind
        self.counts.setdefault(topic, 0)
        if kind not in ROLES_OF:
            return None
        roles = [role for role in self.wanted.get(topic, ()) if role in ROLES_OF[kind]]
        if not roles:
            first = self._first.setdefault(topic, [])

            def show(times: Sequence[int], data: Sequence[bytes]) -> None:
                if len(first) < _SHOWN:
                    first.extend(x for x in data[:_SHOWN] if not x.startswith(ZSTD))

            return show
        self.types[topic] = kind
        for role in roles:
            self.messages.setdefault((topic, role), messages_of(kind, role, self.names))
        sinks = [self.messages[topic, role].take for role in roles]

        def fan(times: Sequence[int], data: Sequence[bytes]) -> None:
            for sink in sinks:
                sink(times, data)

        return fan

    def offered(self) -> Iterator[tuple[str, str, tuple[str, ...]]]:
        """Yield topic, type and possible roles of what could be read and is not wanted."""
        for topic, first in sorted(self._first.items()):
            kind = self.types[topic]
            found = {x for data in first for x in offers(kind, data)}
            yield topic, kind, tuple(x for x in ROLES_OF[kind] if x in found)
