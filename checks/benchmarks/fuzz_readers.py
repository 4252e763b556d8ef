# SPDX-License-Identifier: Apache-2.0
"""Damaged logs by the hundred thousand: what the readers make of them.

Small logs of every kind (MCAP, db3, ROS 1, tables, with every compression, with and without
checksums) are damaged at random, by seed: bits and bytes changed, deleted, inserted, repeated,
zeroed, numbers replaced by extreme ones, the end cut off. Each is read and judged as `ident check`
does, in child processes whose memory is limited. Told are the outcomes of each kind, the slowest
input and the largest memory; inputs that end in a traceback, hang or exceed the memory are kept.

Example: python checks/benchmarks/fuzz_readers.py --inputs 100000
"""

import argparse
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
import multiprocessing
from pathlib import Path
import random
import resource
import signal
import sys
import tempfile
import time
import traceback
from typing import Any
import warnings

sys.path.insert(0, str(Path(__file__).parents[2] / 'test'))

from reader_cases import damage, Kind, kinds, outcome  # noqa: E402

from ros2_ident.recording import read_bag  # noqa: E402

# Formats in which every byte is covered by a checksum: no damage may pass without a word.
CHECKED = ('mcap', 'mcap_plain', 'mcap_lz4')
OUTCOMES = ('same', 'salvaged', 'refused', 'silent', 'traceback', 'hang', 'memory')
BATCH = 100  # inputs of one child process


@dataclass
class Tally:
    """What came of the inputs of one kind."""

    outcomes: Counter[str] = field(default_factory=Counter)
    slowest: float = 0.0
    slowest_input: int = 0
    memory: int = 0  # bytes above what the process takes before
    kept: list[str] = field(default_factory=list)


def too_long(*_: object) -> None:
    """End an input that takes too long."""
    raise TimeoutError


def run_batch(task: tuple[str, Kind, int, int, int, int, float, str, int]) -> tuple[str, Tally]:
    """Read `count` damaged inputs of one kind."""
    name, kind, seed, first, count, memory, seconds, keep, judge = task
    tally = Tally()
    warnings.simplefilter('ignore')
    signal.signal(signal.SIGALRM, too_long)
    with tempfile.TemporaryDirectory() as folder:
        room = Path(folder)
        truth = read_bag(kind.write(room, kind.data))
        before = peak()
        size = resident() + memory
        resource.setrlimit(resource.RLIMIT_DATA, (size, resource.RLIM_INFINITY))
        for number in range(first, first + count):
            data = damage(kind.data, random.Random(f'{seed} {name} {number}'))
            path = kind.write(room, data)
            found, took = 'traceback', 0.0
            signal.setitimer(signal.ITIMER_REAL, seconds)
            try:
                begin = time.perf_counter()
                found = outcome(path, truth, number % judge == 0)
                took = time.perf_counter() - begin
            except TimeoutError:
                found, took = 'hang', seconds
            except MemoryError:
                found = 'memory'
            except Exception:
                text = traceback.format_exc(limit=-3)
                tally.kept.append(f'{name} {number}\n{text}')
            finally:
                signal.setitimer(signal.ITIMER_REAL, 0.0)
            tally.outcomes[found] += 1
            wrong = found in OUTCOMES[4:] or (found == 'silent' and name in CHECKED)
            if wrong and keep:
                Path(keep, f'{name}_{number}_{found}').write_bytes(data)
            if took > tally.slowest:
                tally.slowest, tally.slowest_input = took, number
        tally.memory = peak() - before
    return name, tally


def peak() -> int:
    """Return the largest memory of this process so far, bytes."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


def resident() -> int:
    """Return the data of this process, bytes."""
    fields = Path('/proc/self/statm').read_text().split()
    return int(fields[5]) * resource.getpagesize()


def tasks(args: argparse.Namespace, logs: dict[str, Kind]) -> Iterator[tuple[Any, ...]]:
    """Yield batches, a batch of every kind in turn."""
    each = -(-args.inputs // len(logs))
    for first in range(args.first, args.first + each, BATCH):
        count = min(BATCH, args.first + each - first)
        for name, kind in logs.items():
            limits = args.memory << 20, args.seconds
            yield name, kind, args.seed, first, count, *limits, args.keep, args.judge


def main() -> None:
    """Damage, read, count."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--inputs', type=int, default=100_000)
    parser.add_argument('--seed', type=int, default=1)
    parser.add_argument('--first', type=int, default=0, help='number of the first input')
    parser.add_argument('--kinds', nargs='*', help='kinds of logs; all where not given')
    parser.add_argument('--processes', type=int, default=2)
    parser.add_argument('--memory', type=int, default=2048, help='MiB that an input may take')
    parser.add_argument('--seconds', type=float, default=10.0, help='that an input may take')
    parser.add_argument('--size', type=int, default=120, help='samples of each stream')
    parser.add_argument('--judge', type=int, default=1, help='judge one of so many that are read')
    parser.add_argument('--keep', default='', help='directory for inputs that went wrong')
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        logs = kinds(Path(folder), args.size)
    if args.keep:
        Path(args.keep).mkdir(parents=True, exist_ok=True)
    logs = {k: v for k, v in logs.items() if not args.kinds or k in args.kinds}
    found = {name: Tally() for name in logs}
    begin = time.monotonic()
    context = multiprocessing.get_context('spawn')
    with context.Pool(args.processes, maxtasksperchild=20) as pool:
        for name, part in pool.imap_unordered(run_batch, tasks(args, logs)):
            tally = found[name]
            tally.outcomes += part.outcomes
            tally.memory = max(tally.memory, part.memory)
            tally.kept += part.kept
            if part.slowest > tally.slowest:
                tally.slowest, tally.slowest_input = part.slowest, part.slowest_input
    print('| log |', ' | '.join(OUTCOMES), '| slowest, s | memory, MiB |')
    print('| --- |' + ' ---: |' * (len(OUTCOMES) + 2))
    for name, tally in found.items():
        cells = [str(tally.outcomes[x]) for x in OUTCOMES]
        print(f'| {name} |', ' | '.join(cells), f'| {tally.slowest:.2f}', end=' ')
        print(f'| {tally.memory >> 20} |')
    total = sum((x.outcomes for x in found.values()), Counter[str]())
    print(f'{sum(total.values())} inputs in {time.monotonic() - begin:.0f} s, seed {args.seed}')
    for text in [y for x in found.values() for y in x.kept][:20]:
        print(text)


if __name__ == '__main__':
    main()
