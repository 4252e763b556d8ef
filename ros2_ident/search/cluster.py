# SPDX-License-Identifier: Apache-2.0
"""Evaluate candidates on a Dask cluster, some of whose workers may be lost on the way.

Batches are cut to the number of workers. Dask sends again what a lost worker had; what it gives up
is evaluated in this process.
"""

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import CancelledError, Future, wait
from contextlib import contextmanager
from functools import lru_cache
import math
import pickle
import time
from typing import Any

import numpy as np

from ros2_ident.arrays import Array
from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.search.evaluators import (
    Cancel,
    dealt,
    Evaluate,
    Evaluators,
    Objective,
    RunTasks,
    Stop,
    Subject,
    Threads,
)

# So long to reach a scheduler, and to wait for a worker where there is none, s.
PATIENCE = 30.0
# So long the number of workers is believed, s.
_FRESH = 1.0
# How long to wait before looking again, s.
_LOOK = 0.05


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
        raise IdentError(
            ErrorCode.INVALID_GOAL,
            'Dask is not installed; install it with `pip install "ros2-ident[dask]"`',
        ) from None
    try:
        return Client(  # type: ignore[no-untyped-call]
            scheduler, timeout=PATIENCE / 3.0, set_as_default=False, name='ros2_ident'
        )
    except (OSError, TimeoutError, ValueError) as error:
        said = ' '.join(str(error).split()) or type(error).__name__
        raise IdentError(
            ErrorCode.INVALID_GOAL,
            f'{scheduler}: no Dask scheduler answers ({said}); start one with `dask scheduler` '
            'and give the address that it prints',
        ) from None


class Cluster:
    """The workers of a Dask cluster.

    Data go to every worker once; a worker that joins later gets them from another one.

    Args:
        scheduler: Address of the scheduler, as `tcp://host:8786`; or a `distributed.Client`, which
            stays open.
    """

    def __init__(self, scheduler: Any) -> None:
        self._scheduler = scheduler

    @contextmanager
    def open(self, objective: Objective, cancel: Cancel | None = None) -> Iterator[Evaluators]:
        """Connect, and bring the data to the workers; see `Workers`.

        Raises:
            IdentError: INVALID_GOAL where there is no Dask, no scheduler, or no worker.
        """
        with self._link(objective, cancel) as link, Threads().open(objective) as here:
            # A candidate's residuals are as long as the log: sending them takes longer than
            # simulating them anew.
            yield Evaluators(_Costs(link, here.costs), here.residuals)

    @contextmanager
    def tasks(self, subject: Subject) -> Iterator[RunTasks]:
        """Connect, and bring the subject to the workers; see `Workers`.

        Raises:
            IdentError: As `open`.
        """
        with self._link(subject, None) as link:

            def run(name: str, items: Sequence[tuple[Any, ...]]) -> Iterator[Any]:
                here = getattr(subject, name)
                calls = [_Away(link, here, name, item) for item in items]
                return (one.result() for one in calls)

            yield run

    @contextmanager
    def _link(self, subject: Subject, cancel: Cancel | None) -> Iterator['_Link']:
        """Connect to the scheduler, wait for its workers, and bring an object to them."""
        own = isinstance(self._scheduler, str)
        client = connect(self._scheduler) if own else self._scheduler
        try:
            _await_workers(client, cancel)
            link = _Link(subject, client, cancel)
            try:
                yield link
            finally:
                link.close()
        finally:
            if own:
                client.close()


def _slots(client: Any) -> int:
    """Return how many tasks the workers of a client's cluster run at the same time."""
    return sum(int(worker['nthreads']) for worker in _workers(client).values())


def _workers(client: Any) -> dict[str, Any]:
    found: dict[str, Any] = client.scheduler_info(n_workers=-1).get('workers', {})
    return found


def _await_workers(client: Any, cancel: Cancel | None) -> None:
    end = time.monotonic() + PATIENCE
    while not _slots(client):
        if time.monotonic() > end or (cancel is not None and cancel.is_set()):
            raise IdentError(
                ErrorCode.INVALID_GOAL,
                f'{client.scheduler.address}: the scheduler has no worker; start some with '
                '`dask worker ADDRESS`',
            )
        time.sleep(_LOOK)


class _Link:
    """A Dask scheduler, whose workers have an object."""

    def __init__(self, subject: Subject, client: Any, cancel: Cancel | None) -> None:
        self._packed = pickle.dumps(subject, protocol=pickle.HIGHEST_PROTOCOL)
        self._client = client
        self._executor = client.get_executor(pure=False)
        self._asked = -math.inf
        self._slots = 0
        self._alone_since = math.inf
        self._scatter()
        # Every worker compiles before a clock runs.
        ready = [
            self._executor.submit(_call, self._data, 'prepare', (), workers=[x])
            for x in _workers(client)
        ]
        while wait(ready, _LOOK).not_done and not (cancel is not None and cancel.is_set()):
            pass
        for future in ready:
            if future.done() and not future.cancelled():
                error = future.exception()
                if error is not None and not _lost(error):
                    raise _said(error) from error

    def _scatter(self) -> None:
        """Bring the data to every worker."""
        self._data = self._client.scatter(
            self._packed, broadcast=True, hash=False, timeout=PATIENCE
        )

    @property
    def slots(self) -> int:
        """Batches that are evaluated at the same time; 0 where no worker is there now."""
        # Each question is a message to the scheduler.
        if time.monotonic() - self._asked > _FRESH and self._client.status == 'running':
            self._slots = _slots(self._client)
            self._asked = time.monotonic()
        return self._slots

    @property
    def hopeless(self) -> bool:
        """Whether to wait for workers no longer."""
        if self._client.status != 'running':
            return True
        if self.slots:
            self._alone_since = math.inf
        elif self._alone_since == math.inf:
            self._alone_since = time.monotonic()
        return time.monotonic() - self._alone_since > PATIENCE

    def send(self, name: str, arguments: tuple[Any, ...]) -> 'Future[Any] | None':
        """Send a call of the object's method; None where no worker can be reached."""
        if self.hopeless:
            return None
        try:
            # The only worker that held the data may be the one that was lost.
            if self._data.status != 'finished' and _slots(self._client):
                self._scatter()
            found: Future[Any] = self._executor.submit(_call, self._data, name, arguments)
            return found
        except Exception as error:
            if not _lost(error):
                raise
            return None

    def close(self) -> None:
        """Let go of the workers."""
        # What is still on its way belongs to a run that has ended.
        if self._client.status == 'running':
            self._executor.shutdown(wait=False)


class _Away:
    """A call on its way; done here where Dask gives it up."""

    def __init__(
        self, link: _Link, here: Callable[..., Any], name: str, arguments: tuple[Any, ...]
    ) -> None:
        self._link, self._here, self._arguments = link, here, arguments
        self._there, self._value = False, None
        self._future = link.send(name, arguments)

    def wait(self, seconds: float) -> bool:
        """Return whether the result is there, after waiting at most so long."""
        if not self._there and self._future is not None and wait([self._future], seconds).done:
            try:
                self._there, self._value = True, self._future.result()
            except (CancelledError, Exception) as error:
                self._there, self._future = False, None
                if not _lost(error):
                    raise _said(error) from error
        if not self._there and (self._future is None or self._link.hopeless):
            self._there, self._value = True, self._here(*self._arguments)
        return self._there

    def result(self) -> Any:
        """Wait for the result."""
        while not self.wait(_LOOK):
            pass
        return self._value

    def drop(self) -> None:
        """Take it back where no worker has begun."""
        if self._future is not None:
            self._future.cancel()


class _Costs:
    """The costs, each batch cut into equal pieces, one for each worker."""

    limited = True

    def __init__(self, link: _Link, here: Evaluate) -> None:
        self._link = link
        self._here = here

    def __call__(self, theta: Array, limit: float = math.inf, stop: Stop = bool) -> Array:
        """Evaluate (S, N) candidates; `stop` is asked here, the workers do not know it."""
        pieces = [
            (rows, _Away(self._link, self._here, 'costs', (theta[rows], limit)))
            for rows in dealt(len(theta), self._link.slots)
        ]
        out = np.full(len(theta), np.inf)
        for rows, piece in pieces:
            while not piece.wait(_LOOK):
                if stop():
                    for _, left in pieces:
                        left.drop()
                    return out
            out[rows] = piece.result()
        return out


def _lost(error: BaseException) -> bool:
    """Return whether an error means that the worker is gone, not that its work failed."""
    from distributed import KilledWorker
    from distributed.comm.core import CommClosedError

    return isinstance(error, KilledWorker | CancelledError | CommClosedError | TimeoutError)


def _said(error: BaseException) -> BaseException:
    """Return an error of a worker as the user shall see it."""
    if isinstance(error, ImportError):
        return IdentError(
            ErrorCode.INVALID_GOAL,
            f'a worker cannot import what it needs ({error}); install the same version of '
            'ros2_ident on every worker',
        )
    return error
