# SPDX-License-Identifier: Apache-2.0
"""How the plots of the page look: the colours of `report.style`, one type, little ink."""

from dataclasses import dataclass
import math
from typing import Any

from bokeh.models import CustomJSTickFormatter, FixedTicker, GridPlot
from bokeh.models.layouts import LayoutDOM
from bokeh.plotting import figure

# Width of the page's content, pixels; the style sheet has the same.
WIDTH = 1000
INK, LINE, GRID = '#1c2733', '#9aa5b1', '#e6eaee'
FONT = 'system-ui, -apple-system, "Segoe UI", Roboto, "Helvetica Neue", Arial, sans-serif'


@dataclass(frozen=True)
class Key:
    """An entry of a legend, which stands beside the plot as text.

    Attributes:
        text: What it is.
        colour: Of the line or mark.
        style: A line's width in pixels, `dashed`, `dot`, or `square`.
    """

    text: str
    colour: str
    style: str


@dataclass(frozen=True)
class Button:
    """One of a group of buttons.

    Attributes:
        text: What stands on it.
        value: What it does, for `page.js`.
        pressed: Whether it is at first.
    """

    text: str
    value: str
    pressed: bool = False


@dataclass(frozen=True)
class Choice:
    """Buttons above a plot.

    Attributes:
        label: What they choose.
        action: What `page.js` does with their values.
        buttons: The buttons.
    """

    label: str
    action: str
    buttons: tuple[Button, ...]


@dataclass(frozen=True)
class Picture:
    """A plot and what is said with it.

    Attributes:
        plot: Bokeh's model.
        summary: What it shows, for who cannot see it.
        keys: The legend.
        notes: Sentences for the caption.
        choices: Buttons above it.
        least: Width below which it scrolls [px].
    """

    plot: LayoutDOM
    summary: str
    keys: tuple[Key, ...] = ()
    notes: tuple[str, ...] = ()
    choices: tuple[Choice, ...] = ()
    least: int = 0

    @property
    def height(self) -> int:
        """Height of its plots [px]: the page keeps it free until they are drawn."""
        if not isinstance(self.plot, GridPlot):
            return int(self.plot.height or 0)
        rows: dict[int, int] = {}
        for made, row, *_ in self.plot.children:
            if made.visible:
                rows[row] = max(rows.get(row, 0), int(made.height or 0))
        return sum(rows.values())


def plot(**options: Any) -> Any:
    """Return an empty plot: vectors, so that it prints sharply, and tools that hide themselves.

    Args:
        options: As `bokeh.plotting.figure`.
    """
    # Any: bokeh's annotations do not tell a title or an axis from what stands for one.
    made: Any = figure(
        **{
            'output_backend': 'svg',
            'toolbar_location': 'above',
            'tools': 'box_zoom,pan,reset',
            'active_drag': 'box_zoom',
            'min_border': 4,
            'background_fill_color': None,
            'border_fill_color': None,
            **options,
        }
    )
    made.toolbar.autohide = True
    made.toolbar.logo = None
    made.outline_line_color = None
    for axis in made.axis:
        axis.axis_label_text_font = axis.major_label_text_font = FONT
        axis.axis_label_text_font_style = 'normal'
        axis.axis_label_text_font_size = axis.major_label_text_font_size = '13px'
        axis.axis_label_text_color = axis.major_label_text_color = INK
        axis.axis_label_standoff = 6
        axis.axis_line_color = axis.major_tick_line_color = LINE
        axis.minor_tick_line_color = None
        axis.major_tick_in = 0
    made.grid.grid_line_color = GRID
    made.title.text_font = FONT
    made.title.text_font_size = '13px'
    made.title.text_font_style = 'bold'
    made.title.text_color = INK
    return made


def logarithmic(axis: Any, low: float, high: float) -> None:
    """Write plain numbers along a logarithmic axis: at 1, 2 and 5 of each decade, or 1 only."""
    exponents = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    steps = (1, 2, 5) if math.log10(high / low) < 2.5 else (1,)
    axis.ticker = FixedTicker(ticks=[step * 10.0**e for e in exponents for step in steps])
    axis.formatter = CustomJSTickFormatter(code='return String(Number(tick.toPrecision(3)))')
