# SPDX-License-Identifier: Apache-2.0
"""How the machines of a fleet compare: drift, differences, effects."""

from collections.abc import Iterable, Mapping, Sequence
import json
import math
from pathlib import Path
from typing import Any

import numpy as np

from ros2_ident.arrays import NORMAL
from ros2_ident.effects import CATALOGUE
from ros2_ident.errors import ErrorCode
from ros2_ident.files import write_text
from ros2_ident.gap.verdict import REFUSED
from ros2_ident.identify.result import half_of_difference, smallest_shown

# What was found in a bag, as its file holds it.
Row = dict[str, Any]
# Its files; the page is made of the first.
SUMMARY, PAGE = 'fleet.json', 'report.html'
# Probability that a drift is said where there is none, over all comparisons of a fleet.
LEVEL = 0.05
# Differences below this share are not said: friction moves by more than that with a few kelvin, so
# one log a machine cannot tell the machine from the day (Bittencourt and Gunnarsson 2012, Static
# Friction in a Robot Joint, ASME J. Dyn. Syst. Meas. Control 134(5)).
LEAST = 0.02
# Fleets of equal machines that the interval of a median is taken from.
DRAWS = 2000


def sound(row: Row) -> bool:
    """Return whether a row's values say something of its machine."""
    contradicted = row.get('code') == ErrorCode.CONTRADICTED.name or row.get('effect') in REFUSED
    return row['state'] == 'done' and not contradicted


def effects_named(rows: Iterable[Row]) -> list[list[str]]:
    """Return the effects that were named on any row, each with its place."""
    named = {at for row in rows if sound(row) and row.get('effect') in CATALOGUE
             for at in _effects_of(row)}  # fmt: skip
    return [list(at) for at in sorted(named)]


def summarise(rows: Sequence[Row]) -> dict[str, Any]:
    """Compare the rows that are done, but for those whose log contradicts its machine file.

    Two values differ where their difference is beyond its own interval: with intervals that reach
    a and b towards each other the standard deviation of it is sqrt(a^2 + b^2) / 1.96. The level is
    shared among all comparisons (Holm 1979), so that in a fleet of equal machines one in twenty
    says anything. What differs by less than `LEAST` is left out. Rows whose models have other
    effects are not compared.

    Returns:
        `drifts`: parameters of a machine against its earliest bag; `machines`: latest values of a
        machine against the median of all, so that one that is off does not make the others
        differ, or of two against the other; both strongest first. `effects`: for each effect
        the drives it was found on. `smallest`: for each parameter compared the least change
        that would have been told of every machine, in all but one case of twenty.
    """
    done = sorted((r for r in rows if sound(r)), key=lambda r: str(r['date']))
    by_machine: dict[str, list[Row]] = {}
    for row in done:
        by_machine.setdefault(row['machine'], []).append(row)
    drifts = [
        (name, row, of_one[0]['parameters'][name], of_one[0]['name'])
        for of_one in by_machine.values()
        for row in of_one[1:]
        for name in row['parameters']
        if name in of_one[0]['parameters'] and row.get('beside') == of_one[0].get('beside')
    ]
    latest: dict[tuple[str, str], list[Row]] = {}
    for row in (of_one[-1] for of_one in by_machine.values()):
        for name in row['parameters']:
            latest.setdefault((name, str(row.get('beside'))), []).append(row)
    machines = []
    for (name, _), of in latest.items():
        values = [row['parameters'][name] for row in of]
        if len(of) == 2:
            machines.append((name, of[0], values[1], of[1]['machine']))
        elif len(of) > 2:
            median = _median(values)
            machines += [(name, row, median, 'median of the machines') for row in of]
    effects: dict[str, list[str]] = {}
    for row in done:
        for effect, drive in _effects_of(row):
            effects.setdefault(effect, []).append(f'{row["name"]}: {drive}')
    pairs = [(name, row['parameters'][name], other) for name, row, other, _ in drifts + machines]
    return {
        'drifts': _told([_difference(*x) for x in drifts]),
        'machines': _told([_difference(*x) for x in machines]),
        'effects': effects,
        'smallest': smallest_shown(pairs, max(1, len(drifts), len(machines)), LEAST),
    }


def _effects_of(row: Row) -> list[tuple[str, str]]:
    """Return the effects that were named, or `unknown`, each with its place."""
    if row.get('effect') in (None, 'none'):
        return []
    first = [(row['effect'], drive) for drive in row['where'] or ['all']]
    return [*first, *((x['effect'], x['where']) for x in row.get('also', ()))]


def _median(values: Sequence[Mapping[str, Any]]) -> Row:
    """Return the median with the 95 % interval that it has among equal machines.

    It is drawn from their intervals: no formula holds for few values that are known unequally
    well. One that is hardly known does not hide how the others differ.
    """
    middle = float(np.median([v['value'] for v in values]))
    ends = np.array([(v['low'], v['high']) for v in values], dtype=float)
    halves = 0.5 * (ends[:, 1] - ends[:, 0])
    if not np.isfinite(halves).all():
        return {'value': middle, 'low': None, 'high': None}
    draws = np.random.default_rng(0).normal(size=(DRAWS, len(values))) * halves / NORMAL
    half = float(np.quantile(np.abs(np.median(draws, axis=1)), 0.95))
    return {'value': middle, 'low': middle - half, 'high': middle + half}


def _difference(name: str, row: Row, other: Mapping[str, Any], against: str) -> Row:
    value = row['parameters'][name]
    spread = half_of_difference(value, other) / NORMAL
    change = float(value['value']) - float(other['value'])
    strength = abs(change) / spread if 0.0 < spread < math.inf else 0.0
    return {
        'parameter': name,
        'machine': row['machine'],
        'bag': row['name'],
        'against': against,
        'value': value['value'],
        'reference': other['value'],
        'change': change / float(other['value']) if other['value'] else None,
        'unit': value['unit'],
        'p': math.erfc(strength / math.sqrt(2.0)),
    }


def _told(differences: list[Row]) -> list[Row]:
    """Return those that Holm's procedure tells and that are not too small, the surest first."""
    ordered = sorted(differences, key=lambda x: float(x['p']))
    told: list[Row] = []
    for number, difference in enumerate(ordered):
        if difference['p'] > LEVEL / (len(ordered) - number):
            break
        told.append(difference)
    return [x for x in told if x['change'] is None or abs(x['change']) >= LEAST]


def write_summary(out: Path, rows: Sequence[Row]) -> None:
    """Write `fleet.json`."""
    content = {'schema': 'ros2_ident.fleet', 'version': 1, 'rows': rows, **summarise(rows)}
    write_text(out / SUMMARY, json.dumps(content, indent=1, allow_nan=False) + '\n')
