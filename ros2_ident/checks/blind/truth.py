# SPDX-License-Identifier: Apache-2.0
"""One row of the table: what was in a case, how much of it could be seen, what was answered."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ros2_ident.checks.blind.label import effect_mapping, from_mapping, Label
from ros2_ident.checks.blind.probe import Left, Probe
from ros2_ident.checks.blind.store import read_json
from ros2_ident.models import EffectAt, load_machine, make_model
from ros2_ident.reference.effects import Effect

Array = npt.NDArray[np.float64]
RANKED = 30

# The catalogue's parameter that means the same as the generator's size, and how it is read: as it
# is, as the deviation of a factor from one, as the length of (sine, cosine), or inverted.
SHARED: dict[str, tuple[str, tuple[str, ...], str]] = {
    'stribeck': ('torque', ('torque',), 'plain'),
    'load_dependent_friction': ('share', ('coefficient',), 'plain'),
    'presliding': ('length', ('way',), 'plain'),
    'quadratic_drag': ('slope', ('torque',), 'plain'),
    'degressive_friction': ('torque', ('torque',), 'plain'),
    'gear_flexibility': ('share', ('share',), 'plain'),
    'backlash': ('width', ('gap',), 'plain'),
    'torque_ripple': ('torque', ('sine', 'cosine'), 'length'),
    'transmission_eccentricity': ('amplitude', ('sine', 'cosine'), 'length'),
    'torque_constant_error': ('share', ('factor',), 'factor'),
    'current_loop_lag': ('time', ('time_constant',), 'plain'),
    'cable_spring': ('stiffness', ('stiffness',), 'plain'),
    'constant_force': ('force', ('force',), 'plain'),
    'effort_bias': ('torque', ('bias',), 'plain'),
    'position_dependent_friction': ('slope', ('slope',), 'plain'),
    'effort_filter': ('time', ('time_constant',), 'plain'),
    'effort_smoothing': ('period', ('period',), 'plain'),
    'integral_gain_error': ('share', ('factor',), 'factor'),
    'velocity_gain_error': ('share', ('factor',), 'factor'),
    'position_gain_error': ('share', ('factor',), 'factor'),
    'command_delay': ('time', ('delay',), 'plain'),
    'position_dependent_stiffness': ('slope', ('slope',), 'plain'),
    'encoder_quantisation': ('step', ('step',), 'plain'),
    'frame_resonance': ('mass', ('inverse_mass',), 'inverse'),
    'payload_change': ('mass', ('mass',), 'plain'),
    'rod_mass': ('mass', ('mass',), 'plain'),
    'rail_radius_error': ('length', ('error',), 'plain'),
    'rod_length_error': ('length', ('error',), 'plain'),
    'effort_crosstalk': ('share', ('coefficient',), 'plain'),
}
# Kinds whose two forms mean the same number.
ONE_FORM = ('integral_gain_error', 'position_gain_error')


def make_row(label_plain: Mapping[str, Any], case: Path, machine_file: Path) -> dict[str, Any]:
    """Return a case's row; every number that needs the reference is computed here.

    Args:
        label_plain: The opened label.
        case: Directory of the case, with the diagnosis.
        machine_file: The machine file.

    Returns:
        Plain values.
    """
    machine = load_machine(machine_file)
    label = from_mapping(label_plain)
    probe = Probe(machine, label.parameters, [m.draw(machine) for m in label.motions])
    diagnosis = read_json(case / 'diagnosis' / 'diagnosis.json')
    went = read_json(case / 'run.json') or {'error': 'no diagnosis'}
    every = (*label.imperfections, *label.effects)
    alone = [probe.truth([effect]) for effect in label.effects]
    listed = (
        alone[0] if len(alone) == 1 else (probe.truth(label.effects) if alone else _nothing(probe))
    )
    small = probe.truth(label.imperfections) if label.imperfections else _nothing(probe)
    everything = probe.truth(every) if label.imperfections and label.effects else None
    if everything is None:
        everything = listed if label.effects else small
    row = {
        'case': label.case,
        'sort': label.sort,
        'motions': [[m.kind, m.pace] for m in label.motions],
        'effects': [
            {**effect_mapping(e), 'rho': left.size}
            for e, left in zip(label.effects, alone, strict=True)
        ],
        'imperfections': [[e.name, list(e.where), e.form] for e in label.imperfections],
        'rho': listed.size,
        'rho_small': small.size,
        'rho_all': everything.size,
        'error': went['error'],
        'seconds': went.get('seconds'),
        'cpu_seconds': went.get('cpu_seconds'),
    }
    if diagnosis is None:
        return row
    row |= answer_of(diagnosis)
    row['share'] |= _true_share(probe, every, everything, small, diagnosis)
    row['parameters'] = _errors(label, diagnosis)
    return row


def _nothing(probe: Probe) -> Left:
    zero = np.zeros(len(probe.machine.drives))
    return Left(zero, zero)


def answer_of(d: Mapping[str, Any]) -> dict[str, Any]:
    """Return what of a diagnosis the scores need."""
    gap = d['gap']
    return {
        'verdict': {k: d['verdict'][k] for k in ('effect', 'where', 'probability')},
        'also': d['also'],
        'confusable': d['confusable'],
        'ranking': [
            {k: entry.get(k) for k in ('effect', 'where', 'probability', 'gap_after', 'share')}
            for entry in d['ranking'][:RANKED]
        ],
        'evidence': {**_evidence(gap), **d.get('evidence', {})},
        'not_testable': [[x['effect'], x['where'][0]] for x in d['not_testable']],
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


def _true_share(
    probe: Probe,
    every: Sequence[Effect],
    everything: Left,
    small: Left,
    diagnosis: Mapping[str, Any],
) -> dict[str, float | None]:
    """Return the shares closed on the noise-free recording held out.

    `oracle` is what the generator without the listed effects closes; `actual` what the model that
    the diagnosis delivers closes, beside its own nominal fit.
    """
    before = float(everything.check.sum())
    out: dict[str, float | None] = {'oracle': None, 'actual': None}
    if before > 0.0:
        out['oracle'] = 1.0 - float(small.check.sum()) / before
    effects = [diagnosis['verdict'], *diagnosis['also']]
    if diagnosis['verdict']['effect'] in ('none', 'unknown'):
        return out
    values = {name: v['value'] for name, v in diagnosis['parameters'].items()}
    moved = diagnosis['moved']
    data = probe.dataset(1, probe.effort(1, every))
    at = [EffectAt(e['effect'], e['where'][0]) for e in effects]
    extended = make_model(probe.machine, data, effects=at)
    nominal = make_model(probe.machine, data)
    try:
        with_effects = np.array([values[p.name] for p in extended.parameters])
        known = diagnosis.get('nominal') or {
            p.name: values[p.name] / (1.0 + moved.get(p.name, 0.0)) for p in nominal.parameters
        }
        without = np.array([float(known[p.name]) for p in nominal.parameters])
    except (KeyError, ZeroDivisionError):
        return out  # a parameter that moved to zero does not say where it was
    skip = int(round(0.1 / data.cycle))
    assert data.effort is not None
    squares = []
    for model, theta in ((nominal, without), (extended, with_effects)):
        rest = data.effort - model.simulate(theta[None])[0]
        squares.append(float(np.nansum(np.nanmean(rest[:, skip:] ** 2, axis=1))))
    if squares[0] > 0.0:
        out['actual'] = 1.0 - squares[1] / squares[0]
    return out


def _errors(label: Label, diagnosis: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return the relative errors of the sizes found, where the form is shared."""
    values = {name: v['value'] for name, v in diagnosis['parameters'].items()}
    out = []
    for effect in label.effects:
        if effect.name not in SHARED:
            continue
        if effect.form != 'same' and effect.name not in ONE_FORM:
            continue
        quantity, names, how = SHARED[effect.name]
        place = effect.where[0]
        prefix = effect.name if place == 'all' else f'{place}.{effect.name}'
        found = [values.get(f'{prefix}.{name}') for name in names]
        known = [x for x in found if x is not None]
        if len(known) < len(names):
            continue
        true = abs(effect.values[quantity])
        if how == 'factor':
            size = abs(known[0] - 1.0)
        elif how == 'inverse':
            size = 1.0 / max(abs(known[0]), 1e-9)
        else:
            size = float(np.linalg.norm(known))
        out.append(
            {'effect': effect.name, 'true': true, 'found': size, 'error': abs(size / true - 1.0)}
        )
    return out
