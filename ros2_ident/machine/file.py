# SPDX-License-Identifier: Apache-2.0
"""From a machine file to a `Machine`, and to remarks that name the line to change.

Which kinds of machines there are is known to the caller.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
import difflib
import hashlib
import os
from pathlib import Path
from typing import Any

import yaml

from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.files import read_small
from ros2_ident.machine.description import description_text
from ros2_ident.machine.keys import DESCRIPTION_TOPIC, Key, Value
from ros2_ident.machine.kind import Draft, Kind, Remark
from ros2_ident.machine.machine import Box, Machine
from ros2_ident.machine.units import effort_factors, name_of, number, plain_unit, shown
from ros2_ident.recording.limits import unfit

SECTIONS = ('geometry', 'drive', 'controller', 'parameters')
TEMPLATE = 'start from one that `ident new-machine` writes'
# What others are divided by; a gear may turn the other way round.
_ABOVE_ZERO = ('cycle', 'torque_limit')
_NOT_ZERO = (*_ABOVE_ZERO, 'gear_factor')


@dataclass(frozen=True)
class MachineFile:
    """A machine file as read.

    Attributes:
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

    def usable(self) -> Machine:
        """Return the machine.

        Raises:
            IdentError: The first remark, where it is an error.
        """
        if self.machine is None:
            first = self.remarks[0]
            raise first.code.error(self.sentence(first))
        return self.machine


def read(path: str | Path, kinds: Mapping[str, Kind]) -> MachineFile:
    """Read a machine file and judge it.

    Args:
        path: A YAML file; its keys are those of its kind.

    Returns:
        The file, with everything there is to change in it.

    Raises:
        IdentError: BAD_MACHINE_FILE where it cannot be read or is no YAML.
    """
    try:
        raw = read_small(path)
    except (OSError, ValueError) as exc:
        raise ErrorCode.BAD_MACHINE_FILE.error(
            f'{path}: cannot be read ({getattr(exc, "strerror", None) or exc}); give the path of '
            'a machine file'
        ) from None
    try:
        loader = _Loader(raw)
        node = loader.get_single_node()
        data = None if node is None else loader.construct_document(node)
    except RecursionError:
        raise ErrorCode.BAD_MACHINE_FILE.error(
            f'{path}: is nested too deeply; {TEMPLATE}'
        ) from None
    except (yaml.YAMLError, ValueError) as exc:
        mark = getattr(exc, 'problem_mark', None)
        where = f'{path}:{mark.line + 1}' if mark else str(path)
        problem = getattr(exc, 'problem', None) or str(exc).replace('\n', ' ')
        raise ErrorCode.BAD_MACHINE_FILE.error(
            f'{where}: is no YAML ({problem}); correct this line or {TEMPLATE}'
        ) from None
    lines: dict[tuple[str, ...], int] = {}
    twice = [
        Remark(path, f'{path[-1]} stands there twice; keep one of the two lines')
        for path in _walk(node, (), lines)
    ]
    digest = hashlib.sha256(raw).hexdigest()
    return judged(data, kinds, str(path), lines, twice, digest, Path(path).parent)


class _Loader(yaml.SafeLoader):
    """A loader that refuses `*name`, by which a small file can stand for one without end."""

    def compose_node(self, parent: Any, index: Any) -> Any:
        if self.check_event(yaml.AliasEvent):
            event = self.peek_event()  # type: ignore[no-untyped-call]
            problem = f'the alias *{event.anchor}; write out what it stands for'
            raise yaml.MarkedYAMLError(problem=problem, problem_mark=event.start_mark)
        return super().compose_node(parent, index)


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


def judged(
    data: Any,
    kinds: Mapping[str, Kind],
    name: str,
    lines: Mapping[tuple[str, ...], int] | None = None,
    known: list[Remark] | None = None,
    digest: str = '',
    folder: Path = Path(),
) -> MachineFile:
    """Judge a parsed machine file.

    Args:
        digest: SHA-256 of the file.
        folder: Where the files lie that it names.
    """
    remarks = [*(known or ()), *judge(data, kinds, folder)]
    remarks.sort(key=lambda remark: remark.level)  # `error` before `warn`, stable
    broken = any(remark.level == 'error' for remark in remarks)
    machine = None if broken else _machine(data, kinds[data['machine']], digest, folder)
    return MachineFile(name, lines or {}, tuple(remarks), machine)


# ---------------------------------------------------------------------- the value


def _machine(data: Mapping[str, Any], kind: Kind, digest: str, folder: Path) -> Machine:
    """Return the machine of a mapping in which there is no error."""
    present, described_in = contents(data), None
    for key in kind.constants:
        if key.file and present.get(key.path, DESCRIPTION_TOPIC) != DESCRIPTION_TOPIC:
            path = folder / str(present[key.path])
            text, described_in = description_text(path), path.parent
            present[key.path] = text
            digest = hashlib.sha256(f'{digest}{text}'.encode()).hexdigest()
    drives = tuple(map(str, data['drives']))
    unit = str(data.get('effort_unit', 'N m'))
    bounds, own = _boxes(present, drives)
    stated = [key for key in kind.constants if key.path in present]
    return Machine(
        kind=kind.name,
        drives=drives,
        constants=_constants(kind, present, drives, bounds, own),
        bounds=bounds,
        own_bounds=own,
        given=frozenset([*(key.name for key in stated), *({'effort_noise'} & data.keys())]),
        effort_unit=unit,
        effort_scale=(1.0,)
        if unit in kind.logs
        else effort_factors(unit, data.get('torque_constant'), data.get('rated_torque')),
        effort_noise=float(data.get('effort_noise', 0.01)),
        digest=digest,
        travel=kind.travel,
        described_in=described_in,
    )


def _boxes(
    present: Mapping[tuple[str, ...], Any], drives: tuple[str, ...]
) -> tuple[dict[str, Box], dict[str, Box]]:
    """Return the boxes by name, and those of single drives."""
    bounds: dict[str, Box] = {}
    own: dict[str, Box] = {}
    for path, value in present.items():
        if path[0] != 'parameters':
            continue
        several = value if isinstance(value[0], list) else [value]
        boxes = [(float(low), float(high), str(unit)) for low, high, unit in several]
        bounds[path[1]] = (min(b[0] for b in boxes), max(b[1] for b in boxes), boxes[0][2])
        if len(boxes) > 1:
            own |= {f'{d}.{path[1]}': box for d, box in zip(drives, boxes, strict=True)}
    return bounds, own


def _constants(
    kind: Kind,
    present: Mapping[tuple[str, ...], Any],
    drives: tuple[str, ...],
    bounds: Mapping[str, Box],
    own: Mapping[str, Box],
) -> dict[str, tuple[Value, ...]]:
    """Return every constant of the kind, what is absent by its default."""
    of_drive: list[dict[str, Value]] = [{} for _ in drives]
    out: dict[str, tuple[Value, ...]] = {}
    for key in kind.constants:
        for d, (drive, before) in enumerate(zip(drives, of_drive, strict=True)):
            if key.path in present:
                given = present[key.path]
                before[key.name] = _stated(key, given[d] if isinstance(given, list) else given)
            elif key.name in bounds:
                low, high, _ = own.get(f'{drive}.{key.name}', bounds[key.name])
                before[key.name] = 0.5 * (low + high)
            else:
                before[key.name] = key.value(before)
        values = tuple(before[key.name] for before in of_drive)
        out[key.name] = values if len(set(values)) > 1 else values[:1]
    return out


def _stated(key: Key, value: Any) -> Value:
    if key.unit:
        found = number(value)
        assert found is not None
        return found
    return dict(key.aliases).get(str(value), str(value))


# ---------------------------------------------------------------------- what there is to change


def contents(data: Mapping[str, Any]) -> dict[tuple[str, ...], Any]:
    """Return what a machine file holds by path; a section that is no mapping as a whole."""
    present: dict[tuple[str, ...], Any] = {}
    for name, value in data.items():
        if name in SECTIONS and isinstance(value, Mapping):
            present |= {(name, name_of(key)): entry for key, entry in value.items()}
        elif name not in SECTIONS or value is not None:
            present[name_of(name),] = value
    return present


def judge(data: Any, kinds: Mapping[str, Kind], folder: Path) -> Iterator[Remark]:
    """Yield everything there is to change in a machine file's content."""
    if not isinstance(data, Mapping):
        yield Remark((), f'holds no mapping; {TEMPLATE}')
        return
    if str(data.get('machine')) not in kinds:
        yield Remark(
            ('machine',),
            f'machine is {shown(data.get("machine"))}; write one of {", ".join(kinds)}',
            code=ErrorCode.UNKNOWN_MODEL,
        )
        return
    kind = kinds[str(data['machine'])]
    draft = Draft(kind.name, kind.by_path, contents(data))
    for name in SECTIONS:
        if (name,) in draft.present:
            yield Remark((name,), f'{name} has to be a mapping of names to values')
            return
    yield from _drives(draft, kind)
    yield from _names(draft)
    for path, value in draft.present.items():
        if path in draft.keys and path not in (('machine',), ('drives',)):
            yield from _value(draft, draft.keys[path], value)
            yield from _file(draft.keys[path], value, folder)
    yield from _missing(draft)
    yield from _effort(draft, kind)
    yield from kind.judge(draft)


def _drives(draft: Draft, kind: Kind) -> Iterator[Remark]:
    drives = draft.present.get(('drives',))
    for name in drives if isinstance(drives, list) else ():
        if why := unfit(name):
            yield Remark(('drives',), f'drives names a joint {shown(name)}, {why}')
            return
    if not isinstance(drives, list) or not drives or len(set(draft.drives)) != len(drives):
        yield Remark(('drives',), 'drives has to be a list of different joint names')
    elif kind.drives is not None and len(drives) != kind.drives:
        yield Remark(
            ('drives',),
            f'drives lists {len(drives)}, and a {kind.name} has {kind.drives}; name these',
        )


def _names(draft: Draft) -> Iterator[Remark]:
    """Judge keys that no machine of this kind has."""
    for path in draft.present:
        if path in draft.keys:
            continue
        beside = [key[-1] for key in draft.keys if key[:-1] == path[:-1]]
        near = difflib.get_close_matches(path[-1], beside, 1)
        elsewhere = next((key for key in draft.keys if key[-1] == path[-1]), None)
        if elsewhere is not None:
            remedy = f'it belongs under {elsewhere[0] if elsewhere[1:] else "the file itself"}'
        elif near:
            remedy = f'write {near[0]}, or remove the line'
        else:
            remedy = f'choose from {", ".join(beside)}, or remove the line'
        boxed = path[0] == 'parameters'
        found = ErrorCode.UNKNOWN_PARAMETER if boxed else ErrorCode.BAD_MACHINE_FILE
        yield Remark(
            path, f'a {draft.kind} has no key {shown(".".join(path))}; {remedy}', code=found
        )


def _missing(draft: Draft) -> Iterator[Remark]:
    """Judge what is not there; what is to be found need not be known."""
    for key in draft.keys.values():
        if key.absent or key.section == 'parameters' or key.path in draft.present:
            continue
        if not draft.states('parameters', key.name) and key.path != ('drives',):
            yield Remark(
                key.path,
                f'{".".join(key.path)} is missing; add the line `{draft.line(*key.path)}`',
            )
    if not any(path[0] == 'parameters' for path in draft.present):
        example = next(k for k in draft.keys.values() if k.section == 'parameters')
        yield Remark(
            ('parameters',),
            f'parameters is empty: name at least one, as `{draft.line(*example.path)}`',
        )


def _effort(draft: Draft, kind: Kind) -> Iterator[Remark]:
    if draft.effort_unit in kind.logs:
        return
    try:
        effort_factors(
            draft.effort_unit,
            draft.present.get(('torque_constant',)),
            draft.present.get(('rated_torque',)),
        )
    except IdentError as error:
        yield Remark(('effort_unit',), error.message, code=error.code)


# ---------------------------------------------------------------------- one value


def _value(draft: Draft, key: Key, value: Any) -> Iterator[Remark]:
    """Judge what stands at one key: one value, or one for each drive."""
    entries = [value]
    several = isinstance(value, list) and (
        key.section != 'parameters' or bool(value) and isinstance(value[0], list)
    )
    if several and key.each:
        entries = value
        if len(value) != len(draft.drives):
            yield Remark(
                key.path,
                f'{".".join(key.path)} has {len(value)} values for {len(draft.drives)} drives; '
                'write one for all, or one for each drive',
            )
            return
    for entry in entries:
        if key.section == 'parameters':
            yield from _interval(draft, key, entry)
        elif key.unit:
            yield from _quantity(draft, key, entry)
        elif key.choices and entry not in (*key.choices, *dict(key.aliases)):
            yield Remark(
                key.path, f'{key.name} is {shown(entry)}; write one of {", ".join(key.choices)}'
            )


def _file(key: Key, value: Any, folder: Path) -> Iterator[Remark]:
    if not key.file or value == DESCRIPTION_TOPIC:
        return
    # False, too, for what can be no path
    if isinstance(value, str) and os.path.isfile(folder / value):
        try:
            description_text(folder / value)
        except IdentError as error:
            yield Remark(key.path, error.message)
    else:
        yield Remark(
            key.path,
            f'{key.name} names {name_of(value)}, and there is no such file; give its way from the '
            'folder of the machine file',
        )


def _quantity(draft: Draft, key: Key, value: Any) -> Iterator[Remark]:
    found = number(value)
    if found is None:
        yield Remark(
            key.path,
            f'{".".join(key.path)} is {shown(value)}; write a number{_in_unit(draft, key)}',
        )
    elif found == 0.0 and key.name in _NOT_ZERO or found < 0.0 and key.name in _ABOVE_ZERO:
        yield Remark(
            key.path,
            f'{".".join(key.path)} is {found:g}, by which nothing can be divided; write a number '
            f'above 0{_in_unit(draft, key)}',
        )
    elif not key.low <= found <= key.high:
        yield Remark(key.path, _implausible(draft, key, f'{found:g}'), 'warn')


def _interval(draft: Draft, key: Key, value: Any) -> Iterator[Remark]:
    ends = [number(end) for end in value[:2]] if isinstance(value, list) else []
    if len(ends) != 2 or len(value) != 3 or None in ends:
        yield Remark(
            key.path, f'parameter {key.name}: write [min, max, unit], found {shown(value)}'
        )
        return
    low, high = (end for end in ends if end is not None)
    if not low < high:
        yield Remark(
            key.path, f'parameter {key.name}: min has to be below max, found {shown(value)}'
        )
    elif not (key.low <= low and high <= key.high):
        yield Remark(key.path, _implausible(draft, key, f'[{low:g}, {high:g}]'), 'warn')
    if draft.turns:
        known = [draft.unit(key)]
    else:
        known = [unit for unit in (key.unit, key.force_unit) if unit]
    if plain_unit(value[2]) not in [plain_unit(unit) for unit in known]:
        yield Remark(
            key.path,
            f'parameter {key.name} is in {shown(value[2])} but read as {draft.unit(key)}; convert '
            'the bounds and write that unit',
            code=ErrorCode.WRONG_UNITS,
        )


def _in_unit(draft: Draft, key: Key) -> str:
    unit = draft.unit(key)
    return '' if unit in ('', '1') else f' in {unit}'


def _implausible(draft: Draft, key: Key, found: str) -> str:
    return (
        f'{key.name} is {found} {draft.unit(key)}, {key.low:g} to {key.high:g} would be '
        f'plausible; {key.remedy}'
    )
