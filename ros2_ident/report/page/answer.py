# SPDX-License-Identifier: Apache-2.0
"""The first screen: what is wrong, how sure that is, how far the gap closes, what to do now."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
import math
import shlex
from typing import Any

from ros2_ident.effects import CATALOGUE, Effect
from ros2_ident.identify.result import Identification, Outcome
from ros2_ident.machine.keys import digits
from ros2_ident.report.page import sentences
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

# Drives that the first screen lists; the table further down has all.
LISTED = 3
# Levels of a check of the log that come before any answer.
GRAVE = ('error', 'fail')
# Answers that say nothing of physics: what is wrong, and what to do.
REFUSALS = {
    'bookkeeping': (
        'Log and machine file contradict each other: nothing physical can be said.',
        'Correct what is named above, in the machine file or in the recording. What fits and what '
        'does not says:',
    ),
    'model': (
        'The model is not the one of this machine: nothing physical can be said.',
        'Choose another kind of machine, or check that the recording is of this one:',
    ),
}
# Parameters that it offers to paste.
VALUES = 6
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
class Law:
    """An effect that was found, as an equation with its numbers.

    Attributes:
        anchor: Where the page says more of it.
        title: Its name with its place.
        equation: The equation.
        numbers: Symbol, name, and value with its interval.
    """

    anchor: str
    title: str
    equation: str
    numbers: tuple[tuple[str, str, str], ...]


@dataclass(frozen=True)
class Step:
    """Something to do.

    Attributes:
        text: What.
        laws: Equations to put into a simulation.
        code: Lines to paste.
    """

    text: str
    laws: tuple[Law, ...] = ()
    code: str = ''


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


def effects_found(data: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """Return the effects of a verdict at their places, the first first; none where unnamed."""
    verdict = data['verdict']
    if verdict['effect'] in sentences.NAMELESS:
        return []
    return [verdict, *data['also']]


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
    first = () if verdict['effect'] in REFUSALS else tuple(joined(grave))
    if data['complete'] and verdict['effect'] not in sentences.NAMELESS - {'none'} and not first:
        unsure = len(data['confusable']) > 1 or _unexplained(data)
        level = 'doubtful' if careful or unsure else 'good'
    return Answer(
        level,
        _headline(data),
        tuple(_sure(data)),
        _gaps(data['gap'], material=float(data['evidence']['material'] or 0.0)),
        tuple(_closes(data)),
        tuple(_steps(data, out)),
        careful,
        first=first,
    )


def _headline(data: Mapping[str, Any]) -> str:
    verdict = data['verdict']
    if verdict['effect'] == 'none':
        small = (data['evidence']['size'] or 0.0) < (data['evidence']['material'] or 0.0)
        return (
            'Nothing is missing in the simulation: what is left is noise.'
            if small
            else 'Nothing can be named: what is left is too small to tell its cause.'
        )
    if verdict['effect'] in REFUSALS:
        return REFUSALS[verdict['effect']][0]
    if verdict['effect'] == 'unknown':
        where = _places(verdict['where'])
        if not data['complete']:
            return f'Cut short: the simulation of {where} is off, and no cause was found yet.'
        return (
            f'Something is missing in the simulation of {where}, and no known effect explains it.'
        )
    found = effects_found(data)
    said = sentences.effects_named(found)
    verb = 'is' if len(found) == 1 else 'are'
    return f'{said[0].upper()}{said[1:]} {verb} missing in the simulation.'


def _places(where: Sequence[str]) -> str:
    return 'the machine' if not where or 'all' in where else ' and '.join(where)


def _chance(probability: float | None) -> str:
    if probability is not None and probability > 0.99:
        return 'Over 99 %'
    return percent(probability)


def _sure(data: Mapping[str, Any]) -> Iterator[str]:
    verdict = data['verdict']
    held = {
        'check bag': 'Judged on a recording that was not used for fitting.',
        'blocks': 'Judged on every second block of 1 s, which was not used for fitting.',
    }
    if verdict['effect'] in REFUSALS:
        yield verdict['sentence']
    elif data['complete'] or verdict['probability']:
        that = {
            'none': 'that nothing is missing',
            'unknown': 'that the cause is none of the effects tried',
        }.get(verdict['effect'], f'that {_first(data)} the cause, and at this place')
        yield f'{_chance(verdict["probability"])} {that}.'
    rivals = [effect_name(x) for x in data['confusable'][1:]]
    if rivals:
        yield f'This recording cannot tell it from {some(rivals)}.'
    yield held.get(data['gap']['held_out'], str(data['gap']['held_out']))


def _first(data: Mapping[str, Any]) -> str:
    return 'the first of these is' if data['also'] else 'this is'


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
            told = f' (95 % interval: {percent(low)} to {percent(high)})'
        yield f'{said} of the gap above the noise closes{told}.'
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
    odd = [g['sentence'] for g in data['gates'] if g['level'] not in ('ok', *GRAVE)]
    yield from joined([text for text in odd if text not in data['verdict']['sentence']])
    ends = [name for name, v in data['parameters'].items() if v['at_bound']]
    if ends:
        yield (
            f'{some(ends)} {"ends" if len(ends) == 1 else "end"} at a bound of the search: the '
            'effect is larger than any looked for, or stands in for another cause.'
        )


# ---------------------------------------------------------------------- what to do now


def law_of(at: Mapping[str, Any], parameters: Mapping[str, Any]) -> Law | None:
    """Return an effect as an equation with its numbers; None where the catalogue has it no more.

    Args:
        at: The effect and its place, as in `diagnosis.json`.
        parameters: All parameters of the model that holds it.
    """
    effect = CATALOGUE.get(at['effect'])
    if effect is None:
        return None
    place = '' if at['where'] == ['all'] else f'{at["where"][0]}.'
    rows = []
    for p in effect.parameters:
        v = parameters.get(f'{place}{effect.id}.{p.name}')
        if v is not None:
            rows.append((p.symbol, p.name.replace('_', ' '), _value(v)))
    return Law(effect.id, effect_name(at), effect.equation, tuple(rows))


def _value(v: Mapping[str, Any]) -> str:
    text = quantity(v['value'], v['unit'], 3)
    if None in (v['low'], v['high'], v['value']):
        return text
    half = 0.5 * (v['high'] - v['low'])
    if half > abs(v['value']):
        return f'{text}, not determined'
    return f'{number(v["value"], 3)} ± {quantity(half, v["unit"], 2)}'


def _steps(data: Mapping[str, Any], out: str) -> Iterator[Step]:
    found = effects_found(data)
    if found:
        yield from _steps_of_effects(data, found, out)
    elif data['verdict']['effect'] == 'none':
        yield Step('Use the parameters: no effect has to be added to the simulation.')
        yield Step('Identify them on all of the recording:', code=_identify(data, out))
    elif data['verdict']['effect'] in REFUSALS:
        settings = data['settings']
        check = f'{_bags(settings, data["provenance"]["source"])} {_machine(settings)}'
        yield Step(REFUSALS[data['verdict']['effect']][1], code=f'ident check {check}')
    else:
        where = data['verdict']['where']
        alone = 'the machine' if not where or 'all' in where else f'{" and ".join(where)} alone'
        yield Step(
            f'Look at where the gap lies, below. Record {alone}, slowly and in both directions.'
        )
        yield Step('Then judge on that recording:', code=_diagnose(data, out))
        yield Step(
            'If you know the cause, write it as an effect of your own and try it with '
            '`--effect FILE.py`.'
        )


def _steps_of_effects(
    data: Mapping[str, Any], found: Sequence[Mapping[str, Any]], out: str
) -> Iterator[Step]:
    laws = [law for at in found if (law := law_of(at, data['parameters'])) is not None]
    yield Step('Add to your simulation:', laws=tuple(laws))
    if data['machine_lines']:
        yield Step('Change the machine file:', code='\n'.join(data['machine_lines']))
    values = [_line(name, data) for name in sentences.moved_names(data)]
    if values:
        them = 'it' if len(found) == 1 else 'them'
        more = '' if len(values) <= VALUES else ' (all of them in the table below)'
        yield Step(
            f'Take over the parameters that were off without {them}{more}:',
            code='\n'.join(values[:VALUES]),
        )
    motions = list(dict.fromkeys(_motions(data)))
    if motions:
        rivals = '; from '.join(motions)
        text = f'Record what tells it from {rivals}. Then judge on that recording:'
        yield Step(text, code=_diagnose(data, out))
    else:
        text = 'Record another motion, and see that the gap closes there, too:'
        yield Step(text, code=_diagnose(data, out))


def _line(name: str, data: Mapping[str, Any]) -> str:
    """Return a parameter as YAML, with what it was before."""
    v, before = data['parameters'][name], data['nominal'].get(name)
    value, old = (_plain(x) for x in (v['value'], before))
    unit = '' if v['unit'] == '1' else f'{v["unit"]}; '
    return f'{name}: {value}  # {unit}{old} before'


def _plain(value: float) -> str:
    """Return a number with four digits as YAML reads one."""
    rounded = float(f'{value:.4g}')
    return f'{rounded:.0f}' if 1e3 <= abs(rounded) < 1e9 else digits(rounded)


def _motions(data: Mapping[str, Any]) -> Iterator[str]:
    for other in data['confusable'][1:]:
        effect: Effect | None = CATALOGUE.get(other['effect'])
        if effect is not None:
            motion = effect.separated_by.format(drive=_places(other['where']))
            yield f'{effect.title}: {motion}'


def _diagnose(data: Mapping[str, Any], out: str) -> str:
    settings, source = data['settings'], data['provenance']['source']
    return (
        f'ident diagnose {_bags(settings, source)} --check NEW_BAG {_machine(settings)} '
        f'--out {_next(out)}'
    )


def _identify(data: Mapping[str, Any], out: str) -> str:
    settings, source = data['settings'], data['provenance']['source']
    bags, machine = _bags(settings, source), _machine(settings)
    return f'ident identify {bags} {machine} --out {shlex.quote(out)}'


def _bags(settings: Mapping[str, Any], source: str) -> str:
    bags = settings.get('bags') or [source or 'BAG']
    return ' '.join(shlex.quote(str(bag)) for bag in bags)


def _machine(settings: Mapping[str, Any]) -> str:
    return f'--machine {shlex.quote(str(settings.get("machine_file") or "MACHINE.yaml"))}'


def _next(out: str) -> str:
    return shlex.quote(f'{out}_next')


# ---------------------------------------------------------------------- an identification


def of_identification(result: Identification, out: str) -> Answer:
    """Return the first screen of an identification without a diagnosis.

    Args:
        result: The identification.
        out: The directory it lies in.
    """
    doubts = [*sentences.doubts(result), *joined(result.quality.warnings)]
    level: sentences.Level = 'bad'
    if result.outcome is Outcome.IDENTIFIED:
        level = 'doubtful' if doubts else 'good'
    longest = max((x.rms for x in result.residuals), default=1.0) or 1.0
    gaps = [
        Gap(
            x.drive,
            quantity(x.rms, x.unit or result.cost.unit, 3),
            percent(x.share),
            x.rms / longest,
            None,
            None,
        )
        for x in sorted(result.residuals, key=lambda x: -x.rms)
    ]
    more = len(gaps) - LISTED
    return Answer(
        level,
        sentences.headline(result),
        tuple(sentences.precision_of(result)),
        tuple(gaps[:LISTED]),
        (f'{more} more in the file `result.json`.',) if more > 0 else (),
        tuple(_steps_of_identification(result, out)),
        tuple(doubts),
        tuple(_values(result)),
    )


def _values(result: Identification) -> Iterator[tuple[str, str, str]]:
    for p in result.parameters[:PARAMETERS]:
        known = precision(sentences.width(p)) if p.identifiable else 'not determined'
        yield p.name, quantity(p.value, p.unit, 4), known


def _steps_of_identification(result: Identification, out: str) -> Iterator[Step]:
    if result.outcome is Outcome.IDENTIFIED:
        yield Step('Use the values of the table below.')
    bags = _bags(result.settings, result.provenance.source)
    yield Step(
        'Ask what the model lacks; the intervals hold only where it lacks nothing:',
        code=f'ident diagnose {bags} {_machine(result.settings)} --out {shlex.quote(out)}',
    )
