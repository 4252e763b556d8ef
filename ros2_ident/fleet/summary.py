# SPDX-License-Identifier: Apache-2.0
"""Which bags of a fleet are compared, and what is found in all of them."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ros2_ident.errors import ErrorCode
from ros2_ident.files import write_json
from ros2_ident.gap.verdict import REFUSED

# What was found in a bag, as its file holds it.
Row = dict[str, Any]
# Its files; the page is made of the first.
SUMMARY, PAGE = 'fleet.json', 'report.html'


def sound(row: Row) -> bool:
    """Return whether a row's values say something of its machine."""
    contradicted = row.get('code') == ErrorCode.CONTRADICTED.name or row.get('effect') in REFUSED
    return row['state'] == 'done' and not contradicted


def pairs_of(rows: Sequence[Row]) -> list[Row]:
    """Return the begins of the rows of all comparisons.

    Each bag of a machine is compared with its earliest one, the latest bag of each machine with
    that of the machine nearest to the median of all: one that is off does not make the others
    differ. Only machines of one machine file are compared.

    Returns:
        `name`, `kind` (`drift` or `machine`), `machine`, `before` and `after`, names of bags, and
        `among` how many comparisons a change is chosen: a power of 2, so that one more bag seldom
        changes them all.
    """
    by_file: dict[str, dict[str, list[Row]]] = {}
    for row in sorted((r for r in rows if sound(r)), key=lambda r: str(r['date'])):
        machines = by_file.setdefault(row['machine_file'], {})
        machines.setdefault(row['machine'], []).append(row)
    pairs = []
    for machines in by_file.values():
        pairs += [('drift', x, of_one[0]) for of_one in machines.values() for x in of_one[1:]]
        latest = [of_one[-1] for of_one in machines.values()]
        usual = latest[_most_usual(latest)]
        pairs += [('machine', row, usual) for row in latest if row is not usual]
    among = 1 << max(0, len(pairs) - 1).bit_length()
    return [
        {'name': f'{row["name"]}~{other["name"]}', 'kind': kind, 'machine': row['machine'],
         'before': other['name'], 'after': row['name'], 'among': among}
        for kind, row, other in pairs
    ]  # fmt: skip


def _most_usual(rows: Sequence[Row]) -> int:
    """Return which row's values lie nearest to the median of all, in ranges of all."""
    names = set.intersection(*(set(row['parameters']) for row in rows))
    values = np.array([[row['parameters'][n]['value'] for n in sorted(names)] for row in rows])
    off = np.abs(values - np.median(values, axis=0)) / np.maximum(np.ptp(values, axis=0), 1e-300)
    return int(np.argmin(off.sum(axis=1)))


def write_summary(out: Path, rows: Sequence[Row]) -> None:
    """Write `fleet.json`: the rows of bags and of comparisons, for each effect its drives."""
    effects: dict[str, list[str]] = {}
    for row in filter(sound, rows):
        if row.get('effect') in (None, 'none'):
            continue
        named = [(row['effect'], drive) for drive in row['where'] or ['all']]
        named += [(x['effect'], x['where']) for x in row.get('also', ())]
        for effect, drive in named:
            effects.setdefault(effect, []).append(f'{row["name"]}: {drive}')
    content = {
        'schema': 'ros2_ident.fleet',
        'version': 2,
        'rows': [row for row in rows if 'after' not in row],
        'comparisons': [row for row in rows if 'after' in row],
        'effects': effects,
    }
    write_json(out / SUMMARY, content)
