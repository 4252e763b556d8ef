# SPDX-License-Identifier: Apache-2.0
"""Draws machines: geometry, masses, controllers, gains and boxes about those of a machine file.

A machine is kept as the mapping that its file holds, so that label and file say the same.
"""

from collections.abc import Mapping
import copy
import math
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from ros2_ident.machine.file import judged
from ros2_ident.machine.machine import Machine
from ros2_ident.models.registry import KINDS

Plain = dict[str, Any]

CYCLES = (4e-4, 5e-4, 1e-3)
# Regularisation of friction where drives move carriages [m/s], and where they turn arms [rad/s].
ON_RAILS, ON_ARMS = (2e-3, 8e-3), (8e-3, 3e-2)
# Share of machines whose drives have a P controller on velocity.
PROPORTIONAL = 0.2


def read_plain(path: str | Path) -> Plain:
    """Return a machine file's content."""
    return dict(yaml.safe_load(Path(path).read_text(encoding='utf-8')))


def machine_of(plain: Mapping[str, Any]) -> Machine:
    """Return the machine of a file's content.

    Raises:
        IdentError: BAD_MACHINE_FILE where something in it is wrong.
    """
    return judged(plain, KINDS, 'the drawn machine').usable()


def file_text(plain: Mapping[str, Any]) -> str:
    """Return the text of a machine file."""
    text = yaml.safe_dump(dict(plain), sort_keys=False, default_flow_style=None, width=99)
    return '# SPDX-License-Identifier: Apache-2.0\n' + str(text)


def draw_machine(plain: Mapping[str, Any], rng: np.random.Generator, pi_only: bool) -> Plain:
    """Draw a machine of the kind of a file, about its numbers; return its file's content."""
    out: Plain = copy.deepcopy(dict(plain))
    if 'rod_length' not in out.get('geometry', {}):
        _scale(out['controller'], rng, ('position_gain', 'velocity_gain', 'integral_gain'), 1.25)
        return out
    _geometry(out['geometry'], rng)
    turn = _drive(out, rng)
    _controller(out, rng, turn, pi_only)
    return out


def _between(rng: np.random.Generator, low: float, high: float) -> float:
    """Return a number drawn evenly in its logarithm, with six digits as files have."""
    return float(f'{math.exp(rng.uniform(math.log(low), math.log(high))):.6g}')


def _scale(part: Plain, rng: np.random.Generator, names: tuple[str, ...], most: float) -> None:
    for name in names:
        if isinstance(part.get(name), (int, float)):
            part[name] = part[name] * _between(rng, 1.0 / most, most)


def _geometry(part: Plain, rng: np.random.Generator) -> None:
    size = _between(rng, 0.75, 1.35)
    if 'arm_length' in part:
        _arms(part, rng, size)
        return
    part['rod_length'] = float(f'{part["rod_length"] * size:.4g}')
    part['rail_radius'] = float(f'{part["rod_length"] * rng.uniform(0.42, 0.58):.4g}')
    part['rail_azimuth'] = [float(f'{a + rng.uniform(-0.06, 0.06):.4f}') for a in
                            part['rail_azimuth']]  # fmt: skip


def _arms(part: Plain, rng: np.random.Generator, size: float) -> None:
    """Draw where the shafts of a delta stand, and its lengths: alike, but for a few percent."""
    for name in ('shaft_radius', 'arm_length', 'rod_length'):
        part[name] = float(f'{part[name] * size * rng.uniform(0.96, 1.04):.4g}')
    part['shaft_azimuth'] = [float(f'{a + rng.uniform(-0.06, 0.06):.4f}') for a in
                             part['shaft_azimuth']]  # fmt: skip


def _drive(out: Plain, rng: np.random.Generator) -> float:
    """Draw gear, carriage or arm, and boxes; return by how much more the motor turns."""
    turn = _between(rng, 0.65, 1.5)
    drive, boxes = out['drive'], out['parameters']
    drive['gear_factor'] = float(f'{drive["gear_factor"] * turn:.6g}')
    heavy = _between(rng, 0.7, 1.8)
    for name in ('rail_mass', 'arm_inertia', 'arm_moment'):
        if name in drive:
            drive[name] = float(f'{drive[name] * heavy:.4g}')
    ends = ON_RAILS if 'rail_mass' in drive else ON_ARMS
    drive['coulomb_regularisation'] = _between(rng, *ends)
    # A motor that turns more needs less torque and less inertia for the same machine.
    for name, power in (('drive_inertia', 2), ('coulomb_torque', 1), ('viscous_torque', 1)):
        low, high, unit = boxes[name]
        boxes[name] = [float(f'{x / turn**power:.4g}') for x in (low, high)] + [unit]
    return turn


def _controller(out: Plain, rng: np.random.Generator, turn: float, pi_only: bool) -> None:
    part, boxes = out['controller'], out['parameters']
    drive, lever = out['drive'], out['geometry'].get('arm_length', 1.0)
    gear = drive['gear_factor']
    carriage = drive['rail_mass'] if 'rail_mass' in drive else drive['arm_inertia']
    inertia = 0.5 * sum(boxes['drive_inertia'][:2])
    load = 0.5 * sum(boxes['tool_mass'][:2]) / 3.0 * lever**2
    moved = inertia * gear**2 + carriage + load
    part['cycle'] = float(rng.choice(CYCLES))
    bandwidth = _between(rng, 100.0, 200.0)  # rad/s, of the velocity loop
    part['velocity_gain'] = float(f'{bandwidth * moved / gear:.5g}')
    part['position_gain'] = float(f'{bandwidth * rng.uniform(0.25, 0.5):.4g}')
    reset = bandwidth * _between(rng, 0.2, 0.5)
    part['integral_gain'] = float(f'{part["velocity_gain"] * reset:.5g}')
    part['velocity_feedforward'] = float(rng.choice([1.0, 1.0, round(rng.uniform(0.8, 1.0), 3)]))
    part['torque_limit'] = float(f'{part["torque_limit"] / turn * _between(rng, 0.8, 1.4):.3g}')
    if not pi_only and rng.random() < PROPORTIONAL:
        part['law'] = 'cascade_p'
        part['integral_gain'] = 0.0
