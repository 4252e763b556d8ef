# SPDX-License-Identifier: Apache-2.0
"""One row of the table: what was in a case, how much of it could be seen, what was answered."""

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from checks.blind.case import MACHINE
from checks.blind.faults import named_by
from checks.blind.label import from_mapping, Label
from checks.blind.store import read_json
from ros2_ident.identify.data import read_data
from ros2_ident.models import load_machine
from ros2_ident.report.files import DIAGNOSIS_SIGNALS

Array = npt.NDArray[np.float64]
RANKED = 30
# Parameters of the log, not of the machine.
MEASURED = ('measurement_delay', 'log_bias', 'log_gain')


def make_row(label_plain: Mapping[str, Any], case: Path, clean: Path) -> dict[str, Any]:
    """Return a case's row.

    Args:
        case: Directory of the case, with the diagnosis.
        clean: Bag held out as it would be without noise; it need not be there.
    """
    label = from_mapping(label_plain)
    went = read_json(case / 'run.json') or {'error': 'no diagnosis'}
    row = {
        **_asked(label),
        'error': went['error'],
        'seconds': went.get('seconds'),
        'cpu_seconds': went.get('cpu_seconds'),
    }
    diagnosis = read_json(case / 'diagnosis' / 'diagnosis.json')
    if diagnosis is None:
        return row
    row |= answer_of(diagnosis)
    row['share'] |= {'oracle': label.share, 'true': _closed(case, clean, diagnosis)}
    row['parameters'] = intervals(label, diagnosis)
    return row


def _closed(case: Path, clean: Path, diagnosis: Mapping[str, Any]) -> float | None:
    """Return the share that the diagnosed model closes of the gap without noise.

    It is of the recording held out and of the drives that the predicted share counts; None where
    that is not known.
    """
    if not clean.exists() or len(diagnosis['gap']['steps']) < 2:
        return None
    with np.load(case / 'diagnosis' / DIAGNOSIS_SIGNALS, allow_pickle=False) as found:
        drives = [str(name) for name in found['drives']]
        time, simulated = found['time_1'], found['simulated_1'].astype(float)
    if len(simulated) < 2:
        return None
    machine = load_machine(case / MACHINE)
    data = read_data(clean, machine).datasets[0]
    assert data.effort is not None
    at = np.round(time / data.cycle).astype(int)
    effort = np.array([data.effort[data.names.index(name), at] for name in drives])
    counted = [diagnosis['gap']['per_drive'][name]['counted'] for name in drives]
    left = np.nanmean((effort - simulated)[:, counted] ** 2, axis=2).sum(axis=1)
    return float(1.0 - left[1] / left[0])


def _asked(label: Label) -> dict[str, Any]:
    """Return what was in a case."""
    rough = label.rough
    return {
        'case': label.case,
        'sort': label.sort,
        'generator': label.generator,
        'motions': [[m.kind, m.pace] for m in label.motions],
        'effects': [
            {'effect': e.effect, 'where': [e.where], 'form': e.form, 'rho': e.rho}
            for e in label.effects
        ],
        'imperfections': [[e.effect, [e.where], e.form] for e in label.imperfections],
        'rho': label.rho,
        'rho_small': label.rho_small,
        'rho_all': label.rho_all,
        'noise': {
            'size': float(np.mean(label.noise)),
            'memory': rough.memory,
            'stated': rough.stated,
            'hard': rough.hard,
        },
        'fault': {**asdict(label.fault), 'named_by': named_by(label.fault)}
        if label.fault
        else None,
    }


def answer_of(d: Mapping[str, Any]) -> dict[str, Any]:
    """Return what of a diagnosis the scores need."""
    gap = d['gap']
    return {
        'verdict': {k: d['verdict'][k] for k in ('effect', 'where', 'probability', 'sentence')},
        'also': d['also'],
        'confusable': d['confusable'],
        'ranking': [
            {k: entry.get(k) for k in ('effect', 'where', 'probability', 'gap_after', 'share')}
            for entry in d['ranking'][:RANKED]
        ],
        'evidence': {**_evidence(gap), **d.get('evidence', {})},
        'not_testable': [[x['effect'], x['where'][0]] for x in d['not_testable']],
        'gates': [g for g in d.get('gates', []) if g['level'] != 'ok'],
        'gap': {k: gap[k] for k in ('before', 'after', 'noise_floor')},
        'share': {
            'predicted': gap['share_closed'],
            'low': gap['share_closed_low'],
            'high': gap['share_closed_high'],
        },
        'complete': d['complete'],
    }


def _evidence(gap: Mapping[str, Any]) -> dict[str, float]:
    """Return size, share closed and what remains, as the held-out recording shows them."""
    drives = list(gap['per_drive'].values())

    def above(key: str) -> Array:
        return np.array([(x[key] / x['noise_floor']) ** 2 - 1.0 for x in drives])

    before, after = above('before'), above('after')
    total = float(before.sum())
    return {
        'size': float(np.sqrt(np.maximum(before, 0.0)).max()),
        'remaining': float(np.sqrt(np.maximum(after, 0.0)).max()),
        'closed': float((before - after).sum()) / total if total > 0.0 else 0.0,
    }


def intervals(label: Label, diagnosis: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return the physical parameters' intervals beside the truth."""
    out = []
    for name, found in diagnosis['parameters'].items():
        bare = name.rpartition('.')[2]
        true = label.parameters.get(name, label.parameters.get(bare))
        if true is None or bare in MEASURED:
            continue
        ends = {key: found.get(key) for key in ('value', 'low', 'high')}
        out.append({'name': name, 'true': true, **ends})
    return out
