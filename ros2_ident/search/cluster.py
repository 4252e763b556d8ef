# SPDX-License-Identifier: Apache-2.0
"""Evaluate candidates on a Dask cluster, some of whose workers may be lost on the way.

Batches are cut to the number of workers. Dask sends again what a lost worker had; what it gives up
is evaluated in this process.
"""

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import CancelledError
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache, partial
import math
import pickle
import time
from typing import Any, ClassVar

import numpy as np

from ros2_ident.arrays import Array
from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.search.evaluators import (
    Cancel,
    dealt,
    Evaluate,
    Objective,
    RunTasks,
    Stop,
    Subject,
    Threads,
)
from ros2_ident.threads import processors

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

    Attributes:
        count: Threads of this process.
    """

    def __init__(self, scheduler: Any) -> None:
        self._scheduler = scheduler
        self.count = processors()

    @contextmanager
    def open(self, objective: Objective, cancel: Cancel | None = None) -> Iterator[Evaluate]:
        """Connect, and bring the data to the workers; see `Workers`.

        Raises:
            IdentError: INVALID_GOAL where there is no Dask, no scheduler, or no worker.
        """
        with self._link(objective, cancel) as link, Threads().open(objective) as here:
            yield _Costs(link, here)

    @contextmanager
    def tasks(self, subject: Subject) -> Iterator[RunTasks]:
        """Connect, and bring the subject to the workers; see `Workers`.

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
    def _link(self, subject: Subject, cancel: Cancel | None) -> Iterator['_Link']:
        """Connect to the scheduler, wait for its workers, and bring an object to them."""
        own = isinstance(self._scheduler, str)
        client = connect(self._scheduler) if own else self._scheduler
        try:
            _await_workers(client, cancel)
            yield _Link(subject, client, cancel)
        finally:
            if own:
                client.close()


def _slots(client: Any) -> int:
    """Return how many tasks the workers of a client's cluster run at the same time."""
    return sum(client.nthreads().values())


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
        self._asked = -math.inf
        self._slots = 0
        self._alone_since = math.inf
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
        now = time.monotonic()
        self._alone_since = math.inf if self.slots else min(self._alone_since, now)
        return now - self._alone_since > PATIENCE

    def send(self, name: str, arguments: tuple[Any, ...], **where: Any) -> Any:
        """Return the future of a call of the object's method; None without a worker."""
        if self.hopeless:
            return None
        try:
            # The only worker that held the data may be the one that was lost.
            if self._data.status != 'finished' and _slots(self._client):
                self._scatter()
            return self._client.submit(_call, self._data, name, arguments, pure=False, **where)
        except Exception as error:
            if not _lost(error):
                raise
            return None

    def result(self, future: Any, here: Callable[[], Any], stop: Stop = bool) -> Any:
        """Return the result of a call, made `here` where Dask gives it up; None once stopped."""
        while future is not None and not self.hopeless:
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


@dataclass(frozen=True)
class _Costs:
    """The costs, each batch cut into equal pieces, one for each worker."""

    link: _Link
    here: Evaluate
    limited: ClassVar[bool] = True

    def __call__(self, theta: Array, limit: float = math.inf, stop: Stop = bool) -> Array:
        """Evaluate (S, N) candidates; `stop` is asked here, the workers do not know it."""
        pieces = dealt(len(theta), self.link.slots)
        sent = [self.link.send('costs', (theta[rows], limit)) for rows in pieces]
        out = np.full(len(theta), np.inf)
        for rows, future in zip(pieces, sent, strict=True):
            told = self.link.result(future, partial(self.here, theta[rows], limit, stop), stop)
            if told is None:
                break
            out[rows] = told
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
