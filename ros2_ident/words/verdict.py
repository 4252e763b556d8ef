# SPDX-License-Identifier: Apache-2.0
"""The verdict of a diagnosis with its evidence, and the next steps."""

from collections.abc import Iterable, Iterator, Sequence
import math
from typing import Any

from ros2_ident.effects import get_effect, title_at
from ros2_ident.gap.result import Cause, Diagnosis, Facts, NOISE, PARAMETERS, Tie, WrongConstant
from ros2_ident.gates import GateReport
from ros2_ident.gates.asked import Event
from ros2_ident.models import EffectAt
from ros2_ident.recording.limits import enumerated
from ros2_ident.words.figures import (
    capital,
    compared,
    figure,
    in_travel,
    interval,
    joined,
    length,
    quantity,
)
from ros2_ident.words.finding import instants

# A gap below this share of the measured output is called small.
_SMALL = 0.01
# A headline of more letters names the first effect only: three lines of a page.
_LONG = 110
# Odds "not worth more than a bare mention" (Kass, Raftery, J. Am. Stat. Assoc. 90, 1995).
_ODDS = 3.0
# Places that a sentence lists.
_LISTED = 6


def of_output(share: float, unit: str) -> str:
    """Return a gap as a share of the measured output."""
    return f'{figure(100.0 * share)} % of the {compared(unit)}'


def judged_on(held_out: str) -> str:
    """Return on which data a gap is judged, `check bag` or `blocks`."""
    data = 'another recording' if held_out == 'check bag' else 'every second block of 1 s'
    return f'Judged on data not used for fitting: {data}.'


def events(facts: Facts) -> str:
    """Return effort that was not commanded: by drive, instants and sizes."""
    drives: dict[str, list[Event]] = {}
    for e in facts.events:
        drives.setdefault(e.drive, []).append(e)
    unit = facts.effort_unit
    made = '; '.join(f'{drive} at {instants(each, unit)}' for drive, each in drives.items())
    return (
        f'{made}. No effect of a machine does that: look for another source of commands, contact '
        'with a person or an object, or a fault of the drive.'
    )


def slow(facts: Facts, unit: str) -> str:
    """Return a residual too large and too slow for noise: by drive, RMS [unit]."""
    left = ', '.join(f'{v:.3g} {unit} on {name}' for name, v in facts.slow.items())
    return (
        f'{left}, independent of effects, motion, position and time: an external force or an '
        'unmodelled load. Look for a load that swings, a frame that rocks, other axes or contact, '
        'and state effort_noise as measured at rest.'
    )


def hidden(d: Diagnosis) -> Iterator[str]:
    """Yield the gap that slow noise can hide, by drive, RMS."""
    sizes = {name: f'{v:.2g} {d.unit}'.strip() for name, v in d.facts.hidden.items()}
    if sizes:
        yield (
            f'The residual of {", ".join(sizes)} is so slow that it can be noise or a gap of up '
            f'to {", ".join(sizes.values())}: record longer, or the same motion twice.'
        )


def at_bounds(d: Diagnosis) -> Iterator[str]:
    """Yield which sizes of effects, and which parameters, ended at a bound of their search."""
    if ends := _at_bounds(d):
        yield (
            f'{ends}: the effect is larger than the search allows, or replaces another cause. '
            'Check the unit of the effort and the constants of the machine file, or exclude the '
            'effect.'
        )
    names = [name for name, v in d.parameters.items() if name in d.nominal and v.at_bound]
    if names:
        lie = 'lies' if len(names) == 1 else 'lie'
        yield (
            f'{enumerated(names, _LISTED)} {lie} at a bound of the machine file: what is missing '
            'may be what lies beyond; widen it.'
        )


def _at_bounds(d: Diagnosis) -> str:
    """Return which effects' parameters ended at a bound of their search; empty for none."""
    names = [name for name, v in d.parameters.items() if name not in d.nominal and v.at_bound]
    ends = 'ends at a bound' if len(names) == 1 else 'end at bounds'
    return f'{", ".join(names)} {ends} of the search' if names else ''


def unseen(effects: Iterable[EffectAt], drives: int) -> dict[str, str]:
    """Return effects that a motion cannot show, by title, with their places.

    Args:
        effects: Each at one place.
        drives: Number of drives.
    """
    places: dict[str, list[str]] = {}
    for at in effects:
        places.setdefault(title_at(at.effect), []).append(place([at.where]))
    return {
        title: 'any drive' if len(where) == drives > 1 else enumerated(where, _LISTED)
        for title, where in places.items()
    }


def _unseen(d: Diagnosis) -> str:
    listed = unseen(d.not_testable, len(d.per_drive)).items()
    return f'cannot show: {", ".join(f"{title} ({where})" for title, where in listed)}.'


def separating(rival: str, where: str, travel: Sequence[Any]) -> str:
    """Return the motion that tells an effect from another one.

    Args:
        travel: Unit of the drives' positions, and how many of them are a metre.
    """
    return in_travel(get_effect(rival).separated_by.format(drive=place([where])), *travel)


def place(where: Sequence[str]) -> str:
    """Return the drives of a verdict, or the machine."""
    return 'the machine' if not where or 'all' in where else joined(where)


def named(d: Diagnosis) -> tuple[EffectAt, ...]:
    """Return the effects that a verdict names, each at one place, the first first."""
    if d.facts.cause != Cause.EFFECT:
        return ()
    return (*(EffectAt(d.effect, where) for where in d.where), *d.also)


def worst(d: Diagnosis) -> tuple[str, ...]:
    """Return the drive with the largest gap over its noise floor; none where all is noise."""
    if not d.evidence['size'] >= d.evidence['material']:
        return ()
    return (max(d.per_drive, key=lambda name: d.per_drive[name].over_floor),)


def headline(d: Diagnosis) -> str:
    """Return the cause and its place; of many effects the first one, and how many more."""
    if d.facts.cause == Cause.MODEL:
        return 'The model is not the one of this machine: nothing physical can be said.'
    wrong = next(iter(d.facts.constants), None)
    if d.facts.cause == Cause.CONSTANT and wrong and math.isfinite(wrong.stated):
        return f'{_stated(wrong)} fits the log.'
    if d.facts.cause in (Cause.LOG, Cause.CONSTANT):
        return 'Log and machine file contradict each other: nothing physical can be said.'
    text, _ = _answer(d)
    missing = _titles(d, logged=False)
    if len(text) > _LONG and len(missing) > 1:
        more = len(missing) - 1
        text = _missing([missing[0], 'another effect' if more == 1 else f'{more} more effects'])
    return f'{_small(d)}{text}.'


def sentence(d: Diagnosis) -> str:
    """Return the verdict with its evidence."""
    facts = d.facts
    ends = _at_bounds(d)
    bound = f' {ends}.' if ends else ''
    if facts.cause in (Cause.LOG, Cause.CONSTANT, Cause.MODEL):
        return f'{_contradiction(d)} No effect is named.{bound}'
    text = ''.join(_answer(d))
    if facts.cause == Cause.NONE and d.not_testable:
        text = f'{text[:-1]}; this motion {_unseen(d)}'
    lead = 'Alternatively, ' if d.facts.cause == Cause.EFFECT else 'Or '
    text += ''.join(
        f' {lead}{c.key} of the machine file is wrong: {c.value:.4g} '
        f'{interval(c.value, c.low, c.high)} {c.unit} closes '
        f'{100.0 * min(c.closed, 1.0):.0f} % of the gap.'
        for c in facts.constants
    )
    return f'{_contradiction(d)} {_small(d)}{text}{bound}'.lstrip()


def _small(d: Diagnosis) -> str:
    """Return that a gap that counts is small; empty where it is not."""
    if d.evidence['size'] < d.evidence['material']:
        return ''
    drives = d.per_drive.values()
    worst = max((g.share_of_output for g in drives), default=math.inf)
    # of a load or a pressure that stays the same the share would be as small as that is large
    small = max([worst, *(g.share_of_change for g in drives)]) < _SMALL
    return f'The gap is small, {of_output(worst, d.unit)}. ' * small


def _answer(d: Diagnosis) -> tuple[str, str]:
    """Return the cause and its place, as the begin of a sentence, and its numbers."""
    facts, evidence, unit, where = d.facts, d.evidence, d.unit, place(d.where)
    cause, size = facts.cause, evidence['size']
    floors = [g.noise_floor for g in d.per_drive.values()]
    level = f'({sum(floors) / len(floors):.4g} {unit})'
    if cause == Cause.NONE and size < evidence['material']:
        limit = f'{evidence["material"] * max(floors):.2g} {unit}'
        shown = 'Nothing that this motion shows' if d.not_testable else 'Nothing'
        what = f'{shown} is missing: the residual is noise, in which a gap of {limit} would show'
        if facts.hidden:
            what = f'{shown} is missing above {limit}, but slow noise may hide more'
        shares = {x: g.noise_floor / (g.torque_rms or math.inf) for x, g in d.per_drive.items()}
        level = f'{level[:-1]}, at most {of_output(max(shares.values()), unit)})'
        # of their mean square
        if lost := [x for x, share in shares.items() if share**2 > 0.5]:
            of = f'nothing can be said of {joined(lost)}: neither the model nor what came before '
            of += f'explains most of its {compared(unit)}'
            what = capital(of) if len(lost) == len(shares) else f'{what}; {of}'
        return what, f'; the largest of a drive is {size:.2f} times the noise floor {level}.'
    share = of_output(d.per_drive[facts.worst].share_of_output, unit)
    gap = f'{size:.2f} times the noise floor, {share}'
    if cause in (Cause.NONE, Cause.UNKNOWN) and (tie := _tie(facts)):
        would, but = 'would', 'but'
        if tie.beside:
            would, but = f'and {tie.beside} more would together', 'but in its place'
        return (
            f'Something is missing on {where} that this motion cannot tell',
            f': the gap is {gap}. {capital(title_at(tie.effect, [tie.where]))} {would} close '
            f'{100.0 * min(tie.closed, 1.0):.0f} % of it, {but} {_instead(tie)} do about as well.',
        )
    if cause == Cause.NONE:
        return (
            'Nothing can be named: the gap is too small to tell its cause',
            f'; that of {facts.worst} is {gap} {level}, and no effect of the catalogue closes '
            'enough of it to count.',
        )
    if cause == Cause.EVENTS:
        return f'{where} produced effort that was not commanded', f': {events(facts)}'
    if cause == Cause.SLOW:
        what = f'The residual of {where} is too large and too slow for noise'
        return what, f': {slow(facts, unit)}'
    if cause == Cause.CUT_SHORT:
        what = f'The run was cut short: the cause of the gap on {where} is not found yet'
        return what, f'; it is {gap} {level}.'
    if cause == Cause.UNKNOWN:
        return (
            f'Something is missing on {where} that is not in the catalogue',
            f': the gap is {gap}, and the best of {facts.tried} candidates closes '
            f'{100.0 * facts.best:.0f} % of it.',
        )
    rest = ''.join(
        f' {drive} reads its position in steps of {length(step, of)}: commands of its controller '
        'have that period. No simulation can repeat their course, so it does not count as closed.'
        for drive, (step, of) in facts.steps.items()
    )
    rest += ''.join(
        f' The logged effort of {drive} stays at about {limit:.3g} {facts.effort_unit} where '
        'its control law asks for more; no constant limit repeats its course exactly.'
        for drive, limit in facts.limits.items()
    )
    if not rest and evidence['remaining'] >= evidence['unexplained']:
        rest = f' {evidence["remaining"]:.2f} times the noise floor remains unexplained.'
    # One share, on data held out; these may show no gap at all, then of all data.
    closed = d.share_closed.value if len(d.steps) > 1 else evidence['closed']
    if not math.isfinite(closed):
        closed = min(max(evidence['closed'], 0.0), 1.0)
    closes = 'they close' if d.also else 'it closes'
    what = _missing(_titles(d, logged=False), _titles(d, logged=True))
    if same := _as_likely(d):
        what = ', or '.join((what, *same)) + ', which this motion cannot tell from it'
    return what, f'; {closes} {100 * closed:.0f} % of a gap of {gap}.{rest}'


def _tie(facts: Facts) -> Tie | None:
    """Return what would close most, where the parameters do the same along this motion."""
    most = max(facts.ties, key=lambda tie: tie.closed, default=None)
    return most if most and most.closed > facts.best else None


def _as_likely(d: Diagnosis) -> list[str]:
    """Return what the effect named first may be as well; twins, one effect to any log, aside."""
    if not d.confusable:
        return []
    first = d.confusable[0]
    twins = get_effect(first.at.effect).twins
    return [
        title_at(x.at.effect, [] if x.at.where == first.at.where else [x.at.where])
        for x in d.confusable[1:]
        if x.at.effect not in twins and x.probability * _ODDS > first.probability
    ]


def _instead(tie: Tie) -> str:
    """Return what closes as much as an effect along this motion."""
    told = {
        PARAMETERS: 'other values of the parameters',
        NOISE: 'errors of the recorded positions and of their stamps',
    }
    names = [f'the {name}' for name in tie.like if name not in told]
    others = [text for name, text in told.items() if name in tie.like]
    return joined([*others, *([f'functions of {joined(names)}'] if names else [])])


def _missing(names: Sequence[str], logged: Sequence[str] = ()) -> str:
    """Return which effects the simulation lacks, and which are of the log alone."""
    if not names:
        return f'The log is off, not the simulation: {joined(logged)}'
    too = f'; the log is off, too: {joined(logged)}' if logged else ''
    verb = 'is' if len(names) == 1 else 'are'
    return f'{capital(joined(names))} {verb} missing in the simulation{too}'


def _titles(d: Diagnosis, *, logged: bool) -> list[str]:
    """Return the effects named with their places: those of the log, or those of the machine."""
    places: dict[str, list[str]] = {}
    for at in named(d):
        places.setdefault(at.effect, []).append(at.where)
    return [
        title_at(effect, where)
        for effect, where in places.items()
        if (get_effect(effect).group == 'measurement') == logged
    ]


def _contradiction(d: Diagnosis) -> str:
    """Return the contradiction of log and machine file; empty for none."""
    facts = d.facts
    if facts.misfit is not None:
        m = facts.misfit
        tried = 'with the effects that close most' if m.extended else 'with every effect'
        return (
            f'The model is not the one of this machine: {tried} its residual is '
            f'{100.0 * m.share:.0f} % of the variation of the {m.quantity} of {m.drive} '
            f'({m.rms:.3g} {d.unit}, {m.over_floor:.3g} times the noise floor).'
        )
    if facts.cause == Cause.CONSTANT:
        return _wrong(facts, d.evidence['size'])
    return '' if facts.leads is None else GateReport(d.gates).headline


def _wrong(facts: Facts, size: float) -> str:
    """Return the numbers of the machine file that are wrong."""
    first, *ties = facts.constants
    if math.isfinite(first.stated):
        return (
            f'{_stated(first)} fits the log and closes {100.0 * min(first.closed, 1.0):.0f} % of '
            f'a gap of {size:.2f} times the noise floor'
            + ''.join(f'; or {_stated(c)}, which closes as much' for c in ties)
            + '. Correct it in the file.'
        )
    if first.key == 'log_gain':
        return (
            f'The effort of every drive is {first.value:.4g} times that of the model: its unit or '
            'the torque constant is wrong; correct effort_unit or the constant behind it.'
        )
    return (
        f'{first.value:.4g} times the {first.key} of the machine file fits every drive: the '
        'constant is wrong there, or another unit is meant; correct it.'
    )


def _stated(c: WrongConstant) -> str:
    unit = '' if c.unit == '1' else f' {c.unit}'
    found = f'{c.value:.4g} {interval(c.value, c.low, c.high)}{unit}'
    return f'{c.key} is {quantity(c.stated, c.unit)} in the machine file, and {found}'


def advice(d: Diagnosis) -> Iterator[str]:
    """Yield the next steps: motions that tell effects apart, and limits of this motion."""
    facts = d.facts
    yield from at_bounds(d)
    yield from hidden(d)
    for other in d.confusable[1:]:
        one, two = (get_effect(x.at.effect).title for x in (d.confusable[0], other))
        motion = separating(other.at.effect, other.at.where, facts.travel)
        yield f'{one} and {two} cannot be told apart on this data; {motion}.'
    if facts.cause == Cause.EVENTS:
        yield 'Exclude these instants, by windows or in another recording, to see other causes.'
    elif facts.cause == Cause.UNKNOWN and (tie := _tie(facts)):
        yield f'Tell them apart: {separating(tie.effect, tie.where, facts.travel)}.'
    elif facts.cause == Cause.UNKNOWN and d.probability > 0.0:
        yield (
            'No effect of the catalogue explains the gap; look at the localisation, and isolate '
            'the drive named there with slow, single-drive motions both ways.'
        )
    if d.not_testable and facts.cause != Cause.NONE:
        yield f'This motion {_unseen(d)}'
