# SPDX-License-Identifier: Apache-2.0
"""Measured and simulated effort with residual and following error, quick with long logs, too.

The page holds the samples in whole numbers of two bytes, and draws for each column of pixels the
least and the largest of the samples in view: `page.js` does that on every zoom.
"""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from bokeh.layouts import gridplot
from bokeh.models import (
    BasicTicker,
    ColumnDataSource,
    CrosshairTool,
    CustomJS,
    DataRange1d,
    Range1d,
    WheelZoomTool,
)
from bokeh.models.annotations import Span
import numpy as np
import numpy.typing as npt

from ros2_ident.report.page.look import Button, Choice, INK, Key, Picture, plot
from ros2_ident.report.page.numbers import number
from ros2_ident.report.page.thin import (
    breaks,
    coded,
    extremes,
    joined,
    kept,
    NOTHING,
    scale,
    TICK,
    worst_moments,
)
from ros2_ident.report.signals import Curves, Signals
from ros2_ident.report.style import GREY, ORANGE, RED, SKY
from ros2_ident.words.figures import compared

# Stretches that a curve in view is cut into, the same as in `page.js`.
COLUMNS = 1000
# Numbers that a page holds at most, of two bytes each; longer logs are thinned.
MOST = 1_100_000
# From so many drives on each has a tab.
TABS = 4

Floors = Mapping[str, float | None]


def effort_plot(signals: Signals, floor: Floors | None = None, *, most: int = MOST) -> Picture:
    """Draw each drive's measured and simulated effort, below it residual and following error.

    Args:
        signals: What a run keeps.
        floor: Noise floor of each drive, where it is known.
        most: Numbers that the plot may hold, of two bytes each.

    Returns:
        The picture.
    """
    share = most // (len(signals.drives) * (2 + len(signals.models)) + 2)
    recordings = [r for r in signals.recordings if r.time.size]
    rows = [kept(r, share // len(recordings)) for r in recordings]
    time, bounds, starts = joined(recordings, rows)
    parts = list(zip(recordings, rows, strict=True))
    measured = np.concatenate([r.measured[:, k] for r, k in parts], axis=1)
    simulated = np.concatenate([r.simulated[..., k] for r, k in parts], axis=2)
    tracking = np.concatenate([r.tracking[:, k] for r, k in parts], axis=1)
    data: dict[str, Any] = {'time': np.round(time / TICK).astype(np.int32)}
    whole = Range1d(start=float(time[0]), end=float(time[-1]), bounds='auto', name='whole')
    cursor = CrosshairTool(dimensions='height', overlay=Span(dimension='height', line_color=GREY))
    views: list[dict[str, Any]] = []
    figures = []
    first = _worst(signals, measured, simulated, floor)
    for d, drive in enumerate(signals.drives):
        group = _Group(signals, d, (floor or {}).get(drive), whole, cursor)
        group.add_efforts(data, measured[d], simulated[:, d])
        if np.isfinite(tracking[d]).any():
            group.add_tracking(data, tracking[d])
        shown = len(signals.drives) < TABS or d == first
        for view in group.views:
            there = data[view['column']] != NOTHING
            view['bounds'] = breaks(time, there, bounds)
            # A drive behind its tab is drawn once it is asked for, by `refill`.
            view['source'].data = _first_view(data, view) if shown else {'x': [], 'y': []}
        for made in group.figures:
            for start in starts[1:]:
                made.vspan(start, line_color=GREY)
            made.visible = shown
        group.figures[-1].xaxis.axis_label = 'time [s]' + (
            ', one recording after another' if len(starts) > 1 else ''
        )
        group.figures[-1].height += 44
        group.figures[-1].xaxis.visible = True
        figures += group.figures
        views += group.views
    refill = CustomJS(
        args={'full': ColumnDataSource(data), 'views': views, 'range': whole, 'tick': TICK},
        code='identPage.refill(full.data, views, range, tick)',
        name='refill',
    )
    whole.js_on_change('start', refill)
    whole.js_on_change('end', refill)
    layout = gridplot(
        figures, ncols=1, toolbar_options={'logo': None}, sizing_mode='stretch_width'
    )
    moments = worst_moments(time, _compared(signals, measured, simulated, floor))
    return Picture(
        layout,
        f'Measured and simulated {compared(signals.unit)} of '
        f'{", ".join(signals.drives)} over time, with the residual below',
        tuple(_keys(signals, bool(np.isfinite(tracking).any()))),
        tuple(_notes(recordings, rows, floor is not None)),
        tuple(_choices(signals, recordings, starts, first, time, moments)),
        least=320,
    )


def _colours(models: int) -> list[str]:
    return [INK] if models == 1 else [RED, INK]


def _keys(signals: Signals, tracked: bool) -> Iterator[Key]:
    yield Key('measured', SKY, '3')
    for model, colour in zip(signals.models, _colours(len(signals.models)), strict=True):
        yield Key(f'simulated, {model}', colour, '1.5')
    if tracked:
        yield Key('following error: set-point minus measured position', ORANGE, '1.5')


def _compared(
    signals: Signals,
    measured: npt.NDArray[Any],
    simulated: npt.NDArray[Any],
    floor: Floors | None,
) -> npt.NDArray[np.float64]:
    """Return (D, T) the residual that matters over each drive's noise floor."""
    judged = simulated[max(0, signals.judged)]
    residual = np.asarray(measured - judged, dtype=np.float64)
    residual[~np.isfinite(residual)] = np.nan
    known = [(floor or {}).get(drive) or 1.0 for drive in signals.drives]
    out: npt.NDArray[np.float64] = residual / np.array(known)[:, None]
    return out


def _worst(
    signals: Signals,
    measured: npt.NDArray[Any],
    simulated: npt.NDArray[Any],
    floor: Floors | None,
) -> int:
    """Return the drive whose residual is the largest over its noise floor."""
    squares = _compared(signals, measured, simulated, floor) ** 2
    count = np.maximum(1, np.isfinite(squares).sum(axis=1))
    return int(np.argmax(np.nansum(squares, axis=1) / count))


def _choices(
    signals: Signals,
    recordings: Sequence[Curves],
    starts: Sequence[float],
    first: int,
    time: npt.NDArray[np.float64],
    moments: Sequence[tuple[float, float, int]],
) -> Iterator[Choice]:
    """Yield the buttons: drives, models, and stretches of time to look at."""
    if len(signals.drives) >= TABS:
        tabs = [Button(name, str(d), d == first) for d, name in enumerate(signals.drives)]
        yield Choice('Drive', 'drive', tuple(tabs))
    if len(signals.models) > 1:
        both = Button('both', '', signals.judged < 0)
        models = [Button(n, str(m), m == signals.judged) for m, n in enumerate(signals.models)]
        yield Choice('Simulation', 'model', (both, *models))
    views = [
        Button(f'{number(0.5 * (a + b), 3)} s, {signals.drives[d]}', f'{a},{b}')
        for a, b, d in moments
    ]
    yield Choice('Largest residuals', 'view', tuple(views))
    ends = [*starts[1:], float(time[-1])]
    parts = [Button('all' if len(recordings) > 1 else 'whole', f'{time[0]},{time[-1]}')]
    if len(recordings) > 1:
        parts += [
            Button(f'{n}: {r.title}' if r.title else str(n), f'{a},{b}')
            for n, (r, a, b) in enumerate(zip(recordings, starts, ends, strict=True), 1)
        ]
    yield Choice('Recording', 'view', tuple(parts))


def _first_view(data: Mapping[str, Any], view: Mapping[str, Any]) -> dict[str, Any]:
    """Return a curve over all of the time; `refill` of `page.js` does the same for a part."""
    codes = data[view['column']].astype(np.float64)
    codes[codes == NOTHING] = np.nan
    if view['minus']:
        other = data[view['minus']]
        codes -= np.where(other == NOTHING, np.nan, other)
    xs, ys = [], []
    bounds = view['bounds']
    for start, end in zip([0, *bounds], bounds, strict=False):
        part = codes[start:end]
        share = max(1, COLUMNS * part.size // codes.size)
        rows = extremes(part[None], share)
        rows = rows[np.isfinite(part[rows])]
        xs += [TICK * data['time'][start + rows], [np.nan]]
        ys += [view['offset'] + view['step'] * part[rows], [np.nan]]
    return {
        'x': np.concatenate(xs)[:-1],
        'y': np.concatenate(ys)[:-1].astype(np.float32),
    }


class _Group:
    """The plots of one drive: effort, residual, following error.

    Attributes:
        figures: From top to bottom.
        views: What fills their curves.
    """

    def __init__(
        self, signals: Signals, d: int, floor: float | None, whole: Range1d, cursor: CrosshairTool
    ) -> None:
        self._signals, self._d = signals, d
        self._whole, self._cursor = whole, cursor
        self.figures: list[Any] = []
        self.views: list[dict[str, Any]] = []
        top = self._figure(185, f'{signals.drives[d]}\n{compared(signals.unit)} [{signals.unit}]')
        below = self._figure(105, f'residual [{signals.unit}]')
        below.yaxis.ticker = BasicTicker(desired_num_ticks=4)
        self.figures = [top, below]
        if floor is not None:
            for side in (-2.0 * floor, 2.0 * floor):
                below.hspan(side, line_color=GREY, line_dash='dashed')

    def _figure(self, height: int, label: str) -> Any:
        wheel = WheelZoomTool(dimensions='width', modifiers='ctrl')
        made = plot(
            height=height,
            x_range=self._whole,
            y_range=DataRange1d(only_visible=True),
            min_border_left=76,
            tools=['pan', 'box_zoom', wheel, 'reset', self._cursor],
            active_scroll=wheel,
            name=f'drive-{self._d}',
            sizing_mode='stretch_width',
        )
        made.yaxis.axis_label = label
        made.xaxis.visible = False
        return made

    def add_efforts(
        self, data: dict[str, Any], measured: npt.NDArray[Any], simulated: npt.NDArray[Any]
    ) -> None:
        """Add measured (T,) and simulated (M, T) effort and the residuals."""
        d, (top, below) = self._d, self.figures
        offset, step = scale(measured, simulated)
        data[f'measured_{d}'] = coded(measured, offset, step)
        self._line(top, f'measured_{d}', (offset, step), line_color=SKY, line_width=3.0)
        for m, colour in enumerate(_colours(len(self._signals.models))):
            column, name = f'simulated_{d}_{m}', f'model-{m}'
            data[column] = coded(simulated[m], offset, step)
            look: dict[str, Any] = {
                'line_color': colour,
                'name': name,
                'visible': self._signals.judged in (-1, m),
            }
            self._line(top, column, (offset, step), **look)
            self._line(below, f'measured_{d}', (0.0, step), minus=column, line_width=0.7, **look)

    def add_tracking(self, data: dict[str, Any], tracking: npt.NDArray[Any]) -> None:
        """Add the following error (T,), in thousandths of the unit of travel."""
        column, values = f'tracking_{self._d}', 1e3 * tracking
        offset, step = scale(values)
        data[column] = coded(values, offset, step)
        made = self._figure(85, f'following\nerror [m{self._signals.travel}]')
        made.yaxis.ticker = BasicTicker(desired_num_ticks=3)
        self.figures.append(made)
        self._line(made, column, (offset, step), line_color=ORANGE)

    def _line(
        self, made: Any, column: str, scaled: tuple[float, float], minus: str = '', **look: Any
    ) -> None:
        """Add an empty line, and what fills it."""
        source = ColumnDataSource({'x': [], 'y': []})
        made.line('x', 'y', source=source, **look)
        offset, step = scaled
        self.views.append(
            {'source': source, 'column': column, 'minus': minus, 'offset': offset, 'step': step}
        )


def _notes(
    recordings: Sequence[Curves], rows: Sequence[npt.NDArray[np.int64]], floor: bool
) -> list[str]:
    titled = [r.title for r in recordings if r.title]
    out = ['Dashed: twice the noise floor.'] if floor else []
    if titled:
        said = ', then '.join(titled)
        out.append(f'From left to right: {said}.')
    whole = sum(r.time.size for r in recordings)
    held = sum(k.size for k in rows)
    if held < whole:
        out.append(
            f'This page holds {held} of {whole} samples, the least and the largest of each '
            'stretch; the file beside it holds all.'
        )
    return out
