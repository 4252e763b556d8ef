# SPDX-License-Identifier: Apache-2.0
"""The tripod with rotary drives in redundant coordinates: motors, arms and platform, three rods.

See `dynamics` for the equations: an arm's angle takes the place of a carriage's height.
"""

from collections.abc import Mapping
from functools import partial

import numpy as np

from checks.reference import layout as at
from checks.reference.plant import Plant, platform_plant, read_drives
from checks.reference.simulate import simulate_machine
from checks.reference.twin import Twin
from ros2_ident.machine.machine import Machine


def delta_plant(machine: Machine, parameters: Mapping[str, float]) -> Plant:
    """Build the nominal delta.

    Args:
        parameters: As of `tripod_plant`.
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


TWIN = Twin('rotary_tripod', delta_plant, simulate_delta)
