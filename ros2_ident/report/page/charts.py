# SPDX-License-Identifier: Apache-2.0
"""A residual along a coordinate, with the law that was found drawn through it, as SVG.

It is text of the page: there before any script runs, in the page's colours, and it prints.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
import itertools
import math
from typing import Any

from markupsafe import escape, Markup
import numpy as np

from ros2_ident.arrays import Array
from ros2_ident.gap.wording import compared
from ros2_ident.report.page.numbers import number, unit_of

WIDTH, HEIGHT = 560.0, 330.0
_SIDES = ('before', 'after')
_LEFT, _RIGHT, _TOP, _BOTTOM = 84.0, 10.0, 10.0, 52.0
# Nothing is drawn across a gap of this share of the width.
_EMPTY = 0.3
# Dots nearer to each other than this, in pixels, are drawn as one.
_NEAR = 9.0
# A picture over the speed is read at once: it goes before one that shows hardly more.
FAMILIAR = 1.25
# What stands for a coordinate in a sentence.
NAMES = {'load': 'transmitted load', 'torque': 'simulated effort', 'lagging friction': 'time'}


@dataclass(frozen=True)
class Chart:
    """A picture.

    Attributes:
        svg: The drawing.
        title: What it is, for a caption.
        headings: Directions of motion that are drawn apart.
        law: What the thick line is; empty where there is none.
        summary: The same in words, for who cannot see it.
        bent: Whether its axis is linear near zero and logarithmic beyond.
    """

    svg: Markup
    title: str
    headings: tuple[str, ...]
    law: str
    summary: str
    bent: bool = False


@dataclass(frozen=True)
class _Axis:
    """One axis: values from `low` to `high` stand from `start` to `end`, in pixels.

    Attributes:
        linear: Values nearer to zero than this stand evenly, others by their logarithm; 0 for
            an axis that is linear, -1 for one that is logarithmic.
    """

    low: float
    high: float
    start: float
    end: float
    linear: float = 0.0

    def __call__(self, values: Any) -> Array:
        low, high = (float(_stretched(x, self.linear)) for x in (self.low, self.high))
        share = (_stretched(values, self.linear) - low) / ((high - low) or 1.0)
        out: Array = self.start + share * (self.end - self.start)
        return out

    def ticks(self, most: int) -> list[float]:
        """Return round values, `most` at most, none beside another."""
        if self.linear == 0.0:
            return _round_values(self.low, self.high, most)
        room = abs(self.end - self.start) / most
        out: list[float] = []
        for value in _decades(self.low, self.high, self.linear):
            at = float(self(value))
            if all(abs(at - float(self(other))) >= room for other in out):
                out.append(value)
        return sorted(out)


def _stretched(values: Any, linear: float) -> Array:
    """Return places on an axis that is linear near zero and logarithmic beyond."""
    array = np.asarray(values, dtype=np.float64)
    if linear == 0.0:
        return array
    if linear < 0.0:
        return np.asarray(np.log10(np.maximum(array, 1e-300)), dtype=np.float64)
    size = np.abs(array) / linear
    beyond = 0.6 + np.log10(np.maximum(size, 1.0))
    out: Array = np.sign(array) * np.where(size <= 1.0, 0.6 * size, beyond)
    return out


def _round_values(low: float, high: float, most: int) -> list[float]:
    if not high > low:
        return [low]
    rough = (high - low) / most
    power = 10.0 ** math.floor(math.log10(rough))
    step = next(s * power for s in (1.0, 2.0, 5.0, 10.0) if s * power >= rough * (1.0 - 1e-9))
    first = math.ceil(low / step - 1e-9)
    return [step * k for k in range(first, math.floor(high / step + 1e-9) + 1)]


def _decades(low: float, high: float, linear: float) -> list[float]:
    """Return zero, then 1, 5 and 2 of each decade within the axis: what matters most first."""
    least = linear if linear > 0.0 else low
    top = max(abs(low), abs(high))
    exponents = range(math.floor(math.log10(least)), math.ceil(math.log10(top)) + 1)
    sides = [step * 10.0**e for step in (1, 5, 2) for e in exponents]
    sides = [x for x in sides if 0.9 * least <= x <= 1.02 * top]
    if linear < 0.0:
        return [x for x in sides if low <= x <= high]
    return [x for x in [0.0, *(s * x for x in sides for s in (1, -1))] if low <= x <= high]


def picture(found: Mapping[str, Any], effects: str = '') -> Chart | None:
    """Draw a map of the residual.

    Args:
        found: An entry of `maps` of a diagnosis.
        effects: What the law is, for the text; empty draws none.

    Returns:
        The picture; None where the map holds no line.
    """
    before = [line for line in found['before'] if line['place']]
    if not before:
        return None
    spectrum = found['coordinate'] == 'frequency'
    x = _x_axis(before, -1.0 if spectrum else float(found['linear']))
    if not spectrum:
        found = {**found, **{k: [_merged(line, x) for line in found[k]] for k in _SIDES}}
        before = [line for line in found['before'] if line['place']]
    laws = _laws(found) if effects else []
    y = _y_axis(found, before, laws, spectrum)
    parts = [*_frame(found, x, y, spectrum)]
    for line in before:
        parts += _measured(line, x, y, spectrum)
    for heading, place, values in laws:
        drawn = [slice(None)] if spectrum else _stretches(x(place))
        parts += [_path(f'law {heading}', x(place[s]), y(values[s])) for s in drawn]
    name = NAMES.get(found['coordinate'], found['coordinate'])
    what = compared(str(found['unit']))
    title = f'{found["drive"]}: measured minus simulated {what} over the {name}'
    summary = _summary(found, before, laws, effects, title)
    svg = Markup(
        f'<svg class="chart" viewBox="0 0 {WIDTH:.0f} {HEIGHT:.0f}" role="img">'
        f'<title>{escape(summary)}</title>{"".join(parts)}</svg>'
    )
    headings = tuple(line['heading'] for line in before)
    verb = 'add' if effects == 'the effects' else 'adds'
    adds = f'what {effects} {verb} to the simulation, with its parameters refitted'
    what = f'left with {effects}' if spectrum else adds
    return Chart(svg, title, headings, what if laws else '', summary, x.linear > 0.0)


def _merged(line: Mapping[str, Any], x: _Axis) -> Mapping[str, Any]:
    """Return a line whose bins lie apart on the picture: those that would overlap as their mean.

    Bins hold equally many samples, so that means of bins are means of samples.
    """
    if not line['place']:
        return line
    at = x(line['place'])
    groups = [[0]]
    for k in range(1, len(at)):
        if at[k] - at[groups[-1][0]] < _NEAR:
            groups[-1].append(k)
        else:
            groups.append([k])
    place, mean, half = (np.array(line[k], dtype=np.float64) for k in ('place', 'mean', 'half'))
    return {
        **line,
        'place': [float(np.mean(place[g])) for g in groups],
        'mean': [float(np.mean(mean[g])) for g in groups],
        'half': [float(np.sqrt(np.sum(half[g] ** 2)) / len(g)) for g in groups],
    }


def _laws(found: Mapping[str, Any]) -> list[tuple[str, Array, Array]]:
    """Return what the effects add to the simulation, in bins of each direction.

    Both residuals are of the same samples: what was measured drops out of their difference.
    """
    after = {line['heading']: line for line in found['after']}
    out = []
    for line in found['before']:
        other = after.get(line['heading'])
        if other is None or not line['place'] or len(other['place']) != len(line['place']):
            continue
        if found['coordinate'] == 'frequency':  # amplitudes do not subtract: what is left
            values = np.array(other['mean'], dtype=np.float64)
        else:
            values = np.array(line['mean'], dtype=np.float64) - np.array(other['mean'])
        out.append((line['heading'], np.array(line['place'], dtype=np.float64), values))
    return out


def _x_axis(lines: Sequence[Mapping[str, Any]], linear: float) -> _Axis:
    places = [p for line in lines for p in line['place']]
    low, high = min(places), max(places)
    if linear == 0.0:
        room = 0.02 * (high - low)
        low, high = low - room, high + room
    return _Axis(low, high, _LEFT, WIDTH - _RIGHT, linear)


def _y_axis(
    found: Mapping[str, Any],
    lines: Sequence[Mapping[str, Any]],
    laws: Sequence[tuple[str, Array, Array]],
    spectrum: bool,
) -> _Axis:
    values = [np.array(line['mean'], dtype=np.float64) for line in lines]
    values += [law for _, _, law in laws]
    if spectrum:
        positive = np.concatenate(values)
        positive = positive[positive > 0.0]
        low = max(float(positive.min()), 1e-4 * float(positive.max()))
        return _Axis(low, 1.5 * float(positive.max()), HEIGHT - _BOTTOM, _TOP, -1.0)
    for line in lines:
        half = np.nan_to_num(np.array(line['half'], dtype=np.float64))
        mean = np.array(line['mean'], dtype=np.float64)
        values += [mean - half, mean + half]
    low, high = (float(f(np.concatenate(values))) for f in (np.min, np.max))
    floor = float(found['noise_floor'] or 0.0)
    low, high = min(low, -0.3 * floor, 0.0), max(high, 0.3 * floor, 0.0)
    room = 0.06 * (high - low)
    return _Axis(low - room, high + room, HEIGHT - _BOTTOM, _TOP)


def _frame(found: Mapping[str, Any], x: _Axis, y: _Axis, spectrum: bool) -> list[str]:
    """Return grid, numbers, names of the axes, and the noise floor."""
    left, right, top, bottom = _LEFT, WIDTH - _RIGHT, _TOP, HEIGHT - _BOTTOM
    out = []
    floor = float(found['noise_floor'] or 0.0)
    if floor and not spectrum:
        high, low = (float(np.clip(y(s * floor), top, bottom)) for s in (1.0, -1.0))
        out.append(
            f'<rect class="floor" x="{left}" y="{high:.1f}" width="{right - left}" '
            f'height="{max(0.0, low - high):.1f}"/>'
        )
    for value in y.ticks(6):
        at = float(y(value))
        out.append(f'<path class="grid" d="M{left} {at:.1f}H{right}"/>')
        out.append(
            f'<text x="{left - 7}" y="{at + 4.5:.1f}" class="end">{number(value, 3)}</text>'
        )
    for value in x.ticks(7):
        at = float(x(value))
        out.append(f'<path class="grid" d="M{at:.1f} {top}V{bottom}"/>')
        out.append(
            f'<text x="{at:.1f}" y="{bottom + 18}" class="middle">{number(value, 3)}</text>'
        )
    if not spectrum:
        out.append(f'<path class="zero" d="M{left} {float(y(0.0)):.1f}H{right}"/>')
    what = 'amplitude density' if spectrum else 'measured − simulated'
    label = f'{what} [{unit_of(str(found["unit"]))}]'
    middle = 0.5 * (top + bottom)
    out.append(
        f'<text class="middle" transform="translate(15 {middle:.0f}) rotate(-90)">'
        f'{escape(label)}</text>'
    )
    out.append(
        f'<text x="{0.5 * (left + right):.0f}" y="{HEIGHT - 10}" class="middle">'
        f'{escape(str(found["label"]))}</text>'
    )
    return out


def _measured(line: Mapping[str, Any], x: _Axis, y: _Axis, spectrum: bool) -> list[str]:
    """Return the means with their 95 % band; a spectrum as a line."""
    heading = line['heading']
    places, mean = x(line['place']), np.array(line['mean'], dtype=np.float64)
    if spectrum:
        return [_path(f'line {heading}', places, y(np.maximum(mean, y.low)))]
    out = []
    half = np.array(line['half'], dtype=np.float64)
    if np.isfinite(half).all():
        for s in _stretches(places):
            edge = np.concatenate([y(mean + half)[s], y(mean - half)[s][::-1]])
            around = np.concatenate([places[s], places[s][::-1]])
            out.append(_path(f'band {heading}', around, edge, closed=True))
    for px, py in zip(places, y(mean), strict=True):
        if line['heading'] == 'backwards':
            out.append(
                f'<rect class="dot {heading}" x="{px - 3:.1f}" y="{py - 3:.1f}" width="6" '
                'height="6"/>'
            )
        else:
            out.append(f'<circle class="dot {heading}" cx="{px:.1f}" cy="{py:.1f}" r="3.4"/>')
    return out


def _stretches(xs: Array) -> list[slice]:
    """Return the stretches of places, in the picture's units, between which there are no data."""
    if len(xs) < 2:
        return [slice(None)]
    apart = np.diff(xs)
    wide = apart > max(_EMPTY * WIDTH, 3.0 * float(np.median(apart)))
    ends = [0, *(np.flatnonzero(wide) + 1), len(xs)]
    return [slice(a, b) for a, b in itertools.pairwise(ends)]


def _path(style: str, xs: Array, ys: Array, *, closed: bool = False) -> str:
    points = 'L'.join(f'{a:.1f} {b:.1f}' for a, b in zip(xs, ys, strict=True))
    return f'<path class="{style}" d="M{points}{"Z" if closed else ""}"/>'


def _summary(
    found: Mapping[str, Any],
    lines: Sequence[Mapping[str, Any]],
    laws: Sequence[tuple[str, Array, Array]],
    effects: str,
    title: str,
) -> str:
    """Return what the picture shows in words."""
    unit = unit_of(str(found['unit']))
    mean = [m for line in lines for m in line['mean']]
    text = f'{title}. It runs from {number(min(mean), 2)} to {number(max(mean), 2)} {unit}'
    if laws and found['coordinate'] != 'frequency':
        left = [m for line in found['after'] for m in line['mean']]
        text += (
            f'; with {effects} in the model from {number(min(left), 2)} to '
            f'{number(max(left), 2)} {unit}'
        )
    return text + '.'


def all_of(data: Mapping[str, Any], effects: str) -> tuple[Chart | None, list[Chart]]:
    """Return the picture of the first screen, and all others.

    Args:
        data: The content of `diagnosis.json`.
        effects: What was found, for the text; empty where no effect was named.

    Returns:
        The map on which the effects explain most, of a drive they sit on where there is one; the
        first where none was found. None where there is no map.
    """
    maps = data['maps']
    if not maps:
        return None, []
    # what goes on the data fitted to convinces only where it goes on held-out data, too
    closed = {name: d['share_closed'] for name, d in data['gap']['per_drive'].items()}
    where = {w for at in (data['verdict'], *data['also']) for w in at['where']}
    best = max(
        maps,
        key=lambda m: (
            effects != '' and m['drive'] in where,
            effects != '' and 'all' in where,
            _explained(m) * (closed.get(m['drive']) or 0.0) if effects else 0.0,
        ),
    )
    hero, *drawn = [picture(m, effects) for m in (best, *maps)]
    # what lags behind the motion is shown over time, as what depends on time
    titled = {c.title: c for c in drawn[::-1] if c is not None}
    others = [c for c in titled.values() if hero is None or c.title != hero.title][::-1]
    if hero is not None and effects and best['drive'] not in where and len(closed) > 1:
        drive = str(best['drive'])
        title = hero.title.replace(drive, f'{drive}, where the effects explain most', 1)
        hero = replace(hero, title=title)
    return hero, others


def _explained(found: Mapping[str, Any]) -> float:
    """Return the mean square that goes once the effects are in, over that of the noise floor."""
    if found['coordinate'] == 'frequency' or not found['noise_floor']:
        return 0.0
    squares = [
        b * b - a * a
        for line, other in zip(found['before'], found['after'], strict=False)
        for b, a in zip(line['mean'], other['mean'], strict=False)
    ]
    mean = sum(squares) / len(squares) / found['noise_floor'] ** 2 if squares else 0.0
    return mean * (FAMILIAR if found['coordinate'] == 'velocity' else 1.0)
