# SPDX-License-Identifier: Apache-2.0
"""Between a diagnosis and its messages."""

from collections.abc import Mapping
import math
from typing import Any

from builtin_interfaces.msg import Time
from ros2_ident_msgs.action import Diagnose
from ros2_ident_msgs.msg import Gap, GapCandidate, ParameterEstimate

from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.gap.diagnose import DiagnoseProgress
from ros2_ident.gap.diagnosis import Diagnosis, Ranked, Value
from ros2_ident.identify.certainty import NOT_IDENTIFIABLE, state_of
from ros2_ident.identify.outcome import package_version
from ros2_ident.identify.result import bound_of
from ros2_ident.jobs import Diagnosed
from ros2_ident.models import EffectAt, Parameter
from ros2_ident.ros.conversion import doubles, KINDS
from ros2_ident.ros.run import Finished

# A value as near to a bound as this share of the range lies on it.
_AT_BOUND = 1e-3
_UNKNOWN = (
    'probability',
    'before',
    'before_low',
    'before_high',
    'after',
    'after_low',
    'after_high',
    'noise_floor',
    'share_closed',
)


def feedback_message(progress: DiagnoseProgress) -> Any:
    """Return a progress as the action's feedback."""
    return Diagnose.Feedback(
        stage=progress.stage,
        fraction=progress.fraction,
        best_so_far=progress.best_so_far,
        elapsed=progress.elapsed,
        eta=progress.eta,
    )


def feedback_sentence(feedback: Any) -> str:
    """Return a feedback in words."""
    best = f'; so far: {feedback.best_so_far}' if feedback.best_so_far else ''
    return f'diagnosing, {100 * feedback.fraction:.0f} %: {feedback.stage}{best}'


def gap_message(
    finished: Finished[Diagnosed] | None,
    error: IdentError | None,
    stamp: Time,
    result_file: str = '',
) -> Gap:
    """Return a diagnosis' end as a message: what it found, or what kept it from finding it.

    Args:
        finished: The diagnosis, None where there is none.
        error: What went wrong, None for nothing.
        stamp: Of the end, node clock.
        result_file: Path of diagnosis.json, empty where it was not written.
    """
    message = Gap(package_version=package_version(), result_file=result_file)
    message.header.stamp = stamp
    for field in _UNKNOWN:
        setattr(message, field, math.nan)
    if finished is not None:
        _fill(message, finished)
    if finished is not None and finished.cancelled:
        error = IdentError(
            ErrorCode.CANCELLED,
            f'cancelled after {finished.done.seconds:.1f} s; the best so far is kept, effects '
            'that had not been tried by then may close more of the gap',
        )
    if error is not None:
        message.error_code = int(error.code)
        message.error_message = error.message
    return message


def _fill(message: Gap, finished: Finished[Diagnosed]) -> None:
    done, declared = finished.done, finished.declared
    found = done.result
    message.effect = found.effect
    message.where = list(found.where)
    message.probability = found.probability
    message.sentence = found.sentence
    message.warnings = warnings_of(done)
    message.also = [_also(found, declared, at) for at in found.also]
    message.confusable = [_candidate(found, declared, r) for r in found.confusable]
    message.ranking = [_candidate(found, declared, r) for r in found.ranking]
    message.unit = found.unit
    if found.steps:
        for name, gap in (('before', found.steps[0].gap), ('after', found.steps[-1].gap)):
            setattr(message, name, gap.value)
            setattr(message, f'{name}_low', gap.low)
            setattr(message, f'{name}_high', gap.high)
    message.noise_floor = found.floor.together
    message.share_closed = found.share_closed.value
    message.held_out = found.held_out
    message.drives = list(found.per_drive)
    drives = list(found.per_drive.values())
    message.drive_before = doubles([x.before for x in drives])
    message.drive_after = doubles([x.after for x in drives])
    message.drive_noise_floor = doubles([x.noise_floor for x in drives])
    message.drive_share_closed = doubles([x.share_closed for x in drives])
    message.localisation = [finding.sentence for finding in found.localisation]
    message.advice = list(found.advice)
    if not found.complete and not finished.cancelled:
        message.advice.insert(
            0,
            f'The time budget of {done.request.seconds:g} s ended the run before every effect '
            'had been tried; give it more.',
        )
    message.seconds = done.seconds
    message.seed = found.seed


def warnings_of(done: Diagnosed) -> list[str]:
    """Return what gates and data warn of, each sentence once."""
    gates = [gate.sentence for gate in done.result.gates if gate.level != 'ok']
    logs = done.logs.fit, done.logs.check
    said = [w for data in logs if data for w in data.quality(0).warnings]
    return list(dict.fromkeys([*gates, *said]))


def _candidate(found: Diagnosis, declared: Mapping[str, Parameter], ranked: Ranked) -> Any:
    """Return a candidate; the verdict's own effect with the extended model's estimates."""
    values: Mapping[str, Value] = ranked.parameters
    if ranked.at.effect == found.effect and (ranked.at.where,) == found.where:
        values = {name: found.parameters.get(name, value) for name, value in values.items()} | {
            name: found.parameters[name] for name in found.moved
        }
    return GapCandidate(
        effect=ranked.at.effect,
        where=[ranked.at.where],
        probability=ranked.probability,
        gap_after=ranked.gap_after,
        gap_after_low=math.nan,
        gap_after_high=math.nan,
        parameters=[_estimate(name, value, declared.get(name)) for name, value in values.items()],
    )


def _also(found: Diagnosis, declared: Mapping[str, Parameter], at: EffectAt) -> Any:
    """Return a further effect: what it came to in the extended model, and the gap left with it."""
    prefix = f'{at.effect}.' if at.where == 'all' else f'{at.where}.{at.effect}.'
    step = 1 + (EffectAt(found.effect, *found.where[:1]), *found.also).index(at)
    known = step < len(found.steps)
    gap = found.steps[step].gap if known else None
    return GapCandidate(
        effect=at.effect,
        where=[at.where],
        probability=math.nan,
        gap_after=gap.value if gap else math.nan,
        gap_after_low=gap.low if gap else math.nan,
        gap_after_high=gap.high if gap else math.nan,
        parameters=[
            _estimate(name, value, declared.get(name))
            for name, value in found.parameters.items()
            if name.startswith(prefix)
        ],
    )


def _estimate(name: str, value: Value, declared: Parameter | None) -> ParameterEstimate:
    low, high = (declared.low, declared.high) if declared else (math.nan, math.nan)
    edge = _AT_BOUND * (high - low)
    below, above = value.value <= low + edge, value.value >= high - edge
    unknown = math.isnan(value.low) or math.isnan(value.high)
    state = state_of(value.value, value.low, value.high, low, high)
    # without an interval nothing speaks against it
    loose = not unknown and state != 'identified'
    bound = bound_of(value.low, value.high, low, high, value.unit)
    notes = [bound or NOT_IDENTIFIABLE] if loose else []
    if below or above:
        notes.append(f'at its {"lower" if below else "upper"} bound')
    if unknown:
        notes.append('no interval is known')
    return ParameterEstimate(
        name=name,
        unit=value.unit,
        value=value.value,
        low=value.low,
        high=value.high,
        noise_low=value.noise_low,
        noise_high=value.noise_high,
        lower_bound=low,
        upper_bound=high,
        genetic_value=math.nan,
        at_bound=below or above,
        identifiable=not loose,
        kind=KINDS[declared.kind if declared else 'physical'],
        note='; '.join(notes),
    )
