# SPDX-License-Identifier: Apache-2.0
"""The search and the correlations of the estimates."""

from collections.abc import Sequence
import math
from typing import Any

from bokeh.layouts import gridplot
from bokeh.models import BasicTicker, ColumnDataSource, LinearColorMapper
from bokeh.models.annotations import BoxAnnotation
from bokeh.palettes import Viridis256
import numpy as np
import numpy.typing as npt

from ros2_ident.arrays import Array
from ros2_ident.identify.result import Identification, ParameterEstimate
from ros2_ident.report.page.look import INK, Key, logarithmic, Picture, plot, WIDTH
from ros2_ident.report.page.numbers import number, raised, unit_of
from ros2_ident.report.style import ORANGE, RED, SKY

# Costs that span more than this are drawn on a logarithmic axis.
WIDE = 20.0
# Cells of a plot of all candidates; one dot is drawn in each.
CELLS = 160, 110
# A correlation below this is on so dark a blue that white is read best.
DARK = -0.93
# A plot over the width of the page.
ACROSS: dict[str, Any] = {'sizing_mode': 'stretch_width', 'min_border_left': 76}


def _axis_type(values: Array) -> str:
    low, high = float(values.min()), float(values.max())
    return 'log' if low > 0.0 and high > WIDE * low else 'linear'


def _cost_plot(costs: Array, **options: Any) -> Any:
    """Return an empty plot for costs (E,), logarithmic where they span much."""
    made = plot(y_axis_type=_axis_type(costs), **options)
    if _axis_type(costs) == 'log':
        logarithmic(made.yaxis, float(costs.min()), float(costs.max()))
    return made


def cost_over_generations(result: Identification) -> Picture | None:
    """Draw the known costs over their generations, the best so far, and the refined cost."""
    history = result.history
    best = history.best_costs
    there = np.isfinite(best)
    if not there.any():
        return None
    unit = result.cost.unit
    finite = np.isfinite(history.costs)
    values = np.concatenate([history.costs[finite], best[there]])
    made = _cost_plot(
        values, x_axis_label='generation', y_axis_label=f'cost [{unit}]', height=300, **ACROSS
    )
    generations, costs = history.generations[finite], history.costs[finite]
    if costs.size:
        shown = one_a_cell(generations.astype(np.float64), _even(costs))
        # Side by side within a generation, the best to the left, so that none hides another.
        spread = _spread(generations, costs)
        made.scatter(
            (generations + spread)[shown],
            costs[shown],
            size=3,
            color=SKY,
            line_color=None,
        )
    keys = [
        Key('candidates, each generation sorted by cost', SKY, 'dot'),
        Key('best so far', INK, '2'),
    ]
    number_of = np.arange(1.0, best.size + 1.0)
    made.line(
        number_of[there], best[there], color=INK, line_width=1.8
    )
    made.scatter(number_of[there], best[there], color=INK, size=6)
    if math.isfinite(result.cost.refined):
        made.line(
            [number_of[0], number_of[-1] + 0.9],
            [result.cost.refined] * 2,
            color=RED,
            line_width=1.8,
            line_dash='dashed',
        )
        keys.append(Key(f'refined, {number(result.cost.refined)} {unit}', RED, 'dashed'))
    made.xaxis.ticker = BasicTicker(min_interval=1, num_minor_ticks=0)
    return Picture(made, 'Cost of the candidates over the generations', tuple(keys))


def cost_over_time(points: Sequence[tuple[float, float]], unit: str) -> Picture:
    """Draw the best cost over the time of a run, s."""
    times, costs = np.array(points).T
    made = _cost_plot(
        costs, x_axis_label='time [s]', y_axis_label=f'best cost [{unit}]', height=200, **ACROSS
    )
    made.line(times, costs, color=INK, line_width=1.8)
    return Picture(made, f'Best cost over time, now {number(float(costs[-1]))} {unit}')


def _spread(generations: npt.NDArray[np.int64], costs: Array) -> Array:
    """Return (E,) places within the room of a generation, 0 to 0.8, by rank of the cost."""
    order = np.lexsort((costs, generations))
    counts = np.bincount(generations)
    first = np.concatenate([[0], np.cumsum(counts)])[generations[order]]
    out = np.empty(costs.size)
    out[order] = 0.8 * (np.arange(costs.size) - first) / np.maximum(1, counts[generations[order]])
    return out


def _even(values: Array) -> Array:
    """Return values as they stand on their axis."""
    return np.log(values) if _axis_type(values) == 'log' else values


def one_a_cell(x: Array, y: Array) -> npt.NDArray[np.int64]:
    """Return the points (E,) of which one stands in each cell of a plot; later ones go before."""
    places = []
    for values, cells in ((x, CELLS[0]), (y, CELLS[1])):
        span = float(np.ptp(values)) or 1.0
        places.append(np.floor((values - values.min()) / span * (cells - 1e-9)).astype(np.int64))
    _, last = np.unique((places[0] * CELLS[1] + places[1])[::-1], return_index=True)
    return np.sort(x.size - 1 - last)


def cost_over_parameters(result: Identification) -> Picture | None:
    """Draw the known costs over each parameter: the paper's figures 8, 9 and 11."""
    history = result.history
    finite = np.isfinite(history.costs)
    if not finite.any():
        return None
    costs = history.costs[finite]
    colours = LinearColorMapper(
        palette=Viridis256[240::-1], low=1, high=max(2, int(history.generations[finite].max()))
    )
    columns = min(4, len(result.parameters))
    figures = [
        _cost_over(
            p,
            history.candidates[finite, n],
            costs,
            history.generations[finite],
            colours,
            result.cost.unit,
            first=n % columns == 0,
        )
        for n, p in enumerate(result.parameters)
    ]
    layout = gridplot(figures, ncols=columns, toolbar_options={'logo': None})
    return Picture(layout, 'Cost of the candidates over each parameter', least=WIDTH)


def _cost_over(
    parameter: ParameterEstimate,
    values: Array,
    costs: Array,
    generations: npt.NDArray[np.int64],
    colours: LinearColorMapper,
    unit: str,
    *,
    first: bool,
) -> Any:
    shown = one_a_cell(values, _even(costs))
    low, high = parameter.lower_bound, parameter.upper_bound
    power = _power(max(abs(low), abs(high)))
    scale = 10.0**power
    unit_of_axis = ' '.join(x for x in (raised(power), unit_of(parameter.unit)) if x)
    made = _cost_plot(
        costs,
        title=parameter.name,
        width=WIDTH // 4 + (22 if first else -8),
        height=205,
        x_axis_label=f'[{unit_of_axis or "1"}]',
        x_range=(low / scale, high / scale),
        min_border_left=60 if first else 30,
        tools='box_zoom,pan,reset,hover',
        tooltips=[
            (parameter.name, f'@value{{0.0000}} {unit_of_axis}'),
            ('cost', f'@cost{{0.0000e+0}} {unit}'),
            ('generation', '@generation'),
        ],
    )
    made.title.text_font_size = '12px'
    if first:
        made.yaxis.axis_label = f'cost [{unit}]'
    else:
        made.yaxis.visible = False
    made.xaxis.ticker = BasicTicker(desired_num_ticks=4, num_minor_ticks=0)
    made.axis.major_label_text_font_size = made.axis.axis_label_text_font_size = '12px'
    if math.isfinite(parameter.low) and math.isfinite(parameter.high):
        made.add_layout(
            BoxAnnotation(
                left=parameter.low / scale, right=parameter.high / scale, fill_color=ORANGE,
                fill_alpha=0.25, line_color=None,
            )
        )
    made.scatter(
        'value',
        'cost',
        source=ColumnDataSource(
            {
                'value': (values[shown] / scale).astype(np.float32),
                'cost': costs[shown].astype(np.float32),
                'generation': generations[shown].astype(np.uint16),
            }
        ),
        size=3,
        line_color=None,
        fill_color={'field': 'generation', 'transform': colours},
    )
    if math.isfinite(parameter.value):
        made.vspan(parameter.value / scale, line_color=RED, line_width=1.5,
                line_dash='dashed')
    return made


def _power(largest: float) -> int:
    """Return the power of ten that brings an axis' numbers near one; 0 where they are."""
    if largest <= 0.0 or 0.05 <= largest < 1e4:
        return 0
    return 3 * math.floor(math.log10(largest) / 3.0)


def correlations(result: Identification) -> list[tuple[str, list[tuple[str, str, str]]]]:
    """Return the correlation of each two estimates, row by row; nothing where none is known.

    Returns:
        Name, and of each cell the percentage, both names with the number, and its colours (CSS).
    """
    matrix, names = result.correlation, [p.name for p in result.parameters]
    if len(matrix) < 2 or not np.isfinite(matrix[~np.eye(len(matrix), dtype=bool)]).any():
        return []
    return [
        (
            name,
            [
                (_percent(v) if r != c else '', f'{name}, {names[c]}: {number(v, 3)}', _shade(v))
                for c, v in enumerate(row)
            ],
        )
        for r, (name, row) in enumerate(zip(names, matrix.tolist(), strict=True))
    ]  # fmt: skip


def _percent(value: float) -> str:
    return f'{100.0 * value:.0f}'.replace('-', '−') if math.isfinite(value) else ''


def _shade(value: float) -> str:
    """Return the colours of a correlation: blue for -1, white for 0, vermilion for 1."""
    if not math.isfinite(value):
        return 'background:#eee;color:black'
    end = (0, 114, 178) if value < 0.0 else (213, 94, 0)
    shade = ','.join(f'{255 + (e - 255) * abs(value):.0f}' for e in end)
    return f'background:rgb({shade});color:{"white" if value < DARK else "black"}'
