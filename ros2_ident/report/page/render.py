# SPDX-License-Identifier: Apache-2.0
"""From values to HTML: pictures, the templates with their filters, the style sheet, the script."""

from collections.abc import Mapping
from dataclasses import dataclass
from importlib.resources import files as resources
from importlib.util import find_spec
import json
from pathlib import Path
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from ros2_ident import package_version
from ros2_ident.files import make_directory, write_text
from ros2_ident.report.page import numbers, steps

# The script alone is used, so that its package is found, not imported.
_BOKEH = find_spec('bokeh')
if _BOKEH is None or not _BOKEH.submodule_search_locations:
    raise ModuleNotFoundError("No module named 'bokeh'", name='bokeh')
LIBRARY = Path(_BOKEH.submodule_search_locations[0], 'server/static/js/bokeh.min.js')

# Colours of Okabe and Ito (2008), told apart by colour-blind readers too; what matters has marks
# and places of its own as well.
INK, BLUE, ORANGE, RED, GREY, SKY = (
    '#1c2733', '#0072B2', '#E69F00', '#D55E00', '#666666', '#56B4E9',
)  # fmt: skip


@dataclass(frozen=True)
class Key:
    """An entry of a legend: its style is a line's width [px], `dashed`, `dot`, or `square`."""

    text: str
    colour: str
    style: str


Choice = tuple[str, str, tuple[tuple[str, str, bool], ...]]


@dataclass(frozen=True)
class Picture:
    """A picture and what is said with it.

    Attributes:
        drawn: SVG, or what `page.js` makes plots of that zoom.
        summary: What it shows, for who cannot see it.
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
    choices: tuple[Choice, ...] = ()
    height: int = 0
    least: int = 0


def write_page(path: Path, template: str, context: Mapping[str, Any], **how: bool) -> Path:
    """Render a page and write it, its folder, too; arguments as of `render`."""
    make_directory(path.parent)
    return write_text(path, render(template, context, **how))


def render(template: str, context: Mapping[str, Any], *, plots: bool = False) -> str:
    """Return a page.

    Args:
        context: What the template takes; `title` and `lead` for all.
        plots: Whether it holds plots that need the library.
    """
    environment = Environment(
        loader=PackageLoader('ros2_ident.report.page', '.'),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
    )
    named = (
        numbers.breaks, numbers.change, numbers.equation, numbers.number, numbers.percent,
        numbers.precision, numbers.prose, steps.undetermined,
    )  # fmt: skip
    environment.filters |= {x.__name__: x for x in named}
    environment.filters |= {'data': _data, 'unit': numbers.unit_of}
    folder = resources('ros2_ident.report.page')
    library = LIBRARY.read_text(encoding='utf-8') if plots else ''
    page: str = environment.get_template(template).render(
        version=package_version(),
        css=Markup((folder / 'page.css').read_text(encoding='utf-8')),
        script=Markup((folder / 'page.js').read_text(encoding='utf-8')),
        library=Markup(library),
        **context,
    )
    return page


def _data(drawn: Mapping[str, Any]) -> Markup:
    """Return what plots are made of as JSON that may stand inside a script element."""
    return Markup(json.dumps(drawn, allow_nan=False).replace('<', '\\u003c'))
