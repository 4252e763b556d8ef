# SPDX-License-Identifier: Apache-2.0
"""Trajectories as they are sent to a controller, as the set-point that the controller follows.

A trajectory is a few points; joint_trajectory_controller runs through them by a polynomial through
all that two neighbouring points state (linear, cubic or quintic), from the last set-point on and
until the next trajectory begins (ros2_controllers, joint_trajectory_controller, trajectory.cpp).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.interpolate import BPoly

from ros2_ident.recording.cdr import Block, typestore
from ros2_ident.recording.limits import Limits
from ros2_ident.recording.ros2_control import TRAJECTORY
from ros2_ident.recording.streams import FloatArray

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
    Limits.from_environment().require_memory('the set-point of the trajectories takes', needed)
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
