# SPDX-License-Identifier: Apache-2.0
"""Where candidates are evaluated: the seam, and threads of this process behind it.

`Workers` is what a caller chooses. A cluster is in `cluster`.
"""

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager, contextmanager
import math
from typing import Any, Protocol

import numpy as np

from ros2_ident.arrays import Array
from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.lanes import WIDTH
from ros2_ident.search.operators import Index
from ros2_ident.threads import processors

# (S, N) -> (S, ...); where it has an attribute `limited`, with all arguments of `Objective.costs`.
Evaluate = Callable[..., Array]
Stop = Callable[[], bool]


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


class Workers(Protocol):
    """Who evaluates: threads, a cluster.

    Attributes:
        count: Threads of this process, for what is evaluated here: residuals are as long as the
            log, and to send them takes longer than to simulate them.
    """

    count: int

    def tasks(self, subject: Subject) -> AbstractContextManager[RunTasks]:
        """Make ready to run a subject's methods side by side, until the context is left.

        Raises:
            IdentError: The workers cannot be had; with the remedy.
        """
        ...

    def open(
        self, objective: Objective, cancel: Cancel | None = None
    ) -> AbstractContextManager[Evaluate]:
        """Make ready for the costs of an objective, until the context is left; `limited`.

        Args:
            objective: What to evaluate.
            cancel: Ends waiting for workers; what is still asked for then is evaluated here.

        Raises:
            IdentError: The workers cannot be had; with the remedy.
        """
        ...


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
            raise IdentError(ErrorCode.BAD_VALUES, f'threads is {threads}; give at least 1')
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
    """

    def __init__(self, count: int | None = None) -> None:
        self.count = count or processors()

    @contextmanager
    def tasks(self, subject: Subject) -> Iterator[RunTasks]:
        """Start the threads; see `Workers`."""
        with ThreadPoolExecutor(self.count, 'task') as pool:

            def run(name: str, items: Sequence[tuple[Any, ...]]) -> Iterator[Any]:
                method = getattr(subject, name)
                return pool.map(lambda arguments: method(*arguments), items)

            yield run

    def open(
        self, objective: Objective, cancel: Cancel | None = None
    ) -> AbstractContextManager[Evaluate]:
        """Start the threads; see `Workers`."""
        return ThreadedEvaluator(objective.costs, self.count, limited=True)
