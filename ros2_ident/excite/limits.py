# SPDX-License-Identifier: Apache-2.0
"""Limits of a motion: those of its drives and the room its tool may use."""

from collections.abc import Mapping
from dataclasses import dataclass
import math
from pathlib import Path
from typing import Any

import numpy as np

from ros2_ident.arrays import Array
from ros2_ident.errors import ErrorCode
from ros2_ident.files import read_yaml
from ros2_ident.machine.machine import Machine
from ros2_ident.models.registry import kind_of, set_points_of, space_of
from ros2_ident.models.serial.arm import arm_of

# Keys of a drive in a file of limits, as in MoveIt's joint_limits.yaml, by our names.
KEYS = {
    'low': 'min_position',
    'high': 'max_position',
    'velocity': 'max_velocity',
    'acceleration': 'max_acceleration',
    'jerk': 'max_jerk',
    'effort': 'max_effort',
}
# Where no jerk is stated, acceleration turns over in a quarter of the time from 0 to full speed.
_TURNS = 4.0
# A speed of 0 is refused in a sentence, after it was divided by.
_SLOWEST = 1e-12
# Step of the differences that tell how fast drives are where their tool is, share of the reach.
_STEP = 1e-4


@dataclass(frozen=True)
class Limits:
    """Limits of D drives, and of a way of M dimensions that leads them.

    Attributes:
        low: (D,) lowest position, rad or m; -inf where there is none.
        high: (D,) highest.
        velocity: (D,) largest speed.
        acceleration: (D,) largest acceleration.
        jerk: (D,) largest jerk.
        effort: (D,) largest effort, the model's unit; inf where there is none.
        way_low: (M,) lowest point of the way: of the tool where drives carry one, else `low`.
        way_high: (M,) highest.
    """

    low: Array
    high: Array
    velocity: Array
    acceleration: Array
    jerk: Array
    effort: Array
    way_low: Array
    way_high: Array

    def loads(self, motion: 'Moved') -> dict[str, Array]:
        """Return (D,) shares of the limits that a motion takes, by quantity; (M,) of `workspace`.

        A position's share is that of the way from the middle of its range to the nearer end.
        """
        half = 0.5 * (self.high - self.low)
        middle = np.add(self.low, self.high, out=np.zeros_like(half), where=np.isfinite(half))
        away = np.abs(motion.position - 0.5 * middle[:, None]).max(axis=1)
        out = {'position': away / half}
        for name in ('velocity', 'acceleration', 'jerk', 'effort'):
            rows = getattr(motion, name)
            if rows is not None:
                out[name] = np.abs(rows).max(axis=1) / getattr(self, name)
        if motion.tool is not None:
            half = 0.5 * (self.way_high - self.way_low)
            away = motion.tool - (self.way_low + half)[:, None]
            out['workspace'] = np.abs(away).max(axis=1) / half
        return out


@dataclass(frozen=True)
class Moved:
    """A motion of D drives at K instants, with its derivatives.

    Attributes:
        position: (D, K) rad or m.
        velocity: (D, K).
        acceleration: (D, K).
        jerk: (D, K); None where it does not count.
        effort: (D, K), the model's unit; None where it is not known.
        tool: (M, K) where the tool is that the drives carry, m; None where there is none.
    """

    position: Array
    velocity: Array
    acceleration: Array
    jerk: Array | None = None
    effort: Array | None = None
    tool: Array | None = None


def limits_of(machine: Machine, path: str | Path | None = None) -> Limits:
    """Return the limits of a machine.

    What a file of limits states counts first, then the machine file (`torque_limit`), its
    description, and where its kind has a space, the speeds and the room that suit it.

    Args:
        path: A file as MoveIt's joint_limits.yaml: `joint_limits: {drive: {max_velocity: ...}}`,
            also with `min_position`, `max_position`, `max_acceleration`, `max_jerk` and
            `max_effort`; `workspace: [[low, high], ...]` is the tool's room.

    Raises:
        IdentError: BAD_VALUES where the file is not such a one or a limit is missing.
    """
    content = {} if path is None else _read(path)
    found = {name: np.full(len(machine.drives), math.nan) for name in KEYS}
    for source in (_usual(machine), _described(machine), _of_file(content, machine, path)):
        for name, row in source.items():
            found[name] = np.where(np.isnan(row), found[name], row)
    quick = found['acceleration'] ** 2 / np.maximum(found['velocity'], _SLOWEST)
    found['jerk'] = np.where(np.isnan(found['jerk']), _TURNS * quick, found['jerk'])
    found['effort'] = np.where(np.isnan(found['effort']), math.inf, found['effort'])
    carried = carries(machine)
    if carried:
        for name, end in (('low', -math.inf), ('high', math.inf)):
            found[name] = np.where(np.isnan(found[name]), end, found[name])
    _complete(found, machine)
    room = _room(content, machine, path) if carried else (found['low'], found['high'])
    return Limits(**found, way_low=room[0], way_high=room[1])


def carries(machine: Machine) -> bool:
    """Return whether the drives carry a tool whose room counts."""
    return kind_of(machine).set_points is not None


def _usual(machine: Machine) -> dict[str, Array]:
    """Return what suits a machine whose kind has a space to move in."""
    out = {'effort': np.array([machine.number('torque_limit', d) for d in machine.drives])}
    kind = kind_of(machine)
    # How fast an arm may move only its owner knows.
    if kind.space is None or kind.described:
        return out
    space = kind.space(machine)
    if not carries(machine):
        out |= {'low': space.centre - space.reach, 'high': space.centre + space.reach}
    fast = np.linalg.norm(transmission(machine), axis=1)
    return out | {'velocity': space.speed * fast, 'acceleration': space.acceleration * fast}


def transmission(machine: Machine) -> Array:
    """Return (D, M) speeds of the drives by those of the way, in the middle of the room."""
    space = space_of(machine)
    step = _STEP * space.reach
    points = np.concatenate([np.diag(step), -np.diag(step)], axis=1) + space.centre[:, None]
    there = set_points_of(machine, points, np.zeros_like(points))[0]
    ahead, back = np.split(there, 2, axis=1)
    return np.asarray((ahead - back) / (2.0 * step))


def _described(machine: Machine) -> dict[str, Array]:
    """Return the limits of a URDF's joints."""
    text = machine.text('description') if 'description' in machine.constants else ''
    if '<robot' not in text:
        return {}
    # What has no limit is to be stated.
    return {k: np.where(np.isinf(x), math.nan, x) for k, x in arm_of(machine).limits.items()}


def _read(path: str | Path) -> dict[str, Any]:
    try:
        content = read_yaml(path)
    except ValueError as error:
        raise ErrorCode.BAD_VALUES.error(f'{path} {error}; correct it') from None
    if not isinstance(content, dict) or not {'joint_limits', 'workspace'} & set(content):
        raise ErrorCode.BAD_VALUES.error(
            f'{path} states no limits; write `joint_limits: {{drive: {{max_velocity: 1.0}}}}`'
        )
    return content


def _of_file(
    content: Mapping[str, Any], machine: Machine, path: str | Path | None
) -> dict[str, Array]:
    """Return what a file of limits states; `has_velocity_limits: false` leaves one out."""
    stated = content.get('joint_limits') or {}
    strange = set(stated) - set(machine.drives)
    if len(strange) == len(stated) and stated:
        raise ErrorCode.BAD_VALUES.error(
            f'{path} has no limits of {", ".join(machine.drives)}, but of {min(strange)}; name '
            'the drives as in the machine file'
        )
    out = {name: np.full(len(machine.drives), math.nan) for name in KEYS}
    for d, drive in enumerate(machine.drives):
        own = stated.get(drive) or {}
        for name, key in KEYS.items():
            if key in own and own.get(f'has_{key.partition("_")[2]}_limits', True):
                out[name][d] = _number(own[key], f'{path}: {key} of {drive}')
    return out


def _number(value: Any, what: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise ErrorCode.BAD_VALUES.error(f'{what} is {value!r}; give a number')
    return float(value)


def _room(
    content: Mapping[str, Any], machine: Machine, path: str | Path | None
) -> tuple[Array, Array]:
    """Return the room of a tool: as stated, else what suits the machine."""
    space = space_of(machine)
    if 'workspace' not in content:
        return space.centre - space.reach, space.centre + space.reach
    rows = content['workspace']
    shape = isinstance(rows, list) and all(isinstance(r, list) and len(r) == 2 for r in rows)
    if not shape or len(rows) != len(space.centre):
        raise ErrorCode.BAD_VALUES.error(
            f'{path}: workspace has to be {len(space.centre)} pairs [low, high] in m; correct it'
        )
    ends = [[_number(x, f'{path}: an end of workspace') for x in row] for row in rows]
    low, high = np.array(ends).T
    return low, high


def _complete(found: Mapping[str, Array], machine: Machine) -> None:
    for name, row in found.items():
        if np.isnan(row).any():
            raise ErrorCode.BAD_VALUES.error(
                f'no {KEYS[name]} of {machine.drives[int(np.argmax(np.isnan(row)))]} is known; '
                'state it in a file for --limits'
            )
    rates = ('velocity', 'acceleration', 'jerk', 'effort')
    wrong = [n for n in rates if not (found[n] > 0.0).all()]
    if wrong or not (found['low'] < found['high']).all():
        raise ErrorCode.BAD_VALUES.error(
            f'{KEYS[wrong[0]] if wrong else "max_position"} leaves no room to move; correct it'
        )
