# SPDX-License-Identifier: Apache-2.0
"""Time, cancel and progress of a diagnosis, and how long it will still take.

The nominal fit and the noise take shares of the time that are known roughly. Each round that
follows, in which one more effect is looked for, is taken to be as long as all that stood before
the first; how many there will be is guessed from the size of the gap.
"""

from collections.abc import Callable
from dataclasses import dataclass
import math
import time

# Share of the work from which on the time to go is told; before, simulations may be compiled.
KNOWN = 0.05
# Rounds for each doubling of the gap over the noise floor, as on tripods, axes and arms.
_ROUNDS = 1.2
# The end takes this share of a round.
_END = 0.3


@dataclass(frozen=True)
class DiagnoseProgress:
    """How far a diagnosis is.

    Attributes:
        stage: What is being done.
        fraction: Share of the time that has gone, 0 to 1; never falls.
        best_so_far: The verdict if it ended now, as a sentence; empty for none yet.
        elapsed: Seconds since the start.
        eta: Seconds expected until the end, NaN where unknown.
    """

    stage: str
    fraction: float
    best_so_far: str
    elapsed: float
    eta: float


class Clock:
    """The clock of one diagnosis.

    Args:
        seconds: What it may take; 0 for no limit.
        cancelled: Whether it shall end.
        on_progress: Told how far it is.
        now: Seconds that never step back.
    """

    def __init__(
        self,
        seconds: float,
        cancelled: Callable[[], bool],
        on_progress: Callable[[DiagnoseProgress], None] | None,
        now: Callable[[], float] = time.monotonic,
    ) -> None:
        self.begin = now()
        self.seconds = seconds
        self.cancelled = cancelled
        self.on_progress = on_progress
        self.best = ''
        self.stage = 0.0, 1.0  # begin and end, as shares of the time
        self._now = now
        self._done = 0.0
        self._past = 0

    @property
    def elapsed(self) -> float:
        """Seconds since the start."""
        return self._now() - self.begin

    def stopped(self) -> bool:
        """Whether it shall end."""
        return self.cancelled() or 0.0 < self.seconds < self.elapsed

    def rounds(self, size: float) -> None:
        """Begin a round, or the end.

        Args:
            size: The gap that is left, in units of the noise floor; 0 for the end.
        """
        self._past += 1
        left = max(1.0, _ROUNDS * math.log2(max(1.0, size))) if size else 0.0
        total = self._past + left + _END
        self.stage = self._past / total, min(self._past + 1.0, total) / total

    def step(self, share: float, text: str) -> None:
        """Report a share of the present stage."""
        if self.on_progress is None:
            return
        low, high = self.stage
        fraction = low + (high - low) * share
        eta = self.elapsed * (1.0 - fraction) / fraction if fraction > KNOWN else math.nan
        if self.seconds:
            eta = min(eta, max(0.0, self.seconds - self.elapsed))
        if not math.isnan(eta):
            self._done = max(self._done, self.elapsed / max(self.elapsed + eta, 1e-9))
        self.on_progress(DiagnoseProgress(text, self._done, self.best, self.elapsed, eta))

    def ended(self) -> None:
        """Report the end."""
        if self.on_progress is not None:
            self.on_progress(DiagnoseProgress('done', 1.0, self.best, self.elapsed, 0.0))
