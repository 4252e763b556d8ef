# SPDX-License-Identifier: Apache-2.0
"""Functions compiled by numba whose cache on disk is never stale, and digests of sources.

numba renews a function's cache when its own file changes, not when a file it calls into does. Here
the cache carries a digest of all sources that a function is made of instead of its file's time.
"""

from collections.abc import Callable
from contextlib import suppress
import functools
import hashlib
from importlib.metadata import version
import os
from pathlib import Path
import stat
import tempfile
from typing import Any, cast, TypeVar

import numba

F = TypeVar('F', bound=Callable[..., object])
# Where other versions may give other numbers.
LIBRARIES = ('llvmlite', 'numba', 'numpy', 'rosbags', 'scipy')
# Rooms that show or write a result, and have no part in it.
NO_PART = ('cli', 'commissioning.py', 'files.py', 'report', 'ros', 'simulate')


def digest_of(*paths: Path) -> str:
    """Return one digest of some sources: files, or all of a folder."""
    digest = hashlib.sha256()
    for path in paths:
        for file in sorted(path.glob('*.py')) if path.is_dir() else [path]:
            digest.update(file.read_bytes())
    return digest.hexdigest()


def package_digest(package: Path) -> str:
    """Return the digest for a copy of this package.

    Args:
        package: Its folder.
    """
    files = [
        path
        for path in sorted((*package.rglob('*.py'), *package.rglob('*.yaml')))
        if path.relative_to(package).parts[0] not in NO_PART
    ]
    versions = ' '.join(f'{name} {version(name)}' for name in LIBRARIES)
    return hashlib.sha256(f'{versions} {digest_of(*files)}'.encode()).hexdigest()[:16]


@functools.cache
def result_digest() -> str:
    """Return the digest for what this process runs."""
    return package_digest(Path(__file__).parent)


def compiled(function: F, sources: str, **options: Any) -> F:
    """Compile a function, releasing the GIL, cached on disk.

    Args:
        function: A function in the subset of Python that numba compiles.
        sources: Digest of all sources it is made of.
        options: More of numba's.

    Returns:
        The compiled function under the type of the plain one.
    """
    dispatcher: Any = cached(function, **options)
    cache_file = getattr(getattr(dispatcher, '_cache', None), '_cache_file', None)
    if cache_file is not None:
        cache_file._source_stamp = sources
    return cast(F, dispatcher)


def cached(function: F, **options: Any) -> F:
    """Compile a function of one file, releasing the GIL, cached on disk where there is room."""
    try:
        dispatcher = numba.njit(cache=True, nogil=True, **options)(function)
    except RuntimeError:  # neither beside the sources nor in the user's home is room
        folder = _own_folder()
        setattr(numba.config, 'CACHE_DIR', folder)  # noqa: B010 # made when it is loaded
        dispatcher = numba.njit(cache=bool(folder), nogil=True, **options)(function)
    cache = getattr(dispatcher, '_cache', None)
    save = getattr(cache, 'save_overload', None)
    if cache is not None and save is not None:

        def kept(*what: Any) -> None:
            with suppress(OSError):  # where the disk is full, the next run compiles again
                save(*what)

        cache.save_overload = kept
    return cast(F, dispatcher)


def _own_folder() -> str:
    """Return a folder that is this user's alone, since what lies there is run; '' for none."""
    with suppress(OSError):
        path = Path(tempfile.gettempdir(), f'ros2_ident-{os.getuid()}')
        path.mkdir(mode=0o700, exist_ok=True)
        found = path.lstat()
        if stat.S_ISDIR(found.st_mode) and found.st_uid == os.getuid():
            return '' if stat.S_IMODE(found.st_mode) & 0o077 else str(path)
    return ''
