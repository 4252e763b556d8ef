# SPDX-License-Identifier: Apache-2.0
"""The values a recording is made of: immutable, validated once, in the units of the log."""

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field, replace
import hashlib
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
import scipy

from ros2_ident.errors import ErrorCode

FIELDS = ('position', 'velocity', 'effort')
ROLES = ('state', 'effort', 'command')
# Stamps beyond, ns, are damage: their differences would not fit 64 bits.
LATEST_STAMP = 1 << 62

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
_fail = ErrorCode.BAD_VALUES.error


def _there(of: object, names: Iterable[str]) -> dict[str, Any]:
    """Return the attributes that are not None, by their names."""
    return {name: x for name in names if (x := getattr(of, name)) is not None}


@dataclass(frozen=True, eq=False)
class Stream:
    """Samples of some joints, in the order of their stamps.

    Attributes:
        names: The D joints' names.
        stamp: Header stamps (T,), ns, strictly increasing.
        position: Positions (T, D), rad or m; None where never measured; NaN where one message left
            the joint out.
        velocity: Velocities (T, D), rad/s or m/s; likewise.
        effort: Efforts (T, D) in the log's unit; likewise.
    """

    names: tuple[str, ...]
    stamp: IntArray
    position: FloatArray | None = None
    velocity: FloatArray | None = None
    effort: FloatArray | None = None

    def __post_init__(self) -> None:
        """Validate and take ownership of the arrays."""
        names = tuple(str(name) for name in self.names)
        if not names or len(set(names)) < len(names):
            text = f'the joints of a stream are ({", ".join(names)})'
            raise _fail(f'{text}; give at least one, and each its own name')
        stamp = np.array(self.stamp)
        if stamp.ndim != 1 or stamp.dtype.kind not in 'iu' or not stamp.size:
            text = f'stamps have to be integers [ns] of shape (T,), found {stamp.dtype} of shape '
            text += f'{stamp.shape}; convert seconds with round(1e9 * t), leave out what is empty'
            raise _fail(text)
        stamp = stamp.astype(np.int64)
        if (back := np.flatnonzero(np.diff(stamp) <= 0)).size:
            text = f'stamps have to increase, but sample {int(back[0]) + 1} does not'
            raise _fail(f'{text}; feed the messages to a RecordingBuilder')
        stamp.setflags(write=False)
        object.__setattr__(self, 'names', names)
        object.__setattr__(self, 'stamp', stamp)
        shape = (stamp.size, len(names))
        for name, values in self.fields.items():
            array = np.asarray(values, dtype=np.float64)
            if array.shape != shape:
                text = f'{name} has shape {array.shape}, expected {shape} (samples, joints)'
                raise _fail(f'{text}; pass None for what was not measured')
            if np.isinf(array).any():
                row, column = np.argwhere(np.isinf(array))[0].tolist()
                text = f'{name} of {names[column]} is infinite at sample {row}'
                raise _fail(f'{text}; write NaN where there is no measurement')
            flags = array.flags
            if not flags.c_contiguous or not flags.owndata or flags.writeable:
                # what no caller can still write to; a copy of hours would take the room of hours
                array = np.array(array, order='C')
                array.setflags(write=False)
            object.__setattr__(self, name, array)
        if not self.fields:
            raise _fail('a stream holds neither position, velocity nor effort; leave it out')

    @property
    def duration(self) -> float:
        """Time from the first to the last sample, s."""
        return float(self.stamp[-1] - self.stamp[0]) * 1e-9

    @property
    def fields(self) -> dict[str, FloatArray]:
        """Measured values (T, D), by their names."""
        return _there(self, FIELDS)

    def values(self, field: str) -> FloatArray | None:
        """Return one field (T, D) by its name, None where it was never measured."""
        if field not in FIELDS:
            raise _fail(f'a stream has no field {field!r}; choose one of {", ".join(FIELDS)}')
        return self.fields.get(field)

    def taken(self, rows: slice | NDArray[Any]) -> 'Stream':
        """Return some of the samples, at least one."""
        fields = {field: values[rows] for field, values in self.fields.items()}
        return Stream(self.names, self.stamp[rows], **fields)

    def column(self, field: str, name: str) -> FloatArray | None:
        """Return one joint's samples of a field.

        Args:
            field: `position`, `velocity` or `effort`.

        Returns:
            Samples (T,), or None where the joint or the field was never measured.
        """
        array = self.values(field)
        if array is None or name not in self.names:
            return None
        column: FloatArray = array[:, self.names.index(name)]
        return None if np.isnan(column).all() else column

    def between(self, begin: int, end: int) -> 'Stream | None':
        """Return the samples with begin <= stamp [ns] < end, or None where there are none."""
        low, high = np.searchsorted(self.stamp, [begin, end])
        return self.taken(slice(int(low), int(high))) if low < high else None


SPEEDS_ALONE = (
    'command: holds speeds and no positions, so the recorded motion drives the model; record the '
    'set-point of the position where there is one'
)


@dataclass(frozen=True)
class Recording:
    """One uninterrupted stretch of a log.

    Attributes:
        state: What the drives measured, or None.
        effort: The effort where it came on a stream of its own, or None.
        command: The controller's set-point, or None.
        source: Where it came from: a path, or the name of the live buffer.
        sha256: Hash of the bag's storage file(s), empty for live data.
        warnings: What the reader has to say about it, one sentence each.
        notes: Where its values come from, and what else the log holds.
        units: Units that the log states by joint and quantity: m or rad of positions and
            velocities; of efforts N m, N, A or percent.
    """

    state: Stream | None = None
    effort: Stream | None = None
    command: Stream | None = None
    source: str = ''
    sha256: str = ''
    warnings: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    units: Mapping[tuple[str, str], str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Refuse a recording of nothing."""
        if not self.streams:
            text = f'{self.source or "recording"}: holds no stream at all; record joint states'
            raise ErrorCode.NO_DATA.error(text)
        object.__setattr__(self, 'warnings', tuple(self.warnings))

    @property
    def streams(self) -> dict[str, Stream]:
        """The streams that exist, by role."""
        return _there(self, ROLES)

    @property
    def sets_positions(self) -> bool:
        """Whether there are set-points of position: speeds or efforts alone drive no model."""
        asked = self.command.position if self.command else None
        return asked is not None and bool(np.isfinite(asked).any())

    @property
    def sets_speeds_alone(self) -> bool:
        """Whether there are set-points of velocity, and none of position."""
        speeds = self.command is not None and self.command.velocity is not None
        return speeds and not self.sets_positions

    @property
    def begin(self) -> int:
        """Earliest stamp, ns."""
        return min(int(stream.stamp[0]) for stream in self.streams.values())

    @property
    def end(self) -> int:
        """Latest stamp, ns."""
        return max(int(stream.stamp[-1]) for stream in self.streams.values())

    @property
    def duration(self) -> float:
        """Time from the first to the last sample of any stream, s."""
        return float(self.end - self.begin) * 1e-9

    def between(self, begin: int, end: int) -> 'Recording':
        """Return the part with begin <= stamp [ns] < end.

        Raises:
            IdentError: NO_DATA where no sample lies there.
        """
        cut = {role: stream.between(begin, end) for role, stream in self.streams.items()}
        if not any(cut.values()):
            text = f'no sample between {begin} and {end} ns, only {self.begin} to {self.end} ns'
            raise ErrorCode.NO_DATA.error(f'{self.source or "recording"}: {text}')
        return replace(self, **cut)  # type: ignore[arg-type]


def scale_effort(recording: Recording, factor: float | Mapping[str, float]) -> Recording:
    """Convert the measured efforts of a recording.

    Args:
        recording: The recording in its log's unit.
        factor: To N m (or N), of all joints or by joint; those it does not name stay.

    Returns:
        The recording with state and effort streams scaled; the command's feed-forward effort too.

    Raises:
        IdentError: WRONG_UNITS where the factor is no finite number other than zero.
    """
    gains = list(factor.values()) if isinstance(factor, Mapping) else [factor]
    if not all(math.isfinite(x) and x for x in gains):
        text = f'effort factor is {factor}; give the torque constant or the rated torque over 100'
        raise ErrorCode.WRONG_UNITS.error(text)
    scaled = {}
    for role, stream in recording.streams.items() if set(gains) != {1.0} else ():
        if stream.effort is not None:
            own = factor if isinstance(factor, Mapping) else dict.fromkeys(stream.names, factor)
            gain = np.array([own.get(name, 1.0) for name in stream.names])
            scaled[role] = replace(stream, effort=stream.effort * gain)
    return replace(recording, **scaled) if scaled else recording  # type: ignore[arg-type]


def with_positions(
    recording: Recording, names: Collection[str]
) -> tuple[Recording, tuple[str, ...]]:
    """Integrate the speeds of joints without positions, by trapezia from 0.

    Args:
        recording: The recording. Beside set-points of position nothing is integrated: where the
            motion began is not known.

    Returns:
        The recording with positions, and the joints whose positions are integrals.
    """
    state = recording.state
    if state is None or state.velocity is None or recording.sets_positions:
        return recording, ()
    shape = state.velocity.shape
    position = np.full(shape, np.nan) if state.position is None else state.position.copy()
    lacking = np.isnan(position).all(axis=0) & (np.isfinite(state.velocity).sum(axis=0) > 1)
    found = [d for d in np.flatnonzero(lacking) if state.names[d] in names]
    time = (state.stamp - state.stamp[0]) * 1e-9
    for d in found:
        there = np.isfinite(state.velocity[:, d])
        speed = state.velocity[there, d]
        position[there, d] = scipy.integrate.cumulative_trapezoid(speed, time[there], initial=0.0)
    if found:
        recording = replace(recording, state=replace(state, position=position))
    return recording, tuple(state.names[d] for d in found)


# Fields that a model may see, and those of them that hold a value at every cycle.
_SEEN = ('command_position', 'command_velocity', 'position', 'velocity', 'effort')
_EVERY_CYCLE = _SEEN[:2]


@dataclass(frozen=True)
class StreamQuality:
    """How one stream arrived."""

    samples: int  # that are used
    missing: int | None  # samples that should have come and did not; None where they are uneven
    rate: float  # samples per second, Hz
    jitter: float  # standard deviation of the stamps about the grid, s
    stride: int  # cycles from sample to sample; 0 where it does not keep to the grid

    @property
    def missing_share(self) -> float:
        """Missing samples as a share of those expected."""
        missing = self.missing or 0
        return missing / max(1, self.samples + missing)


@dataclass(frozen=True, eq=False)
class Dataset:
    """Measurements of D drives on K controller cycles.

    Attributes:
        names: The drives.
        cycle: From one to the next, s: the controller's, or of a `coarse` grid.
        start: Stamp of cycle 0, ns.
        command_position: Set-point (D, K), rad or m, at every cycle; None where there is no
            command.
        command_velocity: Its derivative (D, K), rad/s or m/s; None likewise.
        position: Measured (D, K), NaN at cycles without a sample; None where never measured.
        velocity: Likewise.
        effort: Likewise, in the unit of the recording given (N m or N after conversion).
        streams: How the streams arrived, by role.
        warnings: What a user has to know of that, one sentence each.
        beside: Positions (K,) of the recording's other joints, by name, at every cycle.
        released: Cycle from which on the motors are switched off; None where they never are.
        command_effort: Effort asked for (D, K), in the unit of `effort`, NaN for drives that are
            told a motion; None where all are. No model is driven by it.
        goal: Set-points of position (D, K), rad or m, though none may drive a model; NaN for a
            drive without; None where the log has none.
        integrated: Drives whose position was not measured: it is the integral of the speed.
    """

    names: tuple[str, ...]
    cycle: float
    start: int
    command_position: FloatArray | None
    command_velocity: FloatArray | None
    position: FloatArray | None
    velocity: FloatArray | None
    effort: FloatArray | None
    streams: Mapping[str, StreamQuality] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    beside: Mapping[str, FloatArray] = field(default_factory=dict)
    released: int | None = None
    command_effort: FloatArray | None = None
    goal: FloatArray | None = None
    integrated: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Check the shapes and make the arrays read-only."""
        shapes = set()
        for name, values in self._arrays.items():
            array = np.array(values, dtype=np.float64, order='C')
            shapes.add(array.shape)
            array.setflags(write=False)
            object.__setattr__(self, name, array)
            if name in _EVERY_CYCLE and not np.isfinite(array).all():
                text = 'has cycles without a value; interpolate the set-point to every cycle'
                raise _fail(f'{name} {text}')
        if [x[:1] for x in shapes] != [(len(self.names),)] or len(min(shapes)) != 2:
            text = f'the arrays of a data set have shapes {sorted(shapes)}, expected one '
            raise _fail(f'{text}({len(self.names)}, cycles)')
        object.__setattr__(self, 'names', tuple(self.names))

    @property
    def _arrays(self) -> dict[str, FloatArray]:
        return _there(self, (*_SEEN, 'command_effort', 'goal'))

    @property
    def digest(self) -> bytes:
        """Of all that a model may see: another one, other numbers."""
        total = hashlib.blake2b(repr((self.names, self.cycle, self.released)).encode())
        for name, values in [*_there(self, _SEEN).items(), *self.beside.items()]:
            total.update(name.encode())
            total.update(np.ascontiguousarray(values).data)
        return total.digest()

    @property
    def cycles(self) -> int:
        """K, the number of controller cycles."""
        return next(int(x.shape[1]) for x in self._arrays.values())

    def coarse(self, least: int) -> 'Dataset':
        """Return it on a grid of at least `least` cycles a sample, for a log without set-point.

        The grid is coarser by a whole number, and every sample lies on it; the same where samples
        keep to no coarser one.
        """
        if self.command_position is not None:
            return self
        there = np.zeros(self.cycles, dtype=bool)
        for values in _there(self, FIELDS).values():
            there |= np.isfinite(values).any(axis=0)
        samples = np.flatnonzero(there)
        apart = int(np.gcd.reduce(np.diff(samples))) if samples.size > 1 else 1
        by = max(k for k in range(1, max(1, apart // least) + 1) if apart % k == 0)
        if by == 1:
            return self
        first = int(samples[0]) % by
        kept: dict[str, Any] = {x: row[:, first::by] for x, row in self._arrays.items()}
        kept['beside'] = {name: row[first::by] for name, row in self.beside.items()}
        start = self.start + round(first * self.cycle * 1e9)
        return replace(self, cycle=self.cycle * by, start=start, **kept)

    @property
    def time(self) -> FloatArray:
        """Time of each cycle since the start (K,), s."""
        return np.arange(self.cycles, dtype=np.float64) * self.cycle

    @property
    def duration(self) -> float:
        """Time from the first to the last cycle, s."""
        return max(0, self.cycles - 1) * self.cycle
