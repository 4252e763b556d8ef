# SPDX-License-Identifier: Apache-2.0
"""A diagnosis as the mapping that goes into `diagnosis.json`, and back."""

from collections.abc import Collection, Iterable, Mapping
from dataclasses import asdict, dataclass
import math
from typing import Any

import numpy as np

from ros2_ident.arrays import plain
from ros2_ident.gap.bootstrap import Interval
from ros2_ident.gap.noise_floor import Floor
from ros2_ident.gap.result import Diagnosis, Ranked
from ros2_ident.identify.result import Provenance
from ros2_ident.models import EffectAt
from ros2_ident.report.maps import maps_of, ResidualMap
from ros2_ident.report.schema import but, read
from ros2_ident.words.finding import region, where
from ros2_ident.words.verdict import advice, headline, sentence

SCHEMA = 5


@dataclass(frozen=True)
class Written:
    """The content of `diagnosis.json`.

    Attributes:
        maps: Maps of the residual.
        machine_lines: Lines for the machine file.
        check_source: Recording that it was judged on; empty for blocks of the others.
        check_sha256: Hash of that.
    """

    found: Diagnosis
    maps: tuple[ResidualMap, ...]
    machine_lines: tuple[str, ...]
    settings: Mapping[str, Any]
    provenance: Provenance
    check_source: str = ''
    check_sha256: str = ''


def effects_in(names: Iterable[str], nominal: Collection[str]) -> tuple[EffectAt, ...]:
    """Return the effects whose parameters are among names beside the nominal ones."""
    parts = [name.rsplit('.', 2) for name in names if name not in nominal]
    return tuple(dict.fromkeys(EffectAt(x[-2], x[0] if len(x) == 3 else 'all') for x in parts))


def _at(at: EffectAt) -> dict[str, Any]:
    return {'effect': at.effect, 'where': [at.where]}


def _ranked(r: Ranked) -> dict[str, Any]:
    return {**_at(r.at), **but(asdict(r), 'at')}


def to_mapping(d: Diagnosis) -> dict[str, Any]:
    """Return what `diagnosis.json` holds; numbers that do not exist are null."""
    before = d.steps[0].gap if d.steps else Interval(math.nan, math.nan, math.nan)
    after = d.steps[-1].gap if d.steps else before
    mapping: dict[str, Any] = plain(
        {
            'schema': SCHEMA,
            'verdict': {
                'effect': d.effect,
                'where': d.where,
                'probability': d.probability,
                'sentence': sentence(d),
                'headline': headline(d),
                'cause': d.facts.cause,
            },
            'facts': {**asdict(d.facts), 'leads': d.facts.leads},
            'also': [_at(a) for a in d.also],
            'confusable': [_ranked(r) for r in d.confusable],
            'ranking': [_ranked(r) for r in d.ranking],
            'gap': {
                'unit': d.unit,
                'before': before.value,
                'after': after.value,
                'noise_floor': d.floor.together,
                'noise_floor_method': d.floor.method,
                'share_closed': d.share_closed.value,
                'share_closed_low': d.share_closed.low,
                'share_closed_high': d.share_closed.high,
                'held_out': d.held_out,
                'steps': [{'label': s.label, **asdict(s.gap)} for s in d.steps],
                'per_drive': {
                    name: {
                        **asdict(g),
                        'share_of_torque_before': g.shares[0],
                        'share_of_torque_after': g.shares[1],
                    }
                    for name, g in d.per_drive.items()
                },
            },
            'evidence': d.evidence,
            'localisation': [
                {
                    **but(asdict(f), 'over_floor'),
                    'coordinate': f.coordinate,
                    'region': region(f),
                    'place': asdict(f.region),
                    'size_over_floor': f.over_floor,
                    'sentence': where(f),
                }
                for f in d.localisation
            ],
            'maps': [asdict(m) for m in maps_of(d)],
            'parameters': {name: asdict(v) for name, v in d.parameters.items()},
            'nominal': d.nominal,
            'moved': d.moved,
            'prediction': None if d.prediction is None else asdict(d.prediction),
            'gates': [asdict(gate) for gate in d.gates],
            'not_testable': [_at(a) for a in d.not_testable],
            'advice': list(advice(d)),
            'complete': d.complete,
            'seconds': d.seconds,
            'seed': d.seed,
        }
    )
    return mapping


def from_mapping(data: Mapping[str, Any]) -> Written:
    """Return what a file's content describes; sentences are not read, they are made anew."""
    gap, provenance = data['gap'], data['provenance']
    floors = np.array([d['noise_floor'] for d in gap['per_drive'].values()], dtype=np.float64)
    none = np.full_like(floors, np.nan)

    def at(entry: Mapping[str, Any]) -> dict[str, Any]:
        return {'effect': entry['effect'], 'where': entry['where'][0]}

    known = {
        **data,
        **data['verdict'],
        **gap,
        'also': [at(x) for x in data['also']],
        'not_testable': [at(x) for x in data['not_testable']],
        'steps': [{'label': s['label'], 'gap': s} for s in gap['steps']],
        'share_closed': {
            'value': gap['share_closed'],
            'low': gap['share_closed_low'],
            'high': gap['share_closed_high'],
        },
        'localisation': [
            {**f, 'over_floor': f['size_over_floor'], 'region': f['place']}
            for f in data['localisation']
        ],
    }
    for name in ('confusable', 'ranking'):
        known[name] = [{**r, 'at': at(r)} for r in data[name]]
    known['floor'] = Floor(floors, none, none, gap['noise_floor_method'], ())
    found = read(Diagnosis, {**known, 'traces': ()})
    written: Written = read(Written, {**data, **provenance, 'found': found})
    return written
