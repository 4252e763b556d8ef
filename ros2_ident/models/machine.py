# SPDX-License-Identifier: Apache-2.0
"""The machine file: what is known of a machine, and the box of what is not."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
import hashlib
from pathlib import Path
from typing import Any

import yaml

from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.recording.streams import effort_factor

KINDS = ('tripod', 'linear_axis', 'belt_drive')


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
    def model_unit(self) -> str:
        """Unit of an effort of the model: `N` where a log states a force or there is no gear."""
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


def _fail(path: object, text: str) -> IdentError:
    return IdentError(ErrorCode.BAD_MACHINE_FILE, f'{path}: {text}')


def machine_from_mapping(data: Any, where: object = 'machine file', digest: str = '') -> Machine:
    """Build a machine from a parsed machine file.

    Args:
        data: The mapping a machine file holds.
        where: What to call it in error messages.
        digest: SHA-256 of the file.

    Returns:
        The machine.

    Raises:
        IdentError: BAD_MACHINE_FILE naming the line's key and the remedy.
    """
    if not isinstance(data, Mapping):
        raise _fail(where, 'holds no mapping; start from a file in config/')
    kind = data.get('machine')
    if kind not in KINDS:
        raise IdentError(
            ErrorCode.UNKNOWN_MODEL,
            f'{where}: machine is {kind!r}; write one of {", ".join(KINDS)}',
        )
    drives = data.get('drives')
    if not isinstance(drives, list) or not drives or len(set(map(str, drives))) != len(drives):
        raise _fail(where, 'drives has to be a list of different joint names')
    if kind == 'tripod' and len(drives) != 3:
        raise _fail(where, f'a tripod has three drives, drives lists {len(drives)}')
    sections = {}
    for key in ('geometry', 'drive', 'controller', 'parameters'):
        section = data.get(key, {})
        if not isinstance(section, Mapping):
            raise _fail(where, f'{key} has to be a mapping of names to values')
        sections[key] = section
    bounds = {}
    for name, entry in sections['parameters'].items():
        try:
            low, high, unit = entry
            bounds[str(name)] = (float(low), float(high), str(unit))
        except (TypeError, ValueError):
            raise _fail(
                where, f'parameter {name}: write [min, max, unit], found {entry!r}'
            ) from None
        if not bounds[str(name)][0] < bounds[str(name)][1]:
            raise _fail(where, f'parameter {name}: min has to be below max, found {entry!r}')
    if not bounds:
        raise _fail(
            where, 'parameters is empty: name at least one, as `tool_mass: [1.0, 2.0, kg]`'
        )
    unit = str(data.get('effort_unit', 'N m'))
    try:
        scale = effort_factor(unit, data.get('torque_constant'), data.get('rated_torque'))
    except IdentError as error:
        raise IdentError(error.code, f'{where}: {error.message}') from None
    return Machine(
        kind=kind,
        drives=tuple(map(str, drives)),
        geometry=dict(sections['geometry']),
        drive=dict(sections['drive']),
        controller=dict(sections['controller']),
        bounds=bounds,
        effort_unit=unit,
        effort_scale=scale,
        effort_noise=float(data.get('effort_noise', 0.01)),
        digest=digest,
    )


def load_machine(path: str | Path) -> Machine:
    """Read a machine file.

    Args:
        path: A YAML file in the format of `config/tripod.yaml`.

    Returns:
        The machine.

    Raises:
        IdentError: BAD_MACHINE_FILE, UNKNOWN_MODEL or WRONG_UNITS with the remedy.
    """
    try:
        raw = Path(path).read_bytes()
    except OSError as exc:
        raise _fail(
            path, f'cannot be read ({exc.strerror}); give the path of a machine file'
        ) from None
    try:
        data = yaml.safe_load(raw)
    except yaml.YAMLError as exc:
        line = str(exc).replace('\n', ' ')
        raise _fail(path, f'is no YAML: {line}') from None
    return machine_from_mapping(data, path, hashlib.sha256(raw).hexdigest())


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
