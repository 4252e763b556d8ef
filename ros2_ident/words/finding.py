# SPDX-License-Identifier: Apache-2.0
"""Where a gap lies."""

from collections.abc import Sequence
import math

from ros2_ident.gap.where.localise import Finding
from ros2_ident.gates.asked import Event
from ros2_ident.words.figures import figure, percent

# Coordinates that a sentence calls otherwise, and phases of the motion.
_NAMES = {'velocity': 'speed', 'load': 'transmitted load'}
_WHILE = {
    'rest': 'at rest',
    'creep': 'while creeping',
    'acceleration': 'while accelerating',
    'cruise': 'while cruising',
    'deceleration': 'while braking',
    'reversal': 'at reversals',
}


def instants(events: Sequence[Event], unit: str) -> str:
    """Return bursts of effort, each with its size, and its recording where there are several."""
    several = any(e.recording > 1 for e in events)
    return ', '.join(
        f'{e.when} ({figure(e.effort, "+")} {unit})'
        + (f' in recording {e.recording}' if several else '')
        for e in events
    )


def region(f: Finding) -> str:
    """Return the part of the coordinate in which a finding lies."""
    r = f.region
    if f.events:
        return instants(f.events, f.unit)
    if f.along == 'recent acceleration':
        return 'within 40 ms'
    if r.labels:
        return ', '.join(r.labels)
    if r.low == r.high:
        return f'order {r.low:.0f}'
    low, high = (f'{x:.3g}' if f.along == 'frequency' else figure(x) for x in (r.low, r.high))
    if math.isinf(r.low):
        return 'everywhere' if math.isinf(r.high) else f'below {high} {r.unit}'
    return f'above {low} {r.unit}' if math.isinf(r.high) else f'{low} to {high} {r.unit}'


def where(f: Finding) -> str:
    """Return a finding as a clause: the drive, where its gap lies, and how large that part is."""
    if f.events:
        of = 'as if pushed' if f.commanded else 'effort that was not commanded'
        return (
            f'{f.drive}: {of} at {region(f)}; up to {f.value:.2g} times the residual elsewhere, '
            f'{percent(f.statistic)} of its power'
        )
    doubt = '; not certain, the motion passes there too few times' if f.likely else ''
    return (
        f'{f.drive}: {_along(f)}; {percent(f.statistic)} of the gap above the noise, '
        f'{figure(f.size)} {f.unit} RMS{doubt}'
    )


def _along(f: Finding) -> str:
    """Return the coordinate that a residual follows, and how."""
    name, at = _NAMES.get(f.along, f.along), region(f)
    along = f'along the {name}' if at == 'everywhere' else f'{name} {at}'
    text = {
        'offset': f'a constant {figure(f.value, "+")} {f.unit}',
        'frequency': f'a swing at {f.value:.3g} Hz (band {at})',
        'motor angle': f'periodic in the motor angle, {at} per turn',
        'phase': ', '.join(_WHILE.get(phase, phase) for phase in f.region.labels),
        'other drives': f'follows the {at}, as with cross-talk or a motor that turns with another '
        'joint, too (coupled_to)',
        'torque rate': 'follows the rate of the effort, as with a wrong delay',
        'recent acceleration': 'follows the acceleration of the last 40 ms',
        'lagging friction': f'like a friction that lags behind the motion: {at}',
    }.get(f.along, along)
    parts = [text]
    if f.phase and f.along not in ('phase', 'offset'):
        parts.insert(0, _WHILE[f.phase])
    if f.parity == 'odd':
        parts.append('changing sign with the direction of motion')
    elif f.parity == 'even' and f.along != 'offset':
        parts.append('the same in both directions')
    return ', '.join(parts)
