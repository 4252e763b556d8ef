# SPDX-License-Identifier: Apache-2.0
"""The one way in which this folder compiles a function."""

from collections.abc import Callable
import hashlib
from pathlib import Path
from typing import cast, TypeVar

import numba

F = TypeVar('F', bound=Callable[..., object])


def _digest() -> str:
    digest = hashlib.sha256()
    for path in sorted(Path(__file__).parent.glob('*.py')):
        digest.update(path.read_bytes())
    return digest.hexdigest()


SOURCES = _digest()


def compiled(function: F) -> F:
    """Compile a function with numba, without fast-math, releasing the GIL, cached on disk.

    numba renews a function's cache when its own file changes, not when a file it calls into does.
    Here the cache carries a digest of the whole folder instead of the file's time, so it never
    serves a stale callee.

    Args:
        function: A function in the subset of Python that numba compiles.

    Returns:
        The compiled function under the type of the plain one.
    """
    dispatcher = numba.njit(cache=True, nogil=True, error_model='numpy')(function)
    cache_file = getattr(getattr(dispatcher, '_cache', None), '_cache_file', None)
    if cache_file is not None:
        cache_file._source_stamp = SOURCES
    return cast(F, dispatcher)
