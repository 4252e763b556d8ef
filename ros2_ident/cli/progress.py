# SPDX-License-Identifier: Apache-2.0
"""Progress of a run: a picture on a terminal, now and then a line elsewhere."""

from collections.abc import Callable, Iterable, Sequence
import io
import math
import os
import sys
import threading
import time
from typing import Any, Self, TextIO, TYPE_CHECKING

from ros2_ident.identify.settings import IdentifyProgress
from ros2_ident.words.figures import duration

if TYPE_CHECKING:
    from ros2_ident.gap.diagnose import DiagnoseProgress

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
# On a terminal it is drawn anew at most so often, s.
DRAW_EVERY = 0.2
# Blocks of a sparkline, and lines of a picture beside those of the parameters.
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


def sparkline(values: Sequence[float]) -> str:
    """Return numbers as a row of at most `WIDTH` blocks; a space where there is none."""
    last = len(values) - 1
    places = range(len(values)) if last < WIDTH else (k * last / (WIDTH - 1) for k in range(WIDTH))
    shown = [values[round(k)] for k in places]
    known = [x for x in shown if math.isfinite(x)]
    low, high = min(known, default=0.0), max(known, default=0.0)
    step = (len(_BLOCKS) - 1) / (high - low) if high > low else 0.0
    return ''.join(
        _BLOCKS[round(step * (x - low))] if math.isfinite(x) else ' ' for x in shown
    )


def _phase(progress: IdentifyProgress) -> str:
    if progress.phase == 'intervals':
        return 'intervals'
    what = 'generation' if progress.phase == 'search' else 'refining start'
    return f'{what} {progress.generation} of {progress.generations}'


class Meter:
    """Progress of a run: drawn where the stream can be drawn on, else a line now and then.

    Args:
        quiet: Show nothing.
        stream: Where to; standard error by default.
    """

    def __init__(self, *, quiet: bool = False, stream: TextIO | None = None) -> None:
        self._stream = io.StringIO() if quiet else stream or sys.stderr
        self._start, self._last = time.monotonic(), -math.inf
        self._best = ''
        self._history: list[IdentifyProgress] = []
        self._live: Any = None
        self._waiting = threading.Timer(PATIENCE, lambda: self.note(WAIT))
        self._waiting.daemon = True
        if fancy(self._stream):
            from rich.console import Console
            from rich.live import Live

            console = Console(file=self._stream, highlight=False)
            self._live = Live(console=console, auto_refresh=False, transient=True)

    def __enter__(self) -> Self:
        """Take the place at the end of the terminal; elsewhere say after a while what is slow."""
        self._waiting.start() if self._live is None else self._live.start()
        return self

    def __exit__(self, *_: object) -> None:
        """Leave nothing behind."""
        self._waiting.cancel()
        if self._live is not None:
            self._live.stop()

    def note(self, text: str) -> None:
        """Say something that stays."""
        if self._live is not None:
            self._live.console.print(text)
        else:
            print(text, file=self._stream, flush=True)

    def _due(self) -> bool:
        """Whether what is shown is so old that it is shown anew."""
        now = time.monotonic()
        if now - self._last < (LINE_EVERY if self._live is None else DRAW_EVERY):
            return False
        self._last = now
        return True

    def draw(self, picture: Callable[[], Any], line: str) -> None:
        """Show where a run is: drawn, or as a line."""
        self._waiting.cancel()
        if self._live is None:
            self.note(line)
        else:
            self._live.update(picture(), refresh=True)

    def __call__(self, fraction: float, text: str, eta: float | None = None) -> None:
        """Show the part that is done, 0 to 1, what is being done, and the time to go [s].

        Where the time to go is not given, it is what the part that is done says.
        """
        if not self._due():
            return
        gone = time.monotonic() - self._start
        if eta is None:
            eta = gone * (1.0 - fraction) / fraction if fraction > KNOWN else math.nan
        times = f'{duration(gone)} gone, {duration(eta)} to go'
        share = f'{100.0 * fraction:.0f} %'
        self.draw(
            lambda: _grid([text, _bar(fraction), share, times]), f'{share}, {text}, {times}'
        )

    def show(self, progress: 'IdentifyProgress | DiagnoseProgress') -> None:
        """Show how far a run is; of a search also how its best changed, and the parameters."""
        if not isinstance(progress, IdentifyProgress):
            if progress.best_so_far != self._best:
                self._best = progress.best_so_far
                self.note(f'so far: {self._best}')
            self(progress.fraction, progress.stage, progress.eta)
        elif self._due():
            best = f'best {progress.best_cost:.5g} {progress.unit}'
            if not math.isfinite(progress.best_cost):
                best = 'no candidate converged yet'
            said = _phase(progress), f'{progress.evaluations} candidates', best
            times = f'{duration(progress.elapsed)} gone, {duration(progress.eta)} to go'
            self.draw(
                lambda: self._picture(progress, *said, times), ', '.join((*said, times))
            )

    def _picture(
        self, progress: IdentifyProgress, phase: str, tried: str, best: str, times: str
    ) -> Any:
        """Take a progress into the history; return what is drawn."""
        from rich.console import Group
        from rich.table import Table
        from rich.text import Text

        def line(values: Iterable[float]) -> Text:
            return Text(sparkline([float(x) for x in values]), style='cyan')

        self._history.append(progress)
        # equal to the eye along orders of magnitude
        costs = (math.log(p.best_cost) if p.best_cost > 0.0 else math.nan for p in self._history)
        spread = f'{progress.spread:.2g}' if math.isfinite(progress.spread) else '?'
        done = progress.evaluations / max(1, progress.budget)
        head = _grid(
            [Text(phase, style='bold'), _bar(done), tried],
            [best, line(costs), times],
            [f'spread {spread} of the bounds', line(p.spread for p in self._history)],
        )
        table = Table(box=None, padding=(0, 2, 0, 0), header_style='dim')
        for name in ('parameter', 'best so far', 'how it changed'):
            table.add_column(name, justify='right' if name == 'best so far' else 'left')
        room = max(1, self._live.console.height - AROUND)
        for k, name in enumerate(progress.names[:room]):
            changes = line(p.best_theta[k] for p in self._history)
            table.add_row(name, f'{progress.best_theta[k]:.5g}', changes)
        more = len(progress.names) - room
        return Group(head, table, *([f'and {more} more'] if more > 0 else []))


def _grid(*rows: Sequence[Any]) -> Any:
    from rich.table import Table

    grid = Table.grid(padding=(0, 2))
    for row in rows:
        grid.add_row(*row)
    return grid


def _bar(fraction: float) -> Any:
    from rich.progress_bar import ProgressBar

    return ProgressBar(total=1.0, completed=fraction, width=WIDTH)
