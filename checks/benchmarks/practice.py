# SPDX-License-Identifier: Apache-2.0
"""Diagnoses the labelled practice cases of a simulator outside this project and scores them.

Such a folder holds `case_NNN/fit`, `case_NNN/check` and `case_NNN/label.json` each. Their labels
tell how much an effect changes the torque, not what the nominal fit leaves of it, so the size
given here is an upper bound.

Example: python checks/benchmarks/practice.py DIRECTORY_OF_CASES --out practice
"""

import argparse
from pathlib import Path
import sys
from typing import Any

import numpy as np

from checks.blind.run import ask_all
from checks.blind.score import score, sentences, verdict_of
from checks.blind.store import read_json, Store
from checks.blind.truth import answer_of
from ros2_ident.models import load_machine


def row_of(case: Path, out: Path, noise: float) -> dict[str, Any]:
    """Return a practice case as a row of the blind check's table."""
    label = read_json(case / 'label.json')
    went = read_json(out / 'run.json') or {'error': 'no diagnosis'}
    squares = np.mean([np.square(bag['effect_rms']) for bag in label['bags']], axis=0)
    rho = float(np.sqrt(squares.max())) / noise
    none = label['effect'] == 'none'
    effects = (
        [] if none else [{'effect': label['effect'], 'where': label['where'], 'form': 'theirs'}]
    )
    row: dict[str, Any] = {
        'case': int(case.name.rpartition('_')[2]),
        'sort': 'none' if none else 'single',
        'effects': [{**e, 'rho': rho} for e in effects],
        'imperfections': [],
        'rho': rho,
        'rho_small': 0.0,
        'rho_all': rho,
        **went,
    }
    diagnosis = read_json(out / 'diagnosis' / 'diagnosis.json')
    return row if diagnosis is None else row | answer_of(diagnosis)


def main() -> int:
    """Run it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('cases', type=Path, help='folder of case_NNN')
    parser.add_argument('--machine', type=Path, default=Path('config/tripod.yaml'))
    parser.add_argument('--out', type=Path, default=Path('practice'))
    parser.add_argument('--processes', type=int, default=2)
    args = parser.parse_args()
    found = sorted(args.cases.glob('case_*/label.json'))
    if not found:
        print(f'no labelled cases in {args.cases}; nothing to do')
        return 0
    store = Store(args.out)
    orders = {}
    for label in found:
        case = label.parent
        number = int(case.name.rpartition('_')[2])
        store.case(number).mkdir(parents=True, exist_ok=True)
        if store.answered(number) is None:
            orders[number] = {
                'fit': str((case / 'fit').resolve()),
                'check': str((case / 'check').resolve()),
                'machine': str(args.machine.resolve()),
                'out': str((store.case(number) / 'diagnosis').resolve()),
            }
    for done, number in enumerate(ask_all(store, orders, args.processes), 1):
        print(f'case {number:03d}, {done} of {len(orders)}', file=sys.stderr)
    noise = load_machine(args.machine).effort_noise
    rows = []
    for label in found:
        number = int(label.parent.name.rpartition('_')[2])
        rows.append(row_of(label.parent, store.case(number), noise))
    store.write_rows(rows)
    for row in rows:
        truth = ', '.join(f'{e["effect"]} {e["where"][0]}' for e in row['effects']) or 'none'
        verdict = verdict_of(row)
        also = ''.join(f', {a["effect"]} {a["where"][0]}' for a in row.get('also', []))
        where = ' '.join(row['verdict']['where']) if 'verdict' in row else row['error'][:80]
        p = f'{row["verdict"]["probability"]:.2f}' if 'verdict' in row else ''
        print(f'{row["case"]:03d}  {truth:40s} {row["rho"]:6.2f}   {verdict} {where}{also}  {p}')
    for line in sentences(score(rows)):
        if 'of 0' not in line:
            print(line)
    return 0


if __name__ == '__main__':
    sys.exit(main())
