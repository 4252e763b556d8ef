# SPDX-License-Identifier: Apache-2.0
"""Units of efforts, of straight motion and of joints that turn."""

import math
import re

from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.machine.shown import name_of, shown

_ANGULAR = {'kg': 'kg m^2', 'N': 'N m', 'm': 'rad'}


def angular(unit: str) -> str:
    """Return a unit of straight motion as it is where a joint turns: `N m s/rad` for `N s/m`.

    Args:
        unit: A unit of masses, forces and lengths.
    """
    return re.sub(r'\b(kg|N|m)\b', lambda found: _ANGULAR[found[0]], unit)


def plain_unit(unit: object) -> str:
    """Return a unit without what is a matter of taste."""
    text = str(unit).replace('²', '2').replace('·', '')
    return ''.join(text.replace('^', '').replace('*', '').split())


def effort_factor(
    unit: str, torque_constant: float | None = None, rated: float | None = None
) -> float:
    """Return the factor from a logged effort to N m (or N).

    Args:
        unit: `N m`, `N`, `A` or `percent`.
        torque_constant: N m/A (or N/A), needed for `A`.
        rated: Rated torque N m (or force N), needed for `percent`.

    Raises:
        IdentError: WRONG_UNITS naming what is missing.
    """
    if unit in ('N m', 'N'):
        return 1.0
    needed: dict[str, tuple[str, float | None, float]] = {
        'A': ('torque_constant', torque_constant, 1.0),
        'percent': ('rated_torque', rated, 0.01),
    }
    if unit not in needed:
        raise IdentError(
            ErrorCode.WRONG_UNITS,
            f'effort unit is {shown(unit)}; write one of N m, N, A, percent',
        )
    key, value, share = needed[unit]
    try:
        factor = float(value) if value is not None else 0.0
    except (TypeError, ValueError, OverflowError):
        factor = 0.0
    if not math.isfinite(factor) or factor == 0.0:
        raise IdentError(
            ErrorCode.WRONG_UNITS,
            f'effort unit {unit} needs {key} to become a torque, found {name_of(value)}; add the '
            f'line `{key}: ...` to the machine file, or give --{key.replace("_", "-")}',
        )
    return factor * share
