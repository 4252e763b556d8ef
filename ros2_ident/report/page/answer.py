# SPDX-License-Identifier: Apache-2.0
"""The first screen: what is wrong, how sure that is, how far the gap closes, what to do now."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
import math
from typing import Literal

import numpy as np

from ros2_ident.effects import title_at
from ros2_ident.gap.result import Cause, Diagnosis
from ros2_ident.gap.verdict import REFUSED
from ros2_ident.gates import sentences as sentences_of
from ros2_ident.identify.result import Identification, Outcome
from ros2_ident.report.diagnosis import Written
from ros2_ident.report.page import steps
from ros2_ident.report.page.numbers import (
    from_to,
    number,
    percent,
    precision,
    quantity,
    some,
    unit_of,
    UNKNOWN,
    width,
)
from ros2_ident.report.page.steps import Step
from ros2_ident.words import verdict as words
from ros2_ident.words.figures import capital, compared
from ros2_ident.words.identification import at_bounds, determined, message, undetermined

Level = Literal['good', 'doubtful', 'bad']

# What the colour of the answer's edge says.
STATES: Mapping[Level, str] = {
    'good': 'Clear answer',
    'doubtful': 'Answer with reservations',
    'bad': 'No clear answer yet',
}
# A gap left above the noise, in units of the noise floor, that wants a cause of its own.
UNEXPLAINED = 1.0
# A share that is as good as all.
NEARLY_ALL = 0.995
# Half an interval over the value from which a parameter is called badly known.
WIDE = 0.2
# Correlations from here on are said in words.
CLOSE = 0.95


@dataclass(frozen=True)
class Gap:
    """One drive's residual.

    Attributes:
        size: RMS in the machine's unit, before and after where something closes it.
        share: The same as a share of what is compared, an effort or a position.
        before: Length of a bar, 0 to 1.
        after: Likewise; None where nothing closes it.
        floor: Likewise, the noise floor; None where it is not known.
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
        gaps: How far the gap closes, for the drives that matter most.
        careful: What else to know, the most important first.
        first: What has to be said before anything else.
    """

    level: Level
    headline: str
    sure: tuple[str, ...]
    gaps: tuple[Gap, ...]
    closes: tuple[str, ...]
    steps: tuple[Step, ...]
    careful: tuple[str, ...] = ()
    first: tuple[str, ...] = ()
    state: str = ''
    compared: str = 'effort'


def of_diagnosis(w: Written, out: str) -> Answer:
    """Return the first screen of a diagnosis."""
    d, careful = w.found, tuple(_careful(w.found))
    first: tuple[str, ...] = ()
    if d.effect not in REFUSED:
        first = tuple(sentences_of(g for g in d.gates if g.level == 'fail'))
    answered = d.effect == 'none' or words.named(d)
    level: Level = 'bad'
    if d.complete and answered and not first:
        doubtful = careful or _unexplained(d) or len(d.confusable) > 1
        level = 'doubtful' if doubtful else 'good'
    state = STATES[level]
    if first:
        state = 'Correct this first:'
    elif d.facts.cause == Cause.EVENTS:
        state = 'The cause is beside the machine and its command'
    sure, gaps, closes = tuple(_sure(d)), tuple(_gaps(d)), tuple(_closes(d))
    todo, of = tuple(steps.of_diagnosis(w, out)), compared(d.unit)
    headline = words.headline(d)
    return Answer(level, headline, sure, gaps, closes, todo, careful, first, state, of)


def _sure(d: Diagnosis) -> Iterator[str]:
    facts_only = d.facts.cause in (Cause.SLOW, Cause.EVENTS)
    if d.effect not in REFUSED and (d.complete or d.probability):
        chance = 'Over 99 %' if d.probability > 0.99 else percent(d.probability)
        of = f'this is the cause, and {words.place(d.where)} the place'
        if d.effect == 'none':
            of = 'nothing larger is missing' + ', as far as noise can tell' * bool(d.facts.hidden)
        elif d.effect == 'unknown':
            of = 'it is no noise' if facts_only else 'the cause is none of the effects tried'
        elif d.also:
            of = f'{title_at(d.effect, d.where)}, found first, is a cause'
        yield f'{chance} that {of}.'
    if d.effect in REFUSED or facts_only:
        yield words.sentence(d)
    rivals = [r.at.title for r in d.confusable[1:]]
    if rivals:
        yield f'This recording cannot tell it from {some(rivals)}.'
    yield words.judged_on(d.held_out)


def _gaps(d: Diagnosis) -> Iterator[Gap]:
    """Yield the gap of each drive, in the machine's order."""
    drives = {n: g for n, g in d.per_drive.items() if math.isfinite(g.before)}
    longest = max((max(g.before, g.after) for g in drives.values()), default=1.0)
    for name, g in drives.items():
        note = ''
        # the gap's square is the residual's less the noise's
        if g.before**2 - g.noise_floor**2 < (d.evidence['material'] * g.noise_floor) ** 2:
            note = 'too slow for noise' if name in d.facts.slow else 'noise only'
        floor = min(1.0, g.noise_floor / longest) if math.isfinite(g.noise_floor) else None
        size, part, after = quantity(g.before, d.unit, 3), percent(g.shares[0]), None
        if len(d.steps) > 1 and math.isfinite(g.after) and not note:
            size = f'{from_to(g.before, g.after)} {unit_of(d.unit)}'
            part = f'{from_to(*(100.0 * x for x in g.shares))} %'
            after = g.after / longest
        yield Gap(name, size, part, g.before / longest, after, floor, note)


def _closes(d: Diagnosis) -> Iterator[str]:
    closed = d.share_closed
    if len(d.steps) > 1 and math.isfinite(closed.value):
        said = 'Nearly all' if closed.value >= NEARLY_ALL else percent(closed.value)
        told = ''
        if closed.low < NEARLY_ALL and math.isfinite(closed.high):
            told = f' (95 % interval: {number(100.0 * closed.low, 2)} to {percent(closed.high)})'
        yield f'{said} of the gap’s power, its square less the noise’s, closes{told}.'
        if _unexplained(d):
            yield 'No effect of the catalogue explains the rest.'


def _unexplained(d: Diagnosis) -> bool:
    return bool(words.named(d)) and d.evidence['remaining'] >= UNEXPLAINED


def _warned(text: str) -> str:
    """Return a warning with a capital; what begins with a name or a path stays."""
    return capital(text) if text.partition(' ')[0].isalpha() else text


def _careful(d: Diagnosis) -> Iterator[str]:
    if not d.complete:
        yield 'The run was cut short: effects not tried by then may close more of the gap.'
    yield from words.hidden(d)
    told = ('not_asked',) if d.facts.events else ()
    odd = [
        g
        for k, g in enumerate(d.gates)
        if k != d.facts.leads and g.level == 'warn' and g.gate not in told
    ]
    yield from map(_warned, sentences_of(odd))
    yield from words.at_bounds(d)


def of_identification(result: Identification, out: str) -> Answer:
    """Return the first screen of an identification without a diagnosis."""
    # Where nothing is identified there is nothing to doubt one by one.
    named = () if result.outcome is Outcome.CONTRADICTED else _doubts(result)
    doubts = [*named, *map(_warned, result.quality.warnings)]
    level: Level = 'bad'
    if result.outcome is Outcome.IDENTIFIED:
        level = 'doubtful' if doubts else 'good'
    closes = [f'Held out: {result.validated_on}.'] if result.validation else []
    # Bounds are said one by one.
    loose = undetermined(result.parameters)
    said, told = f'{determined(result.parameters)}.', [f'Not determined: {loose}.'] * bool(loose)
    plain = result.outcome in (Outcome.IDENTIFIED, Outcome.NOT_IDENTIFIABLE)
    if not plain or result.rival or any(gate.contradicts for gate in result.gates):
        said, told = message(result), []
    # of the first drive where they differ
    unit = next((x.unit for x in result.residuals if x.unit), result.cost.unit)
    sure, gaps, state = tuple(told), tuple(_left(result)), STATES[level]
    todo, careful = tuple(steps.of_identification(result, out)), tuple(doubts)
    of = compared(unit)
    return Answer(level, said, sure, gaps, tuple(closes), todo, careful, (), state, of)


def _doubts(result: Identification) -> Iterator[str]:
    """Yield what to be careful about in the parameters."""
    yield from filter(None, [at_bounds(result.parameters)])
    loose = [p.name for p in result.parameters if not p.identifiable and not p.at_bound]
    # Of such an outcome the headline says it.
    if loose and result.outcome is not Outcome.NOT_IDENTIFIABLE:
        yield f'This recording does not determine {some(loose)}.'
    known = [p for p in result.parameters if p.identifiable and not p.at_bound]
    wide = [f'{p.name} {precision(p)}' for p in known if WIDE < width(p) <= UNKNOWN]
    if wide:
        yield f'Poorly known: {some(wide)}.'
    close = np.nan_to_num(np.triu(result.correlation, 1))
    pairs = np.argwhere(np.abs(close) >= CLOSE).tolist()
    if pairs:
        told = [
            f'{result.parameters[i].name} and {result.parameters[j].name} '
            f'({number(float(close[i, j]), 2)})'
            for i, j in sorted(pairs, key=lambda at: -abs(close[*at]))
        ]
        yield (
            f'This motion hardly separates {some(told)}; correlations in brackets. Record another '
            'motion, or hold one of the two at a known value.'
        )


def _left(result: Identification) -> Iterator[Gap]:
    """Yield what an identification leaves of each drive, the largest first."""
    longest = max((x.rms for x in result.residuals), default=1.0) or 1.0
    unseen = {x.drive: f'held out {percent(x.share)}' for x in result.validation}
    for x in sorted(result.residuals, key=lambda x: -x.rms):
        size, note = quantity(x.rms, x.unit or result.cost.unit, 3), unseen.get(x.drive, '')
        yield Gap(x.drive, size, percent(x.share), x.rms / longest, None, None, note)
