# SPDX-License-Identifier: Apache-2.0
"""Measured and simulated effort with the residual, as a plot that stays quick with long logs.

The page holds the samples in whole numbers of two bytes, and draws for each column of pixels the
least and the largest of the samples in view: `page.js` does that on every zoom.
"""

from collections.abc import Mapping, Sequence
import math
from typing import Any

from bokeh.layouts import gridplot
from bokeh.models import BasicTicker, ColumnDataSource, CustomJS, Range1d, WheelZoomTool
import numpy as np
import numpy.typing as npt

from ros2_ident.report.page.look import GREY, INK, Key, Picture, plot, RED, SKY, WIDTH
from ros2_ident.report.signals import Curves, Short, Signals

# Seconds that a whole number of the time axis stands for.
TICK = 1e-5
# The whole number that stands for no sample.
NOTHING = -32768
# Stretches that a curve in view is cut into, the same as in `page.js`.
COLUMNS = 1000
# Numbers that a page holds at most, of two bytes each; longer logs are thinned.
MOST = 1_100_000
# A simulation this many times beyond the measured range is drawn at that edge.
BEYOND = 10.0
# Room between recordings, as a share of their whole length.
GAP = 0.02


def extremes(rows: npt.NDArray[Any], stretches: int) -> npt.NDArray[np.int64]:
    """Return which columns hold the least and the largest of each row in each stretch, in order.

    Args:
        rows: (R, T) values, NaN for none.
        stretches: Into how many stretches of equal length T is cut, about; all columns where that
            leaves one column each.
    """
    count = rows.shape[1]
    length = max(1, math.ceil(count / max(1, stretches)))
    if length == 1:
        return np.arange(count)
    padded = np.full((len(rows), math.ceil(count / length) * length), np.nan)
    padded[:, :count] = rows
    parts = padded.reshape(len(rows), -1, length)
    first = np.arange(parts.shape[1]) * length
    nothing = np.isnan(parts)
    least = np.where(nothing, np.inf, parts).argmin(axis=2) + first
    most = np.where(nothing, -np.inf, parts).argmax(axis=2) + first
    return np.unique(np.concatenate([least.ravel(), most.ravel()]))


def _kept(recording: Curves, most: int) -> npt.NDArray[np.int64]:
    """Return the samples (of T) that the page keeps: all, or the extremes of each stretch."""
    rows = np.concatenate([recording.measured, *recording.simulated])
    count = rows.shape[1]
    return np.arange(count) if count <= most else extremes(rows, most // (2 * len(rows)))


def _scale(measured: Short, simulated: Short) -> tuple[float, float]:
    """Return offset and step of a drive's whole numbers."""
    there = [part for x in (measured, simulated) if (part := x[np.isfinite(x)]).size]
    if not there:
        return 0.0, 1.0
    low, high = float(there[0].min()), float(there[0].max())
    room = BEYOND * max(high - low, 1e-9)
    low = max(min(float(x.min()) for x in there), low - room)
    high = min(max(float(x.max()) for x in there), high + room)
    return 0.5 * (low + high), max(high - low, 1e-9) / 65000.0


def _coded(values: Short, offset: float, step: float) -> npt.NDArray[np.int16]:
    codes = np.clip(np.round((values - offset) / step), -32500, 32500)
    return np.where(np.isfinite(codes), codes, NOTHING).astype(np.int16)


def effort_plot(
    signals: Signals,
    floor: Mapping[str, float | None] | None = None,
    *,
    most: int = MOST,
) -> Picture:
    """Draw each drive's measured and simulated effort, and the residual below.

    Args:
        signals: What a run keeps.
        floor: Noise floor of each drive, where it is known.
        most: Numbers that the plot may hold, of two bytes each.

    Returns:
        The picture.
    """
    drives, models = len(signals.drives), len(signals.models)
    share = most // (drives * (1 + models) + 2)
    recordings = [r for r in signals.recordings if r.time.size]
    kept = [_kept(r, share // len(recordings)) for r in recordings]
    time, bounds, starts = _joined(recordings, kept)
    measured = np.concatenate(
        [r.measured[:, k] for r, k in zip(recordings, kept, strict=True)], axis=1
    )
    simulated = np.concatenate(
        [r.simulated[..., k] for r, k in zip(recordings, kept, strict=True)], axis=2
    )
    data: dict[str, Any] = {'time': np.round(time / TICK).astype(np.int32)}
    views: list[dict[str, Any]] = []
    whole = Range1d(start=float(time[0]), end=float(time[-1]), bounds='auto')
    figures = []
    for d, drive in enumerate(signals.drives):
        offset, step = _scale(measured[d], simulated[:, d])
        data[f'measured_{d}'] = _coded(measured[d], offset, step)
        for m in range(models):
            data[f'simulated_{d}_{m}'] = _coded(simulated[m, d], offset, step)
        pair = _pair(signals, drive, whole, (floor or {}).get(drive))
        figures += pair
        views += _fill(pair, signals, d, offset, step)
        for made in pair:
            for start in starts[1:]:
                made.vspan(start, line_color=GREY)
    figures[-1].xaxis.axis_label = 'time [s]' + (
        ', one recording after another' if len(starts) > 1 else ''
    )
    figures[-1].height += 44
    figures[-1].xaxis.visible = True
    for view in views:
        view['source'].data = _first_view(data, view, bounds)
    refill = CustomJS(
        args={
            'full': ColumnDataSource(data),
            'views': views,
            'bounds': bounds,
            'range': whole,
            'tick': TICK,
        },
        code='identPage.refill(full.data, views, bounds, range, tick)',
    )
    whole.js_on_change('start', refill)
    whole.js_on_change('end', refill)
    layout = gridplot(figures, ncols=1, toolbar_options={'logo': None})
    keys = [Key('measured', SKY, '3')]
    keys += [
        Key(f'simulated, {model}', colour, '1.5')
        for model, colour in zip(signals.models, _colours(models), strict=True)
    ]
    return Picture(layout, tuple(keys), tuple(_notes(recordings, kept, floor is not None)))


def _colours(models: int) -> list[str]:
    return [INK] if models == 1 else [RED, INK]


def _first_view(
    data: Mapping[str, Any], view: Mapping[str, Any], bounds: Sequence[int]
) -> dict[str, Any]:
    """Return a curve over all of the time; `refill` of `page.js` does the same for a part."""
    codes = data[view['column']].astype(np.float64)
    codes[codes == NOTHING] = np.nan
    if view['minus']:
        other = data[view['minus']]
        codes -= np.where(other == NOTHING, np.nan, other)
    xs, ys = [], []
    for start, end in zip([0, *bounds], bounds, strict=False):
        part = codes[start:end]
        share = COLUMNS * part.size // codes.size
        rows = extremes(part[None], share)
        rows = rows[np.isfinite(part[rows])]
        xs += [TICK * data['time'][start + rows], [np.nan]]
        ys += [view['offset'] + view['step'] * part[rows], [np.nan]]
    return {
        'x': np.concatenate(xs)[:-1],
        'y': np.concatenate(ys)[:-1].astype(np.float32),
    }


def _joined(
    recordings: Sequence[Curves], kept: list[npt.NDArray[np.int64]]
) -> tuple[npt.NDArray[np.float64], list[int], list[float]]:
    """Return times (T,) of all recordings in a row, where each ends, and when each starts."""
    room = GAP * sum(float(r.time[-1] - r.time[0]) for r in recordings)
    times, starts, end = [], [], -room
    for recording, rows in zip(recordings, kept, strict=True):
        start = end + room
        times.append(recording.time[rows] + start)
        starts.append(start)
        end = float(times[-1][-1])
    return np.concatenate(times), [int(n) for n in np.cumsum([t.size for t in times])], starts


def _pair(
    signals: Signals, drive: str, whole: Range1d, floor: float | None
) -> list[Any]:
    wheel = WheelZoomTool(dimensions='width')
    common: dict[str, Any] = {
        'width': WIDTH,
        'x_range': whole,
        'min_border_left': 76,
        'tools': ['pan', 'box_zoom', wheel, 'reset'],
        'active_scroll': wheel,
    }
    top = plot(height=185, **common)
    below = plot(height=105, **common)
    top.yaxis.axis_label = f'{drive}\neffort [{signals.unit}]'
    below.yaxis.axis_label = 'residual'
    below.yaxis.ticker = BasicTicker(desired_num_ticks=4)
    for made in (top, below):
        made.xaxis.visible = False
    if floor is not None:
        for side in (-2.0 * floor, 2.0 * floor):
            below.hspan(side, line_color=GREY, line_dash='dashed')
    return [top, below]


def _fill(
    pair: list[Any], signals: Signals, d: int, offset: float, step: float
) -> list[dict[str, Any]]:
    """Add empty lines to a drive's two plots; return what fills them."""
    top, below = pair
    views: list[dict[str, Any]] = []

    def line(made: Any, column: str, minus: str, **look: Any) -> None:
        source = ColumnDataSource({'x': [], 'y': []})
        made.line('x', 'y', source=source, **look)
        views.append(
            {
                'source': source,
                'column': column,
                'minus': minus,
                'offset': 0.0 if minus else offset,
                'step': step,
            }
        )

    line(top, f'measured_{d}', '', line_color=SKY, line_width=3.0)
    for m, colour in enumerate(_colours(len(signals.models))):
        name = f'simulated_{d}_{m}'
        line(top, name, '', line_color=colour, line_width=1.0)
        line(below, f'measured_{d}', name, line_color=colour, line_width=0.7)
    return views


def _notes(
    recordings: Sequence[Curves], kept: list[npt.NDArray[np.int64]], floor: bool
) -> list[str]:
    titled = [r.title for r in recordings if r.title]
    out = ['Dashed: twice the noise floor.'] if floor else []
    if titled:
        said = ', then '.join(titled)
        out.append(f'From left to right: {said}.')
    whole = sum(r.time.size for r in recordings)
    held = sum(k.size for k in kept)
    if held < whole:
        out.append(
            f'This page holds {held} of {whole} samples, the least and the largest of each '
            'stretch; the file beside it holds all.'
        )
    return out
