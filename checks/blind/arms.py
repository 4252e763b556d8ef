# SPDX-License-Identifier: Apache-2.0
"""What is judged of MuJoCo's arms, which `generators.arm_cases` and `free_arms` draw."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from checks.blind.score import Row, SEEN
from checks.blind.store import read_json, Store
from checks.share import told_share
from ros2_ident.gap.verdict import NAMELESS

LABEL = ('case', 'effect', 'where', 'rho', 'size')
# Parameters of the links and rotors, and those of friction.
BASE = ('link_moment', 'link_inertia', 'drive_inertia')
FRICTION = ('coulomb_torque', 'viscous_torque')
GAINS = ('position_gain', 'velocity_gain')


def row(store: Store, number: int, label: Mapping[str, Any]) -> dict[str, Any]:
    """Hold the answers to a case against its label."""
    folder, went = store.case(number), store.answered(number) or {'error': 'no diagnosis'}
    out: dict[str, Any] = {key: label[key] for key in LABEL}
    ran = {'diagnose': went, 'identify': went.get('identify', went)}
    out['run'] = {
        name: {'code': int(bool(x['error'])), 'said': x['error'], 'seconds': x.get('cpu_seconds')}
        for name, x in ran.items()
    }
    identified = read_json(folder / 'identified' / 'result.json') or {'parameters': {}}
    out['parameters'] = {
        # What is found and not hidden is not there.
        name: {
            **{key: found[key] for key in ('value', 'low', 'high')},
            'true': (true := label['truth'].get(name, 0.0)),
            'held': found['low'] <= true <= found['high'],
            'identifiable': found['identifiable'] and found['high'] > found['low'],
        }
        for name, found in identified['parameters'].items()
    }
    found = read_json(folder / 'diagnosis' / 'diagnosis.json')
    if found is None:
        return out | {'named': []}
    verdict = found['verdict']
    return out | {
        'named': [_placed(at) for at in (verdict, *found['also'])],
        'probability': verdict['probability'],
        'sentence': verdict['sentence'],
        'confusable': [_placed(at) for at in found['confusable']],
    }


def _placed(at: Mapping[str, Any]) -> list[Any]:
    where = at['where']
    return [at['effect'], [where] if isinstance(where, str) else where]


def asked(label: Mapping[str, Any], row: Row) -> dict[str, Any]:
    """Return what a row says of its label."""
    truth = label['truth']
    own = {n: {**p, 'true': truth.get(n, 0.0)} for n, p in row['parameters'].items()}
    return {key: label[key] for key in LABEL} | {'parameters': own}


def figures(rows: Sequence[Row]) -> dict[str, str]:
    """Return what came of the judged cases, by name."""

    def held(kinds: tuple[str, ...], some: Sequence[Row], sure: bool = False) -> str:
        each = [x for r in some for x in r['parameters'].items()]
        own = [p for name, p in each if name.rpartition('.')[2].startswith(kinds)]
        return told_share([p['held'] for p in own if p['identifiable'] or not sure])

    every = [p for r in rows for p in r['parameters'].values()]
    none = [r for r in rows if r['effect'] == 'none']
    some = [r for r in rows if r['effect'] != 'none']
    seen = [(r, [r['effect'], [r['where']]]) for r in some if r['rho'] >= SEEN]
    runs = [[r['run'][name] for r in rows] for name in ('identify', 'diagnose')]
    close = [abs(p['value'] - p['true']) < 0.05 * abs(p['true']) for p in every]
    gains = {'gains held': held(GAINS, rows), 'values within 5 %': told_share(close)}
    return {
        'cases judged': str(len(rows)),
        'base parameters held, all': held(BASE, rows),
        'base parameters held, of those called identifiable': held(BASE, rows, sure=True),
        'base parameters held, cases without an effect': held(BASE, none),
        'base parameters held, cases with one': held(BASE, some),
        'friction held, cases without an effect': held(FRICTION, none),
        'friction held, cases with one': held(FRICTION, some),
        f'effect and joint named first, rho from {SEEN:g}': told_share(
            [r['named'][:1] == [true] for r, true in seen]
        ),
        'effect and joint among those named': told_share([t in r['named'] for r, t in seen]),
        'effect and joint named or called confusable': told_share(
            [true in [*r['named'], *r.get('confusable', [])] for r, true in seen]
        ),
        'joint named first': told_share(
            [bool(r['named']) and r['where'] in r['named'][0][1] for r, _ in seen]
        ),
        'false alarms: anything but `none`': told_share(
            [not r['named'] or r['named'][0][0] != 'none' for r in none]
        ),
        'false alarms: an effect named': told_share(
            [bool(r['named']) and r['named'][0][0] not in NAMELESS for r in none]
        ),
        'processor seconds of identify and diagnose, median': ', '.join(
            f'{np.median([x["seconds"] or 0.0 for x in each]):.0f}' for each in runs
        ),
        'failed': str(sum(x['code'] != 0 for each in runs for x in each)),
        # Of arms under their controllers.
        **(gains if any(name.endswith(GAINS) for r in rows for name in r['parameters']) else {}),
    }


def told(store: Store, rows: Sequence[Row]) -> list[str]:
    """Return the cases and what came of them, as lines."""
    cases = [f'{r["case"]} {r["effect"]} {r["where"]} {r["rho"]:.2f}: {r["named"]}' for r in rows]
    return [*cases, *(f'{name}: {figure}' for name, figure in figures(rows).items())]
