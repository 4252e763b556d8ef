# SPDX-License-Identifier: Apache-2.0
"""Evaluate candidates on several threads, for kernels that release the GIL."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from types import TracebackType

import numpy as np

from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.search.operators import Array


class ThreadedEvaluator:
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
        least: Fewest candidates worth a thread of their own.
    """

    def __init__(
        self, evaluate: Callable[[Array], Array], threads: int = 2, least: int = 8
    ) -> None:
        if threads < 1:
            raise IdentError(ErrorCode.BAD_VALUES, f'threads is {threads}; give at least 1')
        self._evaluate = evaluate
        self._threads = threads
        self._least = least
        self._pool = ThreadPoolExecutor(threads - 1, 'evaluate') if threads > 1 else None

    def __call__(self, theta: Array) -> Array:
        """Evaluate (S, N) candidates, in their order."""
        parts = min(self._threads, -(-len(theta) // self._least))
        if self._pool is None or parts < 2:
            return self._evaluate(theta)
        pieces = np.array_split(theta, parts)
        pending = [self._pool.submit(self._evaluate, piece) for piece in pieces[1:]]
        first = self._evaluate(pieces[0])
        return np.concatenate([first, *(p.result() for p in pending)])

    def close(self) -> None:
        """End the threads."""
        if self._pool is not None:
            self._pool.shutdown()

    def __enter__(self) -> 'ThreadedEvaluator':
        """Return itself."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        value: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """End the threads."""
        self.close()
