# SPDX-License-Identifier: Apache-2.0
"""Plots as SVG, written at once: axes with round numbers, lines, bands, and many dots."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
import math
from typing import Any

from markupsafe import escape, Markup
import numpy as np

from ros2_ident.arrays import Array
from ros2_ident.report.page.numbers import number


@dataclass(frozen=True)
class Axis:
    """An axis: its ends, the values written at it, and what makes values linear along it."""

    low: float
    high: float
    ticks: Sequence[float]
    bend: Callable[[Any], Any] = np.asarray

    def share(self, values: Any) -> Any:
        """Return how far along the axis values lie, 0 to 1 between its ends."""
        low, high = self.bend(self.low), self.bend(self.high)
        return (self.bend(values) - low) / (high - low)


def linear(low: float, high: float, most: int = 5) -> Axis:
    """Return an axis with at most so many steps of 1, 2, 2.5 or 5."""
    decade = 10.0 ** math.floor(math.log10((high - low) / most))
    step = next(s * decade for s in (1.0, 2.0, 2.5, 5.0, 10.0) if high - low <= most * s * decade)
    first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
    return Axis(low, high, [k * step for k in range(first, last + 1)])


def logarithmic(low: float, high: float) -> Axis:
    """Return a logarithmic axis with ticks at 1, 2 and 5 of each decade, of many at 1."""
    decades = range(math.floor(math.log10(low)), math.ceil(math.log10(high)))
    ticks = [s * 10.0**e for e in decades for s in ((1, 2, 5) if high < 1e3 * low else (1,))]
    return Axis(low, high, [x for x in ticks if low <= x <= high], np.log10)


def wider(*values: Array) -> tuple[float, float]:
    """Return the ends of an axis that holds all values with some room."""
    low, high = (float(f(np.concatenate(values))) for f in (np.min, np.max))
    room = 0.05 * (high - low) or 0.05 * abs(high) or 1.0
    return low - room, high + room


class Plot:
    """A plot at a place of a picture: left, top, width and height [px]."""

    def __init__(
        self, place: tuple[float, float, float, float], x: Axis, y: Axis, labels: tuple[str, str],
        title: Sequence[str] = (),
    ) -> None:  # fmt: skip
        self._place, self._x, self._y, self.elements = place, x, y, list[str]()
        left, top, width, height = place
        middle, bottom, high = left + 0.5 * width, top + height, top + 0.5 * height
        for value, (at, _) in zip(x.ticks, self._at(x.ticks, y.low), strict=True):
            self._add(f'path d="M{at} {top}v{height}" stroke="#ddd" stroke-width="0.6"')
            self._add(f'text x="{at}" y="{bottom + 15}" font-size="11"', number(value))
        for value, (_, at) in zip(y.ticks, self._at(x.low, y.ticks), strict=True):
            self._add(f'path d="M{left} {at}h{width}" stroke="#ddd" stroke-width="0.6"')
            if labels[1]:
                where = f'x="{left - 6}" y="{at + 4}" text-anchor="end"'
                self._add(f'text {where} font-size="11"', number(value))
        self._add(f'path d="M{left} {top}v{height}h{width}" stroke="#1c2733" fill="none"')
        self._add(f'text x="{middle}" y="{bottom + 31}"', labels[0])
        turned = f'transform="translate({left - 54} {high}) rotate(-90)"'
        self._add(f'text {turned}', labels[1])
        for k, text in enumerate(reversed(title)):
            self._add(f'text x="{middle}" y="{top - 6 - 14 * k}" font-weight="bold"', text)

    def _add(self, element: str, text: str = '') -> None:
        self.elements.append(f'<{element}>{escape(text)}</{element.split()[0]}>')

    def _at(self, x: Any, y: Any) -> Any:
        """Return (K, 2) pixels of values; what lies beyond is at the edge."""
        shares = np.broadcast_arrays(self._x.share(x), 1.0 - self._y.share(y))
        inside = np.clip(np.stack(shares, axis=-1), 0.0, 1.0)
        return np.round(inside * self._place[2:] + self._place[:2], 1).reshape(-1, 2).tolist()

    def line(self, x: Array, y: Array, colour: str, width: float, dashed: bool = False) -> None:
        """Draw a line through points."""
        points = ' '.join(f'{a},{b}' for a, b in self._at(x, y))
        look = f'stroke="{colour}" stroke-width="{width}"' + dashed * ' stroke-dasharray="6 4"'
        self._add(f'polyline points="{points}" fill="none" {look}')

    def band(self, x: Any, low: Any, high: Any, colour: str, opacity: float) -> None:
        """Fill between two lines over the same places."""
        points = ' '.join(f'{a},{b}' for a, b in [*self._at(x, low), *self._at(x, high)[::-1]])
        self._add(f'polygon points="{points}" fill="{colour}" fill-opacity="{opacity}"')

    def dots(self, x: Array, y: Array, colour: str, size: float, cap: str = 'round') -> None:
        """Draw dots: round, or `square`; of those on half a pixel one."""
        at = dict.fromkeys(f'M{round(2 * a) / 2} {round(2 * b) / 2}h0' for a, b in self._at(x, y))
        look = f'stroke="{colour}" stroke-width="{size}" stroke-linecap="{cap}"'
        self._add(f'path d="{"".join(at)}" {look}')


def svg(plots: Iterable[Plot], width: float, height: float) -> Markup:
    """Return a picture of plots, of a size [px]."""
    body = ''.join(element for plot in plots for element in plot.elements)
    head = f'viewBox="0 0 {width} {height}" fill="#1c2733" text-anchor="middle" font-size="12"'
    return Markup(f'<svg class="chart" {head}>{body}</svg>')
