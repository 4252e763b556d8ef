# SPDX-License-Identifier: Apache-2.0
"""Where candidates are evaluated: threads of this process, or a Dask cluster.

Some workers of a cluster may be lost on the way. Batches are cut to their number; Dask sends again
what a lost worker had; what it gives up is evaluated in this process.
"""

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import CancelledError, ThreadPoolExecutor
from contextlib import AbstractContextManager, contextmanager
from functools import lru_cache, partial
import math
import pickle
import time
from typing import Any, Protocol

import numpy as np

from ros2_ident.arrays import Array
from ros2_ident.errors import ErrorCode
from ros2_ident.lanes import WIDTH
from ros2_ident.search.operators import Index
from ros2_ident.threads import processors

# (S, N) -> (S, ...); where it has an attribute `limited`, with all arguments of `Objective.costs`.
Evaluate = Callable[..., Array]
Stop = Callable[[], bool]
# So long to reach a scheduler, and to wait for its first worker, s.
PATIENCE = 30.0
# How long to wait before looking again, s.
_LOOK = 0.05


class Cancel(Protocol):
    """Interface of a `threading.Event`."""

    def is_set(self) -> bool:
        """Return whether the search shall end."""
        ...


class Subject(Protocol):
    """Object whose methods are the tasks; other processes get it as a pickle."""

    def prepare(self) -> None:
        """Do what takes time only once, as to compile."""
        ...


class Objective(Subject, Protocol):
    """Function to evaluate, by several threads at once."""

    def costs(self, theta: Array, limit: float = math.inf, stop: Stop | None = None) -> Array:
        """Return (S,) costs of (S, N) candidates, inf for a diverged one.

        Above `limit`, what is returned may be any lower bound of the cost that is above it too.
        `stop` is asked now and then; True where the result is not needed any more.
        """
        ...

    def residuals(self, theta: Array) -> Array:
        """Return (S, R) residuals of (S, N) candidates, inf in the row of a diverged one."""
        ...


# Method of the subject, arguments of each task -> results in their order, as they come.
RunTasks = Callable[[str, Sequence[tuple[Any, ...]]], Iterator[Any]]


def dealt(count: int, parts: int) -> list[Index]:
    """Return which of `count` candidates each part gets; fewer parts where vectors are few.

    Whole vectors, dealt in turn: neighbours are alike in work, so that all get as much.
    """
    vectors = -(-count // WIDTH)
    parts = max(1, min(parts, vectors))
    owner = np.arange(count) // WIDTH % parts
    return [np.flatnonzero(owner == part) for part in range(parts)]


class ThreadedEvaluator(AbstractContextManager['ThreadedEvaluator']):
    """Cuts candidates into equal parts, one for each thread.

    Every candidate is evaluated by itself and put back in its place, so the result does not depend
    on the number of threads. Works for costs (S,) and for residuals (S, R) alike.

    Example:
        >>> with ThreadedEvaluator(lambda x: x.sum(axis=1), threads=2) as evaluate:
        ...     evaluate(np.eye(3)).tolist()
        [1.0, 1.0, 1.0]

    Args:
        evaluate: (S, N) -> (S, ...); releases the GIL and may be called from several threads at
            once.
        threads: Number of threads; 1 calls `evaluate` directly.
        limited: Whether `evaluate` takes the arguments of `Objective.costs`.
    """

    def __init__(
        self, evaluate: Callable[..., Array], threads: int = 2, *, limited: bool = False
    ) -> None:
        if threads < 1:
            raise ErrorCode.BAD_VALUES.error(f'threads is {threads}; give at least 1')
        self._evaluate = evaluate
        self._threads = threads
        self.limited = limited
        self._pool = ThreadPoolExecutor(threads - 1, 'evaluate') if threads > 1 else None

    def __call__(self, theta: Array, limit: float = math.inf, stop: Stop | None = None) -> Array:
        """Evaluate (S, N) candidates, in their order."""
        more = (limit, stop) if self.limited else ()
        if self._pool is None or len(theta) <= WIDTH:
            return self._evaluate(theta, *more)
        mine = dealt(len(theta), self._threads)
        pending = [self._pool.submit(self._evaluate, theta[m], *more) for m in mine[1:]]
        values = [self._evaluate(theta[mine[0]], *more), *(p.result() for p in pending)]
        out = np.empty((len(theta), *values[0].shape[1:]))
        for where, value in zip(mine, values, strict=True):
            out[where] = value
        return out

    def __exit__(self, *raised: object) -> None:
        """End the threads."""
        if self._pool is not None:
            self._pool.shutdown()


class Threads:
    """Threads of this process.

    Args:
        count: How many; one for each processor where None.

    Attributes:
        count: How many.
    """

    def __init__(self, count: int | None = None) -> None:
        self.count = count or processors()

    @contextmanager
    def tasks(self, subject: Subject) -> Iterator[RunTasks]:
        """Make ready to run a subject's methods side by side, until the context is left."""
        with ThreadPoolExecutor(self.count, 'task') as pool:

            def run(name: str, items: Sequence[tuple[Any, ...]]) -> Iterator[Any]:
                method = getattr(subject, name)
                return pool.map(lambda arguments: method(*arguments), items)

            yield run

    def open(
        self, objective: Objective, cancel: Cancel | None = None
    ) -> AbstractContextManager[Evaluate]:
        """Make ready for the costs of an objective, until the context is left; `limited`.

        Args:
            objective: What to evaluate.
            cancel: Ends waiting for workers; what is still asked for then is evaluated here.
        """
        return ThreadedEvaluator(objective.costs, self.count, limited=True)


# ---------------------------------------------------------------------- a cluster


@lru_cache(maxsize=4)  # a fleet has an object for each bag that is being identified
def _ready(packed: bytes) -> Subject:
    """Unpack an object on a worker and compile what it needs, once."""
    subject: Subject = pickle.loads(packed)  # noqa: S301 - from who sends the work
    subject.prepare()
    return subject


def _call(packed: bytes, name: str, arguments: tuple[Any, ...]) -> Any:
    """Return what a method of an object gives, on a worker."""
    return getattr(_ready(packed), name)(*arguments)


def connect(scheduler: Any) -> Any:
    """Return a client of a Dask scheduler.

    Args:
        scheduler: Its address, as `tcp://host:8786`.

    Raises:
        IdentError: INVALID_GOAL where Dask is not installed or no scheduler answers.
    """
    try:
        from distributed import Client
    except ImportError:
        raise ErrorCode.INVALID_GOAL.error(
            'Dask is not installed; install it with `pip install "ros2-ident[dask]"`'
        ) from None
    try:
        return Client(  # type: ignore[no-untyped-call]
            scheduler, timeout=PATIENCE / 3.0, set_as_default=False, name='ros2_ident'
        )
    except (OSError, TimeoutError, ValueError) as error:
        said = ' '.join(str(error).split()) or type(error).__name__
        raise ErrorCode.INVALID_GOAL.error(
            f'{scheduler}: no Dask scheduler answers ({said}); start one with `dask scheduler` '
            'and give the address that it prints'
        ) from None


class Cluster:
    """The workers of a Dask cluster.

    Data go to every worker once; a worker that joins later gets them from another one.

    Args:
        scheduler: Address of the scheduler, as `tcp://host:8786`; or a `distributed.Client`, which
            stays open.

    Attributes:
        count: Threads of this process, for what is evaluated here: residuals are as long as the
            log, and to send them takes longer than to simulate them.
    """

    def __init__(self, scheduler: Any) -> None:
        self._scheduler = scheduler
        self.count = processors()

    @contextmanager
    def open(self, objective: Objective, cancel: Cancel | None = None) -> Iterator[Evaluate]:
        """Connect, and bring the data to the workers; see `Threads`.

        Raises:
            IdentError: INVALID_GOAL where there is no Dask, no scheduler, or no worker.
        """
        with Threads().open(objective) as here, self._link(objective, cancel, here) as link:
            yield link

    @contextmanager
    def tasks(self, subject: Subject) -> Iterator[RunTasks]:
        """Connect, and bring the subject to the workers; see `Threads`.

        Raises:
            IdentError: As `open`.
        """
        with self._link(subject, None) as link:

            def run(name: str, items: Sequence[tuple[Any, ...]]) -> Iterator[Any]:
                here = getattr(subject, name)
                sent = [(link.send(name, item), partial(here, *item)) for item in items]
                return (link.result(*one) for one in sent)

            yield run

    @contextmanager
    def _link(
        self, subject: Subject, cancel: Cancel | None, here: Evaluate | None = None
    ) -> Iterator['_Link']:
        """Connect to the scheduler, wait for its workers, and bring an object to them."""
        own = isinstance(self._scheduler, str)
        client = connect(self._scheduler) if own else self._scheduler
        try:
            yield _Link(subject, client, cancel, here)
        finally:
            if own:
                client.close()


# Who evaluates.
Workers = Threads | Cluster


class _Link:
    """A Dask scheduler, whose workers have an object; of an objective also its costs.

    Each batch is cut into equal pieces, one for each worker.
    """

    limited = True

    def __init__(
        self, subject: Subject, client: Any, cancel: Cancel | None, here: Evaluate | None
    ) -> None:
        self._packed = pickle.dumps(subject, protocol=pickle.HIGHEST_PROTOCOL)
        self._client, self._here = client, here
        end = time.monotonic() + PATIENCE
        while not self.slots:
            if time.monotonic() > end or (cancel is not None and cancel.is_set()):
                raise ErrorCode.INVALID_GOAL.error(
                    f'{client.scheduler.address}: the scheduler has no worker; start some with '
                    '`dask worker ADDRESS`'
                )
            time.sleep(_LOOK)
        self._scatter()
        # Every worker compiles before a clock runs.
        ready = [self.send('prepare', (), workers=[name]) for name in client.nthreads()]
        for future in ready:
            self.result(future, bool, cancel.is_set if cancel else bool)

    def _scatter(self) -> None:
        """Bring the data to every worker."""
        self._data = self._client.scatter(
            self._packed, broadcast=True, hash=False, timeout=PATIENCE
        )

    @property
    def slots(self) -> int:
        """Batches that are evaluated at the same time; 0 where no worker is there now."""
        running = self._client.status == 'running'
        return sum(self._client.nthreads().values()) if running else 0

    def __call__(self, theta: Array, limit: float = math.inf, stop: Stop = bool) -> Array:
        """Evaluate (S, N) candidates; `stop` is asked here, the workers do not know it."""
        assert self._here is not None
        pieces = dealt(len(theta), self.slots)
        sent = [self.send('costs', (theta[rows], limit)) for rows in pieces]
        out = np.full(len(theta), np.inf)
        for rows, future in zip(pieces, sent, strict=True):
            told = self.result(future, partial(self._here, theta[rows], limit, stop), stop)
            if told is None:
                break
            out[rows] = told
        return out

    def send(self, name: str, arguments: tuple[Any, ...], **where: Any) -> Any:
        """Return the future of a call of the object's method; None without a worker."""
        try:
            if not self.slots:
                return None
            # The only worker that held the data may be the one that was lost.
            if self._data.status != 'finished':
                self._scatter()
            return self._client.submit(_call, self._data, name, arguments, pure=False, **where)
        except Exception as error:
            if not _lost(error):
                raise
            return None

    def result(self, future: Any, here: Callable[[], Any], stop: Stop = bool) -> Any:
        """Return the result of a call, made `here` where Dask gives it up; None once stopped."""
        while future is not None and self.slots:
            try:
                future.exception(timeout=_LOOK)
                return future.result()
            except Exception as error:
                if future.done():
                    if not _lost(error):
                        raise _said(error) from error
                    break
                if stop():
                    return None
        return here()


def _lost(error: BaseException) -> bool:
    """Return whether an error means that the worker is gone, not that its work failed."""
    from distributed import KilledWorker
    from distributed.comm.core import CommClosedError

    return isinstance(error, KilledWorker | CancelledError | CommClosedError | TimeoutError)


def _said(error: BaseException) -> BaseException:
    """Return an error of a worker as the user shall see it."""
    if isinstance(error, ImportError):
        return ErrorCode.INVALID_GOAL.error(
            f'a worker cannot import what it needs ({error}); install the same version of '
            'ros2_ident on every worker'
        )
    return error
