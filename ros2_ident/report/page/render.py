# SPDX-License-Identifier: Apache-2.0
"""From values to HTML: the templates with their filters, the style sheet, the script."""

from collections.abc import Mapping
from importlib.resources import files as resources
import math
from typing import Any

from bokeh.core.json_encoder import serialize_json
from bokeh.embed import json_item
from bokeh.resources import Resources
from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from ros2_ident.identify.outcome import package_version
from ros2_ident.identify.result import ParameterEstimate
from ros2_ident.report.page import numbers, steps
from ros2_ident.report.page.look import Picture


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
    environment.filters |= {
        'change': numbers.change,
        'command': numbers.command,
        'equation': numbers.equation,
        'item': _item,
        'name': numbers.name,
        'number': numbers.number,
        'percent': numbers.percent,
        'places': _places,
        'precision': numbers.precision,
        'prose': numbers.prose,
        'shade': _shade,
        'undetermined': steps.undetermined,
        'unit': numbers.unit_of,
        'width': numbers.width,
    }
    folder = resources('ros2_ident.report.page')
    library = Resources(mode='inline', components=['bokeh']).render() if plots else ''
    page: str = environment.get_template(template).render(
        version=package_version(),
        css=Markup((folder / 'page.css').read_text(encoding='utf-8')),
        script=Markup((folder / 'page.js').read_text(encoding='utf-8')),
        library=Markup(library),
        **context,
    )
    return page


def _item(picture: Picture, name: str) -> Markup:
    """Return a plot as JSON that may stand inside a script element."""
    text = serialize_json(json_item(picture.drawn, name))  # type: ignore[arg-type]
    return Markup(text.replace('<', '\\u003c'))


def _shade(value: float) -> str:
    """Return the colour of a correlation: blue for -1, white for 0, vermilion for 1."""
    end = (0, 114, 178) if value < 0.0 else (213, 94, 0)
    share = 0.85 * abs(value) if math.isfinite(value) else 0.0  # black is read well on all
    return f'rgb({",".join(f"{255 + (e - 255) * share:.0f}" for e in end)})'


def _places(p: ParameterEstimate) -> tuple[float, float, float] | None:
    """Return left end and width of the interval and the place of the value, % of the bounds."""
    span = p.upper_bound - p.lower_bound
    if not math.isfinite(p.value) or span <= 0.0:
        return None

    def at(value: float, otherwise: float) -> float:
        share = (value - p.lower_bound) / span if math.isfinite(value) else otherwise
        return round(100.0 * min(1.0, max(0.0, share)), 2)

    here = at(p.value, 0.0)
    low, high = at(p.low, here / 100.0), at(p.high, here / 100.0)
    return low, round(high - low, 2), here
