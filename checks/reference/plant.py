# SPDX-License-Identifier: Apache-2.0
"""A machine with its parameters as arrays, its rest position, and one simulated log of it."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from checks.reference import layout as at
from checks.reference.drive_law import drive_law
from checks.reference.dynamics import DriveLaw
from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.machine.machine import Machine
from ros2_ident.simulate import bag as simulate

Array = np.ndarray[tuple[int, ...], np.dtype[np.float64]]
CommandFilter = Callable[[Array, Array, float], tuple[Array, Array]]
EffortFilter = Callable[[Array, float], Array]

# Columns of a drive that are constants of the machine file.
_CONSTANTS = {
    at.GEAR: 'gear_factor',
    at.CARRIAGE_MASS: 'rail_mass',
    at.SIGN_WIDTH: 'coulomb_regularisation',
    at.POSITION_GAIN: 'position_gain',
    at.VELOCITY_GAIN: 'velocity_gain',
    at.INTEGRAL_GAIN: 'integral_gain',
    at.FEEDFORWARD: 'velocity_feedforward',
    at.TORQUE_LIMIT: 'torque_limit',
}
_LAWS = {'cascade_pi': 0.0, 'cascade_p': 1.0, 'position': 2.0}
# Parameters that all drives can have, besides the numeric constants of the machine file.
PARAMETERS = (
    'measurement_delay',
    'coulomb_torque',
    'viscous_torque',
    'coulomb_friction',
    'viscous_friction',
    'constant_force',
)
ELASTIC = ('gear_stiffness', 'gear_damping_ratio', 'drive_inertia')


def _nothing() -> Array:
    return np.zeros((3, 0))


@dataclass(frozen=True)
class Log(simulate.Log):
    """What a simulated machine did, at every controller cycle.

    Attributes:
        torque: (D, K) the controllers' torque at its own instant [N m, or N].
        carriage: (D, K) carriage position in space [m].
        platform: (3, K) platform position [m]; empty without a platform, as what follows.
        frame: (K,) height of the frame [m].
        carriage_velocity: (D, K) [m/s].
        platform_velocity: (3, K) [m/s].
        frame_velocity: (K,) [m/s].
        rod_error: Largest error of a rod's length before it was corrected [m].
    """

    torque: Array
    carriage: Array = field(default_factory=_nothing)
    platform: Array = field(default_factory=_nothing)
    frame: Array = field(default_factory=_nothing)
    carriage_velocity: Array = field(default_factory=_nothing)
    platform_velocity: Array = field(default_factory=_nothing)
    frame_velocity: Array = field(default_factory=_nothing)
    rod_error: float = 0.0


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
        log_filters: What the log passes afterwards.
        internals: How many states effects keep in each drive.
        settled: False: the run starts as the nominal machine would rest, so that unmodelled loads
            make the controllers catch up in the first tenths of a second. True: the machine has
            stood long enough.
        law: The forces in a drive, see `drive_law`.
        torques: States of a drive that hold the controller's torque while it rests.
    """

    names: tuple[str, ...]
    shared: Array
    drive: Array
    delay: Array
    command_filters: list[CommandFilter] = field(default_factory=list)
    effort_filters: list[EffortFilter] = field(default_factory=list)
    log_filters: list[EffortFilter] = field(default_factory=list)
    internals: int = 0
    settled: bool = False
    law: DriveLaw = drive_law
    torques: tuple[int, ...] = (at.CURRENT,)


class Unmodelled(Protocol):
    """Something that changes a plant: an effect."""

    def apply(self, plant: Plant) -> None:
        """Write the effect into the plant."""


def value(
    name: str, drive: str, parameters: Mapping[str, float], default: float | None = None
) -> float:
    """Look a parameter up: the drive's own one, else the shared one.

    Args:
        default: What it is where nobody says.

    Raises:
        IdentError: UNKNOWN_PARAMETER where it has no value.
    """
    for key in (f'{drive}.{name}', name):
        if key in parameters:
            return float(parameters[key])
    if default is None:
        raise _missing(name, drive)
    return default


def _missing(name: str, drive: str) -> IdentError:
    return IdentError(
        ErrorCode.UNKNOWN_PARAMETER,
        f'the reference needs a value of {name}; give {name} or {drive}.{name}',
    )


def true_machine(machine: Machine, parameters: Mapping[str, float]) -> Machine:
    """Return a machine with the true values of constants that are to be identified.

    Raises:
        IdentError: UNKNOWN_PARAMETER for one that neither file nor parameters state,
        BAD_MACHINE_FILE for a gain that is in neither.
    """
    true = machine.with_values(parameters)
    for name in true.constants:
        if name in machine.bounds and not true.stated(name):
            raise _missing(name, machine.drives[0])
    for name in ('position_gain', 'velocity_gain'):
        if np.isnan(true.numbers(name)).any():
            raise IdentError(
                ErrorCode.BAD_MACHINE_FILE,
                'the reference runs the controllers, and the machine file has no '
                f'controller.{name}; add it',
            )
    return true


def known_names(parameters: Mapping[str, float], machine: Machine, own: Sequence[str]) -> None:
    """Raise an IdentError (UNKNOWN_PARAMETER) for a parameter that the machine does not have.

    Args:
        machine: The machine, each of whose numeric constants can be one.
    """
    names = machine.drives
    numeric = [n for n, values in machine.constants.items() if not isinstance(values[0], str)]
    known = (*own, *numeric)
    for key in parameters:
        head, _, tail = key.rpartition('.')
        if (tail or key) not in known or (head and head not in names):
            raise IdentError(
                ErrorCode.UNKNOWN_PARAMETER,
                f'parameter {key} is not one of this machine; it has {", ".join(known)}',
            )


def read_drives(plant: Plant, machine: Machine, parameters: Mapping[str, float]) -> None:
    """Write into a plant what the drives of all machines have: controllers, gears, friction.

    Args:
        plant: The plant; it is rigid where its shared numbers say so.

    Raises:
        IdentError: UNKNOWN_PARAMETER where the gear or the motor of an elastic drive has no value.
    """
    plant.shared[at.CYCLE] = machine.number('cycle')
    for i, name in enumerate(machine.drives):
        d = plant.drive[i]
        for column, key in _CONSTANTS.items():
            d[column] = machine.number(key, name)
        d[at.LAW] = _LAWS[machine.text('law', name)]
        gear = d[at.GEAR]
        for column, friction in ((at.COULOMB, 'coulomb'), (at.VISCOUS, 'viscous')):
            # A torque at the motor, or a force at the carriage.
            torque = value(f'{friction}_torque', name, parameters, 0.0)
            d[column] = torque + value(f'{friction}_friction', name, parameters, 0.0) / gear
        d[at.CONSTANT_FORCE] = value('constant_force', name, parameters, 0.0) * gear
        d[at.CARRIAGE_MASS] = value('moving_mass', name, parameters, d[at.CARRIAGE_MASS])
        plant.delay[i] = value('measurement_delay', name, parameters, 0.0)
        if plant.shared[at.RIGID] == 0.0:
            _read_gear(d, name, parameters)


def _read_gear(d: Array, name: str, parameters: Mapping[str, float]) -> None:
    motor = value('drive_inertia', name, parameters) * d[at.GEAR] ** 2
    carriage = d[at.CARRIAGE_MASS]
    stiffness = value('gear_stiffness', name, parameters)
    ratio = value('gear_damping_ratio', name, parameters)
    d[at.MOTOR_MASS] = motor
    d[at.STIFFNESS] = stiffness
    d[at.DAMPING] = 2.0 * ratio * np.sqrt(stiffness * motor * carriage / (motor + carriage))


def set_columns(
    plant: Plant, i: int, columns: Mapping[int, float], internal: bool = False
) -> None:
    """Write columns of a drive, and switch the internal states on where the effect has one."""
    for column, number in columns.items():
        plant.drive[i, column] = number
    if internal:
        plant.internals = max(plant.internals, at.INTERNALS)


def bare_plant(machine: Machine, elastic: bool) -> Plant:
    """Return a plant without a platform, its drives still to be written."""
    count = len(machine.drives)
    drive = np.zeros((count, at.DRIVE_COLUMNS))
    plant = Plant(machine.drives, np.zeros(at.SHARED_COLUMNS), drive, np.zeros(count))
    plant.shared[at.RIGID] = 0.0 if elastic else 1.0
    return plant


def platform_plant(machine: Machine, parameters: Mapping[str, float]) -> tuple[Machine, Plant]:
    """Begin the nominal machine of three elastic drives that carry a platform on rods.

    Returns:
        The machine with the true values of its constants, and its plant with gravity, platform and
        tool; drives and geometry are still to be written.

    Raises:
        IdentError: UNKNOWN_PARAMETER for a name that is missing or not the machine's.
    """
    names = machine.drives
    known_names(parameters, machine, (*PARAMETERS, *ELASTIC, 'tool_mass'))
    true = true_machine(machine, parameters)
    plant = bare_plant(machine, elastic=True)
    plant.shared[at.GRAVITY] = true.number('gravity')
    plant.shared[at.PLATFORM] = 1.0
    plant.shared[at.TOOL_MASS] = value('tool_mass', names[0], parameters)
    return true, plant
