# SPDX-License-Identifier: Apache-2.0
"""Throughput on a Dask cluster of this machine against threads of one process, on the tripod.

    python checks/benchmarks/cluster.py [--rounds 5] [--evaluations 700]

Both do the same identification, genetic algorithm and refinement, with as many workers as there
are processors. Each round has one run of each, one after the other and in turn first, so that what
else the machine does meets both; the figure is the median of the rounds' ratios. The processor
time of a candidate is told too, scheduler and client included: other programs hardly change it.
"""

import argparse
from pathlib import Path
import platform
import statistics

from distributed import Client, LocalCluster
import numpy as np
import psutil

from ros2_ident.identify.result import Identification
from ros2_ident.identify.run import identify, read_data
from ros2_ident.identify.settings import IdentifySettings
from ros2_ident.models import load_machine
from ros2_ident.search import Budget, Threads, Workers
from ros2_ident.search.evaluators import Cluster
from ros2_ident.threads import processors

ROOT = Path(__file__).resolve().parents[2]


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--rounds', type=int, default=5)
    parser.add_argument('--evaluations', type=int, default=700)
    args = parser.parse_args()
    machine = load_machine(ROOT / 'config/tripod.yaml')
    data = read_data(ROOT / 'bags/tripod_pick_and_place', machine)
    settings = IdentifySettings(budget=Budget(evaluations=args.evaluations))
    count = processors()

    def run(workers: Workers) -> Identification:
        return identify(machine, data, settings=settings, seed=1, workers=workers)

    with (
        LocalCluster(n_workers=count, threads_per_worker=1, dashboard_address=None) as local,
        Client(local) as client,
    ):
        ways: dict[str, Workers] = {'threads': Threads(count), 'dask': Cluster(client)}
        reference = run(ways['dask'])  # every process compiles, or reads the cache
        rates: dict[str, list[float]] = {name: [] for name in ways}
        costs: dict[str, list[float]] = {name: [] for name in ways}
        for number in range(args.rounds):
            for name in sorted(ways, reverse=bool(number % 2)):
                before = _processor_time()
                result = run(ways[name])
                costs[name].append((_processor_time() - before) / result.evaluations)
                assert np.array_equal(result.theta, reference.theta), 'the results differ'
                rates[name].append(result.evaluations / result.seconds)
            print(f'round {number + 1}: ' + _line(rates, number), flush=True)
    dearer = statistics.median(costs['dask']) / statistics.median(costs['threads'])
    ratios = [d / t for d, t in zip(rates['dask'], rates['threads'], strict=True)]
    print(
        f'{platform.machine()}, {count} processors, {args.evaluations} candidates a run; '
        'every result the same to the bit'
    )
    for name, values in rates.items():
        print(f'{name}: median {statistics.median(values):.1f} candidates/s')
    print(
        f'dask over threads: median {statistics.median(ratios):.3f}, '
        f'rounds from {min(ratios):.3f} to {max(ratios):.3f}'
    )
    print(f'processor time of a candidate, dask over threads: {dearer:.3f}')


def _processor_time() -> float:
    """Return the processor time of this process and its children so far, s."""
    own = psutil.Process()
    times = [x.cpu_times() for x in (own, *own.children(recursive=True))]
    return sum(x.user + x.system for x in times)


def _line(rates: dict[str, list[float]], number: int) -> str:
    dask, threads = rates['dask'][number], rates['threads'][number]
    return f'threads {threads:.1f}/s, dask {dask:.1f}/s, ratio {dask / threads:.3f}'


if __name__ == '__main__':
    main()
