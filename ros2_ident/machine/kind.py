# SPDX-License-Identifier: Apache-2.0
"""Kind of machine: its keys, its judgement of a file's content, its model and its space."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
import functools
import pkgutil
from typing import Any, Literal
from xml.etree.ElementTree import Element

import numpy as np

from ros2_ident.arrays import Array
from ros2_ident.errors import ErrorCode
from ros2_ident.machine.keys import Key, literal
from ros2_ident.machine.machine import Machine
from ros2_ident.machine.units import angular, number, plain_unit, shown

Path = tuple[str, ...]


@dataclass(frozen=True)
class Remark:
    """Something to change in a machine file.

    Attributes:
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
        present: What the file holds, by path; nothing of it need be in order.
    """

    kind: str
    keys: Mapping[Path, Key]
    present: Mapping[Path, Any]

    @property
    def drives(self) -> tuple[str, ...]:
        """Joint names of the drives; empty where the list is not in order."""
        drives = self.present.get(('drives',))
        named = drives if isinstance(drives, list) else ()
        return tuple(x if isinstance(x, str) else shown(x) for x in named)

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


@dataclass(frozen=True)
class Space:
    """Where and how fast a machine moves.

    Attributes:
        centre: (M,) middle of the workspace [m]: platform position, or axis position.
        reach: (M,) half its extents [m].
        speed: Largest speed [m/s].
        acceleration: Largest acceleration [m/s^2].
    """

    centre: Array
    reach: Array
    speed: float
    acceleration: float

    def point(self, rng: np.random.Generator, share: float = 1.0) -> Array:
        """Return a point drawn evenly from the workspace, shrunk to a share of its reach."""
        away = rng.uniform(-1.0, 1.0, self.centre.size)
        return np.asarray(self.centre + share * self.reach * away)


@dataclass(frozen=True, eq=False)
class Figure:
    """A machine at F instants; lengths in m.

    Attributes:
        size: A length of the machine to which what is drawn is scaled, m.
        tool: Where its tool is (F, 3).
        blocks: Middles of its B drives' carriages (F, B, 3).
        links: Ends of the lines from carriages to tool (F, L, 2, 3).
        body: Ends of the lines of the tool itself, about its place (L, 2, 3).
        frame: Ends of the lines that stand still (L, 2, 3).
    """

    size: float
    tool: Array
    blocks: Array
    links: Array
    body: Array
    frame: Array


def later(name: str) -> Callable[..., Any]:
    """Return a function or class that is imported when it is called first.

    Args:
        name: `package.module:name`.
    """

    def call(*args: Any, **kwargs: Any) -> Any:
        return pkgutil.resolve_name(name)(*args, **kwargs)

    return call


@dataclass(frozen=True)
class Kind:
    """A kind of machine.

    Attributes:
        name: What `machine:` in a machine file says.
        keys: Its keys, in the order of a new machine file; a constant's name stands there once.
        model: Builds its model: `model(machine, data, *, drives, effects, fixed, cutoff)` where
            it is identified from a bag; what else it can be asked for `make_model` says.
        drives: How many drives it has; None for any number.
        judge: Returns what is to be changed in a machine file and shows only together.
        starts_in_motion: Whether its model can begin in a motion, from the measured position.
        check_motion: Returns what in a machine file contradicts recorded positions (D, K), NaN
            where there is no sample.
        asked: Returns (C, D, K) what a motion (3, D, K) of its drives asks of them: by inertia, by
            weight, by a free fall of 1 m/s^2 along x, y and z of its base, and by one of each
            counterbalance's forces; None where it has no description of links.
        tilt: Returns the keys that say how its base is tilted, by the free fall (3,) in its frame.
        travel: Unit of its drives' positions, `m` or `rad`; where empty, `moving_mass` says it.
        compares: Quantities that are compared by default.
        freely: The same where controllers follow a set-point; None where they are those.
        logs: Units of a logged effort that its model simulates as they are, beside those of
            `units.effort_factors`.
        released: Whether its motors are switched off where no set-point comes any more.
        efforts: Returns the (D,) size of the drives' efforts, of which bounds of effects are
            shares; None where the log says it.
        scene: Returns what to draw at positions (D, F) of its drives, None where they cannot be.
        alike: Whether its drives are of one make and logged alike, with one noise.
        follows: Whether controllers follow a set-point; where not, a logged one is left out.
        read: Reads a machine's description as its model does; None where it has none.
        joints: Returns the joints of a description by its root, see `judged_tree`; None where it
            has no key that names the file of one.
        extent: Returns the mass [kg] that such a one moves, and how far it reaches [m]; None where
            it has no such key.
        space: Returns where it moves by default: its drives, or the tool that they carry.
        set_points: Returns set-points (D, K) of its drives and their derivatives by the way (M, K)
            of the tool that they carry and its derivatives; None where they carry none.
        described: Parameters that its description holds.
        ends: Returns low and high ends (D,) of its drives' joints, rad, infinite for a joint that
            slides or has none; None where it has no description.

    Raises:
        ValueError: Where two of its constants have one name, or none is `controller.cycle`: a
        mistake of the kind's author.
    """

    name: str
    title: str
    keys: tuple[Key, ...]
    model: Callable[..., Any]
    drives: int | None = None
    judge: Callable[[Draft], Iterable[Remark]] = lambda draft: ()
    starts_in_motion: bool = False
    check_motion: Callable[[Machine, Array], Iterable[Remark]] | None = None
    asked: Callable[[Machine, Array], Array] | None = None
    tilt: Callable[[Array], Mapping[str, float]] | None = None
    travel: str = ''
    compares: tuple[str, ...] = ('effort',)
    freely: Callable[[Machine], tuple[str, ...]] | None = None
    logs: tuple[str, ...] = ()
    released: bool = False
    efforts: Callable[[Machine], Array] | None = None
    scene: Callable[[Machine, Array], Figure | None] | None = None
    alike: bool = False
    follows: Callable[[Machine], bool] = lambda machine: True
    read: Callable[[Machine], Any] | None = None
    joints: Callable[[Element], tuple[str, ...]] | None = None
    extent: Callable[[Element], tuple[float, float]] | None = None
    space: Callable[[Machine], Space] | None = None
    set_points: Callable[[Array, Array, Machine], tuple[Array, Array]] | None = None
    described: tuple[str, ...] = ()
    ends: Callable[[Machine], tuple[Array, Array]] | None = None

    def __post_init__(self) -> None:
        names = [key.name for key in self.constants]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise ValueError(f'{self.name}: constants with the same name: {", ".join(twice)}')
        if 'cycle' not in names:
            raise ValueError(f'{self.name}: lacks the key controller.cycle')

    @property
    def constants(self) -> tuple[Key, ...]:
        """The keys that say something of the machine."""
        return tuple(key for key in self.keys if key.constant)

    @functools.cached_property
    def by_path(self) -> Mapping[Path, Key]:
        """Its keys by path."""
        return {key.path: key for key in self.keys}
