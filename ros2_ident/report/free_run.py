# SPDX-License-Identifier: Apache-2.0
"""Free runs as a picture: what was measured, and where each model stood."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from ros2_ident.prediction import Prediction, Run
from ros2_ident.report.style import BLUE, GREEN, GREY, ORANGE, RED, SKY, tidy, WIDTH

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_COLOURS = (BLUE, ORANGE, GREEN, RED, SKY)
_MEASURED = {'color': GREY, 'marker': '.', 'ms': 2, 'ls': ''}


def picture(found: Prediction, stages: Sequence[tuple[str, Sequence[Run]]]) -> 'Figure':
    """Draw the quantity that tells most on the first recording, drive by drive.

    Args:
        found: Free runs.
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
