# SPDX-License-Identifier: Apache-2.0
"""What all comparisons share: interleaved timing, the machine in words.

Times of one thread are its processor time, which other programs on the machine disturb less than
the clock; jobs of several processes are timed by the clock.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
import os
from pathlib import Path
import platform
import time

import numpy as np


@dataclass(frozen=True)
class Timing:
    """Repeated times of one job.

    Attributes:
        seconds: (R,) one for each round.
    """

    seconds: tuple[float, ...]

    @property
    def median(self) -> float:
        """Median, s."""
        return float(np.median(self.seconds))

    @property
    def least(self) -> float:
        """Minimum, s: the run that was disturbed least."""
        return min(self.seconds)

    @property
    def noise(self) -> float:
        """Median over minimum, less one."""
        return self.median / self.least - 1.0


def interleaved(
    jobs: Mapping[str, Callable[[], object]],
    rounds: int,
    clock: Callable[[], float] = time.process_time,
    shares: Mapping[str, int] | None = None,
) -> dict[str, Timing]:
    """Time jobs in turns, so that what disturbs the machine disturbs them alike.

    Args:
        jobs: What to time by name; each is called once before the first round.
        clock: Seconds that never step back.
        shares: How many equal pieces a job does; its time is divided by it.
    """
    shares = shares or {}
    found: dict[str, list[float]] = {name: [] for name in jobs}
    for job in jobs.values():
        job()
    for _ in range(rounds):
        for name, job in jobs.items():
            before = clock()
            job()
            found[name].append((clock() - before) / shares.get(name, 1))
    return {name: Timing(tuple(seconds)) for name, seconds in found.items()}


def ratio(slow: Timing, fast: Timing) -> str:
    """Return how many times longer, by medians and by minima."""
    both = (slow.median / fast.median, slow.least / fast.least)
    medians, minima = (f'{x:.0f}' if x >= 10.0 else f'{x:.2g}' for x in both)
    return f'{medians} ({minima})'


def machine() -> str:
    """Return the machine and its present load as one line."""
    model = platform.processor() or platform.machine()
    cpuinfo = Path('/proc/cpuinfo')
    if cpuinfo.is_file():
        names = [x for x in cpuinfo.read_text().splitlines() if x.startswith('model name')]
        model = names[0].split(':', 1)[1].strip() if names else model
    load = ', '.join(f'{x:.1f}' for x in os.getloadavg())
    return (
        f'{model}, {os.cpu_count()} processors, Linux {platform.release().split("-")[0]}, '
        f'Python {platform.python_version()}; load average {load}'
    )
