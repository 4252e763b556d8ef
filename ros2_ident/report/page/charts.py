# SPDX-License-Identifier: Apache-2.0
"""Maps of a residual along a coordinate, and the law that was found, as SVG by matplotlib."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
import io
import itertools
import math
from typing import Any, TYPE_CHECKING

from markupsafe import escape, Markup
import numpy as np

from ros2_ident.arrays import Array
from ros2_ident.report.page.numbers import number, unit_of
from ros2_ident.report.style import BLUE, GREY, numbers, ORANGE, RED, tidy
from ros2_ident.words.figures import compared

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# Size, inches of 72 pixels.
SIZE = 5.8, 3.5
# No line crosses a gap of this share of the width.
_EMPTY = 0.36
# A picture over the speed is read at once: it goes before one that shows hardly more.
FAMILIAR = 1.25
# Names of coordinates in a sentence.
NAMES = {'load': 'transmitted load', 'torque': 'simulated effort', 'lagging friction': 'time'}
_COLOURS = {'forwards': BLUE, 'backwards': ORANGE, 'both': 'black'}

Laws = Sequence[tuple[str, Array, Array]]


@dataclass(frozen=True)
class Chart:
    """A picture.

    Attributes:
        svg: The drawing.
        title: Caption.
        headings: Directions of motion that are drawn apart.
        law: Name of the thick line; empty where there is none.
        bent: Whether its axis is linear near zero and logarithmic beyond.
    """

    svg: Markup
    title: str
    headings: tuple[str, ...]
    law: str
    bent: bool = False


def picture(found: Mapping[str, Any], effects: str = '') -> Chart | None:
    """Draw a map of the residual.

    Args:
        found: An entry of `maps` of a diagnosis.
        effects: Name of the law; empty draws none.

    Returns:
        The picture; None where the map holds no line.
    """
    before = [line for line in found['before'] if line['place']]
    if not before:
        return None
    spectrum = found['coordinate'] == 'frequency'
    laws = _laws(found) if effects else []
    name = NAMES.get(found['coordinate'], found['coordinate'])
    title = (
        f'{found["drive"]}: measured minus simulated {compared(str(found["unit"]))} over the '
        f'{name}'
    )
    summary = _summary(found, before, laws, effects, title)
    svg = Markup(f'<div class="drawn" role="img" aria-label="{escape(summary)}">') + Markup(
        _drawn(found, before, laws, spectrum=spectrum) + '</div>'
    )
    verb = 'add' if effects == 'the effects' else 'adds'
    law = f'what {effects} {verb} to the simulation, with its parameters refitted'
    law = f'left with {effects}' if spectrum else law
    headings = tuple(line['heading'] for line in before)
    bent = not spectrum and float(found['linear']) > 0.0
    return Chart(svg, title, headings, law if laws else '', bent)


def _drawn(
    found: Mapping[str, Any], lines: Sequence[Mapping[str, Any]], laws: Laws, *, spectrum: bool
) -> str:
    """Return a map as SVG."""
    # A page without maps need not wait for matplotlib.
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    with rc_context({'svg.fonttype': 'none', 'svg.hashsalt': 'ros2_ident', 'font.size': 12.0}):
        made = Figure(SIZE, layout='constrained')
        axes = made.subplots()
        tidy(axes)
        axes.tick_params(labelsize=11.0)
        if spectrum:
            axes.loglog()
            numbers(axes.xaxis)
        elif found['linear']:
            _bend(axes, float(found['linear']), [x for line in lines for x in line['place']])
        floor = float(found['noise_floor'] or 0.0)
        if floor and not spectrum:
            axes.axhspan(-floor, floor, color=GREY, alpha=0.13, lw=0.0)
            axes.axhline(0.0, color=GREY, lw=0.8)
        for line in lines:
            _measured(axes, line, spectrum=spectrum)
        for heading, place, values in laws:
            dashed = '--' if heading == 'backwards' else '-'
            for s in [slice(None)] if spectrum else _stretches(axes, place):
                axes.plot(place[s], values[s], color=RED, lw=2.4, ls=dashed)
        what = 'amplitude density' if spectrum else 'measured − simulated'
        axes.set(xlabel=found['label'], ylabel=f'{what} [{unit_of(str(found["unit"]))}]')
        file = io.StringIO()
        made.savefig(file, format='svg', metadata={'Date': None}, transparent=True)
    text = file.getvalue()
    body = text[text.index('viewBox=') :]
    return f'<svg class="chart" xmlns:xlink="http://www.w3.org/1999/xlink" {body}'


def _bend(axes: 'Axes', linear: float, places: Sequence[float]) -> None:
    """Make an axis linear up to `linear` about zero and logarithmic beyond, with plain numbers."""
    axes.set_xscale('symlog', linthresh=linear, linscale=0.6)
    first = math.ceil(math.log10(linear))
    last = max(first, math.floor(math.log10(max(map(abs, places), default=linear) or linear)))
    decades = [10.0**e for e in range(last, first - 1, -1 - (last - first) // 3)]
    ticks = [0.0, *(sign * x for x in decades for sign in (1.0, -1.0))]
    axes.set_xticks(ticks, labels=[f'{x:g}'.replace('-', '−', 1) for x in ticks])
    axes.set_xticks([], minor=True)


def _measured(axes: 'Axes', line: Mapping[str, Any], *, spectrum: bool) -> None:
    """Draw the means with their 95 % band; a spectrum as a line."""
    place, mean, half = (np.array(line[k], dtype=float) for k in ('place', 'mean', 'half'))
    colour = _COLOURS[line['heading']]
    if spectrum:
        axes.plot(place, mean, color=colour, lw=1.4)
        return
    if np.isfinite(half).all():
        for s in _stretches(axes, place):
            axes.fill_between(
                place[s], (mean - half)[s], (mean + half)[s], color=colour, alpha=0.18, lw=0.0
            )
    mark = 's' if line['heading'] == 'backwards' else 'o'
    axes.plot(place, mean, mark, color=colour, ms=4.0)


def _stretches(axes: 'Axes', place: Array) -> list[slice]:
    """Return the stretches of a line between which there are no data."""
    if len(place) < 2:
        return [slice(None)]
    at = axes.xaxis.get_transform().transform(place)
    apart = np.diff(at)
    wide = apart > max(_EMPTY * float(np.ptp(at)), 3.0 * float(np.median(apart)))
    ends = [0, *(np.flatnonzero(wide) + 1), len(place)]
    return [slice(a, b) for a, b in itertools.pairwise(ends)]


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
