# SPDX-License-Identifier: Apache-2.0
"""Evaluate candidates in other processes, some of which may be lost on the way.

A `Carrier` takes batches to workers: an executor of `concurrent.futures` does here, a Dask
scheduler in `cluster`. What both have in common is here: batches are cut to the number of workers,
a lost one is sent again, and one that is lost again and again is evaluated in this process.
"""

from abc import ABC, abstractmethod
from collections import OrderedDict
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import BrokenExecutor, CancelledError, Executor, Future, wait
from contextlib import contextmanager
from dataclasses import dataclass
import hashlib
import math
import pickle
from threading import Lock
from typing import Any

import numpy as np

from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.lanes import WIDTH
from ros2_ident.search.evaluators import (
    Cancel,
    dealt,
    Evaluators,
    Objective,
    Queue,
    RunTasks,
    Stop,
    Subject,
    Threads,
)
from ros2_ident.search.operators import Array, Index

# How long to wait for a task before looking whether its worker is still there, s.
_LOOK = 0.05
# A batch that was lost so often is evaluated in this process.
_ATTEMPTS = 3
# An executor that breaks so often is of no use.
_STARTS = 8
# Objects a worker keeps unpacked; a fleet has one for each bag that is being identified.
_KEPT = 4


# ---------------------------------------------------------------- in the worker

_held: OrderedDict[str, Subject] = OrderedDict()
_lock = Lock()


def hold(digest: str, packed: bytes) -> None:
    """Unpack an object and compile what it needs, the first time this process sees it."""
    with _lock:
        if digest not in _held:
            subject: Subject = pickle.loads(packed)  # noqa: S301 - from who sends the work
            subject.prepare()
            _held[digest] = subject
            while len(_held) > _KEPT:
                _held.popitem(last=False)
        _held.move_to_end(digest)


def call(digest: str, packed: bytes, name: str, arguments: tuple[Any, ...]) -> Any:
    """Return what a method of an object says, on a worker.

    Args:
        digest: Of the packed object.
        packed: The object; empty where `hold` has seen it in this process.
        name: The method.
        arguments: Its arguments.
    """
    hold(digest, packed)
    return getattr(_held[digest], name)(*arguments)


# ---------------------------------------------------------------- in this process


class Carrier(ABC):
    """Takes batches to workers and back.

    Args:
        digest: Of the packed objective.
        packed: The objective.
    """

    def __init__(self, digest: str, packed: bytes) -> None:
        self.digest = digest
        self.packed = packed

    @property
    @abstractmethod
    def slots(self) -> int:
        """Batches that are evaluated at the same time; 0 where no worker is there now."""

    @property
    def hopeless(self) -> bool:
        """Whether to wait for workers no longer."""
        return False

    @abstractmethod
    def send(self, name: str, *arguments: Any) -> 'Future[Any]':
        """Send a call of the object's method; see `call`."""

    @abstractmethod
    def lost(self, error: BaseException) -> bool:
        """Return whether an error means that the worker is gone, not that its work failed."""

    @abstractmethod
    def repair(self) -> None:
        """Make ready to send again what was lost."""

    @abstractmethod
    def close(self) -> None:
        """Let go of the workers."""


@dataclass
class _Piece:
    """One worker's part of a batch."""

    rows: Index
    theta: Array
    future: 'Future[Array] | None'
    attempts: int = 1
    value: Array | None = None


class _Batch:
    """A batch, cut into equal pieces, one for each worker."""

    def __init__(self, carrier: Carrier, theta: Array, limit: float, here: Any) -> None:
        self._carrier = carrier
        self._count = len(theta)
        self._limit = limit
        self._here = here
        self._pieces = [
            _Piece(rows, theta[rows], self._send(theta[rows]))
            for rows in dealt(len(theta), carrier.slots)
        ]

    def _send(self, theta: Array) -> 'Future[Array] | None':
        """Send a piece; None where it has to be evaluated here."""
        for _ in range(_ATTEMPTS):
            if self._carrier.hopeless:
                break
            try:
                return self._carrier.send('costs', theta, self._limit)
            except Exception as error:
                if not self._carrier.lost(error):
                    raise
                self._carrier.repair()
        return None

    def wait(self, seconds: float) -> bool:
        """Return whether all pieces are there, after waiting for one at most so long."""
        for piece in self._pieces:
            if piece.value is None and not self._settle(piece, seconds):
                return False
        return True

    def _settle(self, piece: _Piece, seconds: float) -> bool:
        if piece.future is None or self._carrier.hopeless:
            piece.value = self._here(piece.theta, self._limit)
            return True
        if not wait([piece.future], seconds).done:
            return False
        try:
            piece.value = piece.future.result()
            return True
        except (CancelledError, Exception) as error:
            if not self._carrier.lost(error):
                raise said(error) from error
        self._carrier.repair()
        piece.attempts += 1
        piece.future = None if piece.attempts > _ATTEMPTS else self._send(piece.theta)
        return False

    def result(self) -> Array:
        """Return the result in the order of the candidates."""
        out = np.empty(self._count)
        for piece in self._pieces:
            out[piece.rows] = piece.value
        return out

    def drop(self) -> None:
        """Take back what no worker has begun."""
        for piece in self._pieces:
            if piece.future is not None:
                piece.future.cancel()


def said(error: BaseException) -> BaseException:
    """Return an error of a worker as the user shall see it."""
    if isinstance(error, ImportError):
        return IdentError(
            ErrorCode.INVALID_GOAL,
            f'a worker cannot import what it needs ({error}); install the same version of '
            'ros2_ident on every worker',
        )
    return error


class _Costs(Queue):
    """The costs as a queue to the workers."""

    # A worker that has done its piece shall find the next one with it, not on the way.
    ahead = 3
    # `stop` stays here: who waits looks at the same himself.
    limited = True

    def __init__(self, carrier: Carrier, here: Any) -> None:
        self._carrier = carrier
        self._here = here

    def submit(self, theta: Array, limit: float = math.inf, stop: Stop | None = None) -> _Batch:
        return _Batch(self._carrier, theta, limit, self._here)


@contextmanager
def _carried(
    subject: Subject, make_carrier: Callable[[str, bytes], Carrier]
) -> Iterator[Carrier]:
    """Bring an object to a carrier's workers; `make_carrier` takes its digest and the pickle."""
    packed = pickle.dumps(subject, protocol=pickle.HIGHEST_PROTOCOL)
    carrier = make_carrier(hashlib.sha256(packed).hexdigest(), packed)
    try:
        yield carrier
    finally:
        carrier.close()


@contextmanager
def remote(
    objective: Objective, make_carrier: Callable[[str, bytes], Carrier]
) -> Iterator[Evaluators]:
    """Evaluate an objective with a carrier's workers; the body of `Workers.open`.

    Args:
        objective: What to evaluate; is pickled once.
        make_carrier: Takes the digest and the packed objective.
    """
    with _carried(objective, make_carrier) as carrier, Threads().open(objective) as here:
        # A candidate's residuals are as long as the log: sending them takes longer than
        # simulating them anew.
        yield Evaluators(
            _Costs(carrier, here.costs), here.residuals, WIDTH * max(1, carrier.slots)
        )


class _Call:
    """One task on its way: sent again where its worker was lost, done here in the end."""

    def __init__(self, carrier: Carrier, here: Subject, name: str, arguments: tuple[Any, ...]):
        self._carrier = carrier
        self._here = here
        self._name = name
        self._arguments = arguments
        self._attempts = 0
        self._future = self._send()

    def _send(self) -> 'Future[Any] | None':
        while self._attempts < _ATTEMPTS and not self._carrier.hopeless:
            self._attempts += 1
            try:
                return self._carrier.send(self._name, *self._arguments)
            except Exception as error:
                if not self._carrier.lost(error):
                    raise
                self._carrier.repair()
        return None

    def result(self) -> Any:
        """Wait for the task's result."""
        while self._future is not None and not self._carrier.hopeless:
            if not wait([self._future], _LOOK).done:
                continue
            try:
                return self._future.result()
            except (CancelledError, Exception) as error:
                if not self._carrier.lost(error):
                    raise said(error) from error
            self._carrier.repair()
            self._future = self._send()
        return getattr(self._here, self._name)(*self._arguments)


@contextmanager
def remote_tasks(
    subject: Subject, make_carrier: Callable[[str, bytes], Carrier]
) -> Iterator[RunTasks]:
    """Run a subject's methods with a carrier's workers; the body of `Workers.tasks`.

    Args:
        subject: Whose methods; is pickled once.
        make_carrier: Takes the digest and the packed subject.
    """
    with _carried(subject, make_carrier) as carrier:

        def run(name: str, items: Sequence[tuple[Any, ...]]) -> Iterator[Any]:
            calls = [_Call(carrier, subject, name, arguments) for arguments in items]
            return (one.result() for one in calls)

        yield run


class Executors:
    """The workers of an executor of `concurrent.futures`, or of anything like it.

    Example:
        >>> from concurrent.futures import ProcessPoolExecutor
        >>> workers = Executors(ProcessPoolExecutor, 4)

    Args:
        make: Makes the executor; is called with `max_workers`, `initializer` and `initargs`. The
            initializer brings the data, once for each worker. Called again where the executor
            says that it is broken, as one of processes does after one of them was killed.
        count: Number of workers.
    """

    def __init__(self, make: Callable[..., Executor], count: int) -> None:
        if count < 1:
            raise IdentError(ErrorCode.INVALID_GOAL, f'workers are {count}; give at least 1')
        self._make = make
        self._count = count

    @contextmanager
    def open(self, objective: Objective, cancel: Cancel | None = None) -> Iterator[Evaluators]:
        """Start the workers; see `Workers`."""
        with remote(objective, self._carrier) as evaluators:
            yield evaluators

    @contextmanager
    def tasks(self, subject: Subject) -> Iterator[RunTasks]:
        """Start the workers; see `Workers`."""
        with remote_tasks(subject, self._carrier) as run:
            yield run

    def _carrier(self, digest: str, packed: bytes) -> Carrier:
        return _ExecutorCarrier(digest, packed, self._make, self._count)


class _ExecutorCarrier(Carrier):
    """An executor; one that is broken is replaced by a new one."""

    def __init__(
        self, digest: str, packed: bytes, make: Callable[..., Executor], count: int
    ) -> None:
        super().__init__(digest, packed)
        self._make = make
        self._count = count
        self._starts = 0
        self._start()

    def _start(self) -> None:
        self._starts += 1
        self._executor = self._make(
            max_workers=self._count, initializer=hold, initargs=(self.digest, self.packed)
        )

    @property
    def slots(self) -> int:
        return self._count

    @property
    def hopeless(self) -> bool:
        return self._starts > _STARTS

    def send(self, name: str, *arguments: Any) -> 'Future[Any]':
        return self._executor.submit(call, self.digest, b'', name, arguments)

    def lost(self, error: BaseException) -> bool:
        return isinstance(error, BrokenExecutor)

    def repair(self) -> None:
        # All batches of a broken executor come back at once; the first of them replaces it.
        try:
            self._executor.submit(int)
        except BrokenExecutor:
            self.close()
            self._start()

    def close(self) -> None:
        self._executor.shutdown(wait=False, cancel_futures=True)
