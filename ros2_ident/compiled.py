# SPDX-License-Identifier: Apache-2.0
"""Functions compiled by numba whose cache on disk is never stale.

numba renews a function's cache when its own file changes, not when a file it calls into does. Here
the cache carries a digest of all sources that a function is made of instead of its file's time.
"""

from collections.abc import Callable
from contextlib import suppress
import hashlib
from pathlib import Path
from typing import Any, cast, TypeVar

import numba

F = TypeVar('F', bound=Callable[..., object])


def digest_of(*paths: Path) -> str:
    """Return one digest of some sources: files, or all of a folder."""
    digest = hashlib.sha256()
    for path in paths:
        for file in sorted(path.glob('*.py')) if path.is_dir() else [path]:
            digest.update(file.read_bytes())
    return digest.hexdigest()


def compiled(function: F, sources: str, **options: Any) -> F:
    """Compile a function, releasing the GIL, cached on disk.

    Args:
        function: A function in the subset of Python that numba compiles.
        sources: Digest of all sources it is made of.
        options: More of numba's.

    Returns:
        The compiled function under the type of the plain one.
    """
    dispatcher = numba.njit(cache=True, nogil=True, **options)(function)
    cache_file = getattr(getattr(dispatcher, '_cache', None), '_cache_file', None)
    if cache_file is not None:
        cache_file._source_stamp = sources
        save = cache_file.save

        def kept(*what: Any) -> None:
            with suppress(OSError):  # where the disk is full, the next run compiles again
                save(*what)

        cache_file.save = kept
    return cast(F, dispatcher)
