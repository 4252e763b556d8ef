# SPDX-License-Identifier: Apache-2.0
"""The files of a diagnosis: what `diagnosis.json` holds, and lines for the machine file."""

from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass
import math
from pathlib import Path
from typing import Any

import numpy as np

from ros2_ident.arrays import plain
from ros2_ident.effects import CATALOGUE
from ros2_ident.errors import ErrorCode
from ros2_ident.files import remove_file, write_json
from ros2_ident.gap.bootstrap import Interval
from ros2_ident.gap.noise_floor import Floor
from ros2_ident.gap.result import Diagnosis, Ranked
from ros2_ident.identify.data import Data
from ros2_ident.identify.outcome import provenance_of
from ros2_ident.identify.result import Provenance
from ros2_ident.machine.keys import digits
from ros2_ident.models import EffectAt, Machine
from ros2_ident.models.drives.candidates import SLOTS
from ros2_ident.models.registry import KINDS
from ros2_ident.report.files import content, DIAGNOSIS, DIAGNOSIS_SIGNALS
from ros2_ident.report.maps import maps_of, ResidualMap
from ros2_ident.report.schema import but, intact, read
from ros2_ident.report.signals import signals_of_diagnosis, write_signals
from ros2_ident.words.finding import region, where
from ros2_ident.words.verdict import advice, headline, named, sentence

SCHEMA = 5


@dataclass(frozen=True)
class Written:
    """The content of `diagnosis.json`.

    Attributes:
        check_source: Recording that it was judged on; empty for blocks of the others.
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
            'correlation': d.correlation,
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


def write_diagnosis(
    directory: str | Path,
    found: Diagnosis,
    machine: Machine,
    fit: Data,
    check: Data | None = None,
    settings: Mapping[str, object] | None = None,
) -> tuple[Path, Path]:
    """Write a diagnosis.

    Args:
        directory: Exists.
        fit: The recordings fitted to.
        check: The recordings it was judged on; None where those are blocks of the others.

    Returns:
        `diagnosis.json`, and `diagnosis.npz` with measured and simulated effort.
    """
    folder = Path(directory)
    data = {
        'format': 'ros2_ident.diagnosis',
        **to_mapping(found),
        'machine_lines': list(machine_lines(found, machine)),
        'settings': dict(settings or {}),
        'provenance': {
            **asdict(provenance_of(machine, fit)),
            'check_source': check.source if check else '',
            'check_sha256': check.sha256 if check else '',
        },
    }
    remove_file(folder / DIAGNOSIS_SIGNALS)  # nothing old beside the new after a crash
    return (
        write_json(folder / DIAGNOSIS, data),
        write_signals(folder / DIAGNOSIS_SIGNALS, signals_of_diagnosis(found)),
    )


def load_diagnosis(directory: str | Path) -> Written:
    """Read what `write_diagnosis` wrote into `diagnosis.json`.

    Raises:
        IdentError: NO_DATA where there is none, BAD_VALUES where it cannot be read.
    """
    path = Path(directory) / DIAGNOSIS
    data = content(path, '`ident diagnose --out` wrote')
    if not isinstance(data, dict) or 'verdict' not in data or data.get('schema') != SCHEMA:
        raise ErrorCode.BAD_VALUES.error(
            f'{path}: is no diagnosis of version {SCHEMA}; write it anew with `ident diagnose`'
        )
    with intact(path):
        return from_mapping(data)


def machine_lines(found: Diagnosis, machine: Machine) -> tuple[str, ...]:
    """Return YAML for the machine file.

    Returns:
        Lines by section; none where no effect was found or the machine file has no key for it. A
        constant gets its new value. What the file does not know becomes a parameter to identify,
        searched up to twice the size found.
    """
    sections: dict[str, list[str]] = {}
    for at in named(found):
        for section, line in _lines(found, machine, at):
            sections.setdefault(section, []).append(line)
    return tuple(
        line for name, lines in sections.items() for line in (f'{name}:', *dict.fromkeys(lines))
    )


def _lines(found: Diagnosis, machine: Machine, at: EffectAt) -> Iterator[tuple[str, str]]:
    effect = CATALOGUE.get(at.effect)
    if effect is None or machine.kind not in KINDS:
        return
    size = next(p for p in effect.parameters if p.role == 'size')
    value = found.parameters.get(f'{at.prefix}{size.name}')
    if value is None or not math.isfinite(value.value):
        return
    # What fills the row of the kernel on which the effect acts.
    names = [name for name, slot in SLOTS.items() if size.target and slot.row == size.target]
    if any(name in machine.bounds for name in names):
        return
    keys = [key for key in KINDS[machine.kind].keys if key.name in names]
    for key in keys:
        if not key.constant:
            continue
        # its new value, of each drive where the effect sits on one
        old = machine.numbers(key.name).tolist()
        new = [
            (x * value.value if size.how == 'scale' else x + value.value)
            if at.where in ('all', drive)
            else x
            for drive, x in zip(machine.drives, old, strict=True)
        ]
        if all(map(math.isfinite, new)):
            said = [digits(float(f'{x:.5g}')) for x in new]
            text = said[0] if len(set(said)) == 1 else f'[{", ".join(said)}]'
            before = ', '.join(dict.fromkeys(digits(x) for x in old))
            yield key.section, f'  {key.name}: {text}  # {before} before'
        return
    fitting = [k for k in keys if value.unit in (k.unit, k.force_unit)]
    if fitting:
        key = max(fitting, key=lambda k: k.unit == value.unit)
        reach = digits(float(f'{2.0 * abs(value.value):.2g}'))
        low = f'-{reach}' if value.value < 0.0 else '0.0'
        yield key.section, f'  {key.name}: [{low}, {reach}, {value.unit}]'
