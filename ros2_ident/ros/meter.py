# SPDX-License-Identifier: Apache-2.0
"""How a stream arrives, judged while it runs: rate, missing samples, backward steps, latency."""

import math

import numpy as np
from numpy.typing import NDArray

# Latencies kept for the percentiles: about the last seconds of a 1 kHz stream.
_KEPT = 5000
# Fewer intervals than this say nothing about the period.
_ENOUGH = 20


class StreamMeter:
    """Counts one stream. Numbers come from the header stamps, never from the time of arrival."""

    def __init__(self) -> None:
        self.received = 0
        self.missing = 0
        self.backward = 0
        self.malformed = 0
        self.dropped = 0
        self.last: int | None = None
        self._period = math.nan
        self._latency: NDArray[np.int64] = np.empty(0, dtype=np.int64)

    @property
    def rate(self) -> float:
        """Samples per second, Hz; NaN while unknown."""
        return 1e9 / self._period

    @property
    def missing_fraction(self) -> float:
        """Samples missing over those expected; NaN while unknown."""
        if math.isnan(self._period):
            return math.nan
        return self.missing / max(1, self.missing + self.received)

    def add(self, stamps: NDArray[np.int64]) -> None:
        """Count the stamps (T,) [ns] of messages in the order of arrival."""
        self.received += len(stamps)
        if self.last is not None:
            stamps = np.concatenate(([self.last], stamps))
        if not len(stamps):
            return
        self.last = int(stamps[-1])
        steps = np.diff(stamps)
        self.backward += int((steps < 0).sum())
        # joints that publish one by one share a stamp
        forward = steps[steps > 0]
        if len(forward) >= _ENOUGH or (math.isnan(self._period) and len(forward)):
            self._period = float(np.median(forward))
        if len(forward):
            self.missing += int(np.maximum(np.rint(forward / self._period) - 1, 0).sum())

    def add_latency(self, nanoseconds: list[int]) -> None:
        """Remember how long messages took from their publisher to here."""
        fresh = np.array(nanoseconds[-_KEPT:], dtype=np.int64)
        self._latency = np.concatenate((self._latency[len(fresh) - _KEPT :], fresh))[-_KEPT:]

    def latency(self, percent: float) -> float:
        """Return a percentile of the latest latencies, s; NaN before the first."""
        if not len(self._latency):
            return math.nan
        return float(np.percentile(self._latency, percent)) * 1e-9
