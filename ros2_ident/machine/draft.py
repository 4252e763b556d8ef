# SPDX-License-Identifier: Apache-2.0
"""A machine file's content on its way to a `Machine`: what a kind's own judgement looks at."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

from ros2_ident.errors import ErrorCode
from ros2_ident.machine.keys import Key, literal
from ros2_ident.machine.units import angular, number, plain_unit

Path = tuple[str, ...]


@dataclass(frozen=True)
class Remark:
    """Something to change in a machine file.

    Attributes:
        path: The key, `('drive', 'rail_mass')`.
        text: What was found and what is expected.
        level: `error` where the file cannot be used, `warn` where it is implausible.
        code: The number that an error is raised with.
    """

    path: Path
    text: str
    level: Literal['error', 'warn'] = 'error'
    code: ErrorCode = ErrorCode.BAD_MACHINE_FILE


@dataclass(frozen=True)
class Draft:
    """A machine file's content by path.

    Attributes:
        kind: Name of the kind.
        keys: The kind's keys by path.
        present: What the file holds, by path; nothing of it need be in order.
    """

    kind: str
    keys: Mapping[Path, Key]
    present: Mapping[Path, Any]

    @property
    def drives(self) -> tuple[str, ...]:
        """Joint names of the drives; empty where the list is not in order."""
        drives = self.present.get(('drives',))
        return tuple(map(str, drives)) if isinstance(drives, list) else ()

    @property
    def effort_unit(self) -> str:
        """Unit of the logged effort."""
        return str(self.present.get(('effort_unit',), 'N m'))

    @property
    def turns(self) -> bool:
        """Whether the parameters say that the joint turns."""
        box = self.present.get(('parameters', 'moving_mass'))
        while isinstance(box, list) and box and isinstance(box[-1], list):
            box = box[-1]
        inertia = plain_unit(angular('kg'))
        return isinstance(box, list) and plain_unit(box[-1] if box else '') == inertia

    def states(self, section: str, name: str) -> bool:
        """Return whether a key stands in the file."""
        return (section, name) in self.present

    def numbers(self, section: str, name: str) -> tuple[float, ...]:
        """Return what a key states: one number, or one for each drive; empty where none is."""
        value = self.present.get((section, name))
        several = value if isinstance(value, list) else [value]
        numbers = [number(entry) for entry in several]
        return tuple(entry for entry in numbers if entry is not None)

    def each(self, *paths: tuple[str, str]) -> list[tuple[float, ...]]:
        """Return the numbers of several keys drive by drive; empty where one of them has none."""
        rows = [self.numbers(*path) for path in paths]
        count = max(len(row) for row in rows)
        if not all(rows) or any(len(row) not in (1, count) for row in rows):
            return []
        return list(zip(*(row * (count // len(row)) for row in rows), strict=True))

    def unit(self, key: Key) -> str:
        """Return the unit in which a key is read."""
        if self.turns:
            return angular(key.force_unit or key.unit)
        return key.force_unit if key.force_unit and self.effort_unit == 'N' else key.unit

    def line(self, *path: str) -> str:
        """Return a key with its example, as it stands in a machine file."""
        key = self.keys[path]
        return f'{key.name}: {literal(key)}'
