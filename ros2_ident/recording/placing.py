# SPDX-License-Identifier: Apache-2.0
"""Number the samples of a recording's streams on one common grid of controller cycles."""

from dataclasses import dataclass

import numpy as np

from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.recording.grid import find_ticks, sample_period, Ticks
from ros2_ident.recording.streams import FIELDS, FloatArray, IntArray, Recording, Stream


@dataclass(frozen=True)
class Placed:
    """A stream reduced to the drives, with the cycle number of each sample.

    Attributes:
        role: `state`, `effort` or `command`.
        stream: The samples of the drives.
        ticks: Their cycle numbers.
        reference: The stamp that the numbers count from, ns.
    """

    role: str
    stream: Stream
    ticks: Ticks
    reference: int

    @property
    def tick(self) -> IntArray:
        """Cycle numbers of the kept samples (T,)."""
        tick: IntArray = self.ticks.tick[self.ticks.keep]
        return tick

    @property
    def instants(self) -> FloatArray:
        """Sampling times (T,) in cycles: whole numbers where the stream keeps to the grid."""
        if self.ticks.stride:
            return self.tick.astype(np.float64)
        return self.ticks.raw[self.ticks.keep]

    def samples(self, field: str) -> FloatArray | None:
        """Return a field's kept samples (T, D), or None."""
        values = self.stream.values(field)
        return None if values is None else values[self.ticks.keep]

    def stamp_of(self, tick: int, cycle: float) -> int:
        """Return the stamp of a cycle on this stream's clock, ns."""
        offset = self.ticks.phase + tick * cycle * (1.0 + self.ticks.drift)
        return self.reference + round(offset * 1e9)


def place(
    recording: Recording, names: tuple[str, ...], cycle: float, warnings: list[str]
) -> dict[str, Placed]:
    """Reduce the streams to the drives and number their samples on one common grid."""
    placed: dict[str, Placed] = {}
    where = recording.source or 'recording'
    present = [x for x in ('state', 'effort', 'command') if x in recording.streams]
    reference, shift = 0, 0
    for role in present:
        stream = _reduced(where, role, recording.streams[role], names, warnings)
        if stream is None:
            continue
        if not placed:
            reference = int(stream.stamp[0])
        counted_from = reference + shift
        stream, ticks = _numbered(stream, counted_from, cycle)
        if not placed:
            shift = round(ticks.phase * 1e9)
        elif ticks.stride and abs(ticks.phase) > 0.35 * cycle:
            warnings.append(
                f'{role}: stamps lie {abs(ticks.phase) * 1e3:.3g} ms beside those of '
                f'{next(iter(placed))}, near half a cycle: it may be one cycle off'
            )
        warnings += _remarks(role, stream, ticks, cycle)
        placed[role] = Placed(role, stream, ticks, counted_from)
    if 'state' not in placed and 'effort' not in placed:
        raise IdentError(
            ErrorCode.MISSING_STREAM,
            f'{where}: neither a state nor an effort stream holds the drives; record the topic on '
            'which they report, or name it',
        )
    return placed


def _numbered(stream: Stream, reference: int, cycle: float) -> tuple[Stream, Ticks]:
    """Number a stream's samples; drives that publish one by one are numbered one by one.

    Args:
        stream: The stream, reduced to the drives.
        reference: The stamp that numbers count from, ns.
        cycle: Controller cycle, s.

    Returns:
        The stream, with one sample per cycle where its drives had to be put together, and the
        numbers.
    """
    fields = [stream.values(field) for field in FIELDS]
    there = np.zeros((stream.stamp.size, len(stream.names)), dtype=np.bool_)
    for values in fields:
        if values is not None:
            there |= ~np.isnan(values)
    if np.mean(there.all(axis=1)) > 0.5 or not there.any(axis=0).all():
        return stream, find_ticks(stream.stamp, reference, cycle)
    parts = [find_ticks(stream.stamp[rows], reference, cycle) for rows in there.T]
    tick = np.unique(np.concatenate([part.tick[part.keep] for part in parts]))
    merged: list[FloatArray | None] = []
    for values in fields:
        if values is None:
            merged.append(None)
            continue
        table = np.full((tick.size, len(stream.names)), np.nan)
        for column, (rows, part) in enumerate(zip(there.T, parts, strict=True)):
            place = np.searchsorted(tick, part.tick[part.keep])
            table[place, column] = values[rows, column][part.keep]
        merged.append(table)
    first = parts[0]
    stride = first.stride if all(part.stride == first.stride for part in parts) else 0
    length = cycle * (1.0 + first.drift)
    stamp = reference + np.round((first.phase + tick * length) * 1e9).astype(np.int64)
    keep = np.ones(tick.size, dtype=np.bool_)
    jitter = max(part.jitter for part in parts)
    raw = tick.astype(np.float64)
    return (
        Stream(stream.names, stamp, *merged),
        Ticks(tick, raw, keep, stride, first.phase, first.drift, jitter),
    )


def _remarks(role: str, stream: Stream, ticks: Ticks, cycle: float) -> list[str]:
    """Say how a stream's samples fell on the grid, where that is worth a warning."""
    remarks = []
    milliseconds = f'{cycle * 1e3:.4g} ms'
    doubled = int((~ticks.keep).sum())
    if doubled:
        remarks.append(
            f'{role}: {doubled} samples share a controller cycle of {milliseconds} with another '
            'and are left out; state a shorter cycle if the controller has one'
        )
    if not ticks.stride and stream.stamp.size > 2:
        period = sample_period(stream.stamp)
        remarks.append(
            f'{role}: the samples, {period * 1e3:.4g} ms apart, do not keep to the controller '
            f'cycle of {milliseconds}; each counts at the nearest cycle'
        )
    if ticks.jitter > 0.2 * ticks.stride * cycle > 0.0:
        remarks.append(
            f'{role}: the stamps scatter by {ticks.jitter * 1e3:.3g} ms about the controller '
            'cycles, some samples may be placed wrongly; stamp the messages where the values are '
            'taken'
        )
    if abs(ticks.drift) > 2e-5:
        remarks.append(
            f'{role}: the controller cycle is {cycle * (1.0 + ticks.drift) * 1e3:.6g} ms on the '
            f'clock of the stamps, not {cycle * 1e3:.6g} ms'
        )
    return remarks


def _reduced(
    where: str, role: str, stream: Stream, names: tuple[str, ...], warnings: list[str]
) -> Stream | None:
    """Return the stream with the drives only, in their order; None where it does not help."""
    missing = [name for name in names if name not in stream.names]
    if missing and role != 'effort':
        raise IdentError(
            ErrorCode.MISSING_STREAM,
            f'{where}: {role} has no joint {", ".join(missing)}, it holds '
            f'{", ".join(stream.names)}; write these names as drives in the machine file, or '
            'record the others too',
        )
    if len(missing) == len(names):
        warnings.append(
            f'effort: holds none of the drives, only {", ".join(stream.names)}; efforts of the '
            'state are used'
        )
        return None
    fields: list[FloatArray | None] = []
    for field in FIELDS:
        values = stream.values(field)
        if values is None:
            fields.append(None)
            continue
        picked = np.full((stream.stamp.size, len(names)), np.nan)
        for column, name in enumerate(names):
            if name in stream.names:
                picked[:, column] = values[:, stream.names.index(name)]
        fields.append(None if np.isnan(picked).all() else picked)
    filled = np.zeros(stream.stamp.size, dtype=np.bool_)
    for values in fields:
        if values is not None:
            filled |= ~np.isnan(values).all(axis=1)
    if not filled.any():
        warnings.append(f'{role}: every value of the drives is NaN; the stream is not used')
        return None
    return Stream(names, stream.stamp[filled], *(None if x is None else x[filled] for x in fields))
