# SPDX-License-Identifier: Apache-2.0
"""The verdict of a diagnosis with its evidence, and the next steps."""

from collections.abc import Iterable, Iterator, Sequence
import math

from ros2_ident.effects import get_effect
from ros2_ident.gap.diagnosis import Diagnosis
from ros2_ident.gap.facts import Cause, Event, Facts, WrongConstant
from ros2_ident.models import EffectAt
from ros2_ident.words.figures import compared, figure, in_travel, length

# Share of the resampled blocks in which an effect has to count to be more than a hint.
OFTEN = 0.9
# A gap below this share of the measured output is called small.
_SMALL = 0.01


def of_output(share: float, unit: str) -> str:
    """Return a gap as a share of the measured output."""
    return f'{figure(100.0 * share)} % of the {compared(unit)}'


def small(shares: Iterable[float], unit: str) -> str:
    """Return that the gap is small; empty where a drive's is not.

    Args:
        shares: Of each drive, the gap over the measured output, RMS.
        unit: Unit of the output.
    """
    worst = max(shares, default=math.inf)
    return f'The gap is small, {of_output(worst, unit)}.' if worst < _SMALL else ''


def events(found: Sequence[Event], unit: str) -> str:
    """Return effort that was not commanded: by drive, instants and sizes."""
    several = len({e.recording for e in found}) > 1 or any(e.recording > 1 for e in found)
    by_drive: dict[str, dict[int, list[str]]] = {}
    for e in found:
        at = f'{e.time:.2f} s ({figure(e.effort, "+")} {unit})'
        by_drive.setdefault(e.drive, {}).setdefault(e.recording, []).append(at)
    made = '; '.join(
        f'{drive} at '
        + ', '.join(
            ', '.join(at) + (f' in recording {number}' if several else '')
            for number, at in parts.items()
        )
        for drive, parts in by_drive.items()
    )
    return (
        f'{made}. No effect of a machine does that: look for another source of commands, contact '
        'with a person or an object, or a fault of the drive.'
    )


def slow(floors: Iterable[tuple[str, float]], unit: str) -> str:
    """Return a residual too large and too slow for noise: by drive, RMS [unit]."""
    left = ', '.join(f'{v:.3g} {unit} on {name}' for name, v in floors)
    return (
        f'{left}, independent of effects, motion, position and time: an external force or an '
        'unmodelled load. Look for a load that swings, a frame that rocks, other axes or contact, '
        'and state effort_noise as measured at rest.'
    )


def hidden(gaps: Iterable[tuple[str, float]], unit: str) -> Iterator[str]:
    """Yield the gap that slow noise can hide, by drive, RMS [unit]."""
    sizes = {name: f'{v:.2g} {unit}'.strip() for name, v in gaps}
    if sizes:
        yield (
            f'The residual of {", ".join(sizes)} is so slow that it can be noise or a gap of up '
            f'to {", ".join(sizes.values())}: record longer, or the same motion twice.'
        )


def at_bounds(names: Sequence[str]) -> str:
    """Return which sizes of effects ended at a bound of their search."""
    return (
        f'{_bound(names)}: the effect is larger than the search allows, or replaces another '
        'cause. Check the unit of the effort and the constants of the machine file, or exclude '
        'the effect.'
    )


def _bound(names: Sequence[str]) -> str:
    ends = 'ends at a bound' if len(names) == 1 else 'end at bounds'
    return f'{", ".join(names)} {ends} of the search'


def not_visible(effects: Sequence[EffectAt]) -> str:
    """Return which effects a motion cannot show, for a sentence about it."""
    places: dict[str, list[str]] = {}
    for at in effects:
        places.setdefault(get_effect(at.effect).title, []).append(_place(at.where))
    titles = ', '.join(f'{title} ({", ".join(where)})' for title, where in places.items())
    return f'cannot show: {titles}.'


def _place(where: str) -> str:
    return 'the machine' if where == 'all' else where


def sentence(d: Diagnosis) -> str:
    """Return the verdict with its evidence."""
    facts, evidence = d.facts, d.evidence
    refused = facts.cause in (Cause.LOG, Cause.CONSTANT, Cause.MODEL)
    text = 'No effect is named.' if refused else _answer(d)
    if facts.cause == Cause.NONE and d.not_testable:
        text = f'{text[:-1]}; this motion {not_visible(d.not_testable)}'
    if not refused:
        text += ''.join(
            f' Alternatively, {c.key} of the machine file is wrong: {c.value:.4g} '
            f'[{c.low:.4g}, {c.high:.4g}] {c.unit} closes as much.'
            for c in facts.constants
        )
    first = ''
    if evidence['size'] >= evidence['material'] and not refused:
        first = small((g.share_of_output for g in d.per_drive.values()), d.unit)
    ends = [name for name, v in d.parameters.items() if v.at_bound]
    bound = _bound(ends) + '.' if ends else ''
    return ' '.join(filter(None, (_first(d), first, text, bound)))


def _first(d: Diagnosis) -> str:
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
    if facts.leads is None:
        return ''
    more = len(facts.contradictions) - 1
    text = d.gates[facts.leads].sentence.rstrip('.')
    return f'{text}.' + (f' ({more} more like it below.)' if more else '')


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
    return (
        f'{c.key} is {c.stated:.4g}{unit} in the machine file, and '
        f'{c.value:.4g} [{c.low:.4g}, {c.high:.4g}]{unit}'
    )


def _answer(d: Diagnosis) -> str:
    facts, evidence, unit = d.facts, d.evidence, d.unit
    size = evidence['size']
    floors = [g.noise_floor for g in d.per_drive.values()]
    level = f'{sum(floors) / len(floors):.4g} {unit}'
    share = of_output(d.per_drive[facts.worst].share_of_output, unit)
    gap = f'{size:.2f} times the noise floor, {share}'
    if facts.cause == Cause.NONE and size < evidence['material']:
        return (
            f'Nothing is missing: the largest gap of a drive is {size:.2f} times the noise floor '
            f'({level}), below the {evidence["material"]:.2g} that counts.'
        )
    if facts.cause == Cause.NONE:
        return (
            f'Nothing can be named: the largest gap of a drive is {gap} '
            f'({level}), and no effect of the catalogue closes enough of it to count.'
        )
    if facts.cause == Cause.EVENTS:
        made = events(facts.events, facts.effort_unit)
        return f'Effort was produced that was not commanded: {made}'
    if facts.cause == Cause.SLOW:
        left = slow(facts.slow.items(), unit)
        return f'The residual is too large and too slow for noise: {left}'
    if facts.cause == Cause.CUT_SHORT:
        return f'The run was cut short: a gap of {gap} ({level}), no cause found yet.'
    if facts.cause == Cause.UNKNOWN:
        return (
            f'Something is missing that is not in the catalogue: the gap on '
            f'{", ".join(d.where)} is {gap}, and the best of '
            f'{facts.tried} candidates closes {100.0 * facts.best:.0f} % of it.'
        )
    rest = ''.join(
        f' {drive} reads its position in steps of {length(step, of)}: commands of its controller '
        'have that period. No simulation can repeat their course, so it does not count as closed.'
        for drive, (step, of) in facts.steps.items()
    )
    rest += ''.join(
        f' The logged effort of {drive} stays at about {limit:.3g} {facts.effort_unit} where '
        'its control law asks for more. No constant limit repeats its course, so it does not '
        'count as closed.'
        for drive, limit in facts.limits.items()
    )
    if not rest and evidence['remaining'] >= evidence['unexplained']:
        rest = f' {evidence["remaining"]:.2f} times the noise floor remains unexplained.'
    places: dict[str, list[str]] = {d.effect: [*d.where]}
    for at in d.also:
        places.setdefault(at.effect, []).append(at.where)
    named = ', then '.join(f'{get_effect(e).title} on {", ".join(w)}' for e, w in places.items())
    # One share, on data held out; these may show no gap at all, then of all data.
    share_closed = d.share_closed.value if len(d.steps) > 1 else evidence['closed']
    if not math.isfinite(share_closed):
        share_closed = min(max(evidence['closed'], 0.0), 1.0)
    return f'{named}: closes {100 * share_closed:.0f} % of a gap of {gap}.{rest}'


def advice(d: Diagnosis) -> tuple[str, ...]:
    """Return the next steps: motions that tell effects apart, and limits of this motion."""
    return tuple(_advice(d))


def _advice(d: Diagnosis) -> Iterator[str]:
    facts = d.facts
    ends = [name for name, v in d.parameters.items() if v.at_bound]
    if ends:
        yield at_bounds(ends)
    named = (EffectAt(d.effect, d.where[0]), *d.also) if facts.cause == Cause.EFFECT else ()
    for at, share in zip(named, d.again, strict=False):
        if share < OFTEN:
            yield (
                f'{at.title} counts in only {100.0 * share:.0f} % of the resampled blocks held '
                'out: treat it as a hint and record another log before acting on it.'
            )
    yield from hidden(facts.hidden.items(), d.unit)
    for other in d.confusable[1:]:
        motion = get_effect(other.at.effect).separated_by.format(drive=_place(other.at.where))
        one, two = (get_effect(x.at.effect).title for x in (d.confusable[0], other))
        motion = in_travel(motion, *facts.travel)
        yield f'{one} and {two} cannot be told apart on this data; {motion}.'
    if facts.cause == Cause.EVENTS:
        yield 'Exclude these instants, by windows or in another recording, to see other causes.'
    elif facts.cause == Cause.UNKNOWN and d.probability > 0.0:
        yield (
            'No effect of the catalogue explains the gap; look at the localisation, and isolate '
            'the drive named there with slow, single-drive motions both ways.'
        )
    if d.not_testable and facts.cause != Cause.NONE:
        yield f'This motion {not_visible(d.not_testable)}'
