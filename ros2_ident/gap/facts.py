# SPDX-License-Identifier: Apache-2.0
"""Facts behind a verdict: values from which `words` makes sentences."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
import math

from ros2_ident.gates.asked import Event


class Cause(StrEnum):
    """Kind of a verdict."""

    NONE = 'none'
    EFFECT = 'effect'
    EVENTS = 'events'
    SLOW = 'slow'
    UNKNOWN = 'unknown'
    CUT_SHORT = 'cut short'
    LOG = 'log'
    CONSTANT = 'constant'
    MODEL = 'model'


@dataclass(frozen=True)
class WrongConstant:
    """A number of the machine file that the log contradicts.

    Attributes:
        key: Its key; `log_gain` for the unit of the logged effort.
        stated: Value in the file; NaN where drives have one each.
        value: Estimate, a factor of the stated ones where these differ.
        low: Lower end of the 95 % interval; NaN where not known.
        high: Upper end.
        unit: Unit of all of them.
        closed: Share of the explainable gap that it closes; NaN where not known.
    """

    key: str
    stated: float
    value: float
    low: float = math.nan
    high: float = math.nan
    unit: str = '1'
    closed: float = math.nan


@dataclass(frozen=True)
class Misfit:
    """Residual of a model that no effect makes fit, on the worst drive.

    Attributes:
        drive: The drive.
        quantity: Quantity compared.
        rms: RMS of the residual [output unit].
        share: The same over the standard deviation of the measured output.
        over_floor: The same over the noise floor.
        extended: Whether effects are in the model.
    """

    drive: str
    quantity: str
    rms: float
    share: float
    over_floor: float
    extended: bool


@dataclass(frozen=True)
class Facts:
    """Facts behind a verdict.

    Attributes:
        cause: Kind of the verdict.
        worst: Drive with the largest gap.
        effort_unit: Unit of the effort.
        travel: Unit of the drives' positions, and how many of them are a metre.
        events: Effort that was not commanded.
        slow: Drives with a residual too large and too slow for noise, and its RMS.
        hidden: Drives with slow noise, and the gap that it can hide, RMS [output unit].
        steps: Drives with a coarse encoder: its step, and the unit of that.
        limits: Drives with a limited effort: the limit [unit of the effort].
        constants: Numbers of the machine file that explain the gap.
        misfit: Residual of a model that is another machine's.
        contradictions: Indices of the checks in which log and machine file contradict each other.
        tried: Candidates that were fitted.
        best: Share of the explainable gap that the best one closes.
    """

    cause: Cause = Cause.NONE
    worst: str = ''
    effort_unit: str = ''
    travel: tuple[str, float] = ('m', 1.0)
    events: tuple[Event, ...] = ()
    slow: Mapping[str, float] = field(default_factory=dict)
    hidden: Mapping[str, float] = field(default_factory=dict)
    steps: Mapping[str, tuple[float, str]] = field(default_factory=dict)
    limits: Mapping[str, float] = field(default_factory=dict)
    constants: tuple[WrongConstant, ...] = ()
    misfit: Misfit | None = None
    contradictions: tuple[int, ...] = ()
    tried: int = 0
    best: float = 0.0

    @property
    def leads(self) -> int | None:
        """Index of the check that a sentence begins with; None for none."""
        first = self.contradictions and not (self.misfit or self.events)
        return self.contradictions[0] if first and self.cause != Cause.CONSTANT else None
