# SPDX-License-Identifier: Apache-2.0
"""A diagnosis as the mapping that goes into `diagnosis.json`."""

from dataclasses import asdict
import math
from typing import Any

from ros2_ident.arrays import plain
from ros2_ident.gap.blocks import Interval
from ros2_ident.gap.diagnosis import Diagnosis
from ros2_ident.models import EffectAt
from ros2_ident.report.maps import chosen, map_of
from ros2_ident.words.finding import region, where
from ros2_ident.words.verdict import advice, headline, sentence

SCHEMA = 4


def _shown(d: Diagnosis) -> tuple[str, ...]:
    """Return the drives that a map is drawn of whatever was found there: the worst, and the named.

    None where the gap is no more than noise.
    """
    if not d.evidence['size'] >= d.evidence['material']:
        return ()
    worst = max(d.per_drive, key=lambda name: d.per_drive[name].over_floor)
    return tuple(dict.fromkeys((worst, *(w for w in d.where if w in d.per_drive))))


def _maps(d: Diagnosis) -> list[dict[str, Any]]:
    """Return maps of the residual along the coordinates that matter, as `localise` saw it."""
    trace, out = d.traces[0], []
    for drive, name in chosen(d.localisation, _shown(d)):
        at = trace.motion.drives.index(drive)
        before = map_of(trace.motion, trace.before[at], at, name)
        after = map_of(trace.motion, trace.after[at], at, name)
        out.append(
            {
                'drive': drive,
                'coordinate': name,
                'label': before.label,
                'unit': before.unit,
                'linear': before.linear,
                'noise_floor': float(d.floor.per_drive[at]),
                'before': [asdict(line) for line in before.lines],
                'after': [asdict(line) for line in after.lines] if len(d.steps) > 1 else [],
            }
        )
    return out


def _at(at: EffectAt) -> dict[str, Any]:
    return {'effect': at.effect, 'where': [at.where]}


def to_mapping(d: Diagnosis) -> dict[str, Any]:
    """Return what `diagnosis.json` holds; numbers that do not exist are null."""
    before = d.steps[0].gap if d.steps else Interval(math.nan, math.nan, math.nan)
    after = d.steps[-1].gap if d.steps else before
    mapping: dict[str, Any] = plain({
        'schema': SCHEMA,
        'verdict': {
            'effect': d.effect,
            'where': list(d.where),
            'probability': d.probability,
            'sentence': sentence(d),
            'headline': headline(d),
            'cause': d.facts.cause,
        },
        'facts': {**asdict(d.facts), 'leads': d.facts.leads},
        'also': [_at(a) for a in d.also],
        'again': list(d.again),
        'confusable': [{**_at(r.at), 'probability': r.probability} for r in d.confusable],
        'ranking': [
            {
                **_at(r.at),
                'probability': r.probability,
                'gap_after': r.gap_after,
                'share': r.share,
                'parameters': {n: asdict(v) for n, v in r.parameters.items()},
            }
            for r in d.ranking
        ],
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
                    'share_of_torque_before': g.before / g.torque_rms,
                    'share_of_torque_after': g.after / g.torque_rms,
                }
                for name, g in d.per_drive.items()
            },
        },
        'evidence': d.evidence,
        'localisation': [
            {
                'drive': f.drive,
                'coordinate': f.coordinate,
                'region': region(f),
                'statistic': f.statistic,
                'p_value': f.p_value,
                'size': f.size,
                'size_over_floor': f.over_floor,
                'beyond': f.beyond,
                'sentence': where(f),
                'by_size': f.by_size,
            }
            for f in d.localisation
        ],
        'maps': _maps(d),
        'parameters': {n: asdict(v) for n, v in d.parameters.items()},
        'nominal': d.nominal,
        'moved': d.moved,
        'prediction': None if d.prediction is None else asdict(d.prediction),
        'gates': [asdict(gate) for gate in d.gates],
        'not_testable': [_at(a) for a in d.not_testable],
        'advice': advice(d),
        'complete': d.complete,
        'seconds': d.seconds,
        'seed': d.seed,
    })
    return mapping
