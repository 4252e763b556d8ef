# SPDX-License-Identifier: Apache-2.0
"""How a candidate's numbers lie in a block of lanes: names of the rows the kernels read.

A block is a flat array; row r holds the W lanes' values at [W r, W r + W). First the machine's
rows, then each drive's, then each drive's effects in the catalogue's order.
"""

from collections import namedtuple
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from ros2_ident.effects import composed, Hook

MACHINE_ROWS = (
    'rail_radius',  # m
    'rod_length',  # m
    'tool_mass',  # kg
    'mass_per_rod',  # kg, each rod's, halved between its ends
    'gravity',  # m/s^2, against the axes
    'payload_step',  # kg, added to the tool from payload_time on
    'payload_time',  # s
    'payload_duration',  # s
    'payload_turned',  # kg, added to the tool while the log shows a load
    'frame_inverse_mass',  # 1/kg, 0 for a frame that does not move
    'frame_frequency',  # Hz, of the frame without the machine
    'frame_damping',  # 1
    'rail_inverse_radius',  # 1/m, derived
    'rail_x',  # 1, derived as what follows: the direction of the first rail
    'rail_y',
    'rail_2_x',  # 1, those of the other two less the first
    'rail_2_y',
    'rail_3_x',
    'rail_3_y',
    'rail_x_2',  # 1, the inverse of these four
    'rail_x_3',
    'rail_y_2',
    'rail_y_3',
    # Of a tripod whose drives turn arms.
    'arm_length',  # m
    'arm_sense',  # 1 where positive angles lift the arms, -1 where they lower them
    # Of a chain of links, carried by the last one.
    'hand_mass',  # kg
    'hand_moment_x',  # kg m, mass times place
    'hand_moment_y',
    'hand_moment_z',
)
DRIVE_ROWS = (
    'gear_stiffness',  # N/m
    'gear_damping',  # N s/m
    'motor_mass',  # kg, derived: the motor's inertia at the rail
    'rail_mass',  # kg
    'coulomb',  # N m
    'viscous',  # N m s/m
    'position_gain',  # 1/s
    'velocity_gain',  # N m s/m
    'integral_gain',  # N m/m
    'set_point_delay',  # s
    'torque_limit',  # N m
    'motor_turn',  # rad/m, motor angle per travel
    'gear',  # rad/m, force per torque; 1 where the effort is a force
    'regularisation',  # m/s, of Coulomb friction
    'feedforward',  # 1, of the set-point's rate
    'gear_inverse',  # m/rad, derived
    'friction_slope',  # s/m, derived: one over the regularisation
    'drive_inertia',  # kg m^2, motor_mass over the square of the gear
    'rail_azimuth',  # rad
    'arm_moment',  # kg m, first moment of an arm about its shaft
    'arm_zero',  # rad, where it lies level
    'constant_load',  # N, against the positive direction
    'log_delay',  # s
    'log_gain',  # 1
    'log_bias',  # N m
    'log_lag',  # s
    'log_crosstalk',  # 1, of the other drives' effort into this one's
    'load_share',  # 1, of the moved mass, behind a flexible gear where the model is rigid
    'load_frequency',  # Hz, of motor and load against each other
    'load_damping',  # 1
    # Of a servo, whose controller asks for a share of its supply.
    'torque_constant',  # N m/A, and V s/rad
    'resistance',  # Ohm
    'supply_voltage',  # V
    'load_mass',  # kg, at the end of the arm
    'load_length',  # m, of the arm
    'arm_mass',  # kg, spread evenly over it
    'load_inertia',  # kg m^2, that gravity does not turn
    'load_angle',  # rad, where the arm hangs
    'drive_gain',  # N m, derived as what follows: torque at the full supply, standing
    'back_emf',  # N m s/rad, by which it falls
    'load_moment',  # N m, of the arm held level
    'log_duty',  # what the log holds for the full supply, in its unit
    'log_speed',  # by which that falls, per rad/s
    'log_smoothing',  # s, no kernel's: it needs the whole log
    'log_zero',  # rad, what the log says where an arm's joint is at 0
)
NEUTRAL = {'payload_duration': 1e9, 'load_frequency': 30.0, 'load_damping': 0.05, 'log_gain': 1.0}

KERNEL_EFFECTS = tuple(e for e in composed() if e.hook is not Hook.PARAMETER)
# What a drive remembers between cycles, besides a row for each effect with a memory.
MEMORY_ROWS = (
    'integral',  # N m, the controller's
    'commanded',  # N m, asked of the motor
    'anchor',  # m, where the motor was after the last step
    'read_error',  # m, of the last reading
    'last_read',  # m
    'last_but_one',  # m
    'lightness',  # 1/kg, one over the moved mass
    'braking',  # N m s/rad, of a servo's back-EMF while it is on
)


def _places(name: str, rows: Sequence[str]) -> Any:
    """Return the place of each row by its name, as the kernels read it: `DRIVE.gear`."""
    return namedtuple(name, rows)(*range(len(rows)))


MACHINE = _places('Machine', MACHINE_ROWS)
DRIVE = _places('Drive', DRIVE_ROWS)
MEMORY = _places('Memory', MEMORY_ROWS)
KEEPING_EFFECTS = tuple(e for e in KERNEL_EFFECTS if e.keeps is not None)
MEMORY_COUNT = len(MEMORY_ROWS) + len(KEEPING_EFFECTS)
MACHINE_COUNT = len(MACHINE_ROWS)
EFFECT_START = len(DRIVE_ROWS)
DRIVE_COUNT = EFFECT_START + sum(len(e.parameters) for e in KERNEL_EFFECTS)


def bit(effect_id: str) -> int:
    """Return the mask that switches a kernel effect on in a drive's flags."""
    return 1 << [e.id for e in KERNEL_EFFECTS].index(effect_id)


def effect_row(effect_id: str) -> int:
    """Return the first row of a kernel effect, counted from its drive's first row."""
    before = [e.id for e in KERNEL_EFFECTS].index(effect_id)
    return EFFECT_START + sum(len(e.parameters) for e in KERNEL_EFFECTS[:before])


def memory_row(effect_id: str) -> int:
    """Return the row of an effect's memory, counted from its drive's first row of memory."""
    return len(MEMORY_ROWS) + [e.id for e in KEEPING_EFFECTS].index(effect_id)


def of(block: npt.NDArray[np.float64], name: str, drives: int) -> npt.NDArray[np.float64]:
    """Return a view of a number of candidates (S, R): (S,) the machine's, (S, D) the drives'.

    Behind the rows of the drives others may follow.
    """
    if name in MACHINE_ROWS:
        return block[:, MACHINE_ROWS.index(name)]
    return _of_drives(block, DRIVE_ROWS.index(name), drives)


def of_effect(
    block: npt.NDArray[np.float64], effect_id: str, number: int, drives: int
) -> npt.NDArray[np.float64]:
    """Return a view (S, D) of a parameter of a kernel effect, by its number."""
    return _of_drives(block, effect_row(effect_id) + number, drives)


def _of_drives(block: npt.NDArray[np.float64], row: int, drives: int) -> npt.NDArray[np.float64]:
    return block[:, MACHINE_COUNT + row : MACHINE_COUNT + drives * DRIVE_COUNT : DRIVE_COUNT]


def neutral_rows(drives: int) -> npt.NDArray[np.float64]:
    """Return (1, rows) a candidate with every row at its neutral value."""
    rows = np.zeros((1, MACHINE_COUNT + drives * DRIVE_COUNT))
    for name, value in NEUTRAL.items():
        of(rows, name, drives)[:] = value
    for effect in KERNEL_EFFECTS:
        for number, parameter in enumerate(effect.parameters):
            of_effect(rows, effect.id, number, drives)[:] = parameter.neutral
    return rows
