# SPDX-License-Identifier: Apache-2.0
"""Every kind of machine there is, of this package or another.

Another package adds one by an entry point of the group `ros2_ident.machines`: its name is the
kind's, its object a `Kind`.
"""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from importlib.metadata import entry_points
import math
from pathlib import Path
from typing import Any, TYPE_CHECKING

import numpy as np

from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.machine import file as machine_file
from ros2_ident.machine.file import MachineFile
from ros2_ident.machine.kind import Kind, Space
from ros2_ident.machine.machine import Machine
from ros2_ident.models.kinds import OWN

if TYPE_CHECKING:
    from ros2_ident.arrays import Array
    from ros2_ident.models.drives.model import DriveModel
    from ros2_ident.models.protocol import FullModel, Scales
    from ros2_ident.recording import Dataset

ENTRY_POINTS = 'ros2_ident.machines'
OWN_KINDS: Mapping[str, Kind] = {kind.name: kind for kind in OWN}


class Kinds(Mapping[str, Kind]):
    """All kinds by name; another package's is loaded when it is asked for."""

    def __iter__(self) -> Iterator[str]:
        yield from OWN_KINDS
        yield from sorted({p.name for p in entry_points(group=ENTRY_POINTS)} - set(OWN_KINDS))

    def __len__(self) -> int:
        return sum(1 for _ in self)

    def __contains__(self, name: object) -> bool:
        return any(name == known for known in self)

    def __getitem__(self, name: str) -> Kind:
        """Return a kind.

        Raises:
            KeyError: Where there is none of that name.
            IdentError: UNKNOWN_MODEL where the package that offers it does not give it.
        """
        if name in OWN_KINDS:
            return OWN_KINDS[name]
        for point in entry_points(group=ENTRY_POINTS, name=name):
            try:
                kind = point.load()
            except (ImportError, AttributeError) as error:
                raise ErrorCode.UNKNOWN_MODEL.error(
                    f'the machine kind {name} of {point.value} cannot be loaded ({error}); repair '
                    'or remove the package that registers it'
                ) from error
            if isinstance(kind, Kind) and kind.name == name:
                return kind
            raise ErrorCode.UNKNOWN_MODEL.error(
                f'{point.value} is no machine kind {name}; register a Kind by its own name'
            )
        raise KeyError(name)


KINDS: Mapping[str, Kind] = Kinds()


def kind_of(machine: Machine) -> Kind:
    """Return the kind of a machine.

    Raises:
        IdentError: UNKNOWN_MODEL where there is none of that name.
    """
    try:
        return KINDS[machine.kind]
    except KeyError:
        raise ErrorCode.UNKNOWN_MODEL.error(
            f'there is no machine kind {machine.kind!r}; choose from {", ".join(KINDS)}'
        ) from None


def read_machine_file(path: str | Path) -> MachineFile:
    """Read a machine file of any kind and judge it; see `machine.file.read`."""
    return machine_file.read(path, KINDS)


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
    return read_machine_file(path).usable()


def machine_from_mapping(
    data: Any, where: object = 'machine file', folder: Path = Path()
) -> Machine:
    """Build a machine from a parsed machine file.

    Args:
        data: The mapping a machine file holds.
        where: What to call it in error messages.
        folder: Where the files lie that it names.

    Returns:
        The machine.

    Raises:
        IdentError: as `load_machine`, without lines.
    """
    return machine_file.judged(data, KINDS, str(where), folder=folder).usable()


def space_of(machine: Machine) -> Space:
    """Return where a machine moves by default.

    Raises:
        IdentError: UNKNOWN_MODEL where its kind does not say.
    """
    space = kind_of(machine).space
    if space is None:
        raise ErrorCode.UNKNOWN_MODEL.error(
            f'the kind {machine.kind} has no `space` to move in; add one to its Kind'
        )
    return space(machine)


def travel_of(machine: Machine) -> dict[str, tuple[float, float]]:
    """Return the ends of the joints that turn and have some, low and high by drive [rad]."""
    ends = kind_of(machine).ends
    if ends is None:
        return {}
    pairs = zip(machine.drives, *(x.tolist() for x in ends(machine)), strict=True)
    return {drive: (low, high) for drive, low, high in pairs if math.isfinite(high - low)}


def set_points_of(machine: Machine, points: 'Array', speeds: 'Array') -> 'tuple[Array, Array]':
    """Return set-points (D, K) of the drives and their derivatives for a way (M, K), see `Kind`.

    Raises:
        IdentError: BAD_VALUES where the tool cannot be there.
    """
    of_tool = kind_of(machine).set_points
    return (points, speeds) if of_tool is None else of_tool(points, speeds, machine)


def follows(machine: Machine) -> bool:
    """Return whether a machine's set-points count, where they are logged."""
    pushed = 'law' in machine.constants and 'effort' in machine.texts('law')
    return kind_of(machine).follows(machine) and not pushed


def knows_gains(machine: Machine) -> bool:
    """Return whether any gain of a machine's cascade is stated or to be identified."""
    cascade = 'position_gain', 'velocity_gain'
    there = {key.name for key in kind_of(machine).keys}
    return not there.issuperset(cascade) or any(map(machine.known, cascade))


def compared_of(machine: Machine) -> tuple[str, ...]:
    """Return the quantities of a machine that are compared by default."""
    kind = kind_of(machine)
    return kind.freely(machine) if kind.freely and follows(machine) else kind.compares


def scales_of(machine: Machine, data: 'Sequence[Dataset]') -> 'Scales':
    """Return what the drives do in recordings, see `protocol.Scales`."""
    from ros2_ident.models.protocol import scales_of

    scales, stated = scales_of(machine, data), kind_of(machine).efforts
    return scales if stated is None else scales._replace(effort=stated(machine))


def make_model(
    machine: Machine, data: 'Dataset', *, quantities: Sequence[str] | None = None, **asked: Any
) -> 'DriveModel':
    """Return the model of a machine on a recording; the arguments are `MachineModel`'s.

    By default that is what its kind compares.

    Raises:
        IdentError: UNKNOWN_MODEL where there is no such kind, or as the kind's model.
    """
    # What not every model can do is asked for only where it is wanted.
    kind = kind_of(machine)
    compared = tuple(quantities or compared_of(machine))
    if {compared, kind.compares} != {('effort',)}:
        asked['quantities'] = compared
    given = {name: value for name, value in asked.items() if value is not None}
    model: DriveModel = kind.model(machine, data, **given)
    return model


def planned_model(
    machine: Machine,
    position: 'Array',
    velocity: 'Array',
    quantities: Sequence[str] | None = None,
    **more: Any,
) -> 'FullModel':
    """Return a model of set-points that the drives follow as well as the model lets them.

    Args:
        position: (D, K) set-points, rad or m.
        velocity: (D, K) their derivatives.
        quantities: Its outputs; all that its kind can simulate where None.
        more: As of `make_model`.

    Raises:
        IdentError: As `make_model`.
    """
    from ros2_ident.recording import Dataset

    both, cycle = (position, velocity), machine.number('cycle')
    data = Dataset(machine.drives, cycle, 0, *both, *both, np.full_like(position, np.nan))
    # The more outputs the better.
    told = ('effort', 'position', 'velocity'), ('effort', 'position')
    for wanted in told if quantities is None else ():
        with suppress(IdentError):
            return make_model(machine, data, quantities=wanted, **more)
    return make_model(machine, data, quantities=quantities or compared_of(machine), **more)


def drives_moved(
    model: 'FullModel', position: 'Array', velocity: 'Array', told: 'Array'
) -> 'dict[str, Array]':
    """Return (D, K) positions, velocities and efforts: what a model does not tell is as planned.

    Args:
        model: A planned model.
        position: (D, K) its set-points, rad or m.
        velocity: (D, K) their derivatives.
        told: (O, K) its outputs.
    """
    still = np.zeros_like(position)
    rows = {'position': position.copy(), 'velocity': velocity.copy(), 'effort': still}
    for output, row in zip(model.outputs, told, strict=True):
        rows[output.quantity][model.data.names.index(output.place or output.name)] = row
    return rows


# A stated number that is wrong is looked for within this factor either way.
STATED_WITHIN = 10.0
# A model's own number, and one that is the same everywhere.
_CERTAIN = frozenset({'coulomb_regularisation', 'gravity'})


def stated_numbers(machine: Machine) -> dict[str, tuple[float, str]]:
    """Return numbers that a machine file states and that could be parameters, with their units.

    Those that differ from drive to drive are left out.
    """
    found = {}
    for key in kind_of(machine).keys:
        values = machine.constants.get(key.name, ())
        alike = len(set(values)) == 1 and isinstance(values[0], float) and values[0] != 0.0
        searched = key.section == 'parameters' and key.name not in _CERTAIN | {*machine.bounds}
        if alike and searched and machine.stated(key.name):
            found[key.name] = float(values[0]), key.unit
    return found
