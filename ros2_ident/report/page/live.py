# SPDX-License-Identifier: Apache-2.0
"""A run in the browser while it goes on.

`report.html` is a page that asks for `progress.js` beside it once a second: a browser loads no
other file of a directory without a server. Where that file has gone, the report is there.
"""

from collections.abc import Sequence
from contextlib import suppress
import json
import math
from pathlib import Path
import time
from types import TracebackType
from typing import Any, Self

import numpy as np

from ros2_ident.arrays import plain
from ros2_ident.errors import IdentError
from ros2_ident.files import remove_file, write_text
from ros2_ident.gap.diagnose import DiagnoseProgress
from ros2_ident.identify.problem import Problem
from ros2_ident.identify.settings import IdentifyProgress
from ros2_ident.recording import Stream
from ros2_ident.report.files import PAGE
from ros2_ident.report.page.numbers import quantity, unit_of
from ros2_ident.report.page.render import render
from ros2_ident.report.preview import Preview

NEWS = 'progress.js'
# Written at most so often, s; the page asks as often.
EVERY = 1.0
# Points of a history; of a longer one every second goes.
POINTS = 240
_CONTENTS = ('answer', 'Progress'), ('effort', 'Effort'), ('parameters', 'Parameters')


class LivePage:
    """The page on a run that goes on, from its start until the report takes its place.

    Args:
        directory: That of the results; exists.
        title: What runs.
        lead: Of what.
        problem: Of an identification: its parameters and efforts are shown, too.
    """

    def __init__(
        self, directory: str | Path, title: str, lead: str, problem: Problem | None = None
    ) -> None:
        self._folder = Path(directory)
        self._heading = {'title': title, 'lead': lead}
        self._problem = problem
        self._next = -math.inf
        self._begin = time.monotonic()
        self._costs: list[tuple[float, float]] = []
        self._thetas: list[list[float]] = []
        self._said: dict[str, Any] = {}
        self._efforts: list[dict[str, Any]] = []
        self._notes: list[tuple[float, str]] = []
        compared = problem is not None and problem.models[0].outputs[0].quantity == 'effort'
        self._preview = Preview(problem, self._compare, EVERY) if problem and compared else None

    def __enter__(self) -> Self:
        """Write the page; what is said of an earlier run goes."""
        self._write({'state': 'preparing'})
        contents = _CONTENTS if self._problem else _CONTENTS[:1]
        context = {**self._heading, 'contents': contents, 'news': NEWS}
        write_text(self._folder / PAGE, render('live.html', context))
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Give way to the report; where none was written, say why."""
        if error is None and (self._folder / PAGE).exists():
            remove_file(self._folder / NEWS)
            return
        why = 'it could not be written' if error is None else type(error).__name__
        if isinstance(error, IdentError):
            why = error.message
        elif isinstance(error, KeyboardInterrupt):
            why = 'it was interrupted twice'
        with suppress(IdentError):
            self._write({**self._said, 'state': 'ended', 'why': why})

    @property
    def place(self) -> str:
        """Where a browser finds it."""
        return (self._folder / PAGE).resolve().as_uri()

    def identifying(self, progress: IdentifyProgress) -> None:
        """Show how far an identification is."""
        if self._preview is not None and math.isfinite(progress.best_cost):
            self._preview(progress)
        if not self._due():
            return
        known = math.isfinite(progress.best_cost)
        if known:
            self._costs = _fewer([*self._costs, (progress.elapsed, progress.best_cost)])
            self._thetas = _fewer([*self._thetas, progress.best_theta.tolist()])
        phases = {'search': 'generation', 'refinement': 'refining start'}
        counted = f'{progress.generation} of {progress.generations}'
        what = phases.get(progress.phase)
        self._say(
            what=f'{what} {counted}' if what else 'weighing what the model may lack',
            gone=progress.elapsed,
            left=progress.eta,
            share=progress.elapsed / (progress.elapsed + progress.eta),
            best=quantity(progress.best_cost, progress.unit, 4) if known else '',
            candidates=progress.evaluations,
            costs=self._costs,
            unit=unit_of(progress.unit),
            parameters=list(self._parameters(progress)) if known else [],
            efforts=self._efforts,
        )

    def diagnosing(self, progress: DiagnoseProgress) -> None:
        """Show how far a diagnosis is."""
        best = progress.best_so_far
        news = bool(best) and (not self._notes or self._notes[-1][1] != best)
        if news:
            self._notes.append((progress.elapsed, best))
        if not self._due() and not news:
            return
        self._say(
            what=progress.stage,
            gone=progress.elapsed,
            left=progress.eta,
            share=progress.fraction,
            notes=self._notes,
        )

    def _due(self) -> bool:
        return time.monotonic() >= self._next

    def _say(self, **said: Any) -> None:
        self._said = {'state': 'running', **said}
        with suppress(IdentError):  # a run does not end where a disk is full
            self._write(self._said)

    def _write(self, said: dict[str, Any]) -> None:
        self._next = time.monotonic() + EVERY
        news = {'format': 'ros2_ident.news', **plain(said), 'written': time.time()}
        text = json.dumps(news, separators=(',', ':'))
        write_text(self._folder / NEWS, f'identNews({text})\n')

    def _parameters(self, progress: IdentifyProgress) -> Any:
        """Yield what is shown of each parameter: how it changed is within its bounds, 0 to 1."""
        assert self._problem is not None
        low, high = self._problem.low, self._problem.high
        within = np.clip((np.array(self._thetas) - low) / (high - low), 0.0, 1.0)
        for k, parameter in enumerate(self._problem.parameters):
            yield {
                'name': progress.names[k],
                'value': quantity(progress.best_theta[k], parameter.unit, 4),
                'trace': np.round(within[:, k], 3).tolist(),
                'ends': f'{low[k]:g} to {high[k]:g}',
            }

    def _compare(self, simulated: Sequence[Stream], residual: Sequence[Stream]) -> None:
        """Take the efforts of the first recording into the page."""
        first, rest = simulated[0], residual[0]
        assert first.effort is not None and rest.effort is not None
        time_s = np.round(1e-9 * (first.stamp - first.stamp[0]), 4).tolist()
        unit = unit_of(self._problem.machine.effort_unit) if self._problem else ''
        self._efforts = [
            {
                'drive': name,
                'unit': unit,
                'time': time_s,
                'simulated': _short(first.effort[:, k]),
                'measured': _short(first.effort[:, k] + rest.effort[:, k]),
            }
            for k, name in enumerate(first.names)
        ]


def _short(values: Any) -> list[float | None]:
    """Return numbers to four digits; None where there is none."""
    return [float(f'{x:.4g}') if math.isfinite(x) else None for x in values.tolist()]


def _fewer(points: list[Any]) -> list[Any]:
    """Return points without every second one where they are too many; the last one stays."""
    return points if len(points) <= POINTS else [*points[:-1:2], points[-1]]
