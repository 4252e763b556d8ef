# SPDX-License-Identifier: Apache-2.0
"""The tripod with rotary drives in redundant coordinates: motors, arms and platform, three rods.

See `dynamics` for the equations: an arm's angle takes the place of a carriage's height.
"""

from collections.abc import Mapping
from functools import partial

import numpy as np

from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.machine.machine import Machine
from ros2_ident.reference import layout as at
from ros2_ident.reference.plant import Array, Plant, platform_plant, read_drives
from ros2_ident.reference.simulate import simulate_machine
from ros2_ident.reference.space import Space
from ros2_ident.reference.twin import Twin

# How far an arm hangs below the level in the middle of the workspace, rad.
_HANGING = 0.5


def delta_plant(machine: Machine, parameters: Mapping[str, float]) -> Plant:
    """Build the nominal delta.

    Args:
        machine: A delta.
        parameters: `measurement_delay` [s], `gear_stiffness` [N m/rad], `gear_damping_ratio` [1],
            `tool_mass` [kg], `drive_inertia` [kg m^2], `coulomb_torque` [N m], `viscous_torque`
            [N m s/rad], and numeric constants of the machine file; all of a drive also as
            `drive_1.gear_stiffness`. The friction torques are zero where not given.

    Returns:
        The machine, ready for effects.

    Raises:
        IdentError: UNKNOWN_PARAMETER for a name that is missing or not the delta's,
        BAD_MACHINE_FILE for a gain that is missing.
    """
    true, plant = platform_plant(machine, parameters)
    plant.shared[at.ROTARY] = 1.0
    inertia = dict(zip(machine.drives, true.numbers('arm_inertia'), strict=True))
    masses = {f'{name}.moving_mass': float(arm) for name, arm in inertia.items()}
    read_drives(plant, true, {**parameters, **masses})
    azimuth = true.numbers('shaft_azimuth')
    out = np.stack([np.cos(azimuth), np.sin(azimuth)], axis=1)
    sense, arm = _sense(true), true.number('arm_length')
    plant.drive[:, [at.RAIL_X, at.RAIL_Y]] = true.number('shaft_radius') * out
    plant.drive[:, [at.ARM_X, at.ARM_Y]] = arm * out
    plant.drive[:, at.ARM_RISE] = sense * arm
    plant.drive[:, at.ARM_MOMENT] = sense * true.numbers('arm_moment')
    plant.drive[:, at.ARM_ZERO] = true.numbers('arm_zero')
    plant.drive[:, at.ROD_LENGTH] = true.number('rod_length')
    return plant


def _sense(machine: Machine) -> float:
    """Return 1 where positive angles lift the arms, -1 where they lower them."""
    return 1.0 if machine.text('positive') == 'up' else -1.0


simulate_delta = partial(simulate_machine, delta_plant)


def _space(machine: Machine) -> Space:
    arm = machine.number('arm_length')
    out = machine.number('shaft_radius') + arm * np.cos(_HANGING)
    depth = arm * np.sin(_HANGING) + np.sqrt(machine.number('rod_length') ** 2 - out**2)
    size = arm / 0.25
    return Space(
        np.array([0.0, 0.0, -depth]), np.array([0.10, 0.10, 0.05]) * size, 2.0 * size, 50.0 * size
    )


def arms_of(points: Array, speeds: Array, machine: Machine) -> tuple[Array, Array]:
    """Return the drives' set-points of a platform's way: the arms bend outwards.

    Args:
        points: (3, K) platform positions [m].
        speeds: (3, K) platform speeds [m/s].
        machine: A delta.

    Returns:
        (3, K) angles [rad] and their rates [rad/s].

    Raises:
        IdentError: BAD_VALUES where a rod would not reach.
    """
    azimuth = machine.numbers('shaft_azimuth')[:, None]
    arm, rod = machine.number('arm_length'), machine.number('rod_length')
    out = np.stack([np.cos(azimuth), np.sin(azimuth)])
    # In each arm's plane: the platform outwards of the shaft and above it; across it the rest.
    ahead = np.sum(out * points[:2, None], axis=0) - machine.number('shaft_radius')
    across = out[0] * points[1] - out[1] * points[0]
    square = ahead**2 + points[2] ** 2
    wanted = (square + across**2 + arm**2 - rod**2) / (2.0 * arm * np.sqrt(square))
    if not np.all(np.abs(wanted) < 1.0):
        raise IdentError(
            ErrorCode.BAD_VALUES, 'the motion leaves the reach of the rods; shrink its space'
        )
    up = np.arctan2(points[2], ahead) + np.arccos(wanted)
    up = np.remainder(up + np.pi, 2.0 * np.pi) - np.pi
    # Along a rod nothing moves: its product with the platform's speed is that with the joint's.
    rate_ahead = np.sum(out * speeds[:2, None], axis=0)
    rate_across = out[0] * speeds[1] - out[1] * speeds[0]
    cos, sin = np.cos(up), np.sin(up)
    rod_ahead, rod_up = ahead - arm * cos, points[2] - arm * sin
    along = rod_ahead * rate_ahead + across * rate_across + rod_up * speeds[2]
    rate = along / (arm * (rod_up * cos - rod_ahead * sin))
    sense = _sense(machine)
    return sense * up + machine.numbers('arm_zero')[:, None], sense * rate


TWIN = Twin('rotary_tripod', delta_plant, simulate_delta, _space, arms_of, platform=True)
