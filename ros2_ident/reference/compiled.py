# SPDX-License-Identifier: Apache-2.0
"""The one way in which this folder compiles a function."""

from collections.abc import Callable
from typing import TypeVar, cast

import numba

F = TypeVar('F', bound=Callable[..., object])


def compiled(function: F) -> F:
    """Compile a function with numba, without fast-math, releasing the GIL, cached on disk.

    The cache of a function is renewed when its own file changes, not when a file it calls into does: after
    an edit of a called module remove `__pycache__`.

    Args:
        function: A function in the subset of Python that numba compiles.

    Returns:
        The compiled function under the type of the plain one.
    """
    return cast(F, numba.njit(cache=True, nogil=True, error_model='numpy')(function))
