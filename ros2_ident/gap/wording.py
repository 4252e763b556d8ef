# SPDX-License-Identifier: Apache-2.0
"""Words for where a gap lies."""

import re

import numpy as np

from ros2_ident.arrays import Array
from ros2_ident.gap.coordinates import Coordinate, PHASES
from ros2_ident.gates.scale import figure as figure

# The regions that hold this share of what is explained are named.
_MOST = 0.75
# Phases that hold this share of it, and so many times their share of the time, are named.
_MAINLY, _DENSER = 0.5, 1.5


# What coordinates are called in a sentence, where that is not their name.
_SAID = {'velocity': 'speed', 'load': 'transmitted load'}
_WHILE = {
    'rest': 'at rest',
    'creep': 'while creeping',
    'acceleration': 'while accelerating',
    'cruise': 'while cruising',
    'deceleration': 'while braking',
    'reversal': 'at reversals',
}


_METRES = {'um': 1e-6, 'mm': 1e-3, 'm': 1.0}
_LENGTH = re.compile(r'(\d+(?:\.\d+)?)(?: to (\d+(?:\.\d+)?))? (um|mm|m)(?=/s|\b)')


def length(value: float, unit: str) -> str:
    """Return a small length: micrometres of one in m, else its own unit."""
    return f'{1e6 * value:.3g} um' if unit == 'm' else f'{value:.3g} {unit}'


def in_travel(text: str, unit: str, per_metre: float) -> str:
    """Return a sentence with its lengths and speeds in a drive's unit of travel.

    Args:
        text: A sentence with lengths in um, mm or m.
        unit: Unit of the drive's position.
        per_metre: How many of these a metre stands for.
    """
    if unit == 'm':
        return text

    def told(found: re.Match[str]) -> str:
        factor = _METRES[found[3]] * per_metre
        numbers = [f'{float(n) * factor:.3g}' for n in (found[1], found[2]) if n]
        return f'{" to ".join(numbers)} {unit}'

    return _LENGTH.sub(told, text)


def compared(unit: str) -> str:
    """Return what was compared, by its unit: effort, position or velocity."""
    return {'m': 'position', 'rad': 'position', 'm/s': 'velocity', 'rad/s': 'velocity'}.get(
        unit, 'effort'
    )


def percent(share: float) -> str:
    """Return a share in percent; one that would round to nothing as less than one."""
    return f'{100.0 * share:.0f} %' if share >= 0.005 else 'less than 1 %'


def _while(region: str) -> str:
    """Return phases as words in a sentence."""
    return ', '.join(_WHILE[phase] for phase in region.split(', '))


def region_of(
    coordinate: Coordinate, fitted: Array, weight: Array, noise: float
) -> tuple[str, str]:
    """Return where along a coordinate a fitted residual lies, and its shape, in words.

    Args:
        coordinate: The coordinate.
        fitted: (T,) part of the residual that it explains, in the effort's unit.
        weight: (T,) samples that each entry stands for.
        noise: Noise floor.
    """
    if coordinate.name == 'offset':
        mean = float(np.average(fitted, weights=weight))
        return 'everywhere', figure(mean, '+')
    if coordinate.pick:
        return _order(coordinate, fitted, coordinate.pick), ''
    sides = np.sign(coordinate.columns)
    inside = np.abs(coordinate.columns) > 0.0
    if coordinate.name == 'recent acceleration':
        return 'within 40 ms', ''
    if coordinate.labels and coordinate.name != 'phase':
        size = np.abs((coordinate.columns / coordinate.columns.std(axis=0)).T @ fitted)
        return coordinate.labels[int(np.argmax(size))], ''
    if coordinate.labels:
        held = dict(zip(coordinate.labels, (weight * fitted**2) @ inside, strict=True))
        names = sorted(held, key=lambda name: -held[name])
        most = np.cumsum([held[name] for name in names]) >= _MOST * sum(held.values())
        return ', '.join(names[: 1 + int(np.argmax(most))]), ''
    counts = np.array([float(weight[c].sum()) for c in inside.T])
    means = np.array(
        [
            float(np.average((fitted * s)[c], weights=weight[c]))
            for s, c in zip(sides.T, inside.T, strict=True)
        ]
    )
    power = np.maximum(counts * means**2 - noise**2, 0.0)
    region, _, _ = _region(coordinate, power)
    return region, _shape(means, coordinate.place.mean(axis=1), counts)


def _region(coordinate: Coordinate, power: Array) -> tuple[str, int, int]:
    """Return the shortest region that holds most of the power, in words and as its end columns."""
    first, last = _narrowest(power)
    ends = coordinate.place
    low, high = ends[first, 0], ends[last, 1]
    if last - first + 1 > 0.8 * len(ends):
        return 'everywhere', first, last
    if first == 0:
        return f'below {figure(high)} {coordinate.unit}', first, last
    if last == len(ends) - 1:
        return f'above {figure(low)} {coordinate.unit}', first, last
    return f'{figure(low)} to {figure(high)} {coordinate.unit}', first, last


def concentration(
    drive: str, coordinate: Coordinate, power: Array, time: Array, unit: str, size: float
) -> tuple[str, float, str]:
    """Return where the gap is large, how much more so than by its share of time, and the sentence.

    Args:
        drive: The drive.
        coordinate: What cuts the motion into regions.
        power: (B,) squares above the noise in each region.
        time: (B,) samples in each region.
        unit: Unit of the effort.
        size: RMS of the gap above the noise.
    """
    share, lasts = power / power.sum(), time / time.sum()
    if coordinate.labels:
        density = share / np.maximum(lasts, 1e-9)
        chosen: list[int] = []
        for i in np.argsort(-density):
            if share[chosen].sum() >= _MOST or density[i] < 1.0:
                break
            chosen.append(int(i))
        region = ', '.join(coordinate.labels[i] for i in chosen)
    else:
        region, first, last = _region(coordinate, np.maximum(power, 0.0))
        chosen = list(range(first, last + 1))
    held, part = float(share[chosen].sum()), float(lasts[chosen].sum())
    name = _SAID.get(coordinate.name, coordinate.name)
    where = _while(region) if coordinate.labels else f'where the {name} is {region}'
    text = (
        f'{drive}: {percent(held)} of the gap of {figure(size)} {unit} lies {where}, '
        f'{percent(part)} of the time'
    )
    return region, min(1.0, max(0.0, held - part)), text


def _order(coordinate: Coordinate, fitted: Array, size: int) -> str:
    """Return the motor order whose lines hold most."""
    columns = coordinate.columns / np.linalg.norm(coordinate.columns, axis=0)
    power = (columns.T @ fitted) ** 2
    groups = power.reshape(-1, size).sum(axis=1)
    return f'order {coordinate.place[size * int(np.argmax(groups)), 0]:.0f}'


def _narrowest(power: Array) -> tuple[int, int]:
    """Return the ends of the shortest run that holds most of the power."""
    total = np.concatenate([[0.0], np.cumsum(power)])
    if total[-1] <= 0.0:
        return 0, len(power) - 1
    best = (len(power), 0.0, 0, len(power) - 1)
    for first in range(len(power)):
        enough = np.flatnonzero(total[first + 1 :] - total[first] >= _MOST * total[-1])
        if enough.size:
            last = first + int(enough[0])
            best = min(best, (last - first, -(total[last + 1] - total[first]), first, last))
    return best[2], best[3]


def _shape(means: Array, centres: Array, counts: Array) -> str:
    """Return whether the means go up or down along the coordinate."""
    if means.size < 4:
        return ''
    a = centres - np.average(centres, weights=counts)
    b = means - np.average(means, weights=counts)
    spread = np.sqrt(np.average(a**2, weights=counts) * np.average(b**2, weights=counts))
    slope = float(np.average(a * b, weights=counts)) / max(float(spread), 1e-300)
    return 'rising' if slope > 0.9 else 'falling' if slope < -0.9 else ''


def sentence_of(
    drive: str,
    coordinate: Coordinate,
    region: str,
    shape: str,
    share: float,
    size: float,
    unit: str,
    power: Array,
    time: Array,
) -> str:
    """Return a finding in words.

    Args:
        drive: The drive.
        coordinate: What the residual follows.
        region: Where along it.
        shape: Rising, falling, or the offset's value.
        share: Share of the gap above the noise floor.
        size: RMS that it explains.
        unit: Unit of the effort.
        power: (P,) what is explained in each phase.
        time: (P,) samples in each phase.
    """
    name = coordinate.name
    along = _SAID.get(name, name)
    along = f'{along} {region}' if region != 'everywhere' else f'along the {along}'
    what = {
        'offset': f'a constant {shape} {unit}',
        'motor angle': f'periodic in the motor angle, {region} per turn',
        'phase': _while(region) if name == 'phase' else '',
        'other drives': f'follows the {region}',
        'torque rate': 'follows the rate of the effort, as with a wrong delay',
        'recent acceleration': 'follows the acceleration of the last 40 ms',
        'lagging friction': f'like a friction that lags behind the motion: {region}',
    }.get(name, f'{along}, {shape} with it' if shape else along)
    parts = [what]
    if name not in ('phase', 'offset'):
        where = _phases(power, time)
        if where:
            parts.insert(0, where)
    if coordinate.parity == 'odd':
        parts.append('changing sign with the direction of motion')
    elif coordinate.parity == 'even' and name != 'offset':
        parts.append('the same in both directions')
    return (
        f'{drive}: {", ".join(parts)}; {percent(share)} of the gap above the noise, '
        f'{figure(size)} {unit} RMS'
    )


def _phases(power: Array, time: Array) -> str:
    """Return the phase that holds most, where it holds much more than its time."""
    total, whole = float(power.sum()), float(time.sum())
    if total <= 0.0:
        return ''
    held, lasts = power / total, time / whole
    top = int(np.argmax(held))
    if held[top] < _MAINLY or held[top] < _DENSER * lasts[top]:
        return ''
    return _WHILE[PHASES[top]]
