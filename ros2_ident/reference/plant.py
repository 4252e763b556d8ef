# SPDX-License-Identifier: Apache-2.0
"""A machine with its parameters as arrays, its rest position, and one simulated log of it."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.reference import layout as at

Array = np.ndarray[tuple[int, ...], np.dtype[np.float64]]
CommandFilter = Callable[[Array, Array, float], tuple[Array, Array]]
EffortFilter = Callable[[Array, float], Array]


@dataclass(frozen=True)
class Log:
    """What a simulated machine did, at every controller cycle.

    Attributes:
        names: Joint names of the drives.
        cycle: Controller cycle [s].
        effort: (D, K) logged effort, late by the measurement delay [N m, or N].
        position: (D, K) motor position at the rail [m].
        velocity: (D, K) its speed [m/s].
        torque: (D, K) the controllers' torque at its own instant [N m, or N].
        carriage: (D, K) carriage position in space [m].
        platform: (3, K) platform position [m]; zeros without a platform.
        frame: (K,) height of the frame [m].
        carriage_velocity: (D, K) [m/s].
        platform_velocity: (3, K) [m/s].
        frame_velocity: (K,) [m/s].
        steps: Integration steps taken.
        rod_error: Largest error of a rod's length before it was corrected [m].
    """

    names: tuple[str, ...]
    cycle: float
    effort: Array
    position: Array
    velocity: Array
    torque: Array
    carriage: Array
    platform: Array
    frame: Array
    carriage_velocity: Array
    platform_velocity: Array
    frame_velocity: Array
    steps: int
    rod_error: float


@dataclass
class Plant:
    """A machine as the compiled functions see it, open to effects.

    Attributes:
        names: Joint names of the drives.
        shared: (SHARED_COLUMNS,) numbers of the machine.
        drive: (D, DRIVE_COLUMNS) numbers of the drives.
        delay: (D,) delay of the effort log [s].
        command_filters: What the set-point passes on its way to the controllers.
        effort_filters: What the torque passes on its way into the log.
        internals: Whether any effect has a state of its own.
        settled: False: the run starts as the nominal machine would rest, so that unmodelled loads
            make the controllers catch up in the first tenths of a second. True: the machine has
            stood long enough.
    """

    names: tuple[str, ...]
    shared: Array
    drive: Array
    delay: Array
    command_filters: list[CommandFilter] = field(default_factory=list)
    effort_filters: list[EffortFilter] = field(default_factory=list)
    internals: bool = False
    settled: bool = False


class Unmodelled(Protocol):
    """Something that changes a plant: an effect."""

    def apply(self, plant: Plant) -> None:
        """Write the effect into the plant."""


def section(machine: Any, key: str) -> Any:
    """Return a part of a machine: of a `Machine`, or of the mapping a machine file holds."""
    if isinstance(machine, Mapping):
        return machine.get('machine' if key == 'kind' else key, {})
    return getattr(machine, key)


def value(
    name: str,
    drive: str,
    parameters: Mapping[str, float],
    constants: Mapping[str, Any],
    default: float | None = None,
) -> float:
    """Look a number up: the drive's own parameter, the shared one, the machine file's constant.

    Args:
        name: `gear_stiffness`.
        drive: `drive_1`.
        parameters: Parameters by name.
        constants: A section of the machine file.
        default: What it is where nobody says.

    Returns:
        The number, in SI units.

    Raises:
        IdentError: UNKNOWN_PARAMETER where it has no value.
    """
    for source, key in ((parameters, f'{drive}.{name}'), (parameters, name), (constants, name)):
        if key in source:
            return float(source[key])
    if default is None:
        raise IdentError(
            ErrorCode.UNKNOWN_PARAMETER,
            f'the reference needs a value of {name}; give {name} or {drive}.{name}',
        )
    return default


def known_names(
    parameters: Mapping[str, float], names: Sequence[str], known: Sequence[str]
) -> None:
    """Raise an IdentError (UNKNOWN_PARAMETER) for a parameter that the machine does not have."""
    for key in parameters:
        head, _, tail = key.rpartition('.')
        if (tail or key) not in known or (head and head not in names):
            raise IdentError(
                ErrorCode.UNKNOWN_PARAMETER,
                f'parameter {key} is not one of this machine; it has {", ".join(known)}',
            )


def read_controller(plant: Plant, controller: Mapping[str, Any]) -> None:
    """Write the controller's constants of a machine file into a plant."""
    law = str(controller.get('law', 'cascade_pi'))
    if law not in ('cascade_pi', 'cascade_p'):
        raise IdentError(
            ErrorCode.BAD_MACHINE_FILE, f'controller.law is {law!r}; write cascade_pi or cascade_p'
        )
    plant.shared[at.LAW] = 1.0 if law == 'cascade_p' else 0.0
    plant.shared[at.CYCLE] = float(controller['cycle'])
    plant.drive[:, at.POSITION_GAIN] = float(controller['position_gain'])
    plant.drive[:, at.VELOCITY_GAIN] = float(controller['velocity_gain'])
    plant.drive[:, at.INTEGRAL_GAIN] = float(controller.get('integral_gain', 0.0))
    plant.drive[:, at.FEEDFORWARD] = float(controller.get('velocity_feedforward', 0.0))
    plant.drive[:, at.TORQUE_LIMIT] = float(controller['torque_limit'])


def set_columns(
    plant: Plant, i: int, columns: Mapping[int, float], internal: bool = False
) -> None:
    """Write columns of a drive, and switch the internal states on where the effect has one."""
    for column, number in columns.items():
        plant.drive[i, column] = number
    plant.internals = plant.internals or internal
