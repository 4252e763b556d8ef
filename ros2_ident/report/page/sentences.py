# SPDX-License-Identifier: Apache-2.0
"""The answer in sentences: what was found, and what to be careful about."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
import math
from typing import Any, Literal

import numpy as np

from ros2_ident.effects import CATALOGUE
from ros2_ident.gap.verdict import NAMELESS, NONE
from ros2_ident.identify.result import Identification, Outcome, ParameterEstimate

Level = Literal['good', 'doubtful', 'bad', 'plain', 'warning']

RAISED = str.maketrans('0123456789-', '⁰¹²³⁴⁵⁶⁷⁸⁹⁻')
# Half an interval over the value from which a parameter is called badly known.
WIDE = 0.2
# Correlations from here on are said in words.
CLOSE = 0.95
# A parameter that an effect moves by so much of its value is named.
MOVED = 0.05
# Pairs, parameters or effects that one sentence lists.
LISTED = 6


@dataclass(frozen=True)
class Sentence:
    """A sentence and how it is meant."""

    level: Level
    text: str


def number(value: float | None, digits: int = 5) -> str:
    """Return a number for people, powers of ten where it is far from one; a dash for none."""
    if value is None or not math.isfinite(value):
        return '–'
    rounded = float(f'{value:.{digits - 1}e}')
    exponent = math.floor(math.log10(abs(rounded))) if rounded else 0
    if not -5 < exponent < 7:
        text = f'{rounded / 10.0**exponent:.{digits}g}·{raised(exponent)}'
    else:
        text = f'{rounded:.{max(0, digits - 1 - exponent)}f}'
        if '.' in text:
            text = text.rstrip('0').rstrip('.')
    return text.replace('-', '−')


def raised(power: int) -> str:
    """Return a power of ten as it is printed; nothing for the power 0."""
    return f'10{str(power).translate(RAISED)}' if power else ''


def unit_of(unit: str) -> str:
    """Return a unit as it is printed; nothing for a ratio."""
    return '' if unit == '1' else unit.replace('^2', '²').replace('^3', '³')


def quantity(value: float | None, unit: str, digits: int = 5) -> str:
    """Return a number with its unit."""
    return f'{number(value, digits)} {unit_of(unit)}'.rstrip()


def percent(share: float | None) -> str:
    """Return a share in percent, two digits."""
    return '–' if share is None or not math.isfinite(share) else f'{number(100.0 * share, 2)} %'


def width(estimate: ParameterEstimate) -> float:
    """Return half the interval over the size of the value; NaN or infinity where unknown."""
    half = 0.5 * (estimate.high - estimate.low)
    return half / abs(estimate.value) if estimate.value else math.inf


def effect_name(at: Mapping[str, Any]) -> str:
    """Return an effect at its place; `all` is the machine as a whole."""
    effect = CATALOGUE.get(at['effect'])
    title = effect.title if effect else str(at['effect'])
    where = [w for w in at['where'] if w != 'all']
    return f'{title} on {", ".join(where)}' if where else title


def some(names: list[str]) -> str:
    """Return a list in words, the end of a long one as its length."""
    more = len(names) - LISTED
    return ', '.join(names[:LISTED]) + (f' and {more} more' if more > 0 else '')


def of_identification(result: Identification) -> list[Sentence]:
    """Return what an identification says, the answer first."""
    # What follows the first sentence is about bounds, which are said below one by one.
    headline, _, rest = result.message.partition('. ')
    if rest and not any(p.at_bound for p in result.parameters):
        headline = result.message
    # Where nothing is identified there is nothing to doubt one by one.
    doubts = () if result.outcome is Outcome.CONTRADICTED else _doubts(result)
    warnings = [*doubts, *result.quality.warnings]
    level: Level = 'bad'
    if result.outcome is Outcome.IDENTIFIED:
        level = 'doubtful' if warnings else 'good'
    out = [Sentence(level, headline.rstrip('.') + '.')]
    left = [
        f'{quantity(x.rms, x.unit or result.cost.unit, 3)} on {x.drive} '
        f'({percent(x.share)} of the {"log" if x.unit else "effort"})'
        for x in result.residuals
    ]
    if left:
        out.append(Sentence('plain', f'The simulation leaves {", ".join(left)}, RMS.'))
    out += _precision(result)
    return out + [Sentence('warning', text) for text in warnings]


def _precision(result: Identification) -> list[Sentence]:
    known = [p for p in result.parameters if p.identifiable and math.isfinite(width(p))]
    if not known:
        return []
    best, worst = min(known, key=width), max(known, key=width)
    text = f'No parameter is known better than ± {percent(width(best))} ({best.name})'
    if worst is not best:
        text += f'; the least well known is known to ± {percent(width(worst))} ({worst.name})'
    return [Sentence('plain', f'{text}. These are 95 % intervals.')]


def _doubts(result: Identification) -> Iterator[str]:
    for p in result.parameters:
        if p.at_bound:
            lower = abs(p.value - p.lower_bound) <= abs(p.value - p.upper_bound)
            yield (
                f'{p.name} is at its {"lower" if lower else "upper"} bound, '
                f'{quantity(p.value, p.unit)}: the true value may lie beyond. Check the bounds '
                'in the machine file.'
            )
    loose = [p.name for p in result.parameters if not p.identifiable and not p.at_bound]
    if loose:
        yield f'This data does not determine {some(loose)}: the values mean little.'
    wide = [
        f'{p.name} ± {percent(width(p))}'
        for p in result.parameters
        if p.identifiable and not p.at_bound and WIDE < width(p) < math.inf
    ]
    if wide:
        yield f'Badly known: {some(wide)}.'
    pairs = correlated(result)
    if pairs:
        told = [f'{a} with {b} ({number(r, 2)})' for a, b, r in pairs]
        yield (
            f'This motion hardly tells apart: {some(told)}. In brackets the correlation of the '
            'estimates; another motion, or one of the two held at a known value, tells them apart.'
        )


def _chance(probability: float | None) -> str:
    if probability is not None and probability > 0.99:
        return 'over 99 %'
    return percent(probability)


def correlated(result: Identification) -> list[tuple[str, str, float]]:
    """Return pairs of parameters with a close correlation, the closest first."""
    names = [p.name for p in result.parameters]
    upper = np.triu(result.correlation, 1)
    rows, columns = np.nonzero(np.abs(np.nan_to_num(upper)) >= CLOSE)
    pairs = [
        (names[i], names[j], float(upper[i, j])) for i, j in zip(rows, columns, strict=True)
    ]
    return sorted(pairs, key=lambda pair: -abs(pair[2]))


def _left(name: str, data: Mapping[str, Any]) -> bool:
    """Whether a parameter's nominal value is outside its interval with the effects."""
    found, before = data['parameters'][name], data['nominal'].get(name)
    ends = [before, found['low'], found['high']]
    return None in ends or not found['low'] <= before <= found['high']


def of_diagnosis(data: Mapping[str, Any]) -> list[Sentence]:
    """Return what a diagnosis says, the answer first.

    Args:
        data: The content of `diagnosis.json`.
    """
    verdict = data['verdict']
    out: list[Sentence] = []
    if not data['complete']:
        out.append(
            Sentence(
                'warning',
                'The diagnosis was cut short: effects it had not tried by then may close more of '
                'the gap.',
            )
        )
    rivals = [effect_name(x) for x in data['confusable'][1:]]
    if rivals:
        out.append(Sentence('warning', f'This log cannot tell it from: {some(rivals)}.'))
    out += [
        Sentence('warning', gate['sentence'])
        for gate in data['gates']
        if gate['level'] != 'ok' and gate['sentence'] not in verdict['sentence']
    ]
    moved = [
        f'{name} by {percent(share)}'
        for name, share in data['moved'].items()
        if share is not None and abs(share) >= MOVED and _left(name, data)
    ]
    if moved and verdict['effect'] not in NAMELESS:
        out.append(
            Sentence(
                'warning',
                'Without the effects in the model the parameters make up for them. With them '
                f'move: {some(moved)}.',
            )
        )
    level: Level = 'bad'
    if data['complete'] and verdict['effect'] not in NAMELESS - {NONE}:
        level = 'doubtful' if out else 'good'
    hidden = [effect_name(x) for x in data['not_testable']]
    if hidden:
        out.append(Sentence('plain', f'This motion cannot show: {some(hidden)}.'))
    said = f'{verdict["sentence"]} Probability {_chance(verdict["probability"])}.'
    return [Sentence(level, said), *out]
