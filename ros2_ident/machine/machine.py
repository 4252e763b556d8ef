# SPDX-License-Identifier: Apache-2.0
"""Content of a machine file: known numbers of a machine, and parameters with their boxes."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
import hashlib
import math
from pathlib import Path
from typing import Literal

import numpy as np
import numpy.typing as npt

from ros2_ident.errors import ErrorCode
from ros2_ident.machine.description import judged_tree
from ros2_ident.machine.keys import DESCRIPTION_TOPIC, NEUTRAL, Value
from ros2_ident.machine.prior import Prior
from ros2_ident.machine.units import angular, plain_unit

Box = tuple[float, float, str]
Kind = Literal['physical', 'base', 'measurement']


@dataclass(frozen=True)
class Parameter:
    """One parameter of a model.

    Attributes:
        name: `tool_mass`, or `drive_1.gear_stiffness` where each drive has its own.
        unit: SI unit as text; `1` for a ratio.
        low: Lower bound of the search, in `unit`.
        high: Upper bound of the search, in `unit`.
        kind: `physical` for the machine, `measurement` for how it was logged; `base` for what
            stands for several of the machine's that show together only, and has either sign.
        source: Equation or reference the parameter stands in.
        absent: Value that means that the machine has none of it, where that is an answer: 0 of
            friction, an offset or a delay, not of a mass.

    Raises:
        IdentError: BAD_MACHINE_FILE where the bounds are not finite or not in order.
    """

    name: str
    unit: str
    low: float
    high: float
    kind: Kind
    source: str
    absent: float | None = None

    def __post_init__(self) -> None:
        if not (math.isfinite(self.low) and math.isfinite(self.high) and self.low < self.high):
            raise ErrorCode.BAD_MACHINE_FILE.error(
                f'parameter {self.name} has the bounds [{self.low}, {self.high}]; '
                'write a finite lower bound below a finite upper one'
            )


@dataclass(frozen=True)
class Machine:
    """The content of a machine file, complete: what the file leaves out has its default.

    Attributes:
        kind: Name of its kind, as `models.registry.KINDS` has it.
        drives: Joint names of the drives, in the model's order.
        constants: Constants by name, SI units: one of the machine, or one of each drive. What is
            to be identified and not stated has the middle of its box; what is unknown is NaN.
        bounds: `{name: (low, high, unit)}` of the parameters to be identified.
        own_bounds: The same of single drives, as `drive_2.rail_azimuth`, where the drives differ;
            `bounds` then holds the box that encloses them.
        given: Names of the constants that the file states, and `effort_noise` where it does; not
            in the `repr`, from which keys are made, since the order of a set is another one in
            every process.
        effort_scale: Factor from the logged effort to N m (or N): a torque constant [N m/A], or
            the rated torque over 100 %; one for all drives, or one each.
        effort_noise: Standard deviation of the logged effort's noise, in the model's effort unit.
        digest: SHA-256 of the file and those that it names; empty for one made in memory.
        travel: Unit of the drives' positions where the kind says it, else empty.
        stands: Drives that stand in all of the data, and where (rad or m).
        prior: What an earlier result knows of its parameters; None for nothing.
        described_in: Folder of the description that the file names; None where there is none.
    """

    kind: str
    drives: tuple[str, ...]
    constants: Mapping[str, tuple[Value, ...]]
    bounds: Mapping[str, Box]
    own_bounds: Mapping[str, Box] = field(default_factory=dict)
    given: frozenset[str] = field(default=frozenset(), repr=False)
    effort_unit: str = 'N m'
    effort_scale: tuple[float, ...] = (1.0,)
    effort_noise: float = 0.01
    digest: str = ''
    travel: str = ''
    stands: Mapping[str, float] = field(default_factory=dict)
    prior: Prior | None = None
    described_in: Path | None = field(default=None, repr=False, compare=False)

    def stated(self, name: str) -> bool:
        """Return whether the file states a constant."""
        return name in self.given

    def known(self, name: str) -> bool:
        """Return whether a constant is stated or is to be identified."""
        return name in self.given or name in self.bounds

    def number(self, name: str, drive: str | None = None) -> float:
        """Return a numeric constant, SI units.

        Args:
            name: Its key.
            drive: The drive it belongs to; without it, one that is the same for all.

        Raises:
            IdentError: BAD_MACHINE_FILE where it differs from drive to drive and none is named,
            or where machines of this kind have no such constant.
        """
        return float(self._value(name, drive))

    def text(self, name: str, drive: str | None = None) -> str:
        """Return a constant that is no number; arguments and errors as of `number`."""
        return str(self._value(name, drive))

    def numbers(self, name: str) -> npt.NDArray[np.float64]:
        """Return (D,) a numeric constant of each drive; errors as of `number`."""
        return np.array([self.number(name, drive) for drive in self.drives])

    def texts(self, name: str) -> tuple[str, ...]:
        """Return a constant of each drive that is no number; errors as of `number`."""
        return tuple(self.text(name, drive) for drive in self.drives)

    def _value(self, name: str, drive: str | None) -> Value:
        values = self.constants.get(name)
        if values is None:
            if name in NEUTRAL:
                return NEUTRAL[name]
            raise ErrorCode.BAD_MACHINE_FILE.error(
                f'a {self.kind} has no constant {name}; it has {", ".join(self.constants)}'
            )
        if len(values) == 1:
            return values[0]
        if drive is not None:
            return values[self.drives.index(drive)]
        if any(value != values[0] for value in values[1:]):
            raise ErrorCode.BAD_MACHINE_FILE.error(
                f'{name} differs from drive to drive, and this needs one for all; '
                'write one value in the machine file'
            )
        return values[0]

    def box(self, name: str, drive: str | None = None) -> Box:
        """Return (low, high, unit) of a parameter to be identified.

        Args:
            name: Its name without a drive.
            drive: The drive whose parameter it is; without it, the box of all.
        """
        return self.own_bounds.get(f'{drive}.{name}', self.bounds[name])

    @property
    def travel_unit(self) -> str:
        """Unit of a drive's position: `rad` where the moving mass is stated as an inertia."""
        if self.travel:
            return self.travel
        of = self.bounds.get('moving_mass', (0.0, 0.0, ''))[2]
        return 'rad' if plain_unit(of) == plain_unit(angular('kg')) else 'm'

    @property
    def model_unit(self) -> str:
        """Unit of an effort of the model: `N` where a log states a force or there is no gear."""
        if self.travel_unit == 'rad':
            return 'N m'
        force = self.effort_unit == 'N'
        other = self.effort_unit in ('A', 'percent') and not self.known('gear_factor')
        return 'N' if force or other else 'N m'

    def with_constants(self, **changed: Value | Sequence[Value]) -> 'Machine':
        """Return the same machine with other constants: one value each, or one for each drive.

        A constant whose default follows from another one stays as it is.
        """
        constants = dict(self.constants)
        for name, value in changed.items():
            constants[name] = (value,) if isinstance(value, (int, float, str)) else tuple(value)
        return replace(self, constants=constants, given=self.given | set(changed))

    def described(self, text: str | None) -> 'Machine':
        """Return the machine with a description that was heard, where its file asks for that.

        Args:
            text: URDF or MJCF; None where nothing was heard.

        Raises:
            IdentError: MISSING_STREAM where it is asked for and nothing was heard,
            BAD_MACHINE_FILE where it is no such description.
        """
        asking = [n for n, values in self.constants.items() if values == (DESCRIPTION_TOPIC,)]
        if not asking:
            return self
        if text is None:
            raise ErrorCode.MISSING_STREAM.error(
                f'the machine file asks for {DESCRIPTION_TOPIC}, and nothing was heard there; '
                'start robot_state_publisher, or name the file of a URDF'
            )
        judged_tree(text, DESCRIPTION_TOPIC)
        digest = hashlib.sha256(f'{self.digest}{text}'.encode()).hexdigest()
        return replace(self.with_constants(**dict.fromkeys(asking, text)), digest=digest)

    def with_values(self, values: Mapping[str, float]) -> 'Machine':
        """Return the same machine with the constants that some of these parameters are.

        Args:
            values: Parameters by name, `rail_mass` or `drive_2.rail_mass`; others are passed over.
        """
        named = {name.rpartition('.')[2] for name in values}
        changed = {
            name: tuple(
                values.get(f'{drive}.{name}', values.get(name, self._value(name, drive)))
                for drive in self.drives
            )
            for name in self.constants
            if name in named
        }
        return self.with_constants(
            **{n: each if len(set(each)) > 1 else each[:1] for n, each in changed.items()}
        )

    @property
    def effort_scales(self) -> dict[str, float]:
        """Factor from the logged effort to N m (or N) of each drive."""
        scale = self.effort_scale
        return dict(zip(self.drives, scale * (len(self.drives) // len(scale)), strict=True))
