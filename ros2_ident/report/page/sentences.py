# SPDX-License-Identifier: Apache-2.0
"""Sentences of the page alone: precision, doubts, parameters that moved."""

from collections.abc import Iterator, Sequence
import math
from typing import Literal

import numpy as np

from ros2_ident.gap.diagnosis import Diagnosis
from ros2_ident.gap.localise import Finding
from ros2_ident.identify.result import Identification, Outcome, ParameterEstimate
from ros2_ident.recording.shown import enumerated
from ros2_ident.report.page.numbers import change, number, precision, UNKNOWN
from ros2_ident.words import verdict as words
from ros2_ident.words.figures import capital
from ros2_ident.words.finding import where
from ros2_ident.words.identification import at_bounds, determined, message, undetermined

Level = Literal['good', 'doubtful', 'bad']

# Half an interval over the value from which a parameter is called badly known.
WIDE = 0.2
# Correlations from here on are said in words.
CLOSE = 0.95
# A parameter that an effect moves by so much of its value is named; where only all numbers
# together are determined, one that moves by so much.
MOVED, MOVED_TOGETHER = 0.05, 0.005
# Pairs, parameters or effects that one sentence lists.
LISTED = 6
# Places of the gap that are told at once, and the share of a drive's gap that a further one has to
# explain beyond the drive's leading one.
LEADING, FURTHER = 3, 0.1


def width(estimate: ParameterEstimate) -> float:
    """Return half the interval over the size of the value; NaN or infinity where unknown."""
    half = 0.5 * (estimate.high - estimate.low)
    return half / abs(estimate.value) if estimate.value else math.inf


def some(names: Sequence[str]) -> str:
    """Return a list in words, the end of a long one as its length."""
    return enumerated(names, LISTED)


def warned(text: str) -> str:
    """Return a warning with a capital; what begins with a name or a path stays."""
    return capital(text) if text.partition(' ')[0].isalpha() else text


# ---------------------------------------------------------------------- identifications


def identified(result: Identification) -> tuple[str, str]:
    """Return how an identification ended, and which parameters it does not determine."""
    plain = result.outcome in (Outcome.IDENTIFIED, Outcome.NOT_IDENTIFIABLE)
    if not plain or result.rival or any(gate.contradicts for gate in result.gates):
        return message(result), ''
    # Bounds are said one by one.
    loose = undetermined(result.parameters)
    return f'{determined(result.parameters)}.', f'Not determined: {loose}.' if loose else ''


def precision_of(result: Identification) -> Iterator[str]:
    """Yield how well the parameters are known."""
    known = [p for p in result.parameters if p.identifiable and math.isfinite(width(p))]
    if not known:
        return
    best, worst = min(known, key=width), max(known, key=width)
    text = f'{best.name} is known best, to {precision(width(best))}'
    if worst is not best and width(worst) <= UNKNOWN:
        text += f'; {worst.name} least, to {precision(width(worst))}'
    yield f'{text} (95 % intervals).'


def doubts(result: Identification) -> Iterator[str]:
    """Yield what to be careful about in the parameters."""
    yield from filter(None, [at_bounds(result.parameters)])
    loose = [p.name for p in result.parameters if not p.identifiable and not p.at_bound]
    # Of such an outcome the headline says it.
    if loose and result.outcome is not Outcome.NOT_IDENTIFIABLE:
        yield f'This recording does not determine {some(loose)}.'
    known = [p for p in result.parameters if p.identifiable and not p.at_bound]
    wide = [f'{p.name} {precision(width(p))}' for p in known if WIDE < width(p) <= UNKNOWN]
    if wide:
        yield f'Poorly known: {some(wide)}.'
    pairs = correlated(result)
    if pairs:
        told = [f'{a} and {b} ({number(r, 2)})' for a, b, r in pairs]
        yield (
            f'This motion hardly separates {some(told)}; correlations in brackets. Record another '
            'motion, or hold one of the two at a known value.'
        )


def correlated(result: Identification) -> list[tuple[str, str, float]]:
    """Return pairs of parameters with a close correlation, the closest first."""
    names = [p.name for p in result.parameters]
    upper = np.triu(result.correlation, 1)
    rows, columns = np.nonzero(np.abs(np.nan_to_num(upper)) >= CLOSE)
    pairs = [(names[i], names[j], float(upper[i, j])) for i, j in zip(rows, columns, strict=True)]
    return sorted(pairs, key=lambda pair: -abs(pair[2]))


# ---------------------------------------------------------------------- diagnoses


def moved_names(d: Diagnosis, *, together: bool = False) -> list[str]:
    """Return the nominal parameters that had made up for the effects.

    Args:
        d: The diagnosis.
        together: Whether to return all that moved, for they are determined together only.
    """
    if not words.named(d):
        return []
    least = MOVED_TOGETHER if together else MOVED
    return [
        name
        for name, share in d.moved.items()
        if abs(share) >= least and (together or _left(name, d))
    ]


def moved(d: Diagnosis) -> str:
    """Return the same in a sentence; empty where none had."""
    told = [f'{name} ({change(d.moved[name])})' for name in moved_names(d)]
    if not told:
        return ''
    return f'Without the effects, these parameters compensated for them: {some(told)}.'


def _left(name: str, d: Diagnosis) -> bool:
    """Whether a parameter's nominal value is outside its interval with the effects."""
    found = d.parameters[name]
    return not found.low <= d.nominal.get(name, math.nan) <= found.high


def leading(d: Diagnosis) -> tuple[list[str], list[str]]:
    """Return where the gap lies: the findings that matter and do not overlap, then the rest."""
    told: list[Finding] = []
    for f in d.localisation:
        if f.drive not in [x.drive for x in told] or (not f.by_size and f.beyond >= FURTHER):
            told.append(f)
    told = sorted(told, key=lambda f: -f.over_floor)[:LEADING]
    missing = [drive for drive in words.worst(d) if all(f.drive != drive for f in told)]
    lost = [f'{x}: the largest gap; it follows no coordinate of the motion' for x in missing]
    return lost + [*map(where, told)], [where(f) for f in d.localisation if f not in told]
