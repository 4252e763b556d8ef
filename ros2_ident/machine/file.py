# SPDX-License-Identifier: Apache-2.0
"""From a machine file to a `Machine`, and to remarks that name the line to change.

Which kinds of machines there are is known to the caller.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
import hashlib
from pathlib import Path
from typing import Any

import yaml

from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.files import read_small
from ros2_ident.machine.description import description_text
from ros2_ident.machine.draft import Remark
from ros2_ident.machine.judge import contents, judge, TEMPLATE
from ros2_ident.machine.keys import DESCRIPTION_TOPIC, Key, Value
from ros2_ident.machine.kind import Kind
from ros2_ident.machine.machine import Box, Machine
from ros2_ident.machine.units import effort_factors, number

_DEPTH = 50  # of lists and mappings


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

    def usable(self) -> Machine:
        """Return the machine.

        Raises:
            IdentError: The first remark, where it is an error.
        """
        if self.machine is None:
            first = self.remarks[0]
            raise IdentError(first.code, self.sentence(first))
        return self.machine


def read(path: str | Path, kinds: Mapping[str, Kind]) -> MachineFile:
    """Read a machine file and judge it.

    Args:
        path: A YAML file; its keys are those of its kind.
        kinds: Kinds of machines by name.

    Returns:
        The file, with everything there is to change in it.

    Raises:
        IdentError: BAD_MACHINE_FILE where it cannot be read or is no YAML.
    """
    try:
        raw = read_small(path)
    except (OSError, ValueError) as exc:
        raise IdentError(
            ErrorCode.BAD_MACHINE_FILE,
            f'{path}: cannot be read ({getattr(exc, "strerror", None) or exc}); give the path of '
            'a machine file',
        ) from None
    try:
        _refuse_aliases(raw, path)
        node = yaml.compose(raw, Loader=yaml.SafeLoader)
        data = yaml.safe_load(raw)
    except RecursionError:
        raise IdentError(
            ErrorCode.BAD_MACHINE_FILE, f'{path}: is nested too deeply; {TEMPLATE}'
        ) from None
    except (yaml.YAMLError, ValueError) as exc:
        mark = getattr(exc, 'problem_mark', None)
        where = f'{path}:{mark.line + 1}' if mark else str(path)
        problem = getattr(exc, 'problem', None) or str(exc).replace('\n', ' ')
        raise IdentError(
            ErrorCode.BAD_MACHINE_FILE,
            f'{where}: is no YAML ({problem}); correct this line or {TEMPLATE}',
        ) from None
    lines: dict[tuple[str, ...], int] = {}
    twice = [
        Remark(path, f'{path[-1]} stands there twice; keep one of the two lines')
        for path in _walk(node, (), lines)
    ]
    digest = hashlib.sha256(raw).hexdigest()
    return judged(data, kinds, str(path), lines, twice, digest, Path(path).parent)


def _refuse_aliases(raw: bytes, path: str | Path) -> None:
    """Refuse `*name`, by which a small file can stand for one without end, and depth.

    Raises:
        IdentError: BAD_MACHINE_FILE with the line.
        RecursionError: Before what is nested costs the reader time by its square.
    """
    depth = 0
    for event in yaml.parse(raw, Loader=yaml.SafeLoader):
        depth += isinstance(event, yaml.CollectionStartEvent)
        depth -= isinstance(event, yaml.CollectionEndEvent)
        if depth > _DEPTH:
            raise RecursionError
        if isinstance(event, yaml.AliasEvent):
            line = event.start_mark.line + 1 if event.start_mark else 1
            raise IdentError(
                ErrorCode.BAD_MACHINE_FILE,
                f'{path}:{line}: has the alias *{event.anchor}; write out '
                'what it stands for',
            )


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
        data: What the file holds.
        kinds: Kinds of machines by name.
        name: What to call it in messages.
        lines: Line of each key, by path.
        known: What is known already to need a change.
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
    present = contents(data)
    for key in kind.constants:
        if key.file and present.get(key.path, DESCRIPTION_TOPIC) != DESCRIPTION_TOPIC:
            text = description_text(folder / str(present[key.path]))
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
