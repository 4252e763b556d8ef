# SPDX-License-Identifier: Apache-2.0
"""Pictures of the page: the colours of `report.style`, one type, little ink."""

from collections.abc import Callable
from dataclasses import dataclass
import io
from typing import Any, TYPE_CHECKING

from markupsafe import Markup

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Width of the page's content, pixels; the style sheet has the same.
WIDTH = 1000
INK = '#1c2733'


@dataclass(frozen=True)
class Key:
    """An entry of a legend, which stands beside the picture as text.

    Attributes:
        text: What it is.
        colour: Of the line or mark.
        style: A line's width in pixels, `dashed`, `dot`, or `square`.
    """

    text: str
    colour: str
    style: str


@dataclass(frozen=True)
class Picture:
    """A picture and what is said with it.

    Attributes:
        drawn: SVG, or Bokeh's model of plots that zoom.
        summary: What it shows, for who cannot see it.
        title: Its title where it stands among others.
        keys: The legend.
        notes: Sentences for the caption.
        choices: Groups of buttons above it: what they choose, what `page.js` does with their
            values, and of each button the text, the value, and whether it is pressed at first.
        height: Of plots that zoom [px]: the page keeps it free until they are drawn.
        least: Width below which it scrolls [px].
    """

    drawn: Any
    summary: str
    title: str = ''
    keys: tuple[Key, ...] = ()
    notes: tuple[str, ...] = ()
    choices: tuple[tuple[str, str, tuple[tuple[str, str, bool], ...]], ...] = ()
    height: int = 0
    least: int = 0


def svg(draw: Callable[['Figure'], None], width: float, height: float) -> Markup:
    """Return what is drawn into a figure of a size [px]; without a date, so the same each time."""
    # A page without such pictures need not wait for matplotlib.
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    with rc_context({'svg.fonttype': 'none', 'svg.hashsalt': 'ros2_ident', 'font.size': 12.0}):
        made = Figure((width / 72.0, height / 72.0), layout='constrained')
        draw(made)
        file = io.StringIO()
        made.savefig(file, format='svg', dpi=144, metadata={'Date': None}, transparent=True)
    text = file.getvalue()
    body = text[text.index('viewBox=') :]
    return Markup(f'<svg class="chart" xmlns:xlink="http://www.w3.org/1999/xlink" {body}')
