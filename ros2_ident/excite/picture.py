# SPDX-License-Identifier: Apache-2.0
"""A motion as a picture: what the drives do, what of their limits that takes, what it is worth."""

from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from ros2_ident.arrays import Array
from ros2_ident.excite.plan import Excitation
from ros2_ident.report.style import (
    BLUE,
    GREEN,
    GREY,
    numbers,
    ORANGE,
    RED,
    SKY,
    tidy,
    WIDTH,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_COLOURS = (BLUE, ORANGE, GREEN, RED, SKY, GREY)
# Points of a line, and bars that fit beneath one another.
_POINTS, _BARS = 4000, 30


def picture(found: Excitation) -> 'Figure':
    """Draw a motion over time, in shares of its limits, and the intervals that it will give.

    Args:
        found: The motion.
    """
    from matplotlib.figure import Figure

    chosen = np.flatnonzero(found.wanted)
    chosen = chosen[np.argsort(-_of_box(found, found.half_widths)[chosen], kind='stable')][:_BARS]
    below = 0.9 + 0.2 * len(chosen)
    figure = Figure(figsize=(WIDTH, 7.0 + below), layout='constrained')
    axes = figure.subplots(5, 1, height_ratios=[1.8, 1.2, 1.2, 1.2, below])
    planned, moved, limits = found.planned, found.shown.moved, found.courses.limits
    _lines(axes[0], found, planned.position)
    axes[0].set_ylabel('position')
    drives = found.courses.machine.drives
    axes[0].legend(
        drives, loc='lower center', bbox_to_anchor=(0.5, 1.0), ncols=3, fontsize=8, frameon=False
    )
    for place, rows, most, word in (
        (axes[1], moved.velocity, limits.velocity, 'velocity'),
        (axes[2], moved.acceleration, limits.acceleration, 'acceleration'),
        (axes[3], moved.effort, limits.effort, 'effort'),
    ):
        bounded = np.isfinite(most).all()
        assert rows is not None
        _lines(place, found, rows / most[:, None] if bounded else rows)
        place.set_ylabel(f'{word}\n(share of limit)' if bounded else word)
        if bounded:
            for end in (-1.0, 1.0):
                place.axhline(end, color=GREY, lw=1.0, ls='--')
    axes[3].set_xlabel('time [s]')
    for place in axes[:3]:
        place.tick_params(labelbottom=False)
    _bars(axes[4], found, chosen)
    return figure


def _of_box(found: Excitation, half: Array) -> Array:
    """Return half widths in percent of the parameters' boxes."""
    out: Array = 100.0 * half / np.array([p.high - p.low for p in found.parameters])
    return out


def _lines(axes: 'Axes', found: Excitation, rows: Array) -> None:
    every = max(1, rows.shape[1] // _POINTS)
    time = found.courses.series.cycle * np.arange(rows.shape[1])[::every]
    for number, row in enumerate(rows):
        axes.plot(time, row[::every], color=_COLOURS[number % len(_COLOURS)], lw=0.9)
    axes.margins(x=0.0)
    tidy(axes)


def _bars(axes: 'Axes', found: Excitation, chosen: npt.NDArray[np.int64]) -> None:
    place = np.arange(len(chosen))
    mine, chance = (_of_box(found, x)[chosen] for x in (found.half_widths, found.chance))
    axes.hlines(place, mine, chance, color=SKY, lw=3.0)
    axes.plot(chance, place, 'o', color=GREY, ms=5, label='a random motion')
    axes.plot(mine, place, 'D', color=GREEN, ms=5, label='this motion')
    axes.set_yticks(place, [found.parameters[n].name for n in chosen], fontsize=8)
    axes.set_xscale('log')
    numbers(axes.xaxis)
    axes.invert_yaxis()
    axes.set_xlabel('half a 95 % interval [% of the range in the machine file]')
    axes.legend(loc='best', fontsize=8, frameon=False)
    tidy(axes)
    axes.tick_params(axis='y', labelsize=8)
