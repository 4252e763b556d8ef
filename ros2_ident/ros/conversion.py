# SPDX-License-Identifier: Apache-2.0
"""From the library's values to messages."""

from array import array
from collections.abc import Mapping, Sequence
import hashlib
import math
from typing import Any

from builtin_interfaces.msg import Time
import numpy as np
import numpy.typing as npt
from ros2_ident_msgs.action import Diagnose, Diff, Identify
from ros2_ident_msgs.msg import (
    Change,
    Comparison,
    Gap,
    GapCandidate,
    IdentificationResult,
    ParameterEstimate,
    Progress,
)

from ros2_ident import package_version
from ros2_ident.change.result import Change as Changed
from ros2_ident.change.result import Suspect, Visible
from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.gap.bootstrap import Interval
from ros2_ident.gap.diagnose import DiagnoseProgress
from ros2_ident.gap.result import Diagnosis, Ranked, Step, Value
from ros2_ident.identify.outcome import NOT_IDENTIFIABLE, state_of
from ros2_ident.identify.result import bound_of, Identification, Outcome
from ros2_ident.identify.settings import IdentifyProgress
from ros2_ident.jobs import Compared, Diagnosed, Identified
from ros2_ident.models import EffectAt, Machine
from ros2_ident.ros import run
from ros2_ident.words.change import changed, differing, limits, title_of
from ros2_ident.words.finding import where
from ros2_ident.words.identification import message as outcome_sentence
from ros2_ident.words.verdict import advice, sentence

_OUTCOMES = {
    Outcome.IDENTIFIED: IdentificationResult.OUTCOME_CONVERGED,
    Outcome.NOT_IDENTIFIABLE: IdentificationResult.OUTCOME_NOT_IDENTIFIABLE,
    Outcome.BUDGET_SPENT: IdentificationResult.OUTCOME_BUDGET_SPENT,
    Outcome.CANCELLED: IdentificationResult.OUTCOME_CANCELLED,
    Outcome.DIVERGED: IdentificationResult.OUTCOME_NONE,
    Outcome.CONTRADICTED: IdentificationResult.OUTCOME_CONTRADICTED,
}
_KINDS = {
    'physical': ParameterEstimate.KIND_PHYSICAL,
    'base': ParameterEstimate.KIND_PHYSICAL,
    'measurement': ParameterEstimate.KIND_MEASUREMENT,
}
# Fields of a message without a result; 0 would be an answer.
_COSTS = 'cost_genetic', 'cost_refined', 'missing_fraction'
_GAPS = ('probability', 'before', 'before_low', 'before_high', 'after', 'after_low', 'after_high',
         'noise_floor', 'share_closed')  # fmt: skip


def _filled(kind: Any, source: Any, /, **own: Any) -> Any:
    """Return a message: its own fields, and those that a value has by the same name."""
    names = [x for x in kind.get_fields_and_field_types() if x not in own and hasattr(source, x)]
    fields = {name: getattr(source, name) for name in names} | own
    return kind(**{k: list(v) if isinstance(v, tuple) else v for k, v in fields.items()})


def _doubles(values: npt.ArrayLike) -> 'array[float]':
    """Return numbers as rclpy takes them without looking at each."""
    return array('d', np.ascontiguousarray(values, dtype=np.float64).tobytes())


def _close(message: Any, error: IdentError | None, stamp: Time, result_file: str) -> Any:
    """Return a message with the time of a run's end, what went wrong, and where its file is."""
    message.header.stamp = stamp
    message.result_file = result_file
    if error is not None:
        message.error_code = int(error.code)
        message.error_message = error.message
    return message


def _unit_of(machine: Machine, name: str) -> str:
    declared = machine.bounds.get(name) or machine.bounds.get(name.rpartition('.')[2])
    return declared[2] if declared else ''


def identify_feedback(
    progress: IdentifyProgress, machine: Machine, stamp: Time
) -> tuple[Identify.Feedback, str]:
    """Return a progress as a message and in words."""
    refining = progress.phase != 'search'
    message = _filled(
        Progress,
        progress,
        evaluation_budget=progress.budget,
        cost_unit=progress.unit,
        phase=Progress.PHASE_REFINEMENT if refining else Progress.PHASE_GENETIC_ALGORITHM,
        parameter_names=list(progress.names),
        parameter_units=[_unit_of(machine, name) for name in progress.names],
        best_theta=_doubles(progress.best_theta),
        spread=_doubles(np.full(len(progress.names), progress.spread)),
    )
    message.header.stamp = stamp
    return Identify.Feedback(progress=message), (
        f'{"refinement" if refining else "genetic algorithm"}, {message.generation} of '
        f'{message.generations}, best cost {message.best_cost:.4g} {message.cost_unit}'
    )


def result_message(
    done: Identified | None, error: IdentError | None, stamp: Time, result_file: str
) -> IdentificationResult:
    """Return a run's end as a message: its result, or what kept it from having one.

    Args:
        result_file: Path of the result file, empty where it was not written.
    """
    nothing = IdentificationResult(**dict.fromkeys(_COSTS, math.nan))
    message = _close(nothing if done is None else _identified(done), error, stamp, result_file)
    message.outcome_sentence = message.outcome_sentence or message.error_message
    return message


def _identified(done: Identified) -> IdentificationResult:
    found, configuration = done.result, run.asked_of(done).configuration
    # undetermined parameters are no error as long as there is one that is determined
    known = found.outcome == Outcome.NOT_IDENTIFIABLE and any(
        p.identifiable for p in found.parameters
    )
    code = 0 if known else int(found.outcome.error_code)
    said = outcome_sentence(found)
    return _filled(
        IdentificationResult,
        found,
        warnings=found.quality.warnings,
        cost_genetic=found.cost.ga,
        cost_refined=found.cost.refined,
        cost_unit=found.cost.unit,
        package_version=found.provenance.package_version,
        configuration=configuration,
        configuration_sha256=hashlib.sha256(configuration.encode()).hexdigest(),
        seconds=done.seconds,
        bag_sha256=done.logs.sha256,
        bag_path=' + '.join(done.request.bags),
        error_code=code,
        error_message=said if code else '',
        outcome=_outcome(found),
        outcome_sentence=said,
        parameters=[_of_result(p) for p in found.parameters],
        correlation=_doubles(found.correlation),
        residual_rms=_doubles([x.rms for x in found.residuals]),
        residual_share=_doubles([x.share for x in found.residuals]),
        missing_fraction=max(found.quality.missing.values(), default=math.nan),
    )


def _outcome(found: Identification) -> int:
    """Return the outcome; an estimate at its bound is told apart from one that is determined."""
    if found.outcome == Outcome.IDENTIFIED and any(p.at_bound for p in found.parameters):
        return int(IdentificationResult.OUTCOME_AT_BOUND)
    return int(_OUTCOMES[found.outcome])


def _of_result(found: Any) -> ParameterEstimate:
    # A flag of NumPy's would end the process: rosidl asserts Python's.
    return _filled(
        ParameterEstimate,
        found,
        genetic_value=found.ga_value,
        at_bound=bool(found.at_bound),
        identifiable=bool(found.identifiable),
        kind=_KINDS[found.kind],
    )


def diagnose_feedback(
    progress: DiagnoseProgress, machine: Machine, stamp: Time
) -> tuple[Diagnose.Feedback, str]:
    """Return a progress as the action's feedback and in words; arguments as of the other one."""
    feedback = _filled(Diagnose.Feedback, progress)
    best = f'; so far: {feedback.best_so_far}' if feedback.best_so_far else ''
    return feedback, f'diagnosing, {100 * feedback.fraction:.0f} %: {feedback.stage}{best}'


def gap_message(
    done: Diagnosed | None, error: IdentError | None, stamp: Time, result_file: str
) -> Gap:
    """Return a diagnosis' end as a message; arguments as of `result_message`."""
    message = Gap(**dict.fromkeys(_GAPS, math.nan)) if done is None else _diagnosed(done)
    message.package_version = package_version()
    if done is not None and done.cancelled:
        error = ErrorCode.CANCELLED.error(
            f'cancelled after {done.seconds:.1f} s; the best so far is kept, effects '
            'that had not been tried by then may close more of the gap'
        )
    return _close(message, error, stamp, result_file)


def gap_sentence(message: Gap) -> str:
    """Return what a diagnosis that came to an end has found."""
    if message.error_code == ErrorCode.CANCELLED:
        return f'The diagnosis was {message.error_message}. By then: {message.sentence}'
    return str(message.sentence)


def _diagnosed(done: Diagnosed) -> Gap:
    found = done.result
    steps = list(advice(found))
    if not found.complete and not done.cancelled:
        steps.insert(
            0,
            f'The time budget of {done.request.seconds:g} s ended the run before every effect '
            'had been tried; give it more.',
        )
    gates = [gate.sentence for gate in found.gates if gate.level != 'ok']
    logs = [data for data in (done.logs.fit, done.logs.check) if data]
    warnings = dict.fromkeys([*gates, *(w for data in logs for w in data.quality(0).warnings)])
    return _filled(
        Gap,
        found,
        noise_floor=found.floor.together,
        share_closed=found.share_closed.value,
        **_interval('before', found.steps[:1]),
        **_interval('after', found.steps[-1:]),
        **{
            f'drive_{name}': _doubles([getattr(x, name) for x in found.per_drive.values()])
            for name in ('before', 'after', 'noise_floor', 'share_closed')
        },
        sentence=sentence(found),
        warnings=list(warnings),
        also=[_also(found, at) for at in found.also],
        confusable=[_candidate(found, r) for r in found.confusable],
        ranking=[_candidate(found, r) for r in found.ranking],
        drives=list(found.per_drive),
        localisation=[where(x) for x in found.localisation],
        advice=steps,
        seconds=done.seconds,
    )


def _interval(name: str, step: Sequence[Step]) -> dict[str, float]:
    """Return the gap at a step of the waterfall with its interval; NaN where there is none."""
    gap = step[0].gap if step else Interval(math.nan, math.nan, math.nan)
    return {name: gap.value, f'{name}_low': gap.low, f'{name}_high': gap.high}


def _candidate(found: Diagnosis, ranked: Ranked) -> Any:
    """Return a candidate; the verdict's own effect with the extended model's estimates."""
    values: Mapping[str, Value] = ranked.parameters
    if ranked.at.effect == found.effect and (ranked.at.where,) == found.where:
        values = {name: found.parameters.get(name, value) for name, value in values.items()} | {
            name: found.parameters[name] for name in found.moved
        }
    return _filled(
        GapCandidate,
        ranked,
        effect=ranked.at.effect,
        where=[ranked.at.where],
        gap_after_low=math.nan,
        gap_after_high=math.nan,
        parameters=[_of_gap(name, value) for name, value in values.items()],
    )


def _also(found: Diagnosis, at: EffectAt) -> Any:
    """Return a further effect: what it came to in the extended model, and the gap left with it."""
    step = 1 + (EffectAt(found.effect, *found.where[:1]), *found.also).index(at)
    return GapCandidate(
        effect=at.effect,
        where=[at.where],
        probability=math.nan,
        **_interval('gap_after', found.steps[step : step + 1]),
        parameters=[
            _of_gap(name, value)
            for name, value in found.parameters.items()
            if name.startswith(at.prefix)
        ],
    )


def _of_gap(name: str, value: Value) -> ParameterEstimate:
    low, high = value.lower_bound, value.upper_bound
    unknown = math.isnan(value.low) or math.isnan(value.high)
    # without an interval nothing speaks against it
    loose = not unknown and state_of(value.value, value.low, value.high, low, high) != 'identified'
    bound = bound_of(value.low, value.high, low, high, value.unit)
    notes = [bound or NOT_IDENTIFIABLE] if loose else []
    if value.end:
        notes.append(f'at its {value.end} bound')
    if unknown:
        notes.append('no interval is known')
    return _filled(
        ParameterEstimate,
        value,
        name=name,
        genetic_value=math.nan,
        at_bound=bool(value.end),
        identifiable=not loose,
        kind=_KINDS[value.kind],
        note='; '.join(notes),
    )


def diff_feedback(
    progress: DiagnoseProgress, machine: Machine, stamp: Time
) -> tuple[Diff.Feedback, str]:
    """Return a progress as the action's feedback and in words; arguments as of the others."""
    feedback = _filled(Diff.Feedback, progress)
    return feedback, f'comparing, {100 * feedback.fraction:.0f} %: {feedback.stage}'


def comparison_message(
    done: Compared | None, error: IdentError | None, stamp: Time, result_file: str
) -> Comparison:
    """Return a comparison's end as a message; arguments as of `result_message`."""
    message = Comparison(explained=math.nan) if done is None else _compared(done)
    message.package_version = package_version()
    if done is not None and not done.complete:
        error = ErrorCode.CANCELLED.error(
            f'cancelled after {done.seconds:.1f} s; what was found by then is kept, more may have '
            'changed'
        )
    return _close(message, error, stamp, result_file)


def _compared(done: Compared) -> Comparison:
    found = done.result
    return _filled(
        Comparison,
        found,
        sentence=' '.join(changed(found)),
        warnings=list(differing(found)),
        limits=list(limits(found)),
        changes=[_change(c) for c in found.changes],
        smallest=[_smallest(v) for v in found.smallest],
        logs_before=found.logs[0],
        logs_after=found.logs[1],
        seconds=done.seconds,
        seed=done.request.seed,
    )


def _change(found: Changed) -> Change:
    columns = {
        f'{name}s' if name in ('unit', 'value') else name: [getattr(x, name) for x in found.sizes]
        for name in ('unit', 'value', 'low', 'high', 'before')
    }
    return _filled(
        Change,
        found.suspect,
        title=title_of(found.suspect),
        numbers=[x.name for x in found.sizes],
        evidence=found.evidence,
        ties=[title_of(x) for x in found.ties],
        **columns,
    )


def _smallest(found: Visible) -> Change:
    suspect: Suspect = found.suspect
    return _filled(
        Change,
        suspect,
        title=title_of(suspect),
        numbers=[found.name],
        units=[found.unit],
        values=[found.size],
        low=[math.nan],
        high=[math.nan],
        before=[found.value],
        evidence=math.nan,
    )
