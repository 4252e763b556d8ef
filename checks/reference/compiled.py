# SPDX-License-Identifier: Apache-2.0
"""The one way in which this folder compiles a function."""

from collections.abc import Callable
from pathlib import Path
from typing import Any, cast, TypeVar

from ros2_ident.compiled import compiled as cached
from ros2_ident.compiled import digest_of

F = TypeVar('F', bound=Callable[..., object])


HERE = Path(__file__).parent
SOURCES = digest_of(HERE)


def compiled(function: F, sources: str = SOURCES) -> F:
    """Compile a function with numba, without fast-math, releasing the GIL, cached on disk.

    Args:
        sources: Digest of all sources it is made of, where that is not this folder alone.
    """
    return cached(function, sources, error_model='numpy')


def settled(function: Callable[..., object], signature: Any) -> None:
    """Compile a function for one signature now, and for no other later.

    A function that is handed to compiled ones as a value needs that.
    """
    dispatcher = cast(Any, function)
    if not dispatcher.signatures:
        dispatcher.compile(signature)
        dispatcher.disable_compile()
