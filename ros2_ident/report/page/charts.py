# SPDX-License-Identifier: Apache-2.0
"""SVG by matplotlib: maps of a residual with the law that was found, and the search."""

from collections.abc import Sequence
from dataclasses import replace
import itertools
import math
from typing import TYPE_CHECKING

import numpy as np

from ros2_ident.arrays import Array
from ros2_ident.identify.result import Identification
from ros2_ident.report.diagnosis import Written
from ros2_ident.report.maps import Line, ResidualMap
from ros2_ident.report.page.numbers import number, unit_of
from ros2_ident.report.page.render import (
    BLUE,
    GREY,
    INK,
    Key,
    ORANGE,
    Picture,
    plain_ticks,
    RED,
    svg,
    tidy,
    WIDTH,
)
from ros2_ident.words.figures import compared
from ros2_ident.words.verdict import named

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Size [px].
SIZE = 417.6, 252.0
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
# Plots of a cost over parameters side by side, and their height, pixels.
COLUMNS, HIGH = 4, 205

Laws = Sequence[tuple[str, Array, Array]]


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
    laws = _laws(found) if effects else []
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
    drawn = svg(lambda made: _draw(made.subplots(), found, before, laws), *SIZE)
    return Picture(drawn, title, title, tuple(keys), (note,))


def _draw(axes: 'Axes', found: ResidualMap, lines: Sequence[Line], laws: Laws) -> None:
    tidy(axes)
    if found.linear:
        _bend(axes, found.linear, np.concatenate([line.place for line in lines]))
    floor = found.noise_floor
    if floor > 0.0:
        axes.axhspan(-floor, floor, color=GREY, alpha=0.13, lw=0.0)
        axes.axhline(0.0, color=GREY, lw=0.8)
    for line in lines:
        _measured(axes, line)
    for heading, place, values in laws:
        dashed = '--' if heading == 'backwards' else '-'
        for s in _stretches(axes, place):
            axes.plot(place[s], values[s], color=RED, lw=2.4, ls=dashed)
    axes.set(xlabel=found.label, ylabel=f'measured − simulated [{unit_of(found.unit)}]')


def _bend(axes: 'Axes', linear: float, places: Array) -> None:
    """Make an axis linear up to `linear` about zero and logarithmic beyond, with plain numbers."""
    axes.set_xscale('symlog', linthresh=linear, linscale=0.6)
    first = math.ceil(math.log10(linear))
    last = max(first, math.floor(math.log10(np.abs(places).max() or linear)))
    decades = [10.0**e for e in range(last, first - 1, -1 - (last - first) // 3)]
    ticks = [0.0, *(sign * x for x in decades for sign in (1.0, -1.0))]
    axes.set_xticks(ticks, labels=[f'{x:g}'.replace('-', '−', 1) for x in ticks])
    axes.set_xticks([], minor=True)


def _measured(axes: 'Axes', line: Line) -> None:
    """Draw the means with their 95 % band."""
    place, mean, half = line.place, line.mean, line.half
    colour = _KEYS[line.heading].colour
    if np.isfinite(half).all():
        for s in _stretches(axes, place):
            axes.fill_between(
                place[s], (mean - half)[s], (mean + half)[s], color=colour, alpha=0.18, lw=0.0
            )
    mark = 's' if line.heading == 'backwards' else 'o'
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


def _laws(found: ResidualMap) -> list[tuple[str, Array, Array]]:
    """Return what the effects add to the simulation, in bins of each direction.

    Both residuals are of the same samples: what was measured drops out of their difference.
    """
    after = {line.heading: line for line in found.after}
    return [
        (b.heading, b.place, b.mean - a.mean)
        for b in found.before
        if (a := after.get(b.heading)) is not None and b.place.size == a.place.size > 0
    ]


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
        if b.mean.size == a.mean.size
    ]
    mean = float(np.concatenate(squares).mean()) if squares else 0.0
    familiar = FAMILIAR if found.coordinate == 'velocity' else 1.0
    return familiar * mean / found.noise_floor**2


# ---------------------------------------------------------------------- the search


def cost_over_parameters(result: Identification) -> Picture | None:
    """Draw the known costs over each parameter: the paper's figures 8, 9 and 11.

    The axis of the costs is logarithmic where they span much.
    """
    history = result.history
    finite = np.isfinite(history.costs)
    if not finite.any():
        return None
    rows, costs = -(-len(result.parameters) // COLUMNS), history.costs[finite]

    def draw(made: 'Figure') -> None:
        grid = made.subplots(rows, COLUMNS, sharey=True, squeeze=False)
        for n, axes in enumerate(grid.flat):
            if n >= len(result.parameters):
                axes.remove()
                continue
            p = result.parameters[n]
            tidy(axes)
            if costs.min() > 0.0 and costs.max() > WIDE * costs.min():
                axes.set_yscale('log')
                plain_ticks(axes.yaxis)
            if math.isfinite(p.low) and math.isfinite(p.high):
                axes.axvspan(p.low, p.high, color=ORANGE, alpha=0.25, lw=0.0)
            axes.scatter(
                history.candidates[finite, n],
                costs,
                c=history.generations[finite],
                cmap='viridis_r',
                s=9.0,
                lw=0.0,
                rasterized=True,  # there can be many thousands
            )
            if math.isfinite(p.value):
                axes.axvline(p.value, color=RED, lw=1.5, ls='--')
            axes.ticklabel_format(axis='x', scilimits=(-2, 4), useMathText=True)
            axes.xaxis.get_offset_text().set_parse_math(True)
            axes.locator_params(axis='x', nbins=4)
            axes.set_xlim(p.lower_bound, p.upper_bound)
            axes.set_title(p.name.replace('.', '.\n'), fontsize=12.0, fontweight='bold')
            axes.set_xlabel(f'[{unit_of(p.unit) or "1"}]')
            if n % COLUMNS == 0:
                axes.set_ylabel(f'cost [{result.cost.unit}]')

    cost, count = result.cost, history.best_costs.size
    refined = f', refined {number(cost.refined)}' if math.isfinite(cost.refined) else ''
    notes = (f'Least cost of {count} generations: {number(cost.ga)}{refined} {cost.unit}.',)
    summary = 'Cost of the candidates over each parameter'
    return Picture(svg(draw, WIDTH, HIGH * rows), summary, notes=notes, least=800)


def correlated(result: Identification) -> bool:
    """Whether the correlation of any two estimates is known."""
    return bool(np.isfinite(result.correlation[~np.eye(len(result.parameters), dtype=bool)]).any())
