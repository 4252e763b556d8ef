# SPDX-License-Identifier: Apache-2.0
"""A residual's mean along a coordinate of the motion, as numbers: what a map is drawn from."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ros2_ident.arrays import Array, NORMAL
from ros2_ident.gap.bootstrap import block_length
from ros2_ident.gap.coordinates import bin_edges, direction, Motion, since_reversal
from ros2_ident.gap.result import Diagnosis
from ros2_ident.gap.where.localise import Finding
from ros2_ident.gates.scale import FEWEST
from ros2_ident.words.verdict import worst

Heading = Literal['both', 'forwards', 'backwards']

_BINS = 24
_OVER_TIME = ('phase', 'offset', 'other drives', 'instants')


@dataclass(frozen=True)
class Line:
    """One line of a map.

    Attributes:
        place: (B,) where along the coordinate.
        mean: (B,) mean residual there, in the effort's unit.
        half: (B,) half of its 95 % band; NaN where there is none.
    """

    heading: Heading
    place: Array
    mean: Array
    half: Array


@dataclass(frozen=True)
class ResidualMap:
    """A drive's residual along one coordinate.

    Attributes:
        label: The same with its unit, for an axis.
        linear: Places nearer to zero than this stand on a linear axis, the others on a
            logarithmic one; 0 where all of the axis is linear.
        before: Lines of the nominal fit's residual: one along the velocity, which tells the
            direction itself; elsewhere one for each direction of motion.
        after: The same with the effects found; none where there are none.
    """

    drive: str
    coordinate: str
    label: str
    unit: str
    linear: float
    noise_floor: float
    before: tuple[Line, ...]
    after: tuple[Line, ...]


def maps_of(d: Diagnosis) -> tuple[ResidualMap, ...]:
    """Return maps along the coordinates that matter, as `localise` saw them."""
    trace = d.traces[0]
    rows = [trace.before, trace.after] if len(d.steps) > 1 else [trace.before]
    out = []
    # The worst and the named drives have a map whatever was found there.
    always = (*worst(d), *d.where) if worst(d) else ()
    for drive, name in _chosen(d.localisation, [w for w in always if w in d.per_drive]):
        at = trace.motion.drives.index(drive)
        values, label = _along(trace.motion, at, name)
        linear = 1.0 if name == 'distance since reversal' else 0.0
        if name == 'velocity':
            # Nearly all of a log is slow: the axis is stretched where most of it is.
            linear = max(0.02 * float(np.percentile(np.abs(values), 99.5)), 1e-9)
        before, *after = [_lines(trace.motion, row[at], at, name, values) for row in rows]
        floor = float(d.floor.per_drive[at])
        unit = trace.motion.unit
        out.append(ResidualMap(drive, name, label, unit, linear, floor, before, *(after or [()])))
    return tuple(out)


def _chosen(findings: Sequence[Finding], always: Sequence[str]) -> tuple[tuple[str, str], ...]:
    """Return drive and coordinate of what to draw, each pair once, drive by drive.

    Args:
        findings: What was found, the drive with the largest gap first.
        always: Drives that are drawn over their velocity where nothing was found.
    """
    # Those over which nothing was found come first.
    # A swing has no place along the motion.
    found = [f for f in findings if not f.likely and f.along != 'frequency']
    others = set(always) - {f.drive for f in found}
    at = {drive: ['velocity'] for drive in always if drive in others}
    for f in found:
        # Findings without an axis of their own are shown over time.
        name = 'time' if f.along in _OVER_TIME else f.along.removeprefix('recent ')
        if name not in at.setdefault(f.drive, []):
            at[f.drive].append(name)
    return tuple((d, name) for d, names in at.items() for name in names[:3])[:12]


def _lines(motion: Motion, row: Array, drive: int, name: str, values: Array) -> tuple[Line, ...]:
    """Return means of a residual (K,) with their bands, NaN where there is no sample."""
    there = np.isfinite(row)
    heading = direction(motion.velocity[drive])
    block = np.arange(row.size) // block_length(row[None], motion.cycle)
    parts: list[tuple[Heading, NDArray[np.bool_]]] = [
        ('forwards', there & (heading > 0.0)),
        ('backwards', there & (heading < 0.0)),
    ]
    if name == 'velocity':
        parts = [('both', there)]
    return tuple(
        Line(which, *_bins(values[mask], row[mask], block[mask]))
        for which, mask in parts
        if mask.sum() >= FEWEST
    )


def _along(motion: Motion, drive: int, name: str) -> tuple[Array, str]:
    """Return a coordinate (K,) and its label."""
    d, travel = drive, motion.travel
    time = np.arange(motion.position.shape[1], dtype=np.float64) * motion.cycle
    way = since_reversal(motion.position[d], motion.velocity[d])
    turn: Array = np.mod(motion.gear[d] * motion.position[d] / (2.0 * np.pi), 1.0)
    table = {
        'velocity': (motion.velocity[d], f'velocity [{travel}/s]'),
        'position': (motion.position[d], f'position [{travel}]'),
        'acceleration': (motion.acceleration[d], f'acceleration [{travel}/s²]'),
        'jerk': (motion.jerk[d], f'jerk [{travel}/s³]'),
        'load': (motion.load[d], f'transmitted load [{motion.effort_unit}]'),
        'torque': (motion.torque[d], f'simulated effort [{motion.effort_unit}]'),
        'torque rate': (
            np.gradient(motion.torque[d], motion.cycle),
            f'rate of the effort [{motion.effort_unit}/s]',
        ),
        'distance since reversal': (1e3 * way, f'distance since the last reversal [m{travel}]'),
        'motor angle': (turn, 'motor angle [turns]'),
    }
    values, label = table.get(name, (time, 'time since start [s]'))
    return np.asarray(values, dtype=np.float64), label


def _bins(values: Array, row: Array, block: NDArray[np.int64]) -> tuple[Array, Array, Array]:
    """Return centres and means of bins of equally many samples, and half their 95 % bands.

    A bin's samples come in few stretches; its uncertainty is that of the stretches' means.
    """
    edges = bin_edges(values, _BINS)
    number = np.clip(np.searchsorted(edges, values, side='right') - 1, 0, edges.size - 2)
    bins = []
    for b in range(edges.size - 1):
        inside = number == b
        if inside.sum() < 10:
            continue
        sums = np.bincount(block[inside], row[inside])
        counts = np.bincount(block[inside])
        average = float(row[inside].mean())
        off = (sums - average * counts)[counts > 0]
        spread = (off**2).sum() * off.size / max(1, off.size - 1)
        bins.append((values[inside].mean(), average, NORMAL * np.sqrt(spread) / inside.sum()))
    centre, mean, half = np.reshape(bins, (-1, 3)).T
    return centre, mean, half
