# SPDX-License-Identifier: Apache-2.0
"""What was put into a case: the label that stays sealed until the case is diagnosed."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any

from checks.blind.faults import Fault
from checks.blind.rough import Rough
from ros2_ident.arrays import plain
from ros2_ident.models import Machine
from ros2_ident.models.registry import space_of
from ros2_ident.report.schema import read
from ros2_ident.simulate.motions import draw_motion, Motion


@dataclass(frozen=True)
class MotionOrder:
    """A motion to be drawn.

    Attributes:
        kind: One of `reference.motions.KINDS`.
        seconds: Duration [s].
        pace: Share of the machine's usual speed; the acceleration goes with its square.
    """

    kind: str
    seconds: float
    seed: int
    pace: float = 1.0

    def draw(self, machine: Machine) -> Motion:
        """Return the set-points."""
        usual, pace = space_of(machine), self.pace
        speed, acceleration = usual.speed * pace, usual.acceleration * pace**2
        slower = replace(usual, speed=speed, acceleration=acceleration)
        return draw_motion(self.kind, machine, self.seconds, self.seed, slower)


@dataclass(frozen=True)
class Part:
    """One effect in a case, as plain values.

    Attributes:
        effect: The catalogue's id; outside it the form's name.
        values: Its numbers, SI units.
        rho: What it alone leaves after a fit of the nominal parameters, RMS of the worst drive
            over both recordings, in units of the true noise; None where nobody asks for it.
    """

    effect: str
    form: str
    where: str
    values: Mapping[str, float]
    rho: float | None


@dataclass(frozen=True)
class Label:
    """One case.

    Attributes:
        sort: One of `sorts.SHARES`.
        generator: `reference` or `mujoco`.
        machine: Content of the true machine's file.
        parameters: The machine's true nominal parameters.
        motions: Of the recording to fit on and of the one held out.
        effects: What has to be found.
        imperfections: Small unlisted deviations beside it.
        noise: Standard deviation of each drive's true noise, of both recordings together.
        rho: What the listed effects leave together, as `Part.rho`.
        rho_small: What the imperfections leave.
        share: Share of what everything leaves on the recording held out that the machine without
            the listed effects does not leave: what the true model closes.
        clean: SHA-256 of the bag held out as it would be without noise; empty for none.
    """

    case: int
    sort: str
    generator: str
    machine: Mapping[str, Any]
    parameters: Mapping[str, float]
    motions: tuple[MotionOrder, MotionOrder]
    effects: tuple[Part, ...]
    imperfections: tuple[Part, ...]
    fault: Fault | None
    rough: Rough
    noise: tuple[float, ...]
    rho: float
    rho_small: float
    rho_all: float
    share: float | None
    seed: int
    clean: str = ''


def to_mapping(label: Label) -> dict[str, Any]:
    """Return a label as a mapping of plain values."""
    mapping: dict[str, Any] = plain(asdict(label))
    return mapping


def from_mapping(mapping: Mapping[str, Any]) -> Label:
    """Return the label that `to_mapping` wrote."""
    label: Label = read(Label, mapping)
    return label
