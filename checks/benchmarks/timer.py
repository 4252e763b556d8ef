# SPDX-License-Identifier: Apache-2.0
"""How late a 1 kHz timer is in another thread while an identification computes.

The identification runs in a thread as the node's does: nice, and with one processor left free.
The timer sleeps to its next tick and asks the clock when it woke; a tick is skipped where it woke
after the following one was due. Idle and busy stretches take turns within one run.

    python checks/benchmarks/timer.py [--seconds 10] [--rounds 3]
"""

import argparse
import os
from pathlib import Path
import sys
import threading
import time

import numpy as np

from checks.benchmarks.measure import machine
from ros2_ident.identify.run import identify, read_data
from ros2_ident.identify.settings import IdentifySettings
from ros2_ident.models import load_machine
from ros2_ident.ros.identifier import SWITCH_INTERVAL
from ros2_ident.ros.worker import NICE
from ros2_ident.search import GeneticSettings

ROOT = Path(__file__).resolve().parents[2]
PERIOD = 1_000_000  # ns


def lateness(seconds: float) -> tuple[np.ndarray, int]:
    """Run the timer in this thread.

    Returns:
        How late each tick was, s, and how many were skipped.
    """
    late, skipped = [], 0
    due = time.monotonic_ns() + PERIOD
    end = due + round(seconds * 1e9)
    while due < end:
        time.sleep(max(0, due - time.monotonic_ns()) * 1e-9)
        behind = time.monotonic_ns() - due
        late.append(behind)
        missed = behind // PERIOD
        skipped += missed
        due += PERIOD * (1 + missed)
    return np.array(late) * 1e-9, skipped


class Busy:
    """An identification of the tripod in a thread, until the context is left."""

    def __init__(self) -> None:
        self._machine = load_machine(ROOT / 'config/tripod.yaml')
        self._data = read_data(str(ROOT / 'bags/tripod_pick_and_place'), self._machine)
        threads = max(1, len(os.sched_getaffinity(0)) - 1)
        # No end within a stretch: what is measured is the search.
        self._settings = IdentifySettings(
            genetic=GeneticSettings(initial_population=512, generations=100_000), threads=threads
        )
        self._end = threading.Event()
        self._begun = threading.Event()
        self._thread = threading.Thread(target=self._work)

    def _work(self) -> None:
        os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), NICE)
        identify(
            self._machine,
            self._data,
            settings=self._settings,
            cancel=self._end,
            on_progress=lambda progress: self._begun.set(),
        )

    def __enter__(self) -> 'Busy':
        self._thread.start()
        self._begun.wait()
        return self

    def __exit__(self, *error: object) -> None:
        self._end.set()
        self._thread.join()


def main() -> int:
    """Measure and print; return 1 where the timer is held up."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--seconds', type=float, default=10.0, help='length of a stretch')
    parser.add_argument('--rounds', type=int, default=3, help='stretches of each kind')
    options = parser.parse_args()
    sys.setswitchinterval(SWITCH_INTERVAL)
    with Busy():  # compiles
        pass
    idle, busy = [], []
    for _ in range(options.rounds):
        idle.append(lateness(options.seconds))
        with Busy():
            busy.append(lateness(options.seconds))
    print('| | ticks | p50 [ms] | p99 [ms] | longest [ms] | skipped |')
    print('| --- | --- | --- | --- | --- | --- |')
    p99 = {}
    for name, found in (('idle', idle), ('while it computes', busy)):
        late = 1e3 * np.concatenate([x for x, _ in found])
        share = sum(x for _, x in found) / (late.size + sum(x for _, x in found))
        p99[name] = float(np.quantile(late, 0.99))
        print(
            f'| {name} | {late.size} | {np.median(late):.3f} | {p99[name]:.3f} '
            f'| {late.max():.2f} | {100 * share:.2f} % |'
        )
    ratio = p99['while it computes'] / p99['idle']
    print(f'p99: {ratio:.2f} times idle; {machine()}')
    return 0 if ratio <= 3.0 and share <= 0.005 else 1


if __name__ == '__main__':
    sys.exit(main())
