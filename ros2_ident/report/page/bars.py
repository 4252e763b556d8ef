# SPDX-License-Identifier: Apache-2.0
"""Bars beside their numbers: how far the gap closes, and what is most probable."""

from dataclasses import dataclass
import math

from ros2_ident.gap.diagnosis import Diagnosis
from ros2_ident.report.page.numbers import change, number, unit_of

# Effects that are listed.
MOST = 8


@dataclass(frozen=True)
class Bar:
    """A row.

    Attributes:
        name: What it is of.
        length: 0 to 1.
        text: Its number.
        style: How it is coloured.
        ends: Ends of its interval, 0 to 1.
    """

    name: str
    length: float
    text: str
    style: str = ''
    ends: tuple[float, float] | None = None


def steps(d: Diagnosis) -> list[Bar]:
    """Return the residual before, with one effect after another, and the noise floor."""
    known = [s for s in d.steps if math.isfinite(s.gap.value)]
    floor = d.floor.together
    if not known or not floor > 0.0:
        return []
    longest = max(floor, *(max(s.gap.value, s.gap.high) for s in known))
    unit, out = unit_of(d.unit), []
    for k, step in enumerate(known):
        gap = step.gap
        name = 'nominal simulation' if k == 0 else f'with {step.label}'
        text = f'{number(gap.value, 3)} {unit}'
        if k:
            text += f' ({change(gap.value / known[k - 1].gap.value - 1.0, 0)})'
        ends = (gap.low / longest, gap.high / longest)
        style = 'last' if k == len(known) - 1 > 0 else ''
        shown = ends if all(map(math.isfinite, ends)) else None
        out.append(Bar(name, gap.value / longest, text.replace('-', '−'), style, shown))
    return [*out, Bar('noise floor', floor / longest, f'{number(floor, 3)} {unit}', 'floor')]


def ranking(d: Diagnosis) -> list[Bar]:
    """Return how probable each effect is, and what it leaves of the residual."""
    out = []
    for k, r in enumerate([r for r in d.ranking if math.isfinite(r.probability)][:MOST]):
        text = f'{100.0 * r.probability:.0f} %' if r.probability >= 0.01 else 'below 1 %'
        if math.isfinite(r.gap_after):
            text += f', leaves {number(r.gap_after, 3)} {unit_of(d.unit)}'
        style = 'other' if k else 'first'
        out.append(Bar(r.at.title, min(1.0, r.probability), text, style))
    return out
