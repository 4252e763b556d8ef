# SPDX-License-Identifier: Apache-2.0
"""Measured and simulated effort with residual and following error, quick with long logs, too.

The page holds the samples in whole numbers of two bytes, and draws for each column of pixels the
least and the largest of the samples in view: `page.js` does that at first and on every zoom. It
makes Bokeh's models as well: their classes in Python take longer to import than a short search.
"""

import base64
from collections.abc import Mapping, Sequence
import gzip
import math
from typing import Any

import numpy as np
import numpy.typing as npt

from ros2_ident.arrays import Array
from ros2_ident.report.page.render import Choice, INK, Key, ORANGE, Picture, RED, SKY
from ros2_ident.report.signals import Curves, Signals
from ros2_ident.words.figures import compared

# Array that a page holds at most, of two bytes each; longer logs are thinned.
MOST = 1_200_000
# From so many drives on each has a tab.
TABS = 4
# Seconds that a whole number of the time axis stands for.
TICK = 1e-5
# The whole number that stands for no sample, the same as in `page.js`.
NOTHING = -32768
# A simulation this many times beyond the measured range is drawn at that edge.
BEYOND = 10.0
# Room between recordings, as a share of their whole length.
GAP = 0.02
# A curve breaks where its next sample is so many times later than usual, and by so many s.
LATE, LATE_SECONDS = 10.0, 0.02


def effort_plot(
    signals: Signals, floor: Mapping[str, float] | None = None, *, most: int = MOST
) -> Picture:
    """Draw each drive's measured and simulated effort, below it residual and following error.

    Args:
        most: Array that the plot may hold, of two bytes each.
    """
    floor = floor or {}
    share = most // (len(signals.drives) * (2 + len(signals.models)) + 2)
    recordings = [r for r in signals.recordings if r.time.size]
    rows = [_kept(r, share // len(recordings)) for r in recordings]
    parts = list(zip(recordings, rows, strict=True))
    time, starts = _joined(parts)
    measured = np.concatenate([r.measured[:, k] for r, k in parts], axis=1)
    simulated = np.concatenate([r.simulated[..., k] for r, k in parts], axis=2)
    tracking = np.concatenate([r.tracking[:, k] for r, k in parts], axis=1)
    # The drive with the largest residual over its noise floor is shown first.
    over = (measured - simulated[max(0, signals.judged)]).astype(np.float64) ** 2
    floors = np.array([floor.get(drive) or 1.0 for drive in signals.drives])
    first = int(np.argmax(np.ma.masked_invalid(over).mean(axis=1).filled(0.0) / floors**2))
    plots = _Plots(time, starts)
    for d, drive in enumerate(signals.drives):
        shown = len(signals.drives) < TABS or d == first
        unit, label = signals.unit, f'{drive}\n{compared(signals.unit)} [{signals.unit}]'
        top = plots.figure(d, 185, label, visible=shown)
        below = plots.figure(d, 105, f'residual [{unit}]', 4, visible=shown)
        if drive in floor:
            below['floor'] = 2.0 * floor[drive]
        scale, name = _scale(measured[d], simulated[:, d]), f'measured_{d}'
        plots.hold(name, measured[d], scale)
        plots.line(top, name, scale, colour=SKY, width=3.0)
        for m, colour in enumerate(_colours(signals)):
            look: dict[str, Any] = {'name': f'model-{m}', 'visible': signals.judged in (-1, m)}
            plots.hold(f'simulated_{d}_{m}', simulated[m, d], scale)
            plots.line(top, f'simulated_{d}_{m}', scale, colour=colour, **look)
            without = 0.0, scale[1]
            plots.line(below, name, without, f'simulated_{d}_{m}', colour=colour,
                       width=0.7, **look)  # fmt: skip
        if np.isfinite(tracking[d]).any():
            # in thousandths of the unit of travel
            scale = _scale(1e3 * tracking[d])
            plots.hold(f'tracking_{d}', 1e3 * tracking[d], scale)
            below = plots.figure(d, 85, f'following\nerror [m{signals.travel}]', 3, visible=shown)
            plots.line(below, f'tracking_{d}', scale, colour=ORANGE)
        below['below'] = 'time [s]' + ', one recording after another' * (len(starts) > 1)
        below['height'] += 44
    named = zip(signals.models, _colours(signals), strict=True)
    models = [Key(f'simulated, {model}', colour, '1.5') for model, colour in named]
    choices, judged = list[Choice](), signals.judged
    if len(signals.drives) >= TABS:
        drives = ((n, str(d), d == first) for d, n in enumerate(signals.drives))
        choices.append(('Drive', 'drive', tuple(drives)))
    if len(signals.models) > 1:
        several = [(n, str(m), m == judged) for m, n in enumerate(signals.models)]
        choices.append(('Simulation', 'model', (('both', '', judged < 0), *several)))
    told = 'following error: set-point minus measured position'
    tracked = [Key(told, ORANGE, '1.5')] * bool(np.isfinite(tracking).any())
    return Picture(
        plots.drawn(),
        f'Measured and simulated {compared(signals.unit)} of '
        f'{", ".join(signals.drives)} over time, with the residual below',
        keys=(Key('measured', SKY, '3'), *models, *tracked),
        notes=tuple(_notes(recordings, rows, bool(floor))),
        choices=tuple(choices),
        height=sum(made['height'] for made in plots.figures if made['visible']),
        least=320,
    )


def _colours(signals: Signals) -> list[str]:
    return [RED, INK][-len(signals.models) :]


class _Plots:
    """Plots that share the time axis (T,), s, and the samples behind their curves."""

    def __init__(self, time: Array, starts: Sequence[float]) -> None:
        self._time, self._starts = time, starts
        self._held: dict[str, npt.NDArray[np.int16]] = {}
        self.figures: list[dict[str, Any]] = []

    def drawn(self) -> dict[str, Any]:
        """Return what `page.js` draws; of the samples first the times, in four bytes each."""
        ticks = np.round(self._time / TICK).astype('<i4')
        held = b''.join(x.tobytes() for x in (ticks, *self._held.values()))
        return {
            'figures': self.figures, 'rows': ticks.size, 'columns': list(self._held), 'tick': TICK,
            'start': float(self._time[0]), 'end': float(self._time[-1]), 'parts': self._starts[1:],
            'packed': base64.b64encode(gzip.compress(held, mtime=0)).decode(),
        }  # fmt: skip

    def figure(
        self, d: int, height: int, label: str, ticks: int = 6, *, visible: bool
    ) -> dict[str, Any]:
        """Add an empty plot of a drive below the others."""
        made = {
            'name': f'drive-{d}', 'height': height, 'label': label, 'ticks': ticks,
            'visible': visible, 'curves': [],
        }  # fmt: skip
        self.figures.append(made)
        return made

    def hold(self, column: str, values: Array, scale: tuple[float, float]) -> None:
        """Keep a curve (T,) in whole numbers."""
        offset, step = scale
        codes = np.clip(np.round((values - offset) / step), -32500, 32500)
        codes = np.where(np.isfinite(codes), codes, NOTHING)
        self._held[column] = codes.astype('<i2')

    def line(
        self, made: dict[str, Any], column: str, scale: tuple[float, float], minus: str = '',
        *, colour: str, width: float = 1.0, name: str = '', visible: bool = True,
    ) -> None:  # fmt: skip
        """Add a line: a curve that is held, less another."""
        steps = np.diff(self._time[self._held[column] != NOTHING])
        late = max(LATE * float(np.median(steps)) if steps.size else 0.0, LATE_SECONDS)
        others = len(self._starts) - 1
        if others:
            # it breaks between recordings
            late = min(late, 0.9 * GAP * float(self._time[-1]) / (1.0 + GAP * others))
        made['curves'].append({
            'column': column, 'minus': minus, 'offset': scale[0], 'step': scale[1],
            'late': late / TICK, 'colour': colour, 'width': width, 'name': name,
            'visible': visible,
        })  # fmt: skip


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


def _kept(recording: Curves, most: int) -> npt.NDArray[np.int64]:
    """Return the samples (of T) that the page keeps.

    All, or of each of many stretches of equal length those that are the least and the largest of a
    curve.
    """
    rows = np.concatenate([recording.measured, *recording.simulated, recording.tracking])
    count = rows.shape[1]
    length = math.ceil(count / max(1, most // (2 * len(rows))))
    if count <= most or length <= 1:
        return np.arange(count)
    padded = np.full((len(rows), math.ceil(count / length) * length), np.nan)
    padded[:, :count] = rows
    parts = padded.reshape(len(rows), -1, length)
    first = np.arange(parts.shape[1]) * length
    nothing = np.isnan(parts)
    least = np.where(nothing, np.inf, parts).argmin(axis=2) + first
    largest = np.where(nothing, -np.inf, parts).argmax(axis=2) + first
    return np.unique(np.concatenate([least.ravel(), largest.ravel()]))


def _scale(first: npt.NDArray[Any], *others: npt.NDArray[Any]) -> tuple[float, float]:
    """Return offset and step of the whole numbers of curves that share an axis."""
    there = [part for x in (first, *others) if (part := x[np.isfinite(x)]).size]
    if not there:
        return 0.0, 1.0
    low, high = float(there[0].min()), float(there[0].max())
    room = BEYOND * max(high - low, 1e-9)
    low = max(min(float(x.min()) for x in there), low - room)
    high = min(max(float(x.max()) for x in there), high + room)
    return 0.5 * (low + high), max(high - low, 1e-9) / 65000.0


def _joined(parts: Sequence[tuple[Curves, npt.NDArray[np.int64]]]) -> tuple[Array, list[float]]:
    """Return times (T,) of the samples of all recordings in a row, and when each starts."""
    room = GAP * sum(float(r.time[-1] - r.time[0]) for r, _ in parts)
    times, starts, end = [], [], -room
    for recording, at in parts:
        starts.append(end + room)
        times.append(recording.time[at] + starts[-1])
        end = float(times[-1][-1])
    return np.concatenate(times), starts
