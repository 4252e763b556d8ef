# SPDX-License-Identifier: Apache-2.0
"""How the pictures look, and free runs as one.

Colours are those of Okabe and Ito (2008), told apart by colour-blind readers too; what matters is
told apart by marks and places as well.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from ros2_ident.prediction import Prediction, Run

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure

BLUE, ORANGE, GREEN, RED, GREY, SKY = (
    '#0072B2', '#E69F00', '#009E73', '#D55E00', '#666666', '#56B4E9',
)
# Width of a figure, inches.
WIDTH = 8.0


def numbers(axis: 'Axis') -> None:
    """Write plain numbers along a logarithmic axis, at 1, 2 and 5 of each decade."""
    # Who takes the colours only need not wait for matplotlib.
    from matplotlib.ticker import LogLocator, NullLocator

    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.set_major_formatter('{x:g}')
    axis.set_minor_locator(NullLocator())


def tidy(axes: 'Axes') -> None:
    """Take away what is not needed to read a picture."""
    axes.spines[['top', 'right']].set_visible(False)
    axes.grid(color='#dddddd', lw=0.6)
    axes.set_axisbelow(True)
    axes.tick_params(labelsize=9)


_COLOURS = (BLUE, ORANGE, GREEN, RED, SKY)
_MEASURED = {'color': GREY, 'marker': '.', 'ms': 2, 'ls': ''}


def picture(found: Prediction, stages: Sequence[tuple[str, Sequence[Run]]]) -> 'Figure':
    """Draw the quantity that tells most on the first recording, drive by drive.

    Args:
        stages: The models behind them, as `prediction.predicted` took them.
    """
    from matplotlib.figure import Figure

    drives = [row[0].drive for row in found.first]
    figure = Figure(figsize=(WIDTH, 1.0 + 2.2 * len(drives)), layout='constrained')
    axes = figure.subplots(len(drives), 1, sharex=True, squeeze=False)[:, 0]
    for number, (label, runs) in enumerate(stages):
        model, theta = runs[0]
        free = model.free_run()
        assert free is not None
        rows = {(o.place or o.name): k for k, o in enumerate(free.outputs)
                if o.quantity == found.quantity}  # fmt: skip
        simulated, time = free.simulate(theta[None])[0], free.data.time
        for place, drive in zip(axes, drives, strict=True):
            if not number:
                place.plot(time, free.measured[rows[drive]], label='measured', **_MEASURED)
            colour = _COLOURS[number % len(_COLOURS)]
            place.plot(time, simulated[rows[drive]], color=colour, lw=1.0, label=label)
    for place, row in zip(axes, found.first, strict=True):
        place.set_ylabel(f'{row[0].drive}\n{row[0].quantity} [{row[0].unit}]')
        tidy(place)
    axes[0].legend(loc='lower center', bbox_to_anchor=(0.5, 1.0), ncols=3, fontsize=8)
    axes[-1].set_xlabel('time [s]')
    return figure
