# SPDX-License-Identifier: Apache-2.0
"""The one way in which this folder compiles a function."""

from collections.abc import Callable
import hashlib
from pathlib import Path
from typing import Any, cast, TypeVar

import numba

F = TypeVar('F', bound=Callable[..., object])


def digest_of(*folders: Path) -> str:
    """Return one digest of all sources in some folders."""
    digest = hashlib.sha256()
    for folder in folders:
        for path in sorted(folder.glob('*.py')):
            digest.update(path.read_bytes())
    return digest.hexdigest()


HERE = Path(__file__).parent
SOURCES = digest_of(HERE)


def compiled(function: F, sources: str = SOURCES) -> F:
    """Compile a function with numba, without fast-math, releasing the GIL, cached on disk.

    numba renews a function's cache when its own file changes, not when a file it calls into does.
    Here the cache carries a digest of the whole folder instead of the file's time, so it never
    serves a stale callee.

    Args:
        function: A function in the subset of Python that numba compiles.
        sources: Digest of all sources it is made of, where that is not this folder alone.

    Returns:
        The compiled function under the type of the plain one.
    """
    dispatcher = numba.njit(cache=True, nogil=True, error_model='numpy')(function)
    cache_file = getattr(getattr(dispatcher, '_cache', None), '_cache_file', None)
    if cache_file is not None:
        cache_file._source_stamp = sources
    return cast(F, dispatcher)


def settled(function: Callable[..., object], signature: Any) -> None:
    """Compile a function for one signature now, and for no other later.

    A function that is handed to compiled ones as a value needs that.

    Args:
        function: From `compiled`.
        signature: numba's signature.
    """
    dispatcher = cast(Any, function)
    if not dispatcher.signatures:
        dispatcher.compile(signature)
        dispatcher.disable_compile()
