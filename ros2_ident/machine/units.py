# SPDX-License-Identifier: Apache-2.0
"""Units of efforts, of straight motion and of joints that turn."""

import math
import re
import reprlib
from typing import Any

from ros2_ident.errors import ErrorCode

_ANGULAR = {'kg': 'kg m^2', 'N': 'N m', 'm': 'rad'}
# Lever that makes a way of an angle, m: the radius of a common pulley or pinion. By it advice for
# a carriage is advice for a joint.
LEVER = 0.05


def angular(unit: str) -> str:
    """Return a unit of straight motion as it is where a joint turns: `N m s/rad` for `N s/m`.

    Args:
        unit: A unit of masses, forces and lengths.
    """
    return re.sub(r'\b(kg|N|m)\b', lambda found: _ANGULAR[found[0]], unit)


def straight(unit: str) -> str:
    """Return a unit of a joint that turns as it is where it slides: `N s/m` for `N m s/rad`."""
    of = {there: here for here, there in _ANGULAR.items()}
    return re.sub(r'kg m\^2|N m|rad', lambda found: of[found[0]], unit)


def per_metre(unit: str) -> float:
    """Return how much travel in `m` or `rad` stands for a metre."""
    return 1.0 / LEVER if unit == 'rad' else 1.0


def plain_unit(unit: object) -> str:
    """Return a unit without what is a matter of taste."""
    text = str(unit).replace('²', '2').replace('·', '')
    return ''.join(text.replace('^', '').replace('*', '').split())


def number(value: Any) -> float | None:
    """Return a value as a finite number, None where it is none."""
    if isinstance(value, bool) or not isinstance(value, (int, float, str)):
        return None
    try:
        found = float(value)  # YAML 1.1 reads 1e-3 as a word
    except (ValueError, OverflowError):  # the latter of a whole number with 309 digits
        return None
    return found if math.isfinite(found) else None


# What the machine file has to state for an effort in a unit that is no torque or force.
STATED_FOR = {'A': 'torque_constant', 'percent': 'rated_torque'}


def effort_factors(
    unit: str, torque_constant: object = None, rated: object = None
) -> tuple[float, ...]:
    """Return the factor from a logged effort to N m (or N), or one for each drive.

    Args:
        unit: `N m`, `N`, `A` or `percent`.
        torque_constant: N m/A (or N/A), needed for `A`; one number, or a list.
        rated: Rated torque N m (or force N), needed for `percent`; likewise.

    Raises:
        IdentError: WRONG_UNITS naming what is missing.
    """
    if unit in ('N m', 'N'):
        return (1.0,)
    if unit not in STATED_FOR:
        raise ErrorCode.WRONG_UNITS.error(
            f'effort unit is {shown(unit)}; write one of N m, N, A, percent'
        )
    key = STATED_FOR[unit]
    value, share = (torque_constant, 1.0) if unit == 'A' else (rated, 0.01)
    factors = [number(x) or 0.0 for x in (value if isinstance(value, list) else [value])]
    if not all(factors):
        raise ErrorCode.WRONG_UNITS.error(
            f'effort unit {unit} needs {key} to become a torque, found {name_of(value)}; add the '
            f'line `{key}: ...` to the machine file, or give --{key.replace("_", "-")}'
        )
    return tuple(x * share for x in factors)


_SHORT = reprlib.Repr()
_SHORT.maxstring, _SHORT.maxother = 120, 120


def shown(value: Any) -> str:
    """Return a value as Python writes it, at most some hundred characters of it."""
    try:
        return _SHORT.repr(value)
    except ValueError:  # a whole number that Python does not print
        return 'a number of thousands of digits'


def name_of(value: Any) -> str:
    """Return a name as it is, where that can be shown."""
    text = value if isinstance(value, str) else shown(value)
    return text if text.isprintable() and len(text) <= _SHORT.maxstring else shown(text)
