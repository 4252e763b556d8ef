# SPDX-License-Identifier: Apache-2.0
"""Rows of a blind check's table, made by hand."""

from typing import Any

from checks.blind.faults import Fault
from checks.blind.label import Label, MotionOrder, Part
from checks.blind.machines import read_plain
from checks.blind.rough import Rough


def a_label() -> Label:
    values = {'torque': 0.05, 'speed': 0.034}
    effect = Part('stribeck', 'stribeck.rational', 'drive_2', values, 2.1)
    small = Part('neighbour', 'neighbour', 'drive_1', {'force': 0.3}, None)
    motions = MotionOrder('mixed', 8.0, 3), MotionOrder('creep', 6.0, 4, 0.5)
    return Label(
        case=5,
        sort='single',
        generator='reference',
        machine=read_plain('config/tripod.yaml'),
        parameters={'tool_mass': 1.3},
        motions=motions,
        effects=(effect,),
        imperfections=(small,),
        fault=Fault('lag', -1, 0.03, 'command'),
        rough=Rough(0.01, (0.9,)),
        noise=(0.01, 0.011, 0.009),
        rho=2.1,
        rho_small=0.2,
        rho_all=2.2,
        share=0.98,
        seed=9,
    )


def effect(name: str, where: str, rho: float, form: str = 'some.form') -> dict[str, Any]:
    return {'effect': name, 'where': [where], 'rho': rho, 'form': form}


def row(
    case: int,
    sort: str,
    effects: list[dict[str, Any]],
    verdict: tuple[str, str],
    probability: float = 0.9,
    also: tuple[tuple[str, str], ...] = (),
    rivals: tuple[tuple[str, str], ...] = (),
    **more: Any,
) -> dict[str, Any]:
    rho = max((e['rho'] for e in effects), default=0.0)
    name, place = verdict
    where = [place] if place else []
    return {
        'case': case,
        'sort': sort,
        'motions': [['mixed', 1.0], ['dwell', 1.0]],
        'effects': effects,
        'imperfections': [],
        'rho': rho,
        'rho_small': 0.0,
        'rho_all': rho,
        'error': '',
        'seconds': 50.0,
        'cpu_seconds': 40.0,
        'verdict': {
            'effect': name,
            'where': where,
            'probability': probability,
            'sentence': f'{name} it is',
        },
        'also': [{'effect': n, 'where': [w]} for n, w in also],
        'confusable': [
            {'effect': n, 'where': [w], 'probability': 0.1} for n, w in ((name, place), *rivals)
        ],
        'ranking': [
            {'effect': n, 'where': [w], 'probability': 0.1, 'gap_after': g, 'share': s}
            for (n, w), g, s in zip(
                ((name, place), *rivals), (0.011, 0.012, 0.015), (0.95, 0.9, 0.5), strict=False
            )
        ],
        'evidence': {'size': rho, 'remaining': 0.1, 'closed': 0.95},
        'not_testable': [],
        'gap': {'before': 0.01 * (1 + rho**2) ** 0.5, 'after': 0.0101, 'noise_floor': 0.01},
        'gates': [],
        'share': {'predicted': 0.95, 'low': 0.9, 'high': 1.0, 'true': 0.97, 'oracle': 0.99},
        'complete': True,
        'parameters': [],
        'noise': {'size': 0.01, 'memory': 0.0, 'stated': 1.0, 'hard': False},
        'fault': None,
        'generator': 'reference',
    } | more


def interval(true: float, low: float | None, high: float | None) -> dict[str, Any]:
    return {'name': 'tool_mass', 'true': true, 'value': true, 'low': low, 'high': high}


def fault(kind: str, *named_by: str) -> dict[str, Any]:
    return {'kind': kind, 'drive': 0, 'value': 1.0, 'name': 'effort', 'named_by': list(named_by)}


def gate(name: str, sentence: str) -> dict[str, str]:
    return {'gate': name, 'level': 'fail', 'sentence': sentence}


def table() -> list[dict[str, Any]]:
    """Return a table in which every score is known by counting."""
    stribeck = [effect('stribeck', 'drive_1', 3.0)]
    bias = [effect('effort_bias', 'drive_2', 2.0)]
    delay = [effect('command_delay', 'drive_3', 0.7)]
    two = [effect('backlash', 'drive_1', 2.0), effect('stribeck', 'drive_2', 1.5)]
    slip = [effect('slip', 'drive_1', 2.0)]
    drag = [effect('quadratic_drag', 'drive_1', 0.1)]
    crash = row(12, 'single', stribeck, ('none', ''))
    for key in ('verdict', 'also', 'confusable', 'ranking', 'evidence', 'share', 'not_testable'):
        del crash[key]
    crash |= {'error': 'exit code 2', 'seconds': 1.0}
    refused = {key: crash[key] for key in crash} | {
        'case': 18,
        'sort': 'fault',
        'effects': [],
        'fault': fault('unit', 'unit'),
        'error': 'exit code 2: positions of 400 m; is their unit mm?',
    }
    three = [*two, effect('effort_bias', 'drive_3', 2.5)]
    small = [['torque_ripple', ['drive_1'], 'ripple.harmonics']]
    hard = {'size': 0.01, 'memory': 0.99, 'stated': 2.5, 'hard': True}
    holds, misses = interval(1.3, 1.2, 1.4), interval(1.3, 1.31, 1.4)
    unknown = interval(1.3, None, None)
    physics = (('stribeck', 'drive_1'),)
    return [
        row(1, 'none', [], ('none', ''), imperfections=small, parameters=[holds, holds, misses]),
        row(2, 'none', [], ('stribeck', 'drive_1'), 0.4, parameters=[misses]),
        row(3, 'single', stribeck, ('stribeck', 'drive_1'), rivals=(('presliding', 'drive_1'),)),
        row(4, 'single', stribeck, ('presliding', 'drive_1'), rivals=(('stribeck', 'drive_1'),)),
        row(
            5,
            'single',
            bias,
            ('constant_force', 'drive_2'),
            noise=hard,
            parameters=[holds, unknown],
        ),
        row(6, 'single', delay, ('none', ''), 0.6),
        row(7, 'pair', two, ('stribeck', 'drive_2'), also=(('backlash', 'drive_1'),)),
        row(8, 'pair', two, ('backlash', 'drive_1'), also=(('cable_spring', 'drive_1'),)),
        row(9, 'outside', slip, ('unknown', 'drive_1')),
        row(10, 'hidden', drag, ('none', ''), not_testable=[['quadratic_drag', 'drive_1']]),
        row(11, 'hidden', drag, ('none', '')),
        crash,
        row(13, 'ideal', [], ('none', '')),
        row(
            14,
            'triple',
            three,
            ('stribeck', 'drive_2'),
            also=(('backlash', 'drive_1'), ('constant_force', 'drive_3')),
        ),
        # Named by a gate; by a gate, but beside physics; by nobody; by refusing the log.
        row(
            15,
            'fault',
            [],
            ('unknown', ''),
            fault=fault('lag', 'late'),
            gates=[gate('command_delay', 'the set-point comes late by 30 ms')],
        ),
        row(
            16,
            'fault',
            [],
            *physics,
            fault=fault('sign', 'sign'),
            gates=[gate('sign', 'the effort of drive_1 has the wrong sign')],
        ),
        row(17, 'fault', [], ('none', ''), fault=fault('order', 'order', 'swap')),
        refused,
    ]
