# SPDX-License-Identifier: Apache-2.0
"""How the pictures look.

Colours are those of Okabe and Ito (2008), told apart by colour-blind readers too; what matters is
told apart by marks and places as well.
"""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis

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
