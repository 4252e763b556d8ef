# SPDX-License-Identifier: Apache-2.0
"""Progress of a run: a dashboard on a terminal, now and then a line elsewhere."""

from collections.abc import Sequence
import io
import math
import os
import sys
import threading
import time
from typing import Any, Self, TextIO

from ros2_ident.identify.settings import IdentifyProgress

# Without a terminal a line comes at most so often, s.
LINE_EVERY = 5.0
# Share of the work from which on the time to go is told.
KNOWN = 0.05
# Writing the results takes so many times as long as reading did: on axes and tripods of 6 to 25 s
# it was between 1 and 3.
WRITING = 2.0
# Seconds after which a line says what keeps the first progress away.
PATIENCE = 3.0
WAIT = 'preparing; the first run on a kind of machine compiles its simulation, for up to a minute'
# A dashboard is drawn anew at most so often, s.
DRAW_EVERY = 0.2
# Blocks of a sparkline, and lines of a dashboard beside those of the parameters.
WIDTH, AROUND = 24, 6
_BLOCKS = '▁▂▃▄▅▆▇█'


def fancy(stream: TextIO) -> bool:
    """Say whether a stream is a terminal that can be drawn on, and its user wants that."""
    return (
        stream.isatty()
        and not os.environ.get('NO_COLOR')
        and os.environ.get('TERM', '') not in ('', 'dumb', 'unknown')
        and (stream.encoding or '').lower().replace('-', '') == 'utf8'
    )


def sparkline(values: Sequence[float], width: int = WIDTH) -> str:
    """Return numbers as a row of at most `width` blocks; a space where there is none."""
    last = len(values) - 1
    places = range(len(values)) if last < width else (k * last / (width - 1) for k in range(width))
    shown = [values[round(k)] for k in places]
    known = [x for x in shown if math.isfinite(x)]
    low, high = min(known, default=0.0), max(known, default=0.0)
    top = len(_BLOCKS) - 1
    return ''.join(
        ' '
        if not math.isfinite(x)
        else _BLOCKS[round(top * (x - low) / (high - low)) if high > low else 0]
        for x in shown
    )


def duration(seconds: float) -> str:
    """Return a time for people: `8 s`, `1:05`, `?` where unknown."""
    if not math.isfinite(seconds):
        return '?'
    whole = max(0, round(seconds))
    return f'{whole} s' if whole < 60 else f'{whole // 60}:{whole % 60:02d}'


def describe(progress: IdentifyProgress) -> str:
    """Return the phase and how far it is."""
    if progress.phase == 'intervals':
        return 'intervals'
    what = 'generation' if progress.phase == 'search' else 'refining start'
    return f'{what} {progress.generation} of {progress.generations}'


def best(progress: IdentifyProgress) -> str:
    """Return the best cost so far with its unit."""
    if not math.isfinite(progress.best_cost):
        return 'no candidate converged yet'
    return f'best {progress.best_cost:.5g} {progress.unit}'


class Lines:
    """Plain lines, for logs."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream
        self._last = -math.inf
        self._waiting = threading.Timer(PATIENCE, lambda: print(WAIT, file=stream, flush=True))
        self._waiting.daemon = True

    def __enter__(self) -> Self:
        """Say after a while what takes so long, where nothing else is said."""
        self._waiting.start()
        return self

    def __exit__(self, *_: object) -> None:
        """Leave nothing behind."""
        self._waiting.cancel()

    def __call__(self, progress: IdentifyProgress) -> None:
        """Print a line, unless the last one is fresh."""
        self._waiting.cancel()
        now = time.monotonic()
        if now - self._last < LINE_EVERY:
            return
        self._last = now
        print(
            f'{describe(progress)}, {progress.evaluations} candidates, {best(progress)}, '
            f'{duration(progress.elapsed)} gone, {duration(progress.eta)} to go',
            file=self._stream,
            flush=True,
        )


class Dashboard:
    """The search on a terminal: how far it is, how the best changed, and the parameters."""

    def __init__(self, stream: TextIO) -> None:
        from rich.console import Console
        from rich.live import Live

        self._console = Console(file=stream)
        self._live = Live(console=self._console, auto_refresh=False, transient=True)
        self._last = -math.inf
        self._costs: list[float] = []
        self._spreads: list[float] = []
        self._thetas: list[list[float]] = []

    def __enter__(self) -> Self:
        """Take the place at the end of the terminal."""
        self._live.start()
        return self

    def __exit__(self, *_: object) -> None:
        """Give it back."""
        self._live.stop()

    def __call__(self, progress: IdentifyProgress) -> None:
        """Draw it, unless it is fresh."""
        now = time.monotonic()
        if now - self._last < DRAW_EVERY:
            return
        self._last = now
        self._live.update(self.picture(progress), refresh=True)

    def picture(self, progress: IdentifyProgress) -> Any:
        """Take a progress into the history; return what is drawn."""
        from rich.console import Group
        from rich.progress_bar import ProgressBar
        from rich.table import Table
        from rich.text import Text

        # equal to the eye along orders of magnitude
        self._costs.append(math.log(progress.best_cost) if progress.best_cost > 0.0 else math.nan)
        self._spreads.append(progress.spread)
        self._thetas.append([float(x) for x in progress.best_theta])
        head = Table.grid(padding=(0, 2))
        head.add_row(
            Text(describe(progress), style='bold'),
            ProgressBar(
                total=max(1, progress.budget), completed=progress.evaluations, width=WIDTH
            ),
            f'{progress.evaluations} candidates',
        )
        head.add_row(
            best(progress),
            Text(sparkline(self._costs), style='cyan'),
            f'{duration(progress.elapsed)} gone, {duration(progress.eta)} to go',
        )
        spread = f'{progress.spread:.2g}' if math.isfinite(progress.spread) else '?'
        head.add_row(
            f'spread {spread} of the bounds', Text(sparkline(self._spreads), style='cyan'), ''
        )
        table = Table(box=None, padding=(0, 2, 0, 0), header_style='dim')
        for name in ('parameter', 'best so far', 'how it changed'):
            table.add_column(name, justify='right' if name == 'best so far' else 'left')
        room = max(1, self._console.height - AROUND)
        for k, name in enumerate(progress.names[:room]):
            changes = sparkline([theta[k] for theta in self._thetas])
            table.add_row(name, f'{progress.best_theta[k]:.5g}', Text(changes, style='cyan'))
        more = len(progress.names) - room
        return Group(head, table, *([f'and {more} more'] if more > 0 else []))


def make_meter(*, quiet: bool = False, stream: TextIO | None = None) -> Lines | Dashboard:
    """Return what shows progress on a stream, standard error by default."""
    stream = io.StringIO() if quiet else stream or sys.stderr
    return Dashboard(stream) if fancy(stream) else Lines(stream)


class FractionMeter:
    """Progress of anything that knows which part of it is done.

    Args:
        quiet: Show nothing.
        stream: Where to; standard error by default.
    """

    def __init__(self, *, quiet: bool = False, stream: TextIO | None = None) -> None:
        self._stream = stream or sys.stderr
        self._quiet = quiet
        self._bar: Any = None
        self._last = -math.inf
        self._start = time.monotonic()
        if not quiet and fancy(self._stream):
            from rich.console import Console
            from rich.progress import Progress

            self._bar = Progress(console=Console(file=self._stream), transient=True)
            self._task: Any = self._bar.add_task('starting', total=1.0)

    def __enter__(self) -> Self:
        """Show it."""
        if self._bar is not None:
            self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        """Take it away."""
        if self._bar is not None:
            self._bar.stop()

    def note(self, text: str) -> None:
        """Say something that stays."""
        if self._bar is not None:
            self._bar.console.print(text, highlight=False)
        elif not self._quiet:
            print(text, file=self._stream, flush=True)

    def __call__(self, fraction: float, text: str, eta: float | None = None) -> None:
        """Show the part that is done, 0 to 1, what is being done, and the time to go [s].

        Where the time to go is not given, it is what the part that is done says.
        """
        if self._quiet:
            return
        if self._bar is not None:
            self._bar.update(self._task, completed=fraction, description=text)
            return
        now = time.monotonic()
        if now - self._last < LINE_EVERY:
            return
        self._last = now
        gone = now - self._start
        left = eta
        if left is None:
            left = gone * (1.0 - fraction) / fraction if fraction > KNOWN else math.nan
        print(
            f'{100.0 * fraction:.0f} %, {text}, {duration(gone)} gone, {duration(left)} to go',
            file=self._stream,
            flush=True,
        )
