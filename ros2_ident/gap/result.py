# SPDX-License-Identifier: Apache-2.0
"""The diagnosis as a value."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
import math
from typing import Literal

import numpy as np
import numpy.typing as npt

from ros2_ident.arrays import Array
from ros2_ident.effects import EffectParameter
from ros2_ident.gap.bootstrap import Interval
from ros2_ident.gap.coordinates import Motion
from ros2_ident.gap.noise_floor import Floor
from ros2_ident.gap.where.localise import Finding
from ros2_ident.gates import Gate
from ros2_ident.gates.asked import Event
from ros2_ident.models import EffectAt
from ros2_ident.prediction import Prediction

# A value as near to an end of its range as this share of it lies on that end: coarser than fits
# end. By hand.
AT_BOUND = 1e-3


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


# Names of other values of the parameters, and of noise in the recorded motion, among the
# coordinates in `Tie.like`.
PARAMETERS, NOISE = 'parameters', 'noise of the motion'


@dataclass(frozen=True)
class Tie:
    """An effect that a motion cannot tell from other causes.

    Attributes:
        effect: Id.
        where: Place.
        closed: Share of the explainable gap that its step would close.
        like: Coordinates of which functions close as much, `PARAMETERS` where it does not count
            beside their other values, and `NOISE` where that does as much.
        beside: Number of the step's other effects.
    """

    effect: str
    where: str
    closed: float
    like: tuple[str, ...]
    beside: int = 0


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
        ties: Effects that would close more, were they not what the parameters do.
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
    ties: tuple[Tie, ...] = ()

    @property
    def leads(self) -> int | None:
        """Index of the check that a sentence begins with; None for none."""
        first = self.contradictions and not (self.misfit or self.events)
        return self.contradictions[0] if first and self.cause != Cause.CONSTANT else None


@dataclass(frozen=True)
class Value:
    """A fitted parameter.

    Attributes:
        value: Estimate.
        low: Lower end of the 95 % interval, within its search; NaN where not known.
        high: Upper end.
        at_bound: Whether it is the size of an effect and ended at a bound of its search, or a
            parameter of the machine file without whose bound the gap would close by a share.
        noise_low: Lower end of the interval if the model lacked nothing: noise alone.
        noise_high: Upper end likewise.
        lower_bound: Lower end of its search, NaN where it was not searched.
        upper_bound: Upper end likewise.
        kind: As of a `models.Parameter`.
    """

    value: float
    unit: str
    low: float
    high: float
    at_bound: bool = False
    noise_low: float = math.nan
    noise_high: float = math.nan
    lower_bound: float = math.nan
    upper_bound: float = math.nan
    kind: str = 'physical'

    @property
    def end(self) -> Literal['', 'lower', 'upper']:
        """The bound of its search at which it ended; empty for none."""
        edge = AT_BOUND * (self.upper_bound - self.lower_bound)
        if self.value <= self.lower_bound + edge:
            return 'lower'
        return 'upper' if self.value >= self.upper_bound - edge else ''


def at_bound(parameter: EffectParameter, value: float) -> bool:
    """Whether an effect's size ended at a bound of its search, other than at its neutral value.

    Args:
        parameter: The parameter with its numbers at a place, from `FullModel.scaled`.
        value: What was fitted, in its unit.
    """
    edge = AT_BOUND * (parameter.high - parameter.low)
    outside = value <= parameter.low + edge or value >= parameter.high - edge
    return parameter.role == 'size' and outside and abs(value - parameter.neutral) > edge


@dataclass(frozen=True)
class Ranked:
    """One effect at one place as an explanation.

    Attributes:
        at: The effect and its place.
        probability: That it is the cause.
        gap_after: Gap on held-out data with it in the model [output unit].
        share: Share of the explainable gap of the nominal fit that it closes, on all data.
        parameters: The effect's own parameters.
    """

    at: EffectAt
    probability: float
    gap_after: float
    share: float
    parameters: Mapping[str, Value]


@dataclass(frozen=True)
class Step:
    """One bar of the waterfall.

    Attributes:
        label: What came in.
        gap: RMS on held-out data with its interval [output unit].
    """

    label: str
    gap: Interval


@dataclass(frozen=True)
class DriveGap:
    """A drive's gap on held-out data [output unit].

    Attributes:
        before: With the nominal fit, RMS.
        after: With the effects found.
        noise_floor: The drive's.
        share_closed: Share of the explainable gap that closed.
        torque_rms: RMS of the measured output.
        share_of_output: The gap before over the measured output, RMS, on all data.
        counted: Whether the drive shows a gap, and counts in the share of all.
        share_of_change: As `share_of_output`, of how the output varies about its mean.
    """

    before: float
    after: float
    noise_floor: float
    share_closed: float
    torque_rms: float
    share_of_output: float
    counted: bool = True
    share_of_change: float = 0.0

    @property
    def over_floor(self) -> float:
        """The gap before over the noise floor; 0 where it is not known."""
        ratio = self.before / self.noise_floor if self.noise_floor else 0.0
        return ratio if math.isfinite(ratio) else 0.0

    @property
    def shares(self) -> tuple[float, float]:
        """The gap before and after over the measured output; NaN where that is not known."""
        output = self.torque_rms or math.nan
        return self.before / output, self.after / output


@dataclass(frozen=True, eq=False)
class Trace:
    """One recording beside its simulations.

    Attributes:
        held_out: Whether all of it was held out from fitting.
        motion: What the drives did; its output is the nominal fit's.
        measured: (D, K) measured output, NaN at cycles without a sample.
        extended: (D, K) simulated output with the effects found; the nominal fit's where there
            are none.
        fitted: (D, K) whether a sample was fitted to.
    """

    held_out: bool
    motion: Motion
    measured: Array
    extended: Array
    fitted: npt.NDArray[np.bool_]

    @property
    def before(self) -> Array:
        """(D, K) measured less simulated output of the nominal fit, NaN where not fitted to."""
        return np.where(self.fitted, self.measured - self.motion.output, np.nan)

    @property
    def after(self) -> Array:
        """(D, K) the same with the effects found."""
        return np.where(self.fitted, self.measured - self.extended, np.nan)


@dataclass(frozen=True)
class Diagnosis:
    """Result: place of the gap, its cause, the share that closes.

    Attributes:
        effect: Id of the effect, `none` or `unknown`.
        where: Its place.
        probability: Of the verdict.
        also: Further effects, in order.
        confusable: What the data cannot tell from the verdict.
        ranking: Every candidate that was fitted, most probable first.
        unit: Unit of the gap.
        steps: The waterfall: the nominal fit, then each effect, on held-out data.
        floor: The noise floor.
        share_closed: Share of the explainable gap closed on held-out data, with its interval.
        held_out: `check bag` or `blocks`.
        evidence: The numbers the verdict rests on: size of the gap and what remains of it, RMS of
            the worst drive in units of the floor, the share closed, the size from which a gap is
            material, and the gap of all drives over their measured output.
        per_drive: Each drive's gap.
        localisation: Findings, the strongest first.
        parameters: Parameters of the extended model.
        nominal: Values of the nominal fit.
        moved: How far each nominal parameter moved when the effects came in, as a share of its
            value.
        gates: What was checked before any physics, the worst first.
        not_testable: Effects this motion cannot show.
        complete: False where the run was cut short.
        seconds: Time taken [s].
        seed: Of the search.
        traces: The recordings, those fitted to first.
        facts: Facts behind the verdict.
        prediction: How far free runs come from the recordings judged on, effect by effect.
        correlation: Correlations of the first N `parameters`, by noise; NaN where unknown.
    """

    effect: str
    where: tuple[str, ...]
    probability: float
    also: tuple[EffectAt, ...]
    confusable: tuple[Ranked, ...]
    ranking: tuple[Ranked, ...]
    unit: str
    steps: tuple[Step, ...]
    floor: Floor
    share_closed: Interval
    held_out: str
    evidence: Mapping[str, float]
    per_drive: Mapping[str, DriveGap]
    localisation: tuple[Finding, ...]
    parameters: Mapping[str, Value]
    nominal: Mapping[str, float]
    moved: Mapping[str, float]
    gates: tuple[Gate, ...]
    not_testable: tuple[EffectAt, ...]
    complete: bool
    seconds: float
    seed: int
    traces: tuple[Trace, ...]
    facts: Facts = Facts()
    prediction: Prediction | None = None
    correlation: tuple[tuple[float, ...], ...] = ()
