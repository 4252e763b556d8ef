# SPDX-License-Identifier: Apache-2.0
"""A recording on the grid of controller cycles: what the models are fitted to."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
import hashlib
from typing import Any

import numpy as np

from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.recording.streams import FloatArray

# Fields that a model may see, and those of them that hold a value at every cycle.
_SEEN = ('command_position', 'command_velocity', 'position', 'velocity', 'effort')
_EVERY_CYCLE = _SEEN[:2]

@dataclass(frozen=True)
class StreamQuality:
    """How one stream arrived.

    Attributes:
        samples: Samples used.
        missing: Samples that should have come and did not.
        rate: Samples per second, Hz.
        jitter: Standard deviation of the stamps about the grid, s.
        stride: Cycles from sample to sample; 0 where the stream does not keep to the grid.
    """

    samples: int
    missing: int
    rate: float
    jitter: float
    stride: int

    @property
    def missing_share(self) -> float:
        """Missing samples as a share of those expected."""
        return self.missing / max(1, self.samples + self.missing)


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

    def __post_init__(self) -> None:
        """Check the shapes and make the arrays read-only."""
        shapes = set()
        for name in (*_SEEN, 'command_effort'):
            values = getattr(self, name)
            if values is None:
                continue
            array = np.array(values, dtype=np.float64, order='C')
            shapes.add(array.shape)
            array.setflags(write=False)
            object.__setattr__(self, name, array)
            if name in _EVERY_CYCLE and not np.isfinite(array).all():
                raise IdentError(
                    ErrorCode.BAD_VALUES,
                    f'{name} has cycles without a value; interpolate the set-point to every cycle',
                )
        if len(shapes) != 1:
            raise IdentError(
                ErrorCode.BAD_VALUES,
                'the arrays of a data set have to be of one shape (drives, cycles), found '
                f'{sorted(shapes)}',
            )
        shape = shapes.pop()
        if len(shape) != 2 or shape[0] != len(self.names):
            raise IdentError(
                ErrorCode.BAD_VALUES,
                f'the arrays of a data set have shape {shape}, expected ({len(self.names)}, '
                'cycles)',
            )
        object.__setattr__(self, 'names', tuple(self.names))

    @property
    def digest(self) -> bytes:
        """Of all that a model may see: another one, other numbers."""
        total = hashlib.blake2b(repr((self.names, self.cycle, self.released)).encode())
        for name, values in [*((x, getattr(self, x)) for x in _SEEN), *self.beside.items()]:
            if values is not None:
                total.update(name.encode())
                total.update(np.ascontiguousarray(values).data)
        return total.digest()

    @property
    def cycles(self) -> int:
        """K, the number of controller cycles."""
        rows = (getattr(self, name) for name in (*_SEEN, 'command_effort'))
        return next(int(x.shape[1]) for x in rows if x is not None)

    def coarse(self, least: int) -> 'Dataset':
        """Return it on a grid of at least `least` cycles a sample, for a log without set-point.

        The grid is coarser by a whole number, and every sample lies on it; the same where samples
        keep to no coarser one.
        """
        if self.command_position is not None:
            return self
        there = np.zeros(self.cycles, dtype=bool)
        for values in (self.position, self.velocity, self.effort):
            if values is not None:
                there |= np.isfinite(values).any(axis=0)
        samples = np.flatnonzero(there)
        apart = int(np.gcd.reduce(np.diff(samples))) if samples.size > 1 else 1
        by = max(k for k in range(1, max(1, apart // least) + 1) if apart % k == 0)
        if by == 1:
            return self
        first = int(samples[0]) % by
        rows = {x: getattr(self, x) for x in (*_SEEN[2:], 'command_effort')}
        kept: dict[str, Any] = {x: row[:, first::by] for x, row in rows.items() if row is not None}
        return replace(
            self,
            cycle=self.cycle * by,
            start=self.start + round(first * self.cycle * 1e9),
            beside={name: row[first::by] for name, row in self.beside.items()},
            **kept,
        )

    @property
    def time(self) -> FloatArray:
        """Time of each cycle since the start (K,), s."""
        return np.arange(self.cycles, dtype=np.float64) * self.cycle

    @property
    def duration(self) -> float:
        """Time from the first to the last cycle, s."""
        return max(0, self.cycles - 1) * self.cycle
