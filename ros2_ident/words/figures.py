# SPDX-License-Identifier: Apache-2.0
"""Numbers, shares and lengths in sentences."""

from collections.abc import Sequence
import math
import re

from ros2_ident.gates.scale import figure as figure

# Two digits of a half do not tell halves apart that are closer than this, as a share.
_ALIKE = 0.05
_METRES = {'um': 1e-6, 'mm': 1e-3, 'm': 1.0}
_LENGTH = re.compile(r'(\d+(?:\.\d+)?)(?: to (\d+(?:\.\d+)?))? (um|mm|m)(?=/s|\b)')


def length(value: float, unit: str) -> str:
    """Return a small length: micrometres of one in m, else its own unit."""
    return f'{1e6 * value:.3g} um' if unit == 'm' else f'{value:.3g} {unit}'


def interval(value: float, low: float, high: float) -> str:
    """Return an interval: half of it after a ± where both halves are alike, else its ends.

    A dash where it is not known.
    """
    half = 0.5 * (high - low)
    if not math.isfinite(half):
        return '-'
    if not half > 0.0 or math.isclose(value - low, high - value, rel_tol=_ALIKE):
        return f'± {figure(half)}'
    digits = 2 + math.floor(math.log10(max(abs(low), abs(high))) - math.log10(half))
    digits = min(max(3, digits), 15)
    return f'[{low:.{digits}g}, {high:.{digits}g}]'


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
    others = {'m': 'position', 'rad': 'position', 'm/s': 'velocity', 'rad/s': 'velocity'}
    return others.get(unit, 'effort')


def percent(share: float) -> str:
    """Return a share in percent; one that would round to nothing as less than one."""
    return f'{100.0 * share:.0f} %' if share >= 0.005 else 'less than 1 %'


def capital(text: str) -> str:
    """Return a text that begins a sentence."""
    return f'{text[0].upper()}{text[1:]}'


def joined(names: Sequence[str]) -> str:
    """Return names as a list in a sentence."""
    return ' and '.join(filter(None, (', '.join(names[:-1]), *names[-1:])))


def duration(seconds: float) -> str:
    """Return a time for people: `8 s`, `1:05`, `?` where unknown."""
    if not math.isfinite(seconds):
        return '?'
    whole = max(0, round(seconds))
    return f'{whole} s' if whole < 60 else f'{whole // 60}:{whole % 60:02d}'


def quantity(value: float, unit: str) -> str:
    """Return a number of four digits with its unit."""
    return f'{value:.4g}' if unit == '1' else f'{value:.4g} {unit}'
