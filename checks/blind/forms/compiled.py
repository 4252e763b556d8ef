# SPDX-License-Identifier: Apache-2.0
"""Compiles as the reference does; the cache goes by the sources of both folders."""

from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

from checks.reference import compiled as reference
from ros2_ident.compiled import digest_of

F = TypeVar('F', bound=Callable[..., object])
SOURCES = digest_of(reference.HERE, Path(__file__).parent)


def compiled(function: F) -> F:
    """Compile a function that may call the reference's."""
    return reference.compiled(function, SOURCES)
