# SPDX-License-Identifier: Apache-2.0
"""The blind check from the draw to the table: draw and seal all, diagnose all, open, score."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import (
    FIRST_COMPLETED,
    Future,
    ProcessPoolExecutor,
    ThreadPoolExecutor,
    wait,
)
from contextlib import contextmanager
from dataclasses import dataclass
import functools
import json
import multiprocessing
import os
from pathlib import Path
import queue
import signal
import subprocess
import sys
import threading
from typing import Any, TypeVar

from checks.blind import seal
from checks.blind.case import CHECK, FIT, MACHINE, write_case
from checks.blind.draw import Drawer
from checks.blind.label import to_mapping
from checks.blind.machines import machine_of, read_plain
from checks.blind.page import write_page
from checks.blind.planning import plan, Wanted
from checks.blind.score import score, sentences
from checks.blind.store import stamp, Store, write_json
from checks.blind.truth import make_row
from ros2_ident.effects import CATALOGUE
from ros2_ident.threads import ONE_THREAD

PATIENCE = 900.0  # s, after which a diagnosis is ended
# Share of the progress that each part takes.
PARTS = {'drawing': (0.0, 0.12), 'diagnosing': (0.12, 0.92), 'scoring': (0.92, 1.0)}

Tell = Callable[[float, str], None]
_T = TypeVar('_T')


class Stopped(Exception):
    """The user has had enough; the same command goes on."""


def _quiet() -> None:
    """Leave Ctrl-C to the parent, and the cores to the other processes."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def draw_case(generator: type[Drawer], store: Store, wanted: Wanted, seed: int) -> dict[str, str]:
    """Draw a case, write its bags, return its sealed label."""
    drawer = generator(read_plain(store.machine), seed, wanted)
    label, effects = drawer.draw()
    label = write_case(store.case(wanted.case), store.clean(wanted.case), drawer, label, effects)
    return seal.close(to_mapping(label), seed)


@contextmanager
def _pool(processes: int) -> Iterator[ProcessPoolExecutor]:
    context = multiprocessing.get_context('spawn')
    # Many small products: threads of BLAS would only get into each other's way.
    os.environ.update(dict.fromkeys(ONE_THREAD, '1'))
    before = set(multiprocessing.active_children())
    pool = ProcessPoolExecutor(processes, mp_context=context, initializer=_quiet)
    try:
        yield pool
    except BaseException:
        pool.shutdown(wait=False, cancel_futures=True)
        for child in set(multiprocessing.active_children()) - before:
            child.terminate()  # half a case is worth nothing
        raise
    pool.shutdown()


def _finished(tasks: Iterable[Future[_T]], stopped: Callable[[], bool]) -> Iterator[Future[_T]]:
    """Yield tasks as they finish; raise `Stopped` when asked to, not only when one does."""
    left = set(tasks)
    while left:
        done, left = wait(left, timeout=0.2, return_when=FIRST_COMPLETED)
        yield from done
        if stopped():
            raise Stopped


def scrubbed() -> dict[str, str]:
    """Return the environment of a diagnosing process: paths, one thread for BLAS, nothing else."""
    kept = ('PATH', 'HOME', 'LANG', 'LD_LIBRARY_PATH', 'VIRTUAL_ENV', 'NUMBA_CACHE_DIR', 'TMPDIR')
    out = {name: os.environ[name] for name in kept if name in os.environ}
    here = str(Path(__file__).resolve().parents[2])
    out['PYTHONPATH'] = os.pathsep.join(
        dict.fromkeys([here, *filter(None, os.environ.get('PYTHONPATH', '').split(os.pathsep))])
    )
    return out | dict.fromkeys(ONE_THREAD, '1')


class _Worker:
    """A diagnosing process."""

    def __init__(self, store: Store) -> None:
        self.process = subprocess.Popen(
            [sys.executable, '-m', 'checks.blind.worker', str(store.root.resolve())],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env=scrubbed(),
            text=True,
            start_new_session=True,  # Ctrl-C is the parent's business
        )

    def ask(self, order: dict[str, str]) -> dict[str, Any]:
        assert self.process.stdin is not None and self.process.stdout is not None
        timer = threading.Timer(PATIENCE, self.process.kill)
        timer.start()
        try:
            self.process.stdin.write(json.dumps(order) + '\n')
            self.process.stdin.flush()
            line = self.process.stdout.readline()
        except OSError:
            line = ''
        finally:
            timer.cancel()
        if not line:
            raise ConnectionError(f'the diagnosing process ended ({self.process.wait()})')
        answer: dict[str, Any] = json.loads(line)
        return answer

    def end(self) -> None:
        self.process.kill()
        self.process.wait()


def order_of(store: Store, number: int) -> dict[str, str]:
    """Return the paths that a diagnosis of a case is told."""
    folder = store.case(number).resolve()
    paths = {'fit': FIT, 'check': CHECK, 'machine': MACHINE, 'out': 'diagnosis'}
    return {name: str(folder / path) for name, path in paths.items()}


def ask_all(
    store: Store,
    orders: Mapping[int, dict[str, str]],
    processes: int,
    stopped: Callable[[], bool] = lambda: False,
) -> Iterator[int]:
    """Diagnose cases in processes of their own, and keep how each went.

    Args:
        orders: Paths by the case's number, see `worker.diagnose`.
        stopped: Asked often; True ends the processes and raises `Stopped`.

    Yields:
        The numbers of the cases as they are answered.
    """
    end = threading.Event()
    started: list[_Worker] = []
    idle: queue.SimpleQueue[_Worker | None] = queue.SimpleQueue()
    for _ in range(processes):
        idle.put(None)

    def ask(number: int) -> int:
        worker = idle.get()
        try:
            if worker is None:
                started.append(worker := _Worker(store))
            answer = worker.ask(orders[number])
        except ConnectionError as exc:
            answer, worker = {'error': str(exc)}, None
        idle.put(worker)
        if not end.is_set():
            write_json(store.case(number) / 'run.json', answer)
        return number

    pool = ThreadPoolExecutor(processes)
    try:
        for task in _finished([pool.submit(ask, n) for n in orders], stopped):
            yield task.result()
    finally:
        end.set()
        pool.shutdown(wait=False, cancel_futures=True)
        for worker in started:
            worker.end()
        pool.shutdown()


@dataclass(frozen=True)
class Generator:
    """What a run is of; the functions are called in processes of their own.

    Attributes:
        plan: Returns what each case of a run shall be, by number.
        draw: Writes such a case of a run with a seed, and returns its sealed label.
        orders: Returns what is asked about a case, by the number under which it is answered.
        row: Returns a case's row of the table: run, number, opened label.
        told: Returns what came of a run as lines, from its table.
    """

    plan: Callable[[Store], Mapping[int, Any]]
    draw: Callable[[Store, Any, int], dict[str, str]]
    orders: Callable[[Store, int], Mapping[int, dict[str, str]]]
    row: Callable[[Store, int, dict[str, Any]], dict[str, Any]]
    told: Callable[[Store, Sequence[Mapping[str, Any]]], list[str]]


def numbered(store: Store) -> dict[int, int]:
    """Return the plan of a run whose cases are drawn by their number alone."""
    return {case: case for case in range(1, int(store.about()['cases']) + 1)}


def _plan(drawer: type[Drawer], store: Store) -> Mapping[int, Wanted]:
    about = store.about()
    names = list(drawer.known(machine_of(read_plain(store.machine))))
    inside = [name for name in names if name in CATALOGUE]
    outside = [name for name in names if name not in CATALOGUE]
    cases, seed = int(about['cases']), int(about['seed'])
    wanted = plan(inside, outside, cases, seed, about['shares'])
    return {w.case: w for w in wanted}


def _row(store: Store, number: int, label: dict[str, Any]) -> dict[str, Any]:
    return make_row(label, store.case(number), store.clean(number))


def _told(store: Store, rows: Sequence[Mapping[str, Any]]) -> list[str]:
    found = score(rows)
    page = write_page(store.root / 'blind.md', rows, found, store.about())
    return [*sentences(found), f'written: {page}']


def drawn_by(drawer: type[Drawer]) -> Generator:
    """Return the generator of the cases that a drawer draws."""
    return Generator(
        functools.partial(_plan, drawer),
        functools.partial(draw_case, drawer),
        lambda store, number: {number: order_of(store, number)},
        _row,
        _told,
    )


GENERATOR = drawn_by(Drawer)


class BlindCheck:
    """One run in one directory; every step goes on where it was left."""

    def __init__(
        self,
        root: str | Path,
        processes: int = 2,
        tell: Tell = lambda share, text: None,
        stopped: Callable[[], bool] = lambda: False,
        generator: Generator = GENERATOR,
    ) -> None:
        self.store = Store(root)
        self.generator = generator
        self.processes = processes
        self._tell = tell
        self._stopped = stopped

    def _progress(self, part: str, done: int, count: int) -> None:
        low, high = PARTS[part]
        self._tell(low + (high - low) * done / max(1, count), f'{part} {done} of {count} cases')

    def begin(
        self,
        machine: str | Path,
        cases: int,
        seed: int,
        shares: Mapping[str, float],
        command: str,
        **more: Any,
    ) -> None:
        """Begin a run or go on with it; `more` is what its generator wants to know."""
        what = {'command': command, 'cases': cases, 'seed': seed, 'shares': dict(shares)}
        self.store.begin(what | more, machine)

    def draw(self) -> str:
        """Draw and seal what is not drawn yet; return the hash over all seals."""
        about = self.store.about()
        cases, seed = int(about['cases']), int(about['seed'])
        wanted = self.generator.plan(self.store)
        missing = {n: w for n, w in wanted.items() if self.store.sealed(n) is None}
        with _pool(self.processes) as pool:
            tasks = {
                pool.submit(self.generator.draw, self.store, w, seed): n
                for n, w in missing.items()
            }
            for done, task in enumerate(_finished(tasks, self._stopped)):
                self.store.seal(tasks[task], task.result())
                self._progress('drawing', cases - len(missing) + done + 1, cases)
        if 'manifest' not in about:
            self.store.note(drawn=stamp())
        return self.store.close_seals(cases)

    def diagnose(self, only: Sequence[int] = ()) -> None:
        """Diagnose what is not diagnosed yet, of some cases or all, in processes told paths."""
        cases = int(self.store.about()['cases'])
        asked = [n for n in range(1, cases + 1) if not only or n in only]
        orders: dict[int, dict[str, str]] = {}
        for number in asked:
            orders |= self.generator.orders(self.store, number)
        count = len(orders)
        orders = {n: order for n, order in orders.items() if self.store.answered(n) is None}
        self.store.diagnosed_by(stamp())
        done = count - len(orders)
        self._progress('diagnosing', done, count)
        for _ in ask_all(self.store, orders, self.processes, self._stopped):
            done += 1
            self._progress('diagnosing', done, count)

    def score(self, again: bool = False) -> list[dict[str, Any]]:
        """Open the seals of the diagnosed cases and fill the table, `again` also what is there."""
        about = self.store.about()
        seed = int(about['seed'])
        rows = {} if again else {int(r['case']): r for r in self.store.rows()}
        ready = [
            n
            for n in range(1, int(about['cases']) + 1)
            if n not in rows and self.store.answered(n) is not None
        ]
        with _pool(self.processes) as pool:
            tasks = [
                pool.submit(
                    self.generator.row,
                    self.store,
                    n,
                    seal.unseal(self.store.sealed(n) or {}, seed),
                )
                for n in ready
            ]
            for done, task in enumerate(_finished(tasks, self._stopped)):
                row = task.result()
                rows[int(row['case'])] = row
                self.store.write_rows(list(rows.values()))
                self._progress('scoring', done + 1, len(ready))
        return [rows[n] for n in sorted(rows)]
