# SPDX-License-Identifier: Apache-2.0
"""Evaluate candidates on a Dask cluster."""

from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError, Future, wait
from contextlib import contextmanager, suppress
import math
import time
from typing import Any

from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.search.evaluators import Cancel, Evaluators, Objective, RunTasks, Subject
from ros2_ident.search.remote import call, Carrier, hold, remote, remote_tasks, said

# So long to reach a scheduler, and to wait for a worker where there is none, s.
PATIENCE = 30.0
# So long the number of workers is believed, s.
_FRESH = 1.0
# How long to wait before looking again, s.
_LOOK = 0.05


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
            'Dask is not installed; install it with `pip install ros2_ident[cluster]`',
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

    Data go to every worker once; a worker that joins later gets them from another one. The
    scheduler sends again what a lost worker had; what is lost for good is evaluated in this
    process.

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
        with self._carrier(cancel) as carrier, remote(objective, carrier) as evaluators:
            yield evaluators

    @contextmanager
    def tasks(self, subject: Subject) -> Iterator[RunTasks]:
        """Connect, and bring the subject to the workers; see `Workers`.

        Raises:
            IdentError: As `open`.
        """
        with self._carrier(None) as carrier, remote_tasks(subject, carrier) as run:
            yield run

    @contextmanager
    def _carrier(self, cancel: Cancel | None) -> Iterator[Callable[[str, bytes], Carrier]]:
        """Connect to the scheduler, wait for its workers, and give what makes a carrier."""
        own = isinstance(self._scheduler, str)
        client = connect(self._scheduler) if own else self._scheduler
        try:
            _await_workers(client, cancel)
            yield lambda digest, packed: _DaskCarrier(digest, packed, client, cancel)
        finally:
            if own:
                client.close()


def slots(client: Any) -> int:
    """Return how many tasks the workers of a client's cluster run at the same time."""
    return sum(int(worker['nthreads']) for worker in _workers(client).values())


def _workers(client: Any) -> dict[str, Any]:
    found: dict[str, Any] = client.scheduler_info(n_workers=-1).get('workers', {})
    return found


def _await_workers(client: Any, cancel: Cancel | None) -> None:
    end = time.monotonic() + PATIENCE
    while not slots(client):
        if time.monotonic() > end or (cancel is not None and cancel.is_set()):
            raise IdentError(
                ErrorCode.INVALID_GOAL,
                f'{client.scheduler.address}: the scheduler has no worker; start some with '
                '`dask worker ADDRESS`',
            )
        time.sleep(_LOOK)


class _DaskCarrier(Carrier):
    """A Dask scheduler; it sends again by itself what a lost worker had."""

    def __init__(self, digest: str, packed: bytes, client: Any, cancel: Cancel | None) -> None:
        super().__init__(digest, packed)
        self._client = client
        self._executor = client.get_executor(pure=False)
        self._asked = -math.inf
        self._slots = 0
        self._alone_since = math.inf
        self._scatter()
        self._prepare(cancel)

    def _scatter(self) -> None:
        """Bring the data to every worker."""
        self._data = self._client.scatter(
            self.packed, broadcast=True, hash=False, timeout=PATIENCE
        )

    def _prepare(self, cancel: Cancel | None) -> None:
        """Let every worker compile, before a clock runs."""
        ready = [
            self._executor.submit(hold, self.digest, self._data, workers=[address])
            for address in _workers(self._client)
        ]
        while wait(ready, _LOOK).not_done and not (cancel is not None and cancel.is_set()):
            pass
        for future in ready:
            if future.done() and not future.cancelled():
                error = future.exception()
                if error is not None and not self.lost(error):
                    raise said(error) from error

    @property
    def slots(self) -> int:
        # Each question is a message to the scheduler.
        if time.monotonic() - self._asked > _FRESH and self._client.status == 'running':
            self._slots = slots(self._client)
            self._asked = time.monotonic()
        return self._slots

    @property
    def hopeless(self) -> bool:
        if self._client.status != 'running':
            return True
        if self.slots:
            self._alone_since = math.inf
        elif self._alone_since == math.inf:
            self._alone_since = time.monotonic()
        return time.monotonic() - self._alone_since > PATIENCE

    def send(self, name: str, *arguments: Any) -> 'Future[Any]':
        future: Future[Any] = self._executor.submit(
            call, self.digest, self._data, name, arguments
        )
        return future

    def lost(self, error: BaseException) -> bool:
        from distributed import KilledWorker
        from distributed.comm.core import CommClosedError

        return isinstance(error, KilledWorker | CancelledError | CommClosedError | TimeoutError)

    def repair(self) -> None:
        # The only worker that held the data may be the one that was lost.
        if self._data.status != 'finished' and slots(self._client):
            # No worker after all: what cannot be sent is evaluated in this process.
            with suppress(TimeoutError):
                self._scatter()

    def close(self) -> None:
        # What is still on its way belongs to a run that has ended.
        if self._client.status == 'running':
            self._executor.shutdown(wait=False)
