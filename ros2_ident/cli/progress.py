# SPDX-License-Identifier: Apache-2.0
"""Progress of an identification: a bar on a terminal, now and then a line elsewhere."""

import math
import sys
import time
from types import TracebackType
from typing import Any, Protocol, Self, TextIO

from ros2_ident.settings import IdentifyProgress

# Without a terminal a line comes at most so often, s.
LINE_EVERY = 5.0


def duration(seconds: float) -> str:
    """Return a time for people: `8 s`, `1:05`, `?` where unknown."""
    if not math.isfinite(seconds):
        return '?'
    whole = max(0, round(seconds))
    return f'{whole} s' if whole < 60 else f'{whole // 60}:{whole % 60:02d}'


def describe(progress: IdentifyProgress) -> str:
    """Return the phase and how far it is."""
    what = 'generation' if progress.phase == 'search' else 'refining start'
    return f'{what} {progress.generation} of {progress.generations}'


def best(progress: IdentifyProgress) -> str:
    """Return the best cost so far with its unit."""
    if not math.isfinite(progress.best_cost):
        return 'no candidate converged yet'
    return f'best {progress.best_cost:.5g} {progress.unit}'


class Meter(Protocol):
    """What shows progress."""

    def __enter__(self) -> Self:
        """Begin."""
        ...

    def __exit__(
        self,
        kind: type[BaseException] | None,
        value: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """End."""
        ...

    def __call__(self, progress: IdentifyProgress) -> None:
        """Show it."""
        ...


class Lines:
    """Plain lines, for logs."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream
        self._last = -math.inf

    def __enter__(self) -> Self:
        """Return itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Leave nothing behind."""

    def __call__(self, progress: IdentifyProgress) -> None:
        """Print a line, unless the last one is fresh."""
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


class Bar:
    """A bar with the best value and the time to go."""

    def __init__(self, stream: TextIO) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, Progress, TextColumn

        self._bar = Progress(
            TextColumn('{task.description}'),
            BarColumn(bar_width=None),
            TextColumn('{task.percentage:>3.0f} %'),
            TextColumn('{task.fields[best]}'),
            TextColumn('{task.fields[eta]}'),
            console=Console(file=stream),
            transient=True,
        )
        self._task: Any = self._bar.add_task('starting', total=None, best='', eta='')

    def __enter__(self) -> Self:
        """Show the bar."""
        self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        """Take the bar away."""
        self._bar.stop()

    def __call__(self, progress: IdentifyProgress) -> None:
        """Move the bar."""
        self._bar.update(
            self._task,
            description=describe(progress),
            completed=progress.evaluations,
            total=progress.budget,
            best=best(progress),
            eta=f'{duration(progress.eta)} to go',
        )


class Silence:
    """Nothing at all."""

    def __enter__(self) -> Self:
        """Return itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Leave nothing behind."""

    def __call__(self, progress: IdentifyProgress) -> None:
        """Show nothing."""


def make_meter(*, quiet: bool = False, stream: TextIO | None = None) -> Meter:
    """Return what shows progress on a stream, standard error by default."""
    stream = stream or sys.stderr
    if quiet:
        return Silence()
    return Bar(stream) if stream.isatty() else Lines(stream)


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
        if not quiet and self._stream.isatty():
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

    def __call__(self, fraction: float, text: str) -> None:
        """Show the part that is done, 0 to 1, and what is being done."""
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
        left = gone * (1.0 - fraction) / fraction if fraction > 0.0 else math.nan
        print(
            f'{100.0 * fraction:.0f} %, {text}, {duration(gone)} gone, {duration(left)} to go',
            file=self._stream,
            flush=True,
        )
