# SPDX-License-Identifier: Apache-2.0
"""Result of an identification: values only, immutable, for files, messages and pages."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
import enum
import math
from statistics import NormalDist
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from ros2_ident.arrays import Above, Array
from ros2_ident.errors import ErrorCode
from ros2_ident.gates import Gate
from ros2_ident.machine.machine import Kind
from ros2_ident.prediction import Prediction

State = Literal['identified', 'bounded', 'not determined']


class Outcome(enum.Enum):
    """How an identification ended; the value is its name in files."""

    IDENTIFIED = 'identified'
    NOT_IDENTIFIABLE = 'not identifiable'
    BUDGET_SPENT = 'budget spent'
    CANCELLED = 'cancelled'
    DIVERGED = 'diverged'
    CONTRADICTED = 'contradicted'

    @property
    def error_code(self) -> ErrorCode:
        """The error a caller may report: OK where the estimate can be used."""
        return ErrorCode.__members__.get(self.name, ErrorCode.OK)


@dataclass(frozen=True)
class ParameterEstimate:
    """One identified parameter; numbers in `unit`, NaN where unknown.

    Attributes:
        name: `tool_mass`, or `drive_1.gear_stiffness` where each drive has its own.
        unit: SI unit; `1` for a ratio.
        value: The estimate.
        low: Lower end of its 95 % interval, not clipped to the box; -inf where the data set no
            limit. It allows for what the model may lack: what effects of the catalogue can hide
            in the residual.
        high: Upper end likewise.
        lower_bound: Lower end of the box that was searched.
        upper_bound: Upper end of it.
        ga_value: What the genetic algorithm found, before the refinement.
        at_bound: Whether the estimate lies on a bound of the box.
        state: What is known of it; see `outcome`.
        kind: `physical`, `base` or `measurement`.
        note: The same in words, empty where there is nothing to say.
        noise_low: Lower end if the model lacked nothing: noise alone.
        noise_high: Upper end likewise.
        hidden: Whether it would be identified if the model lacked nothing.
    """

    name: str
    unit: str
    value: float
    low: float
    high: float
    lower_bound: float
    upper_bound: float
    ga_value: float
    at_bound: bool
    state: State
    kind: Kind
    note: str
    noise_low: float = float('nan')
    noise_high: float = float('nan')
    hidden: bool = False

    @property
    def identifiable(self) -> bool:
        """Whether it is identified."""
        return self.state == 'identified'

    @property
    def impossible(self) -> bool:
        """Whether an inertia or a mass, which have no sign, is below 0."""
        return self.high < 0.0 and self.name.rpartition('.')[2] in ('drive_inertia', 'link_mass')

    @property
    def bound(self) -> str:
        """The interval's ends inside the box, in words; empty where there are none."""
        return bound_of(self.low, self.high, self.lower_bound, self.upper_bound, self.unit)


def bound_of(low: float, high: float, lower: float, upper: float, unit: str) -> str:
    """Return the ends of an interval inside its box as text ("at least 0.3")."""
    least, most = (f'{float(f"{end:.3g}"):.6g}' for end in (low, high))
    after = '' if unit == '1' else f' {unit}'
    if low > lower and high < upper:
        return f'between {least} and {most}{after}'
    return (
        f'at least {least}{after}'
        if low > lower
        else (f'at most {most}{after}' if high < upper else '')
    )


def half_of_difference(a: Mapping[str, Any], b: Mapping[str, Any]) -> float:
    """Return half the 95 % interval of two values' difference; inf where it is not known.

    Of an interval that is longer to one side the side towards the other value counts.

    Args:
        a: `value`, and `low` and `high` of its 95 % interval, None where not known.
    """
    less, more = sorted((a, b), key=lambda v: float(v['value']))
    if less['high'] is None or more['low'] is None:
        return math.inf
    return math.hypot(less['high'] - less['value'], more['value'] - more['low'])


def smallest_shown(
    pairs: Iterable[tuple[str, Mapping[str, Any], Mapping[str, Any]]],
) -> dict[str, dict[str, Any]]:
    """Return for each parameter the minimum detectable difference, of several pairs the largest.

    At a level of 5 %; one of this size is missed as seldom.

    Args:
        pairs: Parameter, a value, and the one it is compared with.
    """
    normal, out = NormalDist(), dict[str, dict[str, Any]]()
    factor = 1.0 + normal.inv_cdf(0.95) / normal.inv_cdf(0.975)
    for name, a, b in pairs:
        change = factor * half_of_difference(a, b)
        if out.get(name, {'change': 0.0})['change'] < change < math.inf:
            share = change / abs(b['value']) if b['value'] else None
            out[name] = {'change': change, 'share': share, 'unit': a['unit']}
    return out


@dataclass(frozen=True)
class Cost:
    """Eq. 2 of Ludwig and Gerstmayr (2011): the RMS error averaged over the drives.

    Attributes:
        ga: At the genetic algorithm's best; inf where every candidate diverged.
        refined: At the refined parameters; NaN where nothing was refined.
    """

    ga: Above
    refined: float
    unit: str


@dataclass(frozen=True)
class DriveResidual:
    """Residual of one drive's effort at the estimate.

    Attributes:
        rms: RMS of measured less simulated effort, in the cost's unit.
        share: The same over the RMS of the measured effort; times 100 it is the relative error of
            the EMPS benchmark.
        samples: Measured samples compared.
        unit: Unit of `rms`; the cost's where empty.
    """

    drive: str
    rms: float
    share: float
    samples: int
    unit: str = ''


@dataclass(frozen=True, eq=False)
class History:
    """How the genetic algorithm went.

    Attributes:
        best_costs: (G,) best cost after each complete generation.
        candidates: (E, N) every candidate evaluated, in order, physical units.
        costs: (E,) its cost; inf where it diverged, or was given up as too dear to survive.
        generations: (E,) its generation, from 1.
    """

    best_costs: Array
    candidates: Array
    costs: Array
    generations: npt.NDArray[np.int64]


@dataclass(frozen=True)
class Quality:
    """Quality of the data.

    Attributes:
        segments: Uninterrupted stretches used.
        duration: Their total length, s.
        missing: Share of the samples that should have come and did not, for each stream.
        warnings: What a user has to know, one sentence each.
    """

    segments: int
    duration: float
    samples: int
    missing: Mapping[str, float]
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True)
class Provenance:
    """Provenance of the numbers.

    Attributes:
        source: Path of the bag, or the name of the live buffer.
        sha256: Hash of the bag's files, empty for live data.
        machine_sha256: Hash of the machine file, empty where the machine was made in memory.
        platform: Operating system, processor, Python, numpy and numba: what bits may depend on.
        created: Wall clock at the end of the run, ISO 8601, UTC.
    """

    source: str
    sha256: str
    machine_sha256: str
    package_version: str
    platform: str
    created: str


@dataclass(frozen=True)
class PoorFit:
    """An output that the model does not fit.

    Attributes:
        name: The output: a drive, or `drive.position`.
        left: RMS of the residual [`unit`].
        share: The same over the standard deviation of the measured output.
        floors: The same over the noise.
    """

    name: str
    left: float
    unit: str
    share: float
    floors: float


@dataclass(frozen=True, eq=False)
class Identification:
    """The result of one identification.

    Attributes:
        drives: Drives whose effort was compared.
        parameters: The estimates, in the order of `theta`.
        fixed: Parameters that were held, by name.
        correlation: (N, N) correlations of the estimates; NaN where unknown.
        evaluations: Candidates simulated, both phases.
        generations: Generations of the genetic algorithm that were completed.
        seconds: Wall time, s.
        search_stop: Why the genetic algorithm ended, as a sentence.
        refinement: How the refinement ended, as a sentence; empty where there was none.
        validation: Held-out error: what is left of data that was not fitted on, for each drive.
        validated_on: Which data that is: a bag, or how parts of the log were left out.
        gates: What log and machine file say of each other before any fit, the worst first.
        prediction: How far free runs come from the data judged on; None where none was made.
        rival: (N,) another minimum of the cost that fits almost as well; empty for none.
        poor: Outputs that the model does not fit.
    """

    outcome: Outcome
    model: str
    drives: tuple[str, ...]
    parameters: tuple[ParameterEstimate, ...]
    fixed: Mapping[str, float]
    correlation: Array
    cost: Cost
    residuals: tuple[DriveResidual, ...]
    evaluations: int
    generations: int
    seconds: float
    seed: int
    search_stop: str
    refinement: str
    history: History
    quality: Quality
    provenance: Provenance
    settings: Mapping[str, object] = field(default_factory=dict)
    validation: tuple[DriveResidual, ...] = ()
    validated_on: str = ''
    gates: tuple[Gate, ...] = ()
    prediction: Prediction | None = None
    rival: tuple[float, ...] = ()
    poor: tuple[PoorFit, ...] = ()

    @property
    def complete(self) -> bool:
        """Whether no cancel and no budget cut it short."""
        return self.outcome not in (Outcome.CANCELLED, Outcome.BUDGET_SPENT)

    @property
    def theta(self) -> Array:
        """(N,) the estimate, physical units; NaN where every candidate diverged."""
        return np.array([p.value for p in self.parameters])

    @property
    def best_cost(self) -> float:
        """Cost of the estimate, `cost.unit`."""
        return self.cost.ga if np.isnan(self.cost.refined) else self.cost.refined
