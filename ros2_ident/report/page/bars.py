# SPDX-License-Identifier: Apache-2.0
"""Bars beside their numbers: how far the gap closes, and what is most probable."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from ros2_ident.report.page.numbers import change, number, unit_of
from ros2_ident.report.page.sentences import name_of

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


def steps(gap: Mapping[str, Any]) -> list[Bar]:
    """Return the residual before, with one effect after another, and the noise floor.

    Args:
        gap: The entry of `diagnosis.json`.
    """
    known = [s for s in gap['steps'] if s['value'] is not None]
    floor = gap['noise_floor']
    if not known or not floor:
        return []
    longest = max(floor, *(s['high'] or s['value'] for s in known))
    unit, out = unit_of(gap['unit']), []
    for k, step in enumerate(known):
        name = 'nominal simulation' if k == 0 else f'with {step["label"]}'
        text = f'{number(step["value"], 3)} {unit}'
        if k:
            text += f' ({change(step["value"] / known[k - 1]["value"] - 1.0, 0)})'
        ends = None
        if None not in (step['low'], step['high']):
            ends = (step['low'] / longest, step['high'] / longest)
        style = 'last' if k == len(known) - 1 > 0 else ''
        out.append(Bar(name, step['value'] / longest, text.replace('-', '−'), style, ends))
    return [*out, Bar('noise floor', floor / longest, f'{number(floor, 3)} {unit}', 'floor')]


def ranking(ranked: Sequence[Mapping[str, Any]], unit: str) -> list[Bar]:
    """Return how probable each effect is, and what it leaves of the residual.

    Args:
        ranked: The entry of `diagnosis.json`, the most probable first.
        unit: Of the residual.
    """
    out = []
    for k, r in enumerate([r for r in ranked if r['probability'] is not None][:MOST]):
        text = f'{100.0 * r["probability"]:.0f} %' if r['probability'] >= 0.01 else 'below 1 %'
        if r['gap_after'] is not None:
            text += f', leaves {number(r["gap_after"], 3)} {unit_of(unit)}'
        style = 'other' if k else 'first'
        out.append(Bar(name_of(r), min(1.0, r['probability']), text, style))
    return out
