# SPDX-License-Identifier: Apache-2.0
"""What is known of a machine, and the box of what is not: a machine file's content."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
import re
from typing import Any

from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.recording.streams import effort_factor


@dataclass(frozen=True)
class Machine:
    """The content of a machine file.

    Attributes:
        kind: `tripod`, `linear_axis` or `belt_drive`.
        drives: Joint names of the drives, in the model's order.
        geometry: Lengths, angles and gravity; SI units.
        drive: Constants of the drives; SI units.
        controller: Constants of the controller; SI units.
        bounds: `{name: (low, high, unit)}` of the parameters to be identified.
        effort_unit: Unit of the logged effort.
        effort_scale: Factor from the logged effort to N m (or N): a torque constant [N m/A], or
            the rated torque over 100 %.
        effort_noise: Standard deviation of the logged effort's noise, in the model's effort unit.
        digest: SHA-256 of the file, empty where the machine was made in memory.
    """

    kind: str
    drives: tuple[str, ...]
    geometry: Mapping[str, Any]
    drive: Mapping[str, float]
    controller: Mapping[str, Any]
    bounds: Mapping[str, tuple[float, float, str]]
    effort_unit: str = 'N m'
    effort_scale: float = 1.0
    effort_noise: float = 0.01
    digest: str = ''

    @property
    def travel_unit(self) -> str:
        """Unit of a drive's position: `rad` where the moving mass is stated as an inertia."""
        of = self.bounds.get('moving_mass', (0.0, 0.0, ''))[2]
        return 'rad' if plain_unit(of) == plain_unit(angular('kg')) else 'm'

    @property
    def model_unit(self) -> str:
        """Unit of an effort of the model: `N` where a log states a force or there is no gear."""
        if self.travel_unit == 'rad':
            return 'N m'
        force = self.effort_unit == 'N'
        other = self.effort_unit in ('A', 'percent') and 'gear_factor' not in self.drive
        return 'N' if force or other else 'N m'

    def with_bounds(self, bounds: Mapping[str, tuple[float, float, str]]) -> 'Machine':
        """Return the same machine with another box."""
        return replace(self, bounds=dict(bounds))

    def with_effort_unit(
        self, unit: str, torque_constant: float | None = None, rated_torque: float | None = None
    ) -> 'Machine':
        """Return the same machine with a log in another unit; the arguments are `effort_factor`'s.

        Raises:
            IdentError: WRONG_UNITS for an unknown unit or a missing constant.
        """
        factor = effort_factor(unit, torque_constant, rated_torque)
        return replace(self, effort_unit=unit, effort_scale=factor)


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


def constant(
    section: Mapping[str, Any], key: str, where: str, default: float | None = None
) -> float:
    """Return one number of a machine file's section.

    Args:
        section: The section's mapping.
        key: The number's name.
        where: The section's name, for the error.
        default: What an absent key means; None makes it an error.

    Returns:
        The number, in the unit the machine file states.

    Raises:
        IdentError: BAD_MACHINE_FILE where it is absent or no number.
    """
    value = section.get(key, default)
    if value is None:
        raise IdentError(
            ErrorCode.BAD_MACHINE_FILE,
            f'machine file: {where}.{key} is missing; add it as a number',
        )
    try:
        return float(value)
    except (TypeError, ValueError):
        raise IdentError(
            ErrorCode.BAD_MACHINE_FILE, f'machine file: {where}.{key} is {value!r}; write a number'
        ) from None
