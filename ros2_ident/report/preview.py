# SPDX-License-Identifier: Apache-2.0
"""Simulated and residual effort of the best candidate so far, while a run goes on."""

from collections.abc import Callable
import time

import numpy as np

from ros2_ident.identify.problem import Problem
from ros2_ident.identify.settings import IdentifyProgress
from ros2_ident.recording import Stream
from ros2_ident.report.overlay import overlay_streams

# Simulating a preview holds the search up; it may for this share of the time.
SHARE = 0.05
# Samples of a segment in a preview: enough for the eye, and a few milliseconds to publish.
SAMPLES = 500

Series = list[Stream]


class Preview:
    """Simulated and residual effort of the best candidate so far, now and then during a run.

    Args:
        problem: The problem that is searched.
        show: Gets the simulated and the residual effort, one stream a segment, thinned out.
        period: Least time from one to the next, s.
    """

    def __init__(
        self, problem: Problem, show: Callable[[Series, Series], None], period: float
    ) -> None:
        self._problem = problem
        self._show = show
        self._period = period
        self._next = -np.inf
        self._shown = np.inf

    def __call__(self, progress: IdentifyProgress) -> None:
        """Simulate and show the best candidate if it is due and better than the last one."""
        begin = time.monotonic()
        if begin < self._next or not progress.best_cost < self._shown:
            return
        self._shown = progress.best_cost
        pairs = overlay_streams(self._problem, progress.best_theta)
        self._show(
            *([_thinned(pair[name]) for pair in pairs] for name in ('simulated', 'residual'))
        )
        took = time.monotonic() - begin
        self._next = begin + max(self._period, took / SHARE)


def _thinned(stream: Stream) -> Stream:
    """Return evenly chosen samples of a stream's efforts."""
    step = -(-stream.stamp.size // SAMPLES)
    assert stream.effort is not None
    return Stream(stream.names, stream.stamp[::step], effort=stream.effort[::step])
