# SPDX-License-Identifier: Apache-2.0
"""One row of the table: what was in a case, how much of it could be seen, what was answered."""

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ros2_ident.checks.blind.faults import named_by
from ros2_ident.checks.blind.label import from_mapping, Label
from ros2_ident.checks.blind.store import read_json

Array = npt.NDArray[np.float64]
RANKED = 30
# Parameters of the log, not of the machine.
MEASURED = ('measurement_delay', 'log_bias', 'log_gain')


def make_row(label_plain: Mapping[str, Any], case: Path) -> dict[str, Any]:
    """Return a case's row.

    Args:
        label_plain: The opened label.
        case: Directory of the case, with the diagnosis.

    Returns:
        Plain values.
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
    row['share'] |= {'oracle': label.share}
    row['parameters'] = intervals(label, diagnosis)
    return row


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
