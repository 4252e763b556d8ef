# SPDX-License-Identifier: Apache-2.0
"""Pictures of a residual. Every function returns a figure; saving it is the caller's matter."""

from collections.abc import Sequence

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter
import numpy as np
from numpy.typing import NDArray

from ros2_ident.gap.coordinates import Motion
from ros2_ident.gap.floor import Floor
from ros2_ident.gap.localise import Finding
from ros2_ident.gap.maps import chosen, coordinate_of, map_of, ResidualMap
from ros2_ident.report.pictures.style import (
    BLUE,
    GREY,
    number,
    numbers,
    ORANGE,
    plain,
    RED,
    SKY,
    WIDTH,
)

Array = NDArray[np.float64]

# Curves with more points than this are drawn as the band that they fill.
_POINTS = 4000
# Text, colour and mark of a line by its direction of motion.
_LOOK = {
    'both': ('mean', BLUE, 'o'),
    'forwards': ('moving forwards', BLUE, 'o'),
    'backwards': ('moving backwards', ORANGE, 's'),
}


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
    name = coordinate_of(coordinate)
    figure = Figure(figsize=(WIDTH, 3.8), layout='constrained')
    axes = figure.add_subplot()
    draw = _draw_spectrum if name == 'frequency' else _draw_map
    draw(axes, map_of(motion, residual[drive], drive, name), float(floor.per_drive[drive]))
    axes.set_title(f'{motion.drives[drive]}: residual along the {name}', loc='left', fontsize=11)
    return figure


def _draw_map(axes: Axes, found: ResidualMap, noise: float) -> None:
    if found.linear:
        axes.set_xscale('symlog', linthresh=found.linear, linscale=0.6)
        axes.xaxis.set_major_formatter(FuncFormatter(number))
    reach = 0.0
    for line in found.lines:
        text, colour, marker = _LOOK[line.heading]
        axes.fill_between(
            line.place, line.mean - line.half, line.mean + line.half, color=colour, alpha=0.25,
            lw=0,
        )
        axes.plot(line.place, line.mean, color=colour, marker=marker, ms=4, lw=1.5, label=text)
        reach = max(reach, float(np.abs(line.mean).max()))
    axes.axhspan(-noise, noise, color=GREY, alpha=0.12, lw=0, label='noise floor of one sample')
    axes.axhline(0.0, color='black', lw=0.8)
    axes.set_ylim(-max(1.4 * reach, 1.3 * noise), max(1.4 * reach, 1.3 * noise))
    axes.set_xlabel(found.label)
    axes.set_ylabel(f'measured less\nsimulated [{found.unit}]')
    axes.legend(fontsize=8, ncols=3, loc='upper left', frameon=False)
    plain(axes)


def _draw_spectrum(axes: Axes, found: ResidualMap, noise: float) -> None:
    (line,) = found.lines
    axes.loglog(line.place, line.mean / noise, color=BLUE, lw=1.2, label='residual')
    axes.axhline(1.0, color=GREY, lw=1.5, ls='--', label='noise floor')
    numbers(axes.xaxis)
    numbers(axes.yaxis)
    axes.set_xlabel(found.label)
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
    return {
        f'{drive}_{name.replace(" ", "_")}': residual_map(
            motion, residual, floor, motion.drives.index(drive), name
        )
        for drive, name in chosen(findings, most)
    }
