# SPDX-License-Identifier: Apache-2.0
"""Maps of a residual with the law that was found, and the search, as SVG, written at once."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
import itertools
import math
from typing import Any

from markupsafe import escape, Markup
import numpy as np

from ros2_ident.arrays import Array
from ros2_ident.identify.result import Identification
from ros2_ident.report.diagnosis import Written
from ros2_ident.report.maps import Line, ResidualMap
from ros2_ident.report.page.numbers import number, unit_of
from ros2_ident.report.page.render import BLUE, GREY, INK, Key, ORANGE, Picture, RED
from ros2_ident.words.figures import compared
from ros2_ident.words.verdict import named

# Size [px], and the place of the plot in it.
SIZE, PLACE = (418, 252), (68, 12, 340, 200)
# No line crosses a gap of this share of the width.
_EMPTY = 0.36
# A picture over the speed is read at once: it goes before one that shows hardly more.
FAMILIAR = 1.25
_KEYS = {
    'forwards': Key('moving forwards', BLUE, 'dot'),
    'backwards': Key('moving backwards', ORANGE, 'square'),
    'both': Key('measured minus simulated', INK, 'dot'),
}
# Costs that span more than this are drawn on a logarithmic axis.
WIDE = 20.0
# Plots of a cost over parameters side by side, and the size of each with its labels, pixels.
COLUMNS, WIDE_EACH, HIGH = 4, 233, 205
# Colours of the generations, from the first on (viridis).
VIRIDIS = '#fde725', '#a5db36', '#4ac16d', '#1fa187', '#277f8e', '#365c8d', '#46327e', '#440154'

Laws = Sequence[tuple[str, Array, Array]]


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


# ---------------------------------------------------------------------- what is drawn


def picture(found: ResidualMap, effects: str = '') -> Picture | None:
    """Draw a map of the residual.

    Args:
        effects: Name of the law; empty draws none.

    Returns:
        The picture; None where the map holds no line.
    """
    before = [line for line in found.before if line.place.size]
    if not before:
        return None
    # Both residuals are of the same samples: what was measured drops out of their difference.
    after = {line.heading: line for line in found.after} if effects else {}
    laws = [
        (b.heading, b.place, b.mean - a.mean)
        for b in found.before
        if (a := after.get(b.heading)) is not None and b.place.size == a.place.size > 0
    ]
    name, _, _ = found.label.partition(' [')
    title = f'{found.drive}: measured minus simulated {compared(found.unit)} over the {name}'
    keys = [_KEYS[line.heading] for line in before]
    if laws:
        verb = 'add' if effects == 'the effects' else 'adds'
        law = f'what {effects} {verb} to the simulation, with its parameters refitted'
        keys.append(Key(law, RED, '3'))
    note = 'dots are means; shaded: their 95 % interval; level band: noise of one sample'
    if found.linear > 0.0:
        note += '; the axis is logarithmic away from 0'
    drawn = svg([_plot(found, before, laws)], *SIZE)
    return Picture(drawn, title, title, tuple(keys), (note,))


def _plot(found: ResidualMap, lines: Sequence[Line], laws: Laws) -> Plot:
    floor = max(found.noise_floor, 0.0)
    bands = [(x.mean, np.nan_to_num(x.half)) for x in lines]
    ends = [y for mean, half in bands for y in (mean - half, mean + half)]
    along = linear(*wider(*(line.place for line in lines)))
    if found.linear:
        along = _bent(found.linear, lines)
    up = linear(*wider(np.array([-floor, floor]), *ends, *(values for _, _, values in laws)))
    labels = found.label, f'measured − simulated [{unit_of(found.unit)}]'
    plot = Plot(PLACE, along, up, labels)
    across = np.array([along.low, along.high])
    if floor > 0.0:
        plot.band(across, -floor, floor, GREY, 0.13)
        plot.line(across, np.zeros(2), GREY, 0.8)
    for line, (mean, half) in zip(lines, bands, strict=True):
        colour = _KEYS[line.heading].colour
        for s in _stretches(along, line.place) if np.isfinite(line.half).all() else ():
            plot.band(line.place[s], (mean - half)[s], (mean + half)[s], colour, 0.18)
        cap = 'square' if line.heading == 'backwards' else 'round'
        plot.dots(line.place, mean, colour, 5.0, cap)
    for heading, place, values in laws:
        for s in _stretches(along, place):
            plot.line(place[s], values[s], RED, 2.4, dashed=heading == 'backwards')
    return plot


def _bent(near: float, lines: Sequence[Line]) -> Axis:
    """Return an axis that is linear up to `near` about zero and logarithmic beyond."""
    places = [0.0, *np.concatenate([line.place for line in lines])]
    low, high = 1.2 * float(min(places)), 1.2 * float(max(places))
    first = math.ceil(math.log10(near))
    last = max(first, math.floor(math.log10(max(-low, high) / 1.2)))
    decades = [10.0**e for e in range(last, first - 1, -1 - (last - first) // 3)]
    ticks = [0.0, *(sign * x for x in decades for sign in (1.0, -1.0))]
    inside = [x for x in ticks if low <= x <= high]
    return Axis(low, high, inside, lambda values: np.arcsinh(np.divide(values, near)))


def _stretches(axis: Axis, place: Array) -> list[slice]:
    """Return the stretches of a line between which there are no data."""
    if len(place) < 2:
        return [slice(None)]
    at = axis.share(place)
    apart = np.diff(at)
    wide = apart > max(_EMPTY * float(np.ptp(at)), 3.0 * float(np.median(apart)))
    ends = [0, *(np.flatnonzero(wide) + 1), len(place)]
    return [slice(a, b) for a, b in itertools.pairwise(ends)]


def all_of(w: Written, effects: str) -> tuple[Picture | None, list[Picture]]:
    """Return the picture of the first screen, and all others.

    Args:
        effects: What was found, for the text; empty where no effect was named.

    Returns:
        The map on which the effects explain most, of a drive they sit on where there is one; the
        first where none was found. None where there is no map.
    """
    if not w.maps:
        return None, []
    drives, where = w.found.per_drive, {at.where for at in named(w.found)}

    # what goes on the data fitted to convinces only where it goes on held-out data, too
    best = max(
        w.maps,
        key=lambda m: (
            m.drive in where,
            _explained(m) * float(np.nan_to_num(drives[m.drive].share_closed)) if effects else 0.0,
        ),
    )
    drawn: dict[str, Picture] = {}
    # what lags behind the motion is shown over time, as what depends on time
    for m in (best, *(m for m in w.maps if m is not best)):
        if made := picture(m, effects):
            drawn.setdefault(made.title, made)
    if not drawn:
        return None, []
    hero, *others = drawn.values()
    if effects and best.drive not in where and len(drives) > 1:
        explained = f'{best.drive}, where the effects explain most'
        hero = replace(hero, title=hero.title.replace(best.drive, explained, 1))
    return hero, others


def _explained(found: ResidualMap) -> float:
    """Return the mean square that goes once the effects are in, over that of the noise floor."""
    if not found.noise_floor > 0.0:
        return 0.0
    squares = [
        b.mean**2 - a.mean**2
        for b, a in zip(found.before, found.after, strict=False)
        if b.mean.size == a.mean.size > 0
    ]
    mean = float(np.concatenate(squares).mean()) if squares else 0.0
    familiar = FAMILIAR if found.coordinate == 'velocity' else 1.0
    return familiar * mean / found.noise_floor**2


def cost_over_parameters(result: Identification) -> Picture | None:
    """Draw the known costs over each parameter: the paper's figures 8, 9 and 11.

    The axis of the costs is logarithmic where they span much.
    """
    history = result.history
    finite = np.isfinite(history.costs)
    if not finite.any():
        return None
    costs, born = history.costs[finite], history.generations[finite]
    wide = costs.min() > 0.0 and costs.max() > WIDE * costs.min()
    ends = np.exp(wider(np.log(costs))) if wide else wider(costs)
    up = logarithmic(*ends) if wide else linear(*ends)
    # the last generations are drawn last
    age = (len(VIRIDIS) - 1) * (born - born.min()) // max(1, np.ptp(born))
    plots = []
    for n, p in enumerate(result.parameters):
        row, column = divmod(n, COLUMNS)
        place = (62 + WIDE_EACH * column, 34 + HIGH * row, WIDE_EACH - 28, HIGH - 72)
        labels = f'[{unit_of(p.unit) or "1"}]', '' if column else f'cost [{result.cost.unit}]'
        axis = linear(p.lower_bound, p.upper_bound, 4)
        plot = Plot(place, axis, up, labels, p.name.replace('.', '.\n').split('\n'))
        if math.isfinite(p.low) and math.isfinite(p.high):
            plot.band(np.array([p.low, p.high]), up.low, up.high, ORANGE, 0.25)
        for k, colour in enumerate(VIRIDIS):
            plot.dots(history.candidates[finite, n][age == k], costs[age == k], colour, 3.0)
        if math.isfinite(p.value):
            plot.line(np.full(2, p.value), np.array([up.low, up.high]), RED, 1.5, dashed=True)
        plots.append(plot)
    cost, count = result.cost, history.best_costs.size
    refined = f', refined {number(cost.refined)}' if math.isfinite(cost.refined) else ''
    notes = (f'Least cost of {count} generations: {number(cost.ga)}{refined} {cost.unit}.',)
    summary = 'Cost of the candidates over each parameter'
    drawn = svg(plots, 1000, HIGH * -(-len(plots) // COLUMNS))
    return Picture(drawn, summary, notes=notes, least=800)


def correlated(result: Identification) -> bool:
    """Whether the correlation of any two estimates is known."""
    return bool(np.isfinite(result.correlation[~np.eye(len(result.parameters), dtype=bool)]).any())
