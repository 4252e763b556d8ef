# SPDX-License-Identifier: Apache-2.0
"""Progress of a run: a bar on a terminal, now and then a line elsewhere."""

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
# Writing takes so many times as long as reading: between 1 and 3 on axes and tripods of 6 to 25 s.
WRITING = 2.0
# Seconds after which a line says what keeps the first progress away.
PATIENCE = 3.0
# Of the bar.
WIDTH = 24
WAIT = 'preparing; the first run on a kind of machine compiles its simulation, for up to a minute'


def coloured(stream: TextIO) -> bool:
    """Return whether a stream is a terminal that shows colours, and its user wants that."""
    plain = os.environ.get('NO_COLOR') or os.environ.get('TERM', '') in ('', 'dumb', 'unknown')
    return stream.isatty() and not plain


class Meter:
    """Progress of a run: drawn where the stream can be drawn on, else a line now and then."""

    def __init__(self, *, quiet: bool = False) -> None:
        self._stream: TextIO = io.StringIO() if quiet else sys.stderr
        self._start, self._last = time.monotonic(), -math.inf
        self._best = ''
        self._bar: Any = None
        self._waiting = threading.Timer(PATIENCE, lambda: self.note(WAIT))
        self._waiting.daemon = True
        encoding = (self._stream.encoding or '').lower().replace('-', '')
        if coloured(self._stream) and encoding == 'utf8':
            from rich.console import Console
            from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn
            from rich.table import Column

            self._bar = Progress(
                BarColumn(WIDTH),
                TaskProgressColumn(),
                TextColumn('{task.description}', markup=False, table_column=Column()),
                console=Console(file=self._stream, highlight=False),
                transient=True,
            )
            self._bar.add_task('preparing', total=1.0)

    def __enter__(self) -> Self:
        """Take the place at the end of the terminal; elsewhere say after a while what is slow."""
        self._waiting.start() if self._bar is None else self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._waiting.cancel()
        if self._bar is not None:
            self._bar.stop()

    def note(self, text: str) -> None:
        """Say something that stays."""
        if self._bar is not None:
            self._bar.console.print(text, markup=False)
        else:
            print(text, file=self._stream, flush=True)

    def __call__(self, fraction: float, text: str, eta: float | None = None) -> None:
        """Show the part that is done, 0 to 1, what is being done, and the time to go [s].

        The time to go is by default what the part that is done says.
        """
        gone = time.monotonic() - self._start
        if eta is None:
            eta = gone * (1.0 - fraction) / fraction if fraction > KNOWN else math.nan
        self._tell(fraction, text, gone, eta, f'{100.0 * fraction:.0f} %, ')

    def _tell(self, fraction: float, text: str, gone: float, eta: float, share: str = '') -> None:
        self._waiting.cancel()
        text = f'{text}, {duration(gone)} gone, {duration(eta)} to go'
        if self._bar is not None:
            self._bar.update(self._bar.task_ids[0], completed=fraction, description=text)
        elif time.monotonic() - self._last >= LINE_EVERY:
            self._last = time.monotonic()
            self.note(share + text)

    def show(self, progress: 'IdentifyProgress | DiagnoseProgress') -> None:
        """Show how far a run is, and the best so far."""
        p = progress
        if not isinstance(p, IdentifyProgress):
            if p.best_so_far != self._best:
                self._best = p.best_so_far
                self.note(f'so far: {self._best}')
            self(p.fraction, p.stage, p.eta)
            return
        phase = 'intervals'
        if p.phase != phase:
            what = 'generation' if p.phase == 'search' else 'refining start'
            phase = f'{what} {p.generation} of {p.generations}'
        best = 'no candidate converged yet'
        if math.isfinite(p.best_cost):
            best = f'best {p.best_cost:.5g} {p.unit}'
        text = f'{phase}, {p.evaluations} candidates, {best}'
        self._tell(p.evaluations / max(1, p.budget), text, p.elapsed, p.eta)
