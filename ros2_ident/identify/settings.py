# SPDX-License-Identifier: Apache-2.0
"""How to identify, and how far it has come."""

from dataclasses import dataclass
from typing import Literal

from ros2_ident.errors import ErrorCode
from ros2_ident.search.driver import OnProgress as OnProgress
from ros2_ident.search.driver import Progress as IdentifyProgress
from ros2_ident.search.fit import FitSettings

__all__ = ['IdentifyProgress', 'IdentifySettings', 'OnProgress']

METHODS = 'genetic', 'algebraic'


@dataclass(frozen=True)
class IdentifySettings(FitSettings):
    """How to identify a machine: how to fit, and how to simulate.

    Attributes:
        cutoff: Low-pass of recorded motion where it drives the model [Hz].
        threads: Threads that simulate, one a processor by default; no result depends on it.
        method: `genetic` searches; `algebraic` solves by weighted least squares what is linear in
            the parameters along the recorded motion, whether or not a set-point is logged.
        decimation: Samples of which `algebraic` keeps one.
    """

    cutoff: float = 100.0
    threads: int | None = None
    method: Literal['genetic', 'algebraic'] = 'genetic'
    decimation: int = 10
    counts = *FitSettings.counts, 'threads', 'decimation'

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.method not in METHODS:
            raise ErrorCode.INVALID_GOAL.error(
                f'method is {self.method!r}; choose from {", ".join(METHODS)}'
            )
