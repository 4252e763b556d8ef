# SPDX-License-Identifier: Apache-2.0
"""Between messages and the library's values."""

from array import array
import math
from typing import Any

from builtin_interfaces.msg import Time
import numpy as np
import numpy.typing as npt
from ros2_ident_msgs.msg import IdentificationResult, ParameterEstimate, Progress

from ros2_ident.errors import IdentError
from ros2_ident.identify.result import Identification, Outcome
from ros2_ident.identify.settings import IdentifyProgress
from ros2_ident.jobs import Identified
from ros2_ident.models import Machine
from ros2_ident.recording import cdr, Stream
from ros2_ident.ros.run import Finished

_OUTCOMES = {
    Outcome.IDENTIFIED: IdentificationResult.OUTCOME_CONVERGED,
    Outcome.NOT_IDENTIFIABLE: IdentificationResult.OUTCOME_NOT_IDENTIFIABLE,
    Outcome.BUDGET_SPENT: IdentificationResult.OUTCOME_BUDGET_SPENT,
    Outcome.CANCELLED: IdentificationResult.OUTCOME_CANCELLED,
    Outcome.DIVERGED: IdentificationResult.OUTCOME_NONE,
    Outcome.CONTRADICTED: IdentificationResult.OUTCOME_CONTRADICTED,
}
KINDS = {
    'physical': ParameterEstimate.KIND_PHYSICAL,
    'base': ParameterEstimate.KIND_PHYSICAL,
    'measurement': ParameterEstimate.KIND_MEASUREMENT,
}


def doubles(values: npt.ArrayLike) -> 'array[float]':
    """Return numbers as rclpy takes them without looking at each."""
    return array('d', np.ascontiguousarray(values, dtype=np.float64).tobytes())


def joint_states(stream: Stream) -> list[bytes]:
    """Return a stream as serialised JointState messages."""
    fields = [stream.position, stream.velocity, stream.effort]
    return cdr.encode(stream.stamp, stream.names, fields)


# ---------------------------------------------------------------------- progress and result


def unit_of(machine: Machine, name: str) -> str:
    """Return the unit of a parameter by its full name."""
    declared = machine.bounds.get(name) or machine.bounds.get(name.rpartition('.')[2])
    return declared[2] if declared else ''


def progress_message(progress: IdentifyProgress, machine: Machine, stamp: Time) -> Progress:
    """Return a progress as a message."""
    message = Progress()
    message.header.stamp = stamp
    refining = progress.phase != 'search'
    message.phase = Progress.PHASE_REFINEMENT if refining else Progress.PHASE_GENETIC_ALGORITHM
    message.generation = progress.generation
    message.generations = progress.generations
    message.evaluations = progress.evaluations
    message.evaluation_budget = progress.budget
    message.best_cost = progress.best_cost
    message.cost_unit = progress.unit
    message.parameter_names = list(progress.names)
    message.parameter_units = [unit_of(machine, name) for name in progress.names]
    message.best_theta = doubles(progress.best_theta)
    message.spread = doubles(np.full(len(progress.names), progress.spread))
    message.elapsed = progress.elapsed
    message.eta = progress.eta
    return message


def result_message(
    finished: Finished[Identified] | None,
    error: IdentError | None,
    stamp: Time,
    result_file: str = '',
) -> IdentificationResult:
    """Return a run's end as a message: its result, or what kept it from having one."""
    message = IdentificationResult()
    message.header.stamp = stamp
    message.cost_genetic = message.cost_refined = message.missing_fraction = math.nan
    message.result_file = result_file
    if finished is not None:
        _fill(message, finished)
    if error is not None:
        message.error_code = int(error.code)
        message.error_message = error.message
        message.outcome = message.outcome or IdentificationResult.OUTCOME_NONE
        message.outcome_sentence = message.outcome_sentence or error.message
    return message


def _fill(message: IdentificationResult, finished: Finished[Identified]) -> None:
    found = finished.done.result
    # undetermined parameters are no error as long as there is one that is determined
    if found.outcome != Outcome.NOT_IDENTIFIABLE or not any(
        p.identifiable for p in found.parameters
    ):
        message.error_code = int(found.outcome.error_code)
        message.error_message = found.message if message.error_code else ''
    message.outcome = _outcome(found)
    message.outcome_sentence = found.message
    message.warnings = list(found.quality.warnings)
    message.model = found.model
    message.drives = list(found.drives)
    message.parameters = [_estimate(p) for p in found.parameters]
    message.correlation = doubles(found.correlation)
    message.cost_genetic = found.cost.ga
    message.cost_refined = found.cost.refined
    message.cost_unit = found.cost.unit
    message.residual_rms = doubles([x.rms for x in found.residuals])
    message.residual_share = doubles([x.share for x in found.residuals])
    message.evaluations = found.evaluations
    message.seconds = finished.done.seconds
    message.seed = found.seed
    message.missing_fraction = max(found.quality.missing.values(), default=math.nan)
    message.bag_path = ' + '.join(finished.done.request.bags)
    message.bag_sha256 = finished.done.logs.sha256
    message.configuration = finished.wanted.configuration
    message.configuration_sha256 = finished.configuration_sha256
    message.package_version = found.provenance.package_version


def _outcome(found: Identification) -> int:
    """Return the outcome; an estimate at its bound is told apart from one that is determined."""
    outcome = _OUTCOMES[found.outcome]
    if outcome == IdentificationResult.OUTCOME_CONVERGED and any(
        p.at_bound for p in found.parameters
    ):
        return int(IdentificationResult.OUTCOME_AT_BOUND)
    return int(outcome)


def _estimate(found: Any) -> ParameterEstimate:
    return ParameterEstimate(
        name=found.name,
        unit=found.unit,
        value=found.value,
        low=found.low,
        high=found.high,
        noise_low=found.noise_low,
        noise_high=found.noise_high,
        lower_bound=found.lower_bound,
        upper_bound=found.upper_bound,
        genetic_value=found.ga_value,
        # A flag of NumPy's would end the process: rosidl asserts Python's.
        at_bound=bool(found.at_bound),
        identifiable=bool(found.identifiable),
        kind=KINDS[found.kind],
        note=found.note,
    )


def progress_sentence(message: Progress) -> str:
    """Return a progress message in words."""
    phase = 'refinement' if message.phase == Progress.PHASE_REFINEMENT else 'genetic algorithm'
    return (
        f'{phase}, {message.generation} of {message.generations}, best cost '
        f'{message.best_cost:.4g} {message.cost_unit}'
    )
