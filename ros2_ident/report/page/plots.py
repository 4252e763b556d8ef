# SPDX-License-Identifier: Apache-2.0
"""The search, as SVG by matplotlib."""

from collections.abc import Sequence
import math
from typing import Any, TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from ros2_ident.arrays import Array
from ros2_ident.identify.result import Identification
from ros2_ident.report.page.look import INK, Key, Picture, svg, WIDTH
from ros2_ident.report.page.numbers import number, unit_of
from ros2_ident.report.style import numbers, ORANGE, RED, SKY, tidy

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Costs that span more than this are drawn on a logarithmic axis.
WIDE = 20.0
# Plots of a cost over parameters side by side, and their height, pixels.
COLUMNS, HIGH = 4, 205
# How a cloud of candidates is drawn: as pixels, for it can be of many thousands.
_DOTS: dict[str, Any] = {'s': 9.0, 'lw': 0.0, 'rasterized': True}


def _of_costs(axes: 'Axes', costs: Array) -> None:
    """Prepare axes for costs (E,), logarithmic where they span much."""
    tidy(axes)
    axes.tick_params(labelsize=11.0)
    if costs.min() > 0.0 and costs.max() > WIDE * costs.min():
        axes.set_yscale('log')
        numbers(axes.yaxis)


def cost_over_generations(result: Identification) -> Picture | None:
    """Draw the known costs over their generations, the best so far, and the refined cost."""
    history, unit, refined = result.history, result.cost.unit, result.cost.refined
    best, finite = history.best_costs, np.isfinite(history.costs)
    if not np.isfinite(best).any():
        return None
    generations, costs = history.generations[finite], history.costs[finite]

    def draw(made: 'Figure') -> None:
        axes = made.subplots()
        _of_costs(axes, np.concatenate([costs, best[np.isfinite(best)]]))
        # Side by side within a generation, the best to the left, so that none hides another.
        axes.scatter(generations + _spread(generations, costs), costs, color=SKY, **_DOTS)
        number_of = np.arange(1, best.size + 1)
        axes.plot(number_of, best, 'o-', color=INK, lw=1.8, ms=5.0)
        if math.isfinite(refined):
            axes.plot([1.0, best.size + 0.9], [refined] * 2, '--', color=RED, lw=1.8)
        axes.locator_params(axis='x', integer=True)
        axes.set(xlabel='generation', ylabel=f'cost [{unit}]')

    keys = [
        Key('candidates, each generation sorted by cost', SKY, 'dot'),
        Key('best so far', INK, '2'),
    ]
    if math.isfinite(refined):
        keys.append(Key(f'refined, {number(refined)} {unit}', RED, 'dashed'))
    summary = 'Cost of the candidates over the generations'
    return Picture(svg(draw, WIDTH, 300), summary, keys=tuple(keys), least=WIDTH // 2)


def cost_over_time(points: Sequence[tuple[float, float]], unit: str) -> Picture:
    """Draw the best cost over the time of a run, s."""
    times, costs = np.array(points).T

    def draw(made: 'Figure') -> None:
        axes = made.subplots()
        _of_costs(axes, costs)
        axes.plot(times, costs, color=INK, lw=1.8)
        axes.set(xlabel='time [s]', ylabel=f'best cost [{unit}]')

    summary = f'Best cost over time, now {number(float(costs[-1]))} {unit}'
    return Picture(svg(draw, WIDTH, 200), summary, least=WIDTH // 2)


def _spread(generations: npt.NDArray[np.int64], costs: Array) -> Array:
    """Return (E,) places within the room of a generation, 0 to 0.8, by rank of the cost."""
    order = np.lexsort((costs, generations))
    counts = np.bincount(generations)
    first = np.concatenate([[0], np.cumsum(counts)])[generations[order]]
    out = np.empty(costs.size)
    out[order] = 0.8 * (np.arange(costs.size) - first) / np.maximum(1, counts[generations[order]])
    return out


def cost_over_parameters(result: Identification) -> Picture | None:
    """Draw the known costs over each parameter: the paper's figures 8, 9 and 11."""
    history = result.history
    finite = np.isfinite(history.costs)
    if not finite.any():
        return None
    rows = -(-len(result.parameters) // COLUMNS)

    def draw(made: 'Figure') -> None:
        grid = made.subplots(rows, COLUMNS, sharey=True, squeeze=False)
        for n, axes in enumerate(grid.flat):
            if n >= len(result.parameters):
                axes.remove()
                continue
            p, costs = result.parameters[n], history.costs[finite]
            _of_costs(axes, costs)
            if math.isfinite(p.low) and math.isfinite(p.high):
                axes.axvspan(p.low, p.high, color=ORANGE, alpha=0.25, lw=0.0)
            axes.scatter(
                history.candidates[finite, n],
                costs,
                c=history.generations[finite],
                cmap='viridis_r',
                **_DOTS,
            )
            if math.isfinite(p.value):
                axes.axvline(p.value, color=RED, lw=1.5, ls='--')
            axes.ticklabel_format(axis='x', scilimits=(-2, 4), useMathText=True)
            axes.locator_params(axis='x', nbins=4)
            axes.set_xlim(p.lower_bound, p.upper_bound)
            axes.set_title(p.name, fontsize=12.0, fontweight='bold')
            axes.set_xlabel(f'[{unit_of(p.unit) or "1"}]')
            if n % COLUMNS == 0:
                axes.set_ylabel(f'cost [{result.cost.unit}]')

    summary = 'Cost of the candidates over each parameter'
    return Picture(svg(draw, WIDTH, HIGH * rows), summary, least=WIDTH)


def correlated(result: Identification) -> bool:
    """Whether the correlation of any two estimates is known."""
    return bool(np.isfinite(result.correlation[~np.eye(len(result.parameters), dtype=bool)]).any())
