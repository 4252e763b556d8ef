# SPDX-License-Identifier: Apache-2.0
"""Page of a run in progress, written anew every few seconds; the browser reloads it."""

from collections.abc import Iterable, Sequence
from contextlib import suppress
import math
from pathlib import Path
import time
from typing import Any, Self, TYPE_CHECKING

import numpy as np

from ros2_ident.errors import IdentError
from ros2_ident.files import write_text
from ros2_ident.identify.problem import Problem
from ros2_ident.identify.settings import IdentifyProgress
from ros2_ident.recording import Stream
from ros2_ident.report.files import PAGE
from ros2_ident.report.overlay import preview
from ros2_ident.report.page.effort import effort_plot
from ros2_ident.report.page.numbers import quantity
from ros2_ident.report.page.render import Picture, render
from ros2_ident.report.signals import Curves, Signals
from ros2_ident.words.figures import capital, duration

if TYPE_CHECKING:
    from ros2_ident.gap.diagnose import DiagnoseProgress

# Seconds from one page to the next, and from one reload by the browser to the next.
EVERY, RELOAD = 3.0, 3


class LivePage:
    """Page of a run in progress, from its start until the report takes its place.

    Args:
        problem: Of an identification: its parameters and efforts are shown, too.
    """

    def __init__(
        self, directory: str | Path, title: str, lead: str, problem: Problem | None = None
    ) -> None:
        self._page = Path(directory) / PAGE
        self._context: dict[str, Any] = {
            'title': title, 'lead': lead, 'reload': RELOAD,
            'times': '', 'notes': [], 'parameters': [],
            'headline': 'Preparing: data are read, and a new kind of machine is compiled',
        }  # fmt: skip
        self._problem = problem
        self._next = -math.inf
        self._signals: Signals | None = None
        self._notes: dict[str, float] = {}
        compared = problem is not None and problem.models[0].outputs[0].quantity == 'effort'
        self._preview = preview(problem, self._compare, EVERY) if problem and compared else None

    def __enter__(self) -> Self:
        self._write()
        return self

    def __exit__(self, _: object, error: BaseException | None, *rest: object) -> None:
        """Leave the report; after an error, the reason of the end."""
        if error is None and self._page.exists():
            return
        why = 'it could not be written' if error is None else type(error).__name__
        if isinstance(error, IdentError):
            why = error.message
        elif isinstance(error, KeyboardInterrupt):
            why = 'it was interrupted twice'
        self._write(headline=f'The run ended without a report: {why}', reload=0)

    @property
    def place(self) -> str:
        """Address for the browser."""
        return self._page.resolve().as_uri()

    def show(self, progress: 'IdentifyProgress | DiagnoseProgress') -> None:
        """Show how far a run is; a better explanation of a diagnosis at once."""
        if isinstance(progress, IdentifyProgress):
            self._identifying(progress)
            return
        best = progress.best_so_far
        news = bool(best) and best not in self._notes
        if news:
            self._notes[best] = progress.elapsed
        if time.monotonic() < self._next and not news:
            return
        self._write(
            headline=capital(progress.stage),
            times=_times(progress.elapsed, progress.eta, ()),
            share=progress.fraction,
            notes=[f'{duration(when)}: {text}' for text, when in self._notes.items()],
        )

    def _identifying(self, progress: IdentifyProgress) -> None:
        known = math.isfinite(progress.best_cost)
        if self._preview is not None and known:
            self._preview(progress)
        if time.monotonic() < self._next:
            return
        phases = {'search': 'generation', 'refinement': 'refining start'}
        counted = f'{progress.generation} of {progress.generations}'
        what = phases.get(progress.phase)
        more, parameters = list[str](), list[tuple[str, str, float, str]]()
        pictures: dict[str, Picture] = {}
        if known:
            parameters += self._parameters(progress)
            best = quantity(progress.best_cost, progress.unit, 4)
            more = [f'best {best}', f'{progress.evaluations} candidates']
        if self._signals is not None:
            pictures['effort-plot'] = effort_plot(self._signals)
        self._write(
            headline=capital(f'{what} {counted}' if what else 'model errors'),
            times=_times(progress.elapsed, progress.eta, more),
            share=progress.elapsed / (progress.elapsed + progress.eta),
            pictures=pictures,
            parameters=parameters,
        )

    def _write(self, share: float = 0.0, **changes: Any) -> None:
        percent = round(100.0 * share) if math.isfinite(share) else 0
        self._context |= {'written': time.strftime('%X'), 'share': percent, **changes}
        context = {'pictures': {}, **self._context}
        with suppress(IdentError):  # a full disk does not end a run
            write_text(self._page, render('live.html', context, plots=bool(context['pictures'])))
        self._next = time.monotonic() + EVERY

    def _parameters(self, progress: IdentifyProgress) -> Iterable[tuple[str, str, float, str]]:
        """Yield name, value, place within the bounds in percent, and the bounds."""
        assert self._problem is not None
        low, high, theta = self._problem.low, self._problem.high, progress.best_theta
        place = np.clip(100.0 * (theta - low) / (high - low), 0.0, 100.0).round(1).tolist()
        for k, parameter in enumerate(self._problem.parameters):
            value = quantity(theta[k], parameter.unit, 4)
            yield progress.names[k], value, place[k], f'{low[k]:g} to {high[k]:g}'

    def _compare(self, simulated: Sequence[Stream], residual: Sequence[Stream]) -> None:
        """Take the efforts of the first recording into the page."""
        first, rest = simulated[0], residual[0]
        assert first.effort is not None and rest.effort is not None and self._problem is not None
        made = first.effort.T.astype(np.float32)
        curves = Curves(
            '', 1e-9 * (first.stamp - first.stamp[0]), made + rest.effort.T.astype(np.float32),
            made[None], np.full_like(made, np.nan),
        )  # fmt: skip
        unit = self._problem.machine.effort_unit
        self._signals = Signals(unit, tuple(first.names), ('best so far',), (curves,))


def _times(gone: float, left: float, more: Sequence[str]) -> str:
    to_go = f'about {duration(left)} to go' if math.isfinite(left) else 'time to go not known yet'
    return ', '.join([f'{duration(gone)} gone', to_go, *more])
