# SPDX-License-Identifier: Apache-2.0
"""The first screen: what is wrong, how sure that is, how far the gap closes, what to do now."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
import math
from typing import Any

from ros2_ident.identify.result import Identification, Outcome
from ros2_ident.report.page import sentences, steps
from ros2_ident.report.page.numbers import (
    from_to,
    number,
    percent,
    precision,
    quantity,
    shares,
    unit_of,
)
from ros2_ident.report.page.sentences import effect_name, joined, some
from ros2_ident.report.page.steps import effects_found, places, Step

# Drives that the first screen lists; the table further down has all.
LISTED = 6
# Levels of a check of the log that come before any answer.
GRAVE = ('error', 'fail')
# Parameters of an identification that it lists.
PARAMETERS = 10
# A gap left above the noise, in units of the noise floor, that wants a cause of its own.
UNEXPLAINED = 1.0
# What the advice on a gap that noise may hide says, of all advice.
_SLOW_NOISE = 'so slow that it can be noise'
# A share that is as good as all.
NEARLY_ALL = 0.995
# An effect that counts in fewer of the resamples is a hint, as the diagnosis' advice says.
_OFTEN = 0.9


@dataclass(frozen=True)
class Gap:
    """One drive's residual.

    Attributes:
        drive: Its name.
        size: RMS in the machine's unit, before and after where something closes it.
        share: The same as a share of the drive's effort.
        before: Length of a bar, 0 to 1.
        after: Likewise; None where nothing closes it.
        floor: Likewise, the noise floor; None where it is not known.
        note: What is to be said of it.
    """

    drive: str
    size: str
    share: str
    before: float
    after: float | None
    floor: float | None
    note: str = ''


@dataclass(frozen=True)
class Answer:
    """The first screen.

    Attributes:
        level: `good`, `doubtful` or `bad`: the colour of its edge.
        headline: What is wrong.
        sure: How sure that is, sentences.
        gaps: How far the gap closes, for the drives that matter most.
        closes: The same in sentences.
        steps: What to do now.
        careful: What else to know, the most important first.
        values: Parameters that were identified: name, value with unit, precision.
        first: What has to be said before anything else.
    """

    level: sentences.Level
    headline: str
    sure: tuple[str, ...]
    gaps: tuple[Gap, ...]
    closes: tuple[str, ...]
    steps: tuple[Step, ...]
    careful: tuple[str, ...] = ()
    values: tuple[tuple[str, str, str], ...] = ()
    first: tuple[str, ...] = ()


# ---------------------------------------------------------------------- a diagnosis


def of_diagnosis(data: Mapping[str, Any], out: str) -> Answer:
    """Return the first screen of a diagnosis.

    Args:
        data: The content of `diagnosis.json`.
        out: The directory it lies in.
    """
    careful = tuple(_careful(data))
    verdict = data['verdict']
    level: sentences.Level = 'bad'
    grave = [g['sentence'] for g in data['gates'] if g['level'] in GRAVE]
    first = () if verdict['effect'] in steps.REFUSALS else tuple(joined(grave))
    if data['complete'] and verdict['effect'] not in sentences.NAMELESS - {'none'} and not first:
        unsure = len(data['confusable']) > 1 or _unexplained(data)
        level = 'doubtful' if careful or unsure else 'good'
    return Answer(
        level,
        _headline(data),
        tuple(_sure(data)),
        _gaps(data['gap'], material=float(data['evidence']['material'] or 0.0)),
        tuple(_closes(data)),
        tuple(steps.of_diagnosis(data, out)),
        careful,
        first=first,
    )


def _headline(data: Mapping[str, Any]) -> str:
    verdict = data['verdict']
    if verdict['effect'] == 'none':
        return _nothing(data)
    if verdict['effect'] in steps.REFUSALS:
        return steps.REFUSALS[verdict['effect']][0]
    if verdict['effect'] == 'unknown':
        where = places(verdict['where'])
        if not data['complete']:
            return f'Cut short: the simulation of {where} is off, and no cause was found yet.'
        return (
            f'Something is missing in the simulation of {where}, and no known effect explains it.'
        )
    found = effects_found(data)
    of_log = [at for at in found if sentences.of_log(at['effect'])]
    missing = [at for at in found if at not in of_log]
    distorted = sentences.effects_named(of_log) if of_log else ''
    if not missing:
        return f'The logged effort is off, not the simulation: {distorted}.'
    said = sentences.effects_named(missing)
    verb = 'is' if len(missing) == 1 else 'are'
    too = f'; the logged effort is off, too: {distorted}' if of_log else ''
    return f'{said[0].upper()}{said[1:]} {verb} missing in the simulation{too}.'


def _nothing(data: Mapping[str, Any]) -> str:
    """Return the headline where no effect is named: how large one could be and not be found."""
    if (data['evidence']['size'] or 0.0) >= (data['evidence']['material'] or 0.0):
        return 'Nothing can be named: what is left is too small to tell its cause.'
    limit = quantity(_limit(data), data['gap']['unit'], 2)
    if _hidden_by_noise(data):
        return f'Nothing found missing above {limit}, but slow noise may hide more.'
    return f'Nothing found missing above {limit}: what is left is noise.'


def _limit(data: Mapping[str, Any]) -> float:
    """Return the gap, RMS, that counts on every drive."""
    floors = [d['noise_floor'] or 0.0 for d in data['gap']['per_drive'].values()]
    return float(data['evidence']['material'] or 0.0) * max(floors, default=0.0)


def _hidden_by_noise(data: Mapping[str, Any]) -> list[str]:
    """Return the advice on a gap that noise may hide."""
    return [text for text in data['advice'] if _SLOW_NOISE in text]


def _chance(probability: float | None) -> str:
    if probability is not None and probability > 0.99:
        return 'Over 99 %'
    return percent(probability)


def _sure(data: Mapping[str, Any]) -> Iterator[str]:
    verdict = data['verdict']
    held = {
        'check bag': 'Judged on data not used for fitting: another recording.',
        'blocks': 'Judged on data not used for fitting: every second block of 1 s.',
    }
    if verdict['effect'] in steps.REFUSALS:
        yield verdict['sentence']
    elif data['complete'] or verdict['probability']:
        that = {
            'none': 'that nothing larger is missing, as far as noise can tell'
            if _hidden_by_noise(data)
            else 'that nothing larger is missing',
            'unknown': 'that the cause is none of the effects tried',
        }.get(verdict['effect'], _cause(data))
        yield f'{_chance(verdict["probability"])} {that}.'
    rivals = [effect_name(x) for x in data['confusable'][1:]]
    if rivals:
        yield f'This recording cannot tell it from {some(rivals)}.'
    yield held.get(data['gap']['held_out'], str(data['gap']['held_out']))
    yield from _again(data)


def _again(data: Mapping[str, Any]) -> Iterator[str]:
    """Say of several effects how often they count where the data held out are resampled."""
    again = data.get('again') or ()
    found = effects_found(data)
    if len(found) < 2 or len(again) != len(found):
        return
    seldom = [(x, share) for x, share in zip(found, again, strict=True) if share < _OFTEN]
    if not seldom:
        least = min(again)
        share = 'all' if least >= NEARLY_ALL else f'{percent(least)} or more of the'
        yield f'Each counts again in {share} resamples of those data.'
    for x, share in seldom:
        yield f'Of resamples of those data, {effect_name(x)} counts in only {percent(share)}.'


def _cause(data: Mapping[str, Any]) -> str:
    if data['also']:
        return f'that {effect_name(data["verdict"])}, found first, is a cause'
    return f'that this is the cause, and {steps.places(data["verdict"]["where"])} the place'


def _gaps(gap: Mapping[str, Any], material: float) -> tuple[Gap, ...]:
    """Return the drives with the largest gaps above their noise floor."""
    drives = {n: d for n, d in gap['per_drive'].items() if d['before'] is not None}
    first = sorted(drives, key=lambda n: -(drives[n]['before'] / (drives[n]['noise_floor'] or 1)))
    chosen = first[:LISTED]
    longest = max((max(drives[n]['before'], drives[n]['after'] or 0.0) for n in chosen), default=1)
    closed = len(gap['steps']) > 1
    return tuple(_gap(n, drives[n], gap['unit'], longest, material, closed) for n in chosen)


def above(rms: float | None, floor: float | None) -> float:
    """Return how much of a residual is above the noise, in units of the noise floor."""
    if rms is None or not floor:
        return math.inf
    return math.sqrt(max(0.0, (rms / floor) ** 2 - 1.0))


def _gap(
    name: str, d: Mapping[str, Any], unit: str, longest: float, material: float, closed: bool
) -> Gap:
    before, after, floor = d['before'], d['after'], d['noise_floor']
    share = d['share_of_torque_before']
    note = '' if above(before, floor) >= material else 'noise only'
    if not closed or after is None or note:
        size, part = quantity(before, unit, 3), percent(share)
        return Gap(name, size, part, before / longest, None, _length(floor, longest), note)
    return Gap(
        name,
        f'{from_to(before, after)} {unit_of(unit)}',
        '–' if share is None else shares(share, d['share_of_torque_after']),
        before / longest,
        after / longest,
        _length(floor, longest),
    )


def _length(value: float | None, longest: float) -> float | None:
    return None if value is None or not longest else min(1.0, value / longest)


def _closes(data: Mapping[str, Any]) -> Iterator[str]:
    gap = data['gap']
    if len(gap['steps']) > 1 and gap['share_closed'] is not None:
        low, high = gap['share_closed_low'], gap['share_closed_high']
        share = gap['share_closed']
        said = 'Nearly all' if share >= NEARLY_ALL else percent(share)
        told = ''
        if None not in (low, high) and low < NEARLY_ALL:
            told = f' (95 % interval: {number(100.0 * low, 2)} to {percent(high)})'
        yield f'{said} of the squared gap above the noise closes{told}.'
        if _unexplained(data):
            yield 'No effect of the catalogue explains the rest.'
    more = len(gap['per_drive']) - LISTED
    if more > 0:
        yield f'{"One more drive" if more == 1 else f"{more} more drives"}: see the table below.'


def _unexplained(data: Mapping[str, Any]) -> bool:
    return bool(effects_found(data)) and (data['evidence']['remaining'] or 0.0) >= UNEXPLAINED


def _careful(data: Mapping[str, Any]) -> Iterator[str]:
    if not data['complete']:
        yield 'The run was cut short: effects not tried by then may close more of the gap.'
    yield from _hidden_by_noise(data)
    odd = [g['sentence'] for g in data['gates'] if g['level'] not in ('ok', *GRAVE)]
    yield from joined([text for text in odd if text not in data['verdict']['sentence']])
    ends = [name for name, v in data['parameters'].items() if v['at_bound']]
    if ends:
        yield (
            f'{some(ends)} {"ends" if len(ends) == 1 else "end"} at a bound of the search: the '
            'effect is larger than any looked for, or stands in for another cause.'
        )


# ---------------------------------------------------------------------- an identification


def of_identification(result: Identification, out: str) -> Answer:
    """Return the first screen of an identification without a diagnosis.

    Args:
        result: The identification.
        out: The directory it lies in.
    """
    # Where nothing is identified there is nothing to doubt one by one.
    named = () if result.outcome is Outcome.CONTRADICTED else sentences.doubts(result)
    doubts = [*named, *joined(result.quality.warnings)]
    level: sentences.Level = 'bad'
    if result.outcome is Outcome.IDENTIFIED:
        level = 'doubtful' if doubts else 'good'
    gaps = _left(result)
    more = len(gaps) - LISTED
    closes = [f'Held out: {result.validated_on}.'] if result.validation else []
    if more > 0:
        closes.append(f'{more} more in the file `result.json`.')
    headline, told = sentences.headline(result)
    return Answer(
        level,
        headline,
        (*filter(None, [told]), *sentences.precision_of(result)),
        tuple(gaps[:LISTED]),
        tuple(closes),
        tuple(steps.of_identification(result, out)),
        tuple(doubts),
        tuple(_values(result)),
    )


def _left(result: Identification) -> list[Gap]:
    """Return what an identification leaves of each drive, the largest first."""
    longest = max((x.rms for x in result.residuals), default=1.0) or 1.0
    unseen = {x.drive: x for x in result.validation}
    return [
        Gap(
            x.drive,
            quantity(x.rms, x.unit or result.cost.unit, 3),
            percent(x.share),
            x.rms / longest,
            None,
            None,
            f'held out {percent(unseen[x.drive].share)}' if x.drive in unseen else '',
        )
        for x in sorted(result.residuals, key=lambda x: -x.rms)
    ]


def _values(result: Identification) -> Iterator[tuple[str, str, str]]:
    """Yield the parameters, of many those known best."""
    order = {p.name: k for k, p in enumerate(result.parameters)}
    best = sorted(result.parameters, key=lambda p: (not p.identifiable, sentences.width(p)))
    for p in sorted(best[:PARAMETERS], key=lambda p: order[p.name]):
        known = precision(sentences.width(p)) if p.identifiable else 'not determined'
        yield p.name, quantity(p.value, p.unit, 4), known
