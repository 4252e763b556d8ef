# SPDX-License-Identifier: Apache-2.0
"""The first screen: what is wrong, how sure that is, how far the gap closes, what to do now."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
import math
from typing import Any

from ros2_ident.gap.facts import Cause
from ros2_ident.gates import sentences as sentences_of
from ros2_ident.identify.result import Identification, Outcome, ParameterEstimate
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
from ros2_ident.report.page.sentences import (
    effects_found,
    name_of,
    places,
    REFUSED,
    some,
)
from ros2_ident.report.page.steps import Step
from ros2_ident.report.schema import gates_from
from ros2_ident.words import verdict as words
from ros2_ident.words.figures import compared

# Drives that the first screen lists; the table further down has all.
LISTED = 6
# Parameters of an identification that it lists.
PARAMETERS = 10
# A gap left above the noise, in units of the noise floor, that wants a cause of its own.
UNEXPLAINED = 1.0
# A share that is as good as all.
NEARLY_ALL = 0.995


@dataclass(frozen=True)
class Gap:
    """One drive's residual.

    Attributes:
        drive: Its name.
        size: RMS in the machine's unit, before and after where something closes it.
        share: The same as a share of what is compared, an effort or a position.
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
        more: The rest of it, where one sentence would be long.
        state: What the colour says, in words.
        sure: How sure that is, sentences.
        gaps: How far the gap closes, for the drives that matter most.
        closes: The same in sentences.
        steps: What to do now.
        careful: What else to know, the most important first.
        values: Parameters that were identified: name, value with unit, precision.
        first: What has to be said before anything else.
        compared: What is compared: effort, position or velocity.
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
    more: tuple[str, ...] = ()
    state: str = ''
    compared: str = 'effort'

    @property
    def closing(self) -> bool:
        """Whether the gap of a drive closes."""
        return any(gap.after is not None for gap in self.gaps)


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
    grave = sentences_of(g for g in gates_from(data['gates']) if g.level == 'fail')
    first = () if verdict['effect'] in REFUSED else tuple(grave)
    if data['complete'] and verdict['effect'] not in sentences.NAMELESS - {'none'} and not first:
        unsure = len(data['confusable']) > 1 or _unexplained(data) or _seldom(data)
        level = 'doubtful' if careful or unsure else 'good'
    return Answer(
        level,
        verdict.get('headline', verdict['sentence']),
        tuple(_sure(data)),
        _gaps(data),
        tuple(_closes(data)),
        tuple(steps.of_diagnosis(data, out)),
        careful,
        first=first,
        state=_state_of(data, level, first, careful),
        compared=compared(data['gap']['unit']),
    )


def _state_of(
    data: Mapping[str, Any], level: sentences.Level, first: Sequence[str], careful: Sequence[str]
) -> str:
    if first:
        return 'Correct this first:'
    if data['verdict']['cause'] == Cause.EVENTS:
        return 'The cause is beside the machine and its command'
    return _state(level, _reservations(data, careful))


def _state(level: sentences.Level, reservations: Iterable[str]) -> str:
    """Return what the colour of the answer's edge says, in words."""
    if level == 'doubtful':
        return f'Answer with reservations: {", ".join(reservations)}'
    return {'good': 'Clear answer', 'bad': 'No clear answer yet'}[level]


def _reservations(data: Mapping[str, Any], careful: Sequence[str]) -> Iterator[str]:
    if _unexplained(data):
        yield 'part of the gap stays unexplained'
    if _seldom(data):
        yield 'not every effect is certain'
    if len(data['confusable']) > 1:
        yield 'another effect explains it as well'
    if careful:
        yield 'see “Be careful” below'


def _chance(probability: float | None) -> str:
    if probability is not None and probability > 0.99:
        return 'Over 99 %'
    return percent(probability)


def _sure(data: Mapping[str, Any]) -> Iterator[str]:
    verdict = data['verdict']
    facts_only = verdict['cause'] in (Cause.SLOW, Cause.EVENTS)
    if verdict['effect'] in REFUSED:
        yield verdict['sentence']
    elif data['complete'] or verdict['probability']:
        that = {
            'none': 'that nothing larger is missing, as far as noise can tell'
            if data['facts']['hidden']
            else 'that nothing larger is missing',
            'unknown': 'that it is no noise'
            if facts_only
            else 'that the cause is none of the effects tried',
        }.get(verdict['effect'], _cause(data))
        yield f'{_chance(verdict["probability"])} {that}.'
    if facts_only:
        yield verdict['sentence']
    rivals = [name_of(x) for x in data['confusable'][1:]]
    if rivals:
        yield f'This recording cannot tell it from {some(rivals)}.'
    yield words.judged_on(data['gap']['held_out'])
    yield from _again(data)


def _again(data: Mapping[str, Any]) -> Iterator[str]:
    """Yield how often several effects count where the data held out are resampled."""
    counted, seldom = _counted(data), _seldom(data)
    if counted and not seldom:
        least = min(share for _, share in counted)
        share = 'all' if least >= NEARLY_ALL else f'{percent(least)} or more of the'
        yield f'Each effect is needed again in {share} resamples of those data.'
    for x, count in seldom:
        yield words.hint(name_of(x), count)


def _counted(data: Mapping[str, Any]) -> list[tuple[Mapping[str, Any], float]]:
    """Return several effects with how often each counts; nothing where that is not known."""
    found, again = effects_found(data), data.get('again') or ()
    if len(found) < 2 or len(again) != len(found):
        return []
    return list(zip(found, again, strict=True))


def _seldom(data: Mapping[str, Any]) -> list[tuple[Mapping[str, Any], float]]:
    """Return those of several effects that are no more than hints."""
    return [(x, share) for x, share in _counted(data) if share < words.OFTEN]


def _cause(data: Mapping[str, Any]) -> str:
    if data['also']:
        return f'that {name_of(data["verdict"])}, found first, is a cause'
    return f'that this is the cause, and {places(data["verdict"]["where"])} the place'


def _gaps(data: Mapping[str, Any]) -> tuple[Gap, ...]:
    """Return the drives with the largest gaps above their noise floor, in the machine's order."""
    gap, material = data['gap'], float(data['evidence']['material'] or 0.0)
    drives = {n: d for n, d in gap['per_drive'].items() if d['before'] is not None}
    first = sorted(drives, key=lambda n: -(drives[n]['before'] / (drives[n]['noise_floor'] or 1)))
    chosen = [n for n in drives if n in first[:LISTED]]
    longest = max((max(drives[n]['before'], drives[n]['after'] or 0.0) for n in chosen), default=1)
    closed = len(gap['steps']) > 1
    rest = dict.fromkeys(data['facts']['slow'], 'too slow for noise')
    quiet = {n for n in chosen if above(drives[n]['before'], drives[n]['noise_floor']) < material}
    notes = {n: rest.get(n, 'noise only') for n in quiet}
    return tuple(
        _gap(n, drives[n], gap['unit'], longest, closed, notes.get(n, '')) for n in chosen
    )


def above(rms: float | None, floor: float | None) -> float:
    """Return how much of a residual is above the noise, in units of the noise floor."""
    if rms is None or not floor:
        return math.inf
    return math.sqrt(max(0.0, (rms / floor) ** 2 - 1.0))


def _gap(
    name: str, d: Mapping[str, Any], unit: str, longest: float, closed: bool, note: str
) -> Gap:
    before, after, floor = d['before'], d['after'], d['noise_floor']
    share = d['share_of_torque_before']
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
        yield f'{said} of the gap’s power, its square less the noise’s, closes{told}.'
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
    facts = data['facts']
    yield from words.hidden(facts['hidden'].items(), data['gap']['unit'])
    told = ('not_asked',) if facts['events'] else ()
    odd = [
        g
        for k, g in enumerate(gates_from(data['gates']))
        if k != facts['leads'] and g.level == 'warn' and g.gate not in told
    ]
    yield from map(sentences.warned, sentences_of(odd))
    ends = [name for name, v in data['parameters'].items() if v['at_bound']]
    if ends:
        yield words.at_bounds(ends)


# ---------------------------------------------------------------------- an identification


def of_identification(result: Identification, out: str) -> Answer:
    """Return the first screen of an identification without a diagnosis.

    Args:
        result: The identification.
        out: The directory it lies in.
    """
    # Where nothing is identified there is nothing to doubt one by one.
    named = () if result.outcome is Outcome.CONTRADICTED else sentences.doubts(result)
    doubts = [*named, *map(sentences.warned, result.quality.warnings)]
    level: sentences.Level = 'bad'
    if result.outcome is Outcome.IDENTIFIED:
        level = 'doubtful' if doubts else 'good'
    gaps = _left(result)
    more = len(gaps) - LISTED
    closes = [f'Held out: {result.validated_on}.'] if result.validation else []
    if more > 0:
        closes.append(f'{more} more in the file `result.json`.')
    said, told = sentences.identified(result)
    return Answer(
        level,
        said,
        (*filter(None, [told]), *sentences.precision_of(result)),
        tuple(gaps[:LISTED]),
        tuple(closes),
        tuple(steps.of_identification(result, out)),
        tuple(doubts),
        tuple(_values(result)),
        state=_state(level, ['see “Be careful” below']),
        compared=compared(_unit(result)),
    )


def _unit(result: Identification) -> str:
    """Return the unit of what is compared, of the first drive where they differ."""
    return next((x.unit for x in result.residuals if x.unit), result.cost.unit)


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


def _known(p: ParameterEstimate) -> str:
    """Return an interval as shares of the value, side by side where it is lopsided."""
    if not p.value or not p.lopsided:
        return precision(sentences.width(p))
    less, more = p.reach
    return f'−{percent(less / abs(p.value))}, +{percent(more / abs(p.value))}'


def _values(result: Identification) -> Iterator[tuple[str, str, str]]:
    """Yield the parameters, of many those known best."""
    order = {p.name: k for k, p in enumerate(result.parameters)}
    best = sorted(result.parameters, key=lambda p: (not p.identifiable, sentences.width(p)))
    for p in sorted(best[:PARAMETERS], key=lambda p: order[p.name]):
        known = _known(p) if p.identifiable else p.bound if p.state == 'bounded' else p.state
        yield p.name, quantity(p.value, p.unit, 4), known
