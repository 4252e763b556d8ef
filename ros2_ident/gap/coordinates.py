# SPDX-License-Identifier: Apache-2.0
"""The coordinates along which a gap is looked for: motion and effort of the drives."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
import math
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
import scipy

from ros2_ident.arrays import Array
from ros2_ident.gates.examine import SEEN
from ros2_ident.models import FullModel
from ros2_ident.recording import smooth_motion
from ros2_ident.recording.motion import allowed_cutoff
from ros2_ident.recording.sections import follow

Parity = Literal['', 'odd', 'even']

PHASES = ('rest', 'creep', 'acceleration', 'cruise', 'deceleration', 'reversal')
# Shares of top speed and top acceleration below which a drive rests; creeps, or cruises. By hand.
_REST, _SLOW = 0.01, 0.1
# Orders of the motor's turn that are looked at: those of `models.trials`.
ORDERS = 24
# A friction that lags behind does so by these times, s; by a way, it is one since a reversal. A
# grid by threes, from the drive's own loop on.
_LAGS = (0.01, 0.03, 0.1, 0.3)
# Knots of the splines that an answer to a switch of the motion may follow, until it is over, s.
_AFTER = np.pad(np.expm1(np.linspace(0.0, math.log(8.0), 16)) / 7.0, 3, mode='edge')


@dataclass(frozen=True)
class Motion:
    """Motion of D drives at each of K cycles, at the time the logged effort belongs to.

    Attributes:
        drives: Their names.
        cycle: Time from column to column, s.
        gear: (D,) motor angle per travel, rad/m; 0 where it is not known.
        position: (D, K), m, or rad of a joint that turns.
        velocity: (D, K), per second.
        acceleration: (D, K), per second squared.
        jerk: (D, K), per second cubed.
        torque: (D, K) simulated effort, N m or N.
        load: (D, K) what of it goes through the transmission: without friction and motor inertia.
        unit: Unit of the output compared, and so of the gap.
        travel: Unit of the position.
        effort_unit: Unit of `torque` and `load`.
        output: (D, K) simulated output; the effort, unless something else is compared.
        tracking: (D, K) set-point less measured position, NaN at cycles without a sample; None
            where one of them was not recorded.
    """

    drives: tuple[str, ...]
    cycle: float
    gear: Array
    position: Array
    velocity: Array
    acceleration: Array
    jerk: Array
    torque: Array
    load: Array
    unit: str
    travel: str
    effort_unit: str
    output: Array
    tracking: Array | None = None


@dataclass(frozen=True)
class Coordinate:
    """Columns that a residual may depend on.

    Attributes:
        name: As in a finding.
        parity: `odd` where the columns change sign with the direction of motion.
        unit: Unit of `place`.
        columns: (T, B) columns, each nonzero in its own region.
        place: (B, 2) ends of each column's region; (0, 2) where they have none.
        labels: Names of the regions where they are no numbers.
        pick: Size of a group of columns where only the best group counts; None where all do.
    """

    name: str
    parity: Parity
    unit: str
    columns: Array
    place: Array
    labels: tuple[str, ...] = ()
    pick: int | None = None


def motion_of(model: FullModel, theta: Array) -> Motion:
    """Return the motion of a model's drives, by the recording where it holds positions.

    Args:
        model: The model with its data.
        theta: (N,) its parameters: delay of the log, friction and motor inertia among them.

    Returns:
        The motion, later by the measurement delay, as the logged effort is.
    """
    data = model.data
    rows = [data.names.index(name) for name in model.places]
    source = data.position if data.position is not None else data.command_position
    output = model.simulate(np.atleast_2d(theta))[0]
    same = model.outputs[0].quantity == 'effort'
    torque = output if same else model.simulated_effort(theta)
    # A model may not tell how its drives move.
    position, velocity, acceleration = (np.zeros_like(torque),) * 3
    load, jerk = torque, position
    if source is not None:
        cutoff = min(allowed_cutoff(source[rows], data.cycle, SEEN), 0.1 / data.cycle)
        grid = np.arange(torque.shape[1])
        delays = model.effort_delay(theta) / data.cycle
        then = np.maximum(grid - delays[:, None], 0.0)
        position, velocity, acceleration = (
            np.stack([np.interp(at, grid, row) for at, row in zip(then, part, strict=True)])
            for part in smooth_motion(source[rows], data.cycle, cutoff)
        )
        load = torque - model.motor_effort(theta, velocity, acceleration)
        jerk = np.gradient(acceleration, data.cycle, axis=1)
    return Motion(
        model.places, data.cycle, np.array([model.motor_turn(place) for place in model.places]),
        position, velocity, acceleration, jerk, torque, load, model.unit,
        model.travel[0] if model.machine is not None else '', model.effort_unit, output,
        following_error(model),
    )  # fmt: skip


def following_error(model: FullModel) -> Array | None:
    """Return (D, K) set-point less measured position, None where one was not recorded."""
    data = model.data
    if data.position is None or data.command_position is None:
        return None
    rows = [data.names.index(name) for name in model.places]
    return np.asarray(data.command_position[rows] - data.position[rows], dtype=np.float64)


def joined(motions: Sequence[Motion]) -> Motion:
    """Return the motion of recordings one after the other."""
    rows = 'position', 'velocity', 'acceleration', 'jerk', 'torque', 'load', 'output'
    every: dict[str, Any] = {n: np.hstack([getattr(m, n) for m in motions]) for n in rows}
    return replace(motions[0], **every)


def direction(velocity: Array) -> Array:
    """Return (K,) the direction of motion, -1 or 1; while a drive hardly moves, the last one."""
    fast = np.abs(velocity) > _REST * _top(velocity)
    if not fast.any():
        return np.ones_like(velocity)
    last = np.maximum.accumulate(np.where(fast, np.arange(velocity.size), 0))
    last = np.where(last == 0, int(np.argmax(fast)), last)
    out: Array = np.sign(velocity[last])
    return out


def phases(velocity: Array, acceleration: Array) -> NDArray[np.int64]:
    """Return (K,) the phase of motion as its number in `PHASES`."""
    speed = np.abs(velocity) / max(_top(velocity), 1e-300)
    push = np.abs(acceleration) / max(_top(acceleration), 1e-300)
    out = np.where(velocity * acceleration > 0.0, 2, 4)
    out[push < _SLOW] = 3
    slow = speed < _SLOW
    out[slow] = 1
    out[(speed < _REST) & (push < 0.5 * _SLOW)] = 0
    # A slow stretch is a reversal where the drive leaves it the other way.
    edges = np.flatnonzero(np.diff(np.concatenate([[0], slow.astype(int), [0]])))
    heading = direction(velocity)
    for begin, end in edges.reshape(-1, 2):
        if begin > 0 and end < velocity.size and heading[begin - 1] != heading[end]:
            out[begin:end] = 5
    return out


def since_reversal(position: Array, velocity: Array) -> Array:
    """Return (K,) the way gone since the last change of direction, m."""
    heading = direction(velocity)
    turn = np.concatenate([[0.0], np.diff(heading)]) != 0.0
    last = np.maximum.accumulate(np.where(turn, np.arange(position.size), 0))
    out: Array = np.abs(position - position[last])
    return out


def _top(values: Array) -> float:
    return float(np.percentile(np.abs(values), 99.5))


def coordinates(motion: Motion, drive: int, at: NDArray[np.int64]) -> Iterator[Coordinate]:
    """Yield the coordinates of one drive at some cycles; for each drive in the same order.

    How many bins each has, and how far back an acceleration may act, is set by hand: few enough
    that a log of seconds fills them.

    Args:
        motion: What the drives did.
        drive: Number of the drive.
        at: (T,) cycles.
    """
    d = drive
    heading = direction(motion.velocity[d])[at]
    velocity = motion.velocity[d, at]
    position = motion.position[d, at]
    load, torque = motion.load[d, at], motion.torque[d, at]
    phase = phases(motion.velocity[d], motion.acceleration[d])[at]
    way = since_reversal(motion.position[d], motion.velocity[d])[at]
    speed: Array = np.abs(velocity)
    effort, travel = motion.effort_unit, motion.travel
    yield from (
        _named('phase', phase, heading),
        _binned('velocity', 'odd', f'{travel}/s', speed, np.sign(velocity), _graded(speed)),
        _binned('velocity', 'even', f'{travel}/s', speed, None, _graded(speed)),
        _binned('position', '', travel, position, None, 12),
        _binned('position', 'odd', travel, position, heading, 8),
        _binned('acceleration', '', f'{travel}/s^2', motion.acceleration[d, at], None, 10),
        _binned('jerk', '', f'{travel}/s^3', motion.jerk[d, at], None, 10),
        _binned('load', '', effort, load, None, 8),
        _binned('load', 'odd', effort, load, heading, 8),
        _binned('torque', '', effort, torque, None, 8),
        _binned('distance since reversal', 'odd', travel, way, heading, _graded(way)),
        _binned('time', '', 's', at.astype(np.float64) * motion.cycle, None, 5),
        _binned('time', 'odd', 's', at.astype(np.float64) * motion.cycle, heading, 5),
    )
    rate = np.gradient(motion.torque[d], motion.cycle)
    rates = [rate[at], np.gradient(rate, motion.cycle)[at]]
    yield _linear('torque rate', ('rate', 'bend'), rates)
    lags = range(-20, 45, 5)
    ago = [np.clip(at - round(1e-3 * x / motion.cycle), 0, motion.load.shape[1] - 1) for x in lags]
    recent = [motion.acceleration[d, x] for x in ago]
    yield _linear('recent acceleration', tuple(f'{lag} ms ago' for lag in lags), recent)
    turn, push = 0.5 * direction(motion.velocity[d]), motion.acceleration[d]
    push = np.sign(push) * (np.abs(push) > _SLOW * _top(push))
    yield from _answers('time since reversal', 'odd', turn, motion.cycle, at)
    yield from _answers('time since a jump of the acceleration', '', push, motion.cycle, at)
    yield _linear('lagging friction', *_memories(motion, d, at))
    others = [o for o in range(len(motion.drives)) if o != d]
    if others:
        rows = [row[o, at] for o in others for row in (motion.torque, motion.acceleration)]
        labels = tuple(
            f'{what} of {motion.drives[o]}' for o in others for what in ('torque', 'acceleration')
        )
        yield _linear('other drives', labels, rows)
    if motion.gear[d]:
        yield from _orders(position, float(motion.gear[d]))


def _answers(
    name: str, parity: Parity, state: Array, cycle: float, at: NDArray[np.int64]
) -> list[Coordinate]:
    """Return answers to each step of a state (K,): by its sign, and to any step alike.

    The courses are splines: noise of a long memory would follow a stair better than they do.
    """
    steps = np.diff(state, prepend=state[0])
    lags = np.arange(0.0, _AFTER[-1], cycle)
    courses = scipy.interpolate.BSpline.design_matrix(lags, _AFTER, 3).toarray()
    courses = courses[:, :-3]  # 0 at the end
    signed, alike = np.zeros((2, at.size, courses.shape[1]))
    for k in np.flatnonzero(steps):
        near = slice(*np.searchsorted(at, (k, k + lags.size)))
        signed[near] += steps[k] * courses[at[near] - k]
        alike[near] += abs(steps[k]) * courses[at[near] - k]
    there = alike.any(axis=0)
    place = np.stack([_AFTER[1:-6], _AFTER[4:-3]], axis=1)[there]
    return [
        Coordinate(name, parity, 's', signed[:, there], place),
        Coordinate(name, 'even', 's', alike[:, there], place),
    ]


def _memories(motion: Motion, drive: int, at: NDArray[np.int64]) -> tuple[tuple[str, ...], Array]:
    """Return direction, slow motion and rest as a friction that lags behind follows them."""
    velocity = motion.velocity[drive]
    heading = direction(velocity)
    speed = np.abs(velocity) / max(_top(velocity), 1e-300)
    kinds = (
        ('direction', heading),
        ('slow motion', np.exp(-speed / _SLOW) * heading),
        ('rest', (speed < _REST) * heading),
    )
    late = {
        f'{name} {1e3 * lag:g} ms late': follow(math.exp(-motion.cycle / lag), row)[at]
        for lag in _LAGS
        for name, row in kinds
    }
    there = [label for label, row in late.items() if np.ptp(row) > 0.0]
    return tuple(there), np.reshape([late[label] for label in there], (len(there), at.size))


def _orders(position: Array, gear: float) -> list[Coordinate]:
    """Return sine and cosine of each order of the motor's angle that the stroke can resolve."""
    angle = gear * position
    turns = float(np.ptp(angle)) / (2.0 * np.pi)
    # Rayleigh's limit: one round at least tells a swing from a plain position.
    orders = [k for k in range(1, ORDERS + 1) if k * turns >= 1.0]
    if not orders:
        return []
    columns = np.stack([f(k * angle) for k in orders for f in (np.cos, np.sin)], axis=1)
    # What is smooth over the stroke is the position's matter.
    smooth = np.vander((position - position.mean()) / max(np.ptp(position), 1e-300), 4)
    columns = columns - smooth @ np.linalg.lstsq(smooth, columns, rcond=None)[0]
    place = np.repeat(np.asarray(orders, dtype=float), 2)[:, None].repeat(2, axis=1)
    return [Coordinate('motor angle', '', 'per turn', columns, place, pick=2)]


def _graded(values: Array) -> Array:
    """Return edges that lie closer towards zero, of bins that are not too thinly filled."""
    top = float(values.max(initial=1e-12))
    shares = np.array([0.0, 0.005, 0.01, 0.02, 0.04, 0.08, 0.15, 0.25, 0.4, 0.6, 0.8, 1.0])
    edges = [0.0]
    for edge in top * shares[1:]:
        inside = np.count_nonzero((values >= edges[-1]) & (values < edge))
        if inside >= max(8.0, 0.005 * values.size):
            edges.append(float(edge))
    edges[-1] = top
    return np.array(edges if len(edges) > 1 else [0.0, top], dtype=np.float64)


def _linear(name: str, labels: tuple[str, ...], rows: Sequence[Array] | Array) -> Coordinate:
    """Return columns that the residual may be proportional to."""
    columns = np.transpose(rows)
    return Coordinate(name, '', '', columns - columns.mean(axis=0), np.empty((0, 2)), labels)


def _named(name: str, index: NDArray[np.int64], heading: Array) -> Coordinate:
    """Return a column for each phase, and one for each that changes sign with the direction."""
    there = [i for i in range(len(PHASES)) if (index == i).sum() >= 5]
    moving = [i for i in there if i != 0]
    columns = [(index == i).astype(float) for i in there]
    columns += [(index == i) * heading for i in moving]
    labels = tuple(PHASES[i] for i in (*there, *moving))
    return Coordinate(name, '', '', np.stack(columns, axis=1), np.empty((0, 2)), labels)


def _binned(
    name: str, parity: Parity, unit: str, values: Array, factor: Array | None, bins: int | Array
) -> Coordinate:
    """Return a column for each bin: between given edges, or so many of equally many samples."""
    edges = bin_edges(values, bins) if isinstance(bins, int) else bins
    number = np.clip(np.searchsorted(edges, values, side='right') - 1, 0, edges.size - 2)
    columns = (number[:, None] == np.arange(edges.size - 1)).astype(float)
    if factor is not None:
        columns *= factor[:, None]
    place = np.stack([edges[:-1], edges[1:]], axis=1)
    keep = np.abs(columns).sum(axis=0) > 0.0
    return Coordinate(name, parity, unit, columns[:, keep], place[keep])


def bin_edges(values: Array, count: int) -> Array:
    """Return edges of bins that hold about equally many samples."""
    edges = np.unique(np.quantile(values, np.linspace(0.0, 1.0, count + 1)))
    if edges.size < 2:
        edges = np.array([edges[0], edges[0] + 1e-12])
    return edges
