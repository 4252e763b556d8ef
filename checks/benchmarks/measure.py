# SPDX-License-Identifier: Apache-2.0
"""What all comparisons share: interleaved timing, memory, the machine in words, tables, pictures.

Times of one thread are its processor time, which other programs on the machine disturb less than
the clock; jobs of several processes are timed by the clock.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
import os
from pathlib import Path
import platform
import resource
import subprocess
import sys
import time

import matplotlib
import numpy as np

matplotlib.use('Agg')
from matplotlib.axes import Axes  # noqa: E402
import matplotlib.pyplot as plt  # noqa: E402


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
        rounds: Rounds.
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


def memory(job: str, folder: Path) -> float:
    """Return how much a job adds to the memory of a fresh process that has made its imports, MB.

    Args:
        job: `module:function`; the function prepares and returns what is measured.
        folder: Where the module is.
    """
    module, name = job.split(':')
    # getrusage's peak begins with the parent's and cannot be set back; the kernel's own can.
    script = (
        'import sys\n'
        f'sys.path.insert(0, {str(folder)!r})\n'
        f'from {module} import {name}\n'
        'def status(key):\n'
        '    with open("/proc/self/status") as file:\n'
        '        return next(int(x.split()[1]) for x in file if x.startswith(key))\n'
        f'job = {name}()\n'
        'with open("/proc/self/clear_refs", "w") as file:\n'
        '    file.write("5")\n'
        'before = status("VmRSS")\n'
        'job()\n'
        'print(status("VmHWM") - before)'
    )
    done = subprocess.run([sys.executable, '-c', script], capture_output=True, text=True)
    if done.returncode:
        raise RuntimeError(f'{job} failed in a process of its own:\n{done.stderr}')
    return float(done.stdout.split()[-1]) / 1024.0


def children_seconds() -> float:
    """Return the processor time of child processes that have ended, s."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


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


def table(head: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    """Return a Markdown table."""
    lines = ['| ' + ' | '.join(head) + ' |', '|' + ' --- |' * len(head)]
    lines += ['| ' + ' | '.join(str(cell) for cell in row) + ' |' for row in rows]
    return '\n'.join(lines) + '\n'


@contextmanager
def picture(path: Path, columns: int = 1) -> Iterator[list[Axes]]:
    """Open a row of axes and write it to a file at the end."""
    figure, axes = plt.subplots(1, columns, figsize=(4.2 * columns, 3.4), squeeze=False)
    for one in axes[0]:
        one.grid(visible=True, alpha=0.3, which='both')
        one.spines[['top', 'right']].set_visible(False)
    yield list(axes[0])
    figure.tight_layout()
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110, metadata={'Software': None})
    plt.close(figure)
