# SPDX-License-Identifier: Apache-2.0
"""Pictures of a residual. Every function returns a figure; saving it is the caller's matter."""

from collections.abc import Sequence

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter
import numpy as np
from numpy.typing import NDArray

from ros2_ident.gap.blocks import block_length
from ros2_ident.gap.coordinates import bin_edges, direction, Motion, since_reversal
from ros2_ident.gap.floor import Floor
from ros2_ident.gap.localise import Finding
from ros2_ident.gap.spectrum import spectrum
from ros2_ident.gap.style import BLUE, GREY, number, numbers, ORANGE, plain, RED, SKY, WIDTH

Array = NDArray[np.float64]

# Curves with more points than this are drawn as the band that they fill.
_POINTS = 4000
_BINS = 24


def residual_map(
    motion: Motion, residual: Array, floor: Floor, drive: int, coordinate: str
) -> Figure:
    """Draw a drive's mean residual along a coordinate, with the band that chance gives it.

    Args:
        motion: What the drives did.
        residual: (D, K) measured less simulated effort, NaN where there is no sample.
        floor: The noise floor.
        drive: Number of the drive.
        coordinate: Name as in a finding; `velocity`, `position`, `acceleration`, `jerk`, `load`,
            `torque`, `time`, `motor angle`, `way since reversal` or `frequency`, with or without
            `size by` before and the parity behind it.

    Returns:
        The figure: means in both directions of motion, with 95 % bands.
    """
    name = coordinate.removeprefix('size by ').split(',')[0]
    figure = Figure(figsize=(WIDTH, 3.8), layout='constrained')
    axes = figure.add_subplot()
    row = residual[drive]
    if name == 'frequency':
        _draw_spectrum(axes, row, motion, floor, drive)
    else:
        _draw_map(axes, motion, row, floor, drive, name)
    axes.set_title(f'{motion.drives[drive]}: residual along the {name}', loc='left', fontsize=11)
    return figure


def _along(motion: Motion, drive: int, name: str) -> tuple[Array, str]:
    """Return a coordinate (K,) and the axis' label."""
    d = drive
    time = np.arange(motion.position.shape[1], dtype=np.float64) * motion.cycle
    way = since_reversal(motion.position[d], motion.velocity[d])
    turn: Array = np.mod(motion.gear * motion.position[d] / (2.0 * np.pi), 1.0)
    table = {
        'velocity': (motion.velocity[d], 'velocity [m/s]'),
        'position': (motion.position[d], 'position [m]'),
        'acceleration': (motion.acceleration[d], 'acceleration [m/s$^2$]'),
        'recent acceleration': (motion.acceleration[d], 'acceleration [m/s$^2$]'),
        'jerk': (motion.jerk[d], 'jerk [m/s$^3$]'),
        'load': (motion.load[d], f'transmitted load [{motion.unit}]'),
        'torque': (motion.torque[d], f'simulated effort [{motion.unit}]'),
        'torque rate': (
            np.gradient(motion.torque[d], motion.cycle), f'rate of the effort [{motion.unit}/s]'
        ),
        'way since reversal': (1e3 * way, 'way since the last reversal [mm]'),
        'motor angle': (turn, 'motor angle [turns]'),
    }
    values, label = table.get(name, (time, 'time since start [s]'))
    return np.asarray(values, dtype=np.float64), label


def _draw_map(
    axes: Axes, motion: Motion, row: Array, floor: Floor, drive: int, name: str
) -> None:
    values, label = _along(motion, drive, name)
    there = np.isfinite(row)
    heading = direction(motion.velocity[drive])
    noise = float(floor.per_drive[drive])
    block = np.arange(row.size) // block_length(row[None], motion.cycle)
    if name == 'velocity':
        # Nearly all of a log is slow: the axis is stretched where most of it is.
        top = float(np.percentile(np.abs(values), 99.5))
        axes.set_xscale('symlog', linthresh=max(0.02 * top, 1e-9), linscale=0.6)
        axes.xaxis.set_major_formatter(FuncFormatter(number))
        parts: list[tuple[NDArray[np.bool_], str, str, str]] = [(there, 'mean', BLUE, 'o')]
    else:
        parts = [
            (there & (heading > 0.0), 'moving forwards', BLUE, 'o'),
            (there & (heading < 0.0), 'moving backwards', ORANGE, 's'),
        ]
    if name == 'way since reversal':
        axes.set_xscale('symlog', linthresh=1.0)
        axes.xaxis.set_major_formatter(FuncFormatter(number))
    reach = 0.0
    for mask, text, colour, marker in parts:
        if mask.sum() < 100:
            continue
        centre, mean, half = _bins(values[mask], row[mask], block[mask])
        axes.fill_between(centre, mean - half, mean + half, color=colour, alpha=0.25, lw=0)
        axes.plot(centre, mean, color=colour, marker=marker, ms=4, lw=1.5, label=text)
        reach = max(reach, float(np.abs(mean).max()))
    axes.axhspan(-noise, noise, color=GREY, alpha=0.12, lw=0, label='noise floor of one sample')
    axes.axhline(0.0, color='black', lw=0.8)
    axes.set_ylim(-max(1.4 * reach, 1.3 * noise), max(1.4 * reach, 1.3 * noise))
    axes.set_xlabel(label)
    axes.set_ylabel(f'measured less\nsimulated [{motion.unit}]')
    axes.legend(fontsize=8, ncols=3, loc='upper left', frameon=False)
    plain(axes)


def _bins(
    values: Array, row: Array, block: NDArray[np.int64]
) -> tuple[Array, Array, Array]:
    """Return centres and means of bins of equally many samples, and half their 95 % bands.

    A bin's samples come in few stretches; its uncertainty is that of the stretches' means.
    """
    edges = bin_edges(values, _BINS)
    number = np.clip(np.searchsorted(edges, values, side='right') - 1, 0, edges.size - 2)
    centre, mean, half = [], [], []
    for b in range(edges.size - 1):
        inside = number == b
        if inside.sum() < 10:
            continue
        sums = np.bincount(block[inside], row[inside])
        counts = np.bincount(block[inside])
        average = float(row[inside].mean())
        off = (sums - average * counts)[counts > 0]
        stretches = off.size
        error = np.sqrt((off**2).sum() * stretches / max(1, stretches - 1)) / inside.sum()
        centre.append(float(values[inside].mean()))
        mean.append(average)
        half.append(1.96 * float(error))
    return np.array(centre), np.array(mean), np.array(half)


def _draw_spectrum(axes: Axes, row: Array, motion: Motion, floor: Floor, drive: int) -> None:
    frequency, power, _ = spectrum(row, motion.cycle)
    noise = float(floor.per_drive[drive])
    keep = frequency > 0.0
    axes.loglog(
        frequency[keep], np.sqrt(power[keep]) / noise, color=BLUE, lw=1.2, label='residual'
    )
    axes.axhline(1.0, color=GREY, lw=1.5, ls='--', label='noise floor')
    numbers(axes.xaxis)
    numbers(axes.yaxis)
    axes.set_xlabel('frequency [Hz]')
    axes.set_ylabel('amplitude density\nover the noise floor')
    axes.legend(fontsize=8, frameon=False)
    plain(axes)


def overlay(motion: Motion, measured: Array, residual: Array, floor: Floor) -> Figure:
    """Draw each drive's measured and simulated effort, and the residual below.

    Args:
        motion: What the drives did.
        measured: (D, K) measured effort, NaN where there is no sample.
        residual: (D, K) measured less simulated effort.
        floor: The noise floor.
    """
    drives = len(motion.drives)
    figure = Figure(figsize=(WIDTH, 0.6 + 2.6 * drives), layout='constrained')
    grid = figure.add_gridspec(2 * drives, 1, height_ratios=[2.0, 1.0] * drives)
    first: Axes | None = None
    for d, name in enumerate(motion.drives):
        top = figure.add_subplot(grid[2 * d], sharex=first)
        first = first or top
        below = figure.add_subplot(grid[2 * d + 1], sharex=first)
        there = np.flatnonzero(np.isfinite(measured[d]))
        time = there.astype(np.float64) * motion.cycle
        top.plot(time, measured[d, there], color=SKY, lw=1.8, label='measured')
        simulated = measured[d, there] - residual[d, there]
        top.plot(time, simulated, color='black', lw=0.8, label='simulated')
        top.set_ylabel(f'{name}\neffort [{motion.unit}]')
        if d == 0:
            top.legend(fontsize=8, ncols=2, frameon=False, loc='upper right')
        _band(below, time, residual[d, there])
        noise = 2.0 * float(floor.per_drive[d])
        for side in (-noise, noise):
            below.axhline(side, color='black', lw=0.9, ls='--')
        below.set_ylabel('residual')
        for axes in (top, below):
            plain(axes)
            axes.tick_params(labelbottom=False)
    below.tick_params(labelbottom=True)
    below.set_xlabel('time [s]; dashed: twice the noise floor')
    figure.align_ylabels()
    return figure


def _band(axes: Axes, time: Array, values: Array) -> None:
    """Draw a curve, as the band it fills where it has very many points."""
    if time.size <= _POINTS:
        axes.plot(time, values, color=RED, lw=0.7)
        return
    group = int(np.ceil(time.size / (_POINTS / 4)))
    size = time.size // group * group
    parts = values[:size].reshape(-1, group)
    at = time[:size].reshape(-1, group).mean(axis=1)
    axes.fill_between(at, parts.min(axis=1), parts.max(axis=1), color=RED, lw=0.3)


def residual_maps(
    motion: Motion,
    residual: Array,
    floor: Floor,
    findings: Sequence[Finding],
    most: int = 6,
) -> dict[str, Figure]:
    """Draw a map for each drive and coordinate that matters, the leading ones only.

    Args:
        motion: What the drives did.
        residual: (D, K) measured less simulated effort.
        floor: The noise floor.
        findings: From `localise`, in their order.
        most: At most so many.

    Returns:
        The figures by a name that suits a file: `drive_2_velocity`.
    """
    out: dict[str, Figure] = {}
    for finding in findings:
        name = finding.coordinate.removeprefix('size by ').split(',')[0]
        if name in ('phase', 'offset', 'other drives'):
            name = 'time'
        key = f'{finding.drive}_{name.replace(" ", "_")}'
        if finding.significant and key not in out and len(out) < most:
            drive = motion.drives.index(finding.drive)
            out[key] = residual_map(motion, residual, floor, drive, name)
    return out
