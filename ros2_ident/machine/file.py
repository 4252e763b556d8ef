# SPDX-License-Identifier: Apache-2.0
"""From a machine file to a `Machine`, and to remarks that name the line to change."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
import difflib
import hashlib
import math
from pathlib import Path
from typing import Any, Literal

import yaml

from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.machine.keys import Key, keys_of, KINDS, LAWS
from ros2_ident.machine.machine import angular, Machine, plain_unit
from ros2_ident.recording.streams import effort_factor

_SECTIONS = ('geometry', 'drive', 'controller', 'parameters')
_TEMPLATE = 'start from one that `ident new-machine` writes'


@dataclass(frozen=True)
class Remark:
    """Something to change in a machine file.

    Attributes:
        level: `error` where the file cannot be used, `warn` where it is implausible.
        path: The key, `('drive', 'rail_mass')`.
        text: What was found and what is expected.
        code: The number that an error is raised with.
    """

    level: Literal['error', 'warn']
    path: tuple[str, ...]
    text: str
    code: ErrorCode = ErrorCode.BAD_MACHINE_FILE


@dataclass(frozen=True)
class MachineFile:
    """A machine file as read.

    Attributes:
        name: What to call it in messages: its path.
        lines: Line of each key, by path.
        remarks: What there is to change, errors first, else in the order of the file.
        machine: Its content; None where there are errors.
    """

    name: str
    lines: Mapping[tuple[str, ...], int]
    remarks: tuple[Remark, ...]
    machine: Machine | None

    def place(self, path: tuple[str, ...]) -> str:
        """Return `file:line` of a key, or of the section where it belongs."""
        while path and path not in self.lines:
            path = path[:-1]
        return f'{self.name}:{self.lines[path]}' if path else self.name

    def sentence(self, remark: Remark) -> str:
        """Return a remark with its place."""
        return f'{self.place(remark.path)}: {remark.text}'


def read_machine_file(path: str | Path) -> MachineFile:
    """Read a machine file and judge it.

    Args:
        path: A YAML file; its keys are those of `machine_keys.KEYS`.

    Returns:
        The file, with everything there is to change in it.

    Raises:
        IdentError: BAD_MACHINE_FILE where it cannot be read or is no YAML.
    """
    try:
        raw = Path(path).read_bytes()
    except OSError as exc:
        raise IdentError(
            ErrorCode.BAD_MACHINE_FILE,
            f'{path}: cannot be read ({exc.strerror}); give the path of a machine file',
        ) from None
    try:
        node = yaml.compose(raw, Loader=yaml.SafeLoader)
        data = yaml.safe_load(raw)
    except (yaml.YAMLError, ValueError) as exc:
        mark = getattr(exc, 'problem_mark', None)
        where = f'{path}:{mark.line + 1}' if mark else str(path)
        problem = getattr(exc, 'problem', None) or str(exc).replace('\n', ' ')
        raise IdentError(
            ErrorCode.BAD_MACHINE_FILE,
            f'{where}: is no YAML ({problem}); mend this line or {_TEMPLATE}',
        ) from None
    lines: dict[tuple[str, ...], int] = {}
    twice = list(_walk(node, (), lines))
    return _judged(str(path), data, lines, twice, hashlib.sha256(raw).hexdigest())


def load_machine(path: str | Path) -> Machine:
    """Read a machine file.

    Args:
        path: A YAML file in the format of `config/tripod.yaml`.

    Returns:
        The machine.

    Raises:
        IdentError: BAD_MACHINE_FILE, UNKNOWN_MODEL, UNKNOWN_PARAMETER or WRONG_UNITS with file,
        line and remedy.
    """
    return _usable(read_machine_file(path))


def machine_from_mapping(data: Any, where: object = 'machine file', digest: str = '') -> Machine:
    """Build a machine from a parsed machine file.

    Args:
        data: The mapping a machine file holds.
        where: What to call it in error messages.
        digest: SHA-256 of the file.

    Returns:
        The machine.

    Raises:
        IdentError: as `load_machine`, without lines.
    """
    return _usable(_judged(str(where), data, {}, [], digest))


def _usable(file: MachineFile) -> Machine:
    if file.machine is None:
        first = file.remarks[0]
        raise IdentError(first.code, file.sentence(first))
    return file.machine


def _walk(
    node: Any, above: tuple[str, ...], lines: dict[tuple[str, ...], int]
) -> Iterator[tuple[str, ...]]:
    """Note the line of every key below a node; yield those that stand there twice."""
    if not isinstance(node, yaml.MappingNode):
        return
    for key, value in node.value:
        path = (*above, str(key.value))
        if path in lines:
            yield path
        lines[path] = key.start_mark.line + 1
        yield from _walk(value, path, lines)


def _judged(
    name: str,
    data: Any,
    lines: Mapping[tuple[str, ...], int],
    twice: list[tuple[str, ...]],
    digest: str,
) -> MachineFile:
    remarks = [
        Remark('error', path, f'{path[-1]} stands there twice; keep one of the two lines')
        for path in twice
    ]
    remarks += _judge(data)
    remarks.sort(key=lambda remark: remark.level)  # `error` before `warn`, stable
    broken = any(remark.level == 'error' for remark in remarks)
    machine = None if broken else _machine(data, digest)
    return MachineFile(name, lines, tuple(remarks), machine)


def _machine(data: Mapping[str, Any], digest: str) -> Machine:
    """Return the machine of a mapping in which there is no error."""
    unit = str(data.get('effort_unit', 'N m'))
    return Machine(
        kind=data['machine'],
        drives=tuple(map(str, data['drives'])),
        geometry=dict(data.get('geometry') or {}),
        drive=dict(data.get('drive') or {}),
        controller=dict(data.get('controller') or {}),
        bounds={
            name: (float(low), float(high), str(of))
            for name, (low, high, of) in data['parameters'].items()
        },
        effort_unit=unit,
        effort_scale=effort_factor(unit, data.get('torque_constant'), data.get('rated_torque')),
        effort_noise=float(data.get('effort_noise', 0.01)),
        digest=digest,
    )


# ---------------------------------------------------------------------- judging


def _judge(data: Any) -> Iterator[Remark]:
    """Yield everything there is to change in a machine file's content."""
    if not isinstance(data, Mapping):
        yield Remark('error', (), f'holds no mapping; {_TEMPLATE}')
        return
    kind = str(data.get('machine'))
    if kind not in KINDS:
        yield Remark(
            'error',
            ('machine',),
            f'machine is {data.get("machine")!r}; write one of {", ".join(KINDS)}',
            ErrorCode.UNKNOWN_MODEL,
        )
        return
    keys = keys_of(kind)
    present: dict[tuple[str, ...], Any] = {}
    for name, value in data.items():
        if name not in _SECTIONS:
            present[str(name),] = value
        elif isinstance(value, Mapping):
            present |= {(name, str(key)): entry for key, entry in value.items()}
        elif value is not None:
            yield Remark('error', (name,), f'{name} has to be a mapping of names to values')
            return
    yield from _names(data, kind, present, keys)
    for path, value in present.items():
        if path in keys and path not in (('machine',), ('drives',)):
            yield from _value(keys[path], value, data)
    for key in keys.values():
        if key.absent or key.section == 'parameters' or key.path in present:
            continue
        if ('parameters', key.name) not in present and key.path != ('drives',):
            yield Remark(
                'error',
                key.path,
                f'{".".join(key.path)} is missing; add the line `{_line(key, kind)}`',
            )
    if not any(path[0] == 'parameters' for path in present):
        example = next(k for k in keys.values() if k.section == 'parameters')
        yield Remark(
            'error',
            ('parameters',),
            f'parameters is empty: name at least one, as `{_line(example, kind)}`',
        )
    yield from _together(kind, data, present)


def _names(
    data: Mapping[str, Any],
    kind: str,
    present: Mapping[tuple[str, ...], Any],
    keys: Mapping[tuple[str, ...], Key],
) -> Iterator[Remark]:
    """Judge the drives' names, and keys that no machine of this kind has."""
    drives = data.get('drives')
    if not isinstance(drives, list) or not drives or len(set(map(str, drives))) != len(drives):
        yield Remark('error', ('drives',), 'drives has to be a list of different joint names')
    elif kind == 'tripod' and len(drives) != 3:
        yield Remark(
            'error', ('drives',), f'a tripod has three drives, drives lists {len(drives)}'
        )
    for path in present:
        if path in keys:
            continue
        beside = [key[-1] for key in keys if key[:-1] == path[:-1]]
        near = difflib.get_close_matches(path[-1], beside, 1)
        elsewhere = next((key for key in keys if key[-1] == path[-1]), None)
        if elsewhere is not None:
            remedy = f'it belongs under {elsewhere[0] if elsewhere[1:] else "the file itself"}'
        elif near:
            remedy = f'write {near[0]}, or remove the line'
        else:
            remedy = f'choose from {", ".join(beside)}, or remove the line'
        yield Remark(
            'error',
            path,
            f'a {kind} has no key {".".join(path)!r}; {remedy}',
            ErrorCode.UNKNOWN_PARAMETER if path[0] == 'parameters' else ErrorCode.BAD_MACHINE_FILE,
        )


def _value(key: Key, value: Any, data: Mapping[str, Any]) -> Iterator[Remark]:
    """Judge one value by its row of the table."""
    if key.section == 'parameters':
        yield from _interval(key, value, data)
    elif key.name == 'rail_azimuth':
        angles = [_number(angle) for angle in value] if isinstance(value, list) else []
        if len(angles) != 3 or None in angles:
            yield Remark('error', key.path, 'geometry.rail_azimuth needs three angles in rad')
        elif any(not key.low <= angle <= key.high for angle in angles if angle is not None):
            yield Remark('warn', key.path, f'rail_azimuth is {value}; write the angles in rad')
    elif not key.unit:
        if key.name == 'law' and value not in LAWS:
            yield Remark(
                'error', key.path, f'law is {value!r}; write one of {", ".join(LAWS[:2])}'
            )
    else:
        number = _number(value)
        if number is None:
            yield Remark(
                'error',
                key.path,
                f'{".".join(key.path)} is {value!r}; write a number{_in_unit(key, data)}',
            )
        elif not key.low <= number <= key.high:
            yield Remark('warn', key.path, _implausible(key, f'{number:g}', data))


def _interval(key: Key, value: Any, data: Mapping[str, Any]) -> Iterator[Remark]:
    """Judge the box of one parameter."""
    ends = [_number(end) for end in value[:2]] if isinstance(value, list) else []
    if len(ends) != 2 or len(value) != 3 or None in ends:
        yield Remark(
            'error',
            key.path,
            f'parameter {key.name}: write [min, max, unit], found {value!r}',
        )
        return
    low, high = (end for end in ends if end is not None)
    if not low < high:
        yield Remark(
            'error', key.path, f'parameter {key.name}: min has to be below max, found {value!r}'
        )
    elif not (key.low <= low and high <= key.high):
        yield Remark('warn', key.path, _implausible(key, f'[{low:g}, {high:g}]', data))
    if _turns(data):
        known = [_unit(key, data)]
    else:
        known = [unit for unit in (key.unit, key.force_unit) if unit]
    if plain_unit(value[2]) not in [plain_unit(unit) for unit in known]:
        yield Remark(
            'error',
            key.path,
            f'parameter {key.name} is in {value[2]!r} but read as {_unit(key, data)}; convert the '
            'bounds and write that unit',
            ErrorCode.WRONG_UNITS,
        )


def _together(
    kind: str, data: Mapping[str, Any], present: Mapping[tuple[str, ...], Any]
) -> Iterator[Remark]:
    """Judge what is plausible or not only together."""
    number = {path: _number(value) for path, value in present.items()}
    unit = str(data.get('effort_unit', 'N m'))
    try:
        effort_factor(unit, data.get('torque_constant'), data.get('rated_torque'))
    except IdentError as error:
        yield Remark('error', ('effort_unit',), error.message, error.code)
    if kind == 'belt_drive':
        return
    gear = number.get(('drive', 'gear_factor'))
    if unit == 'N' and gear not in (None, 1.0):
        yield Remark(
            'warn',
            ('drive', 'gear_factor'),
            f'gear_factor is {gear:g} but effort_unit is N: a force needs none; leave it out, or '
            'state the unit of a torque',
        )
    turns = _turns(data)
    if turns and (unit == 'N' or gear is not None):
        other = 'effort_unit N' if unit == 'N' else 'gear_factor'
        yield Remark(
            'error',
            ('parameters', 'moving_mass'),
            f'moving_mass in kg m^2 says that the joint turns, {other} that it travels; state the '
            'mass in kg, or mend the other',
        )
    if unit == 'N m' and gear is None and not turns:
        yield Remark(
            'warn',
            ('effort_unit',) if ('effort_unit',) in present else ('drive',),
            'the effort is a torque but drive.gear_factor is missing; add it in rad/m, or write '
            '`effort_unit: N`, or `moving_mass` in kg m^2 where a joint turns',
        )
    turn = number.get(('drive', 'travel_per_turn'))
    if gear and turn and unit != 'N' and not 0.98 < turn * gear / (2.0 * math.pi) < 1.02:
        yield Remark(
            'warn',
            ('drive', 'travel_per_turn'),
            f'travel_per_turn {turn:g} m and gear_factor {gear:g} rad/m contradict each other; '
            f'one turn is {2.0 * math.pi / gear:.4g} m by the gear_factor',
        )
    rods, rails = (number.get(('geometry', n)) for n in ('rod_length', 'rail_radius'))
    if rods and rails and rods <= rails:
        yield Remark(
            'error',
            ('geometry', 'rod_length'),
            f'rod_length {rods:g} m does not reach the middle, {rails:g} m away (rail_radius); '
            'correct one of the two',
        )
    elastic = ('parameters', 'gear_stiffness') in present
    if kind == 'tripod' or elastic:
        for name, why in (
            ('gear_stiffness', 'a tripod has elastic gears'),
            ('drive_inertia', 'the motor of an elastic drive needs a mass'),
        ):
            if ('parameters', name) not in present:
                yield Remark(
                    'error',
                    ('parameters',),
                    f'parameters lacks {name}: {why}; add the line '
                    f'`{_line(keys_of(kind)["parameters", name], kind)}`, and hold a known value '
                    f'with --fix {name}=VALUE',
                )
    mass = number.get(('drive', 'rail_mass')) or 0.0
    if kind == 'linear_axis' and mass <= 0.0 and ('parameters', 'moving_mass') not in present:
        yield Remark(
            'error',
            ('drive', 'rail_mass'),
            'nothing has a mass: give drive.rail_mass in kg, or list moving_mass under parameters',
        )


def _line(key: Key, kind: str) -> str:
    """Return a key with its example, as it stands in a machine file."""
    return f'{key.name}: {literal(key, kind)}'


def literal(key: Key, kind: str) -> str:
    """Return the example of a key as YAML."""
    value = key.examples[kind]
    if key.section == 'parameters':
        assert isinstance(value, tuple)
        unit = '"1"' if key.unit == '1' else key.unit
        return f'[{_digits(value[0])}, {_digits(value[1])}, {unit}]'
    if isinstance(value, tuple):
        return f'[{", ".join(str(part) for part in value)}]'
    return _digits(value) if isinstance(value, float) else str(value)


def _digits(value: float) -> str:
    """Return a number so that YAML 1.1 reads it as one: with a point, its exponent with a sign."""
    if value and not 1e-3 <= abs(value) < 1e4:
        mantissa, _, exponent = f'{value:.7e}'.partition('e')
        mantissa = mantissa.rstrip('0')
        return f'{mantissa}{"0" if mantissa.endswith(".") else ""}e{int(exponent):+d}'
    text = f'{value:.9g}'
    return text if '.' in text else f'{text}.0'


def _number(value: Any) -> float | None:
    """Return a value as a finite number, None where it is none."""
    if isinstance(value, bool) or not isinstance(value, (int, float, str)):
        return None
    try:
        number = float(value)  # YAML 1.1 reads 1e-3 as a word
    except ValueError:
        return None
    return number if math.isfinite(number) else None


def _unit(key: Key, data: Mapping[str, Any]) -> str:
    if _turns(data):
        return angular(key.force_unit or key.unit)
    return key.force_unit if key.force_unit and data.get('effort_unit') == 'N' else key.unit


def _turns(data: Mapping[str, Any]) -> bool:
    """Whether a machine file's parameters say that the joint turns."""
    bounds = data.get('parameters')
    mass = bounds.get('moving_mass') if isinstance(bounds, Mapping) else None
    inertia = plain_unit(angular('kg'))
    return isinstance(mass, list) and plain_unit(mass[-1] if mass else '') == inertia


def _in_unit(key: Key, data: Mapping[str, Any]) -> str:
    unit = _unit(key, data)
    return '' if unit in ('', '1') else f' in {unit}'


def _implausible(key: Key, found: str, data: Mapping[str, Any]) -> str:
    return (
        f'{key.name} is {found} {_unit(key, data)}, {key.low:g} to {key.high:g} would be '
        'plausible; check value and unit'
    )
