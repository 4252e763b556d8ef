# SPDX-License-Identifier: Apache-2.0
"""How to identify, and how far it has come."""

from dataclasses import dataclass

from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.search.settings import FitProgress as IdentifyProgress
from ros2_ident.search.settings import FitSettings
from ros2_ident.search.settings import OnProgress as OnProgress

__all__ = ['IdentifyProgress', 'IdentifySettings', 'OnProgress']


@dataclass(frozen=True)
class IdentifySettings(FitSettings):
    """How to identify a machine: how to fit, and how to simulate.

    Attributes:
        cutoff: Low-pass of recorded motion where it drives the model [Hz].
        threads: Threads that simulate; one for each processor by default. The result does not
            depend on it.
    """

    cutoff: float = 100.0
    threads: int | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.threads is not None and not (isinstance(self.threads, int) and self.threads >= 1):
            raise IdentError(
                ErrorCode.INVALID_GOAL,
                f'threads is {self.threads!r}; give a whole number of at least 1',
            )
