# SPDX-License-Identifier: Apache-2.0
"""Units change nothing but units: lengths and forces times a power of two, the same digits."""

from pathlib import Path

import numpy as np

from ros2_ident.models import load_machine, make_model
from ros2_ident.models.trials import trials
from ros2_ident.recording import Dataset

# Powers of two leave all digits of a float.
LENGTH, FORCE = 1024.0, 64.0
TEXT = """
machine: linear_axis
drives: [joint]
controller: {{cycle: 0.002}}
parameters:
  moving_mass: [0.0, {mass}, kg]
  coulomb_friction: [0.0, {force}, N]
  viscous_friction: [0.0, {viscous}, N s/m]
  constant_force: [-{force}, {force}, N]
"""


def model_in(folder: Path, length: float, force: float):
    """Return a carriage along a recorded motion, its units so many times smaller."""
    path = folder / f'{length}_{force}.yaml'
    viscous = 80.0 * force / length
    path.write_text(TEXT.format(mass=20.0 * force / length, force=20.0 * force, viscous=viscous))
    time = 0.002 * np.arange(2000)
    position = 0.1 * np.sin(9.0 * time) + 0.05 * np.sin(3.0 * time)
    effort = 5.0 * np.gradient(np.gradient(position, 0.002), 0.002) + 3.0 * np.sign(np.cos(time))
    data = Dataset(
        ('joint',), 0.002, 0, None, None, length * position[None], None, force * effort[None]
    )
    return make_model(load_machine(path), data)


def test_units_change_no_effect_and_no_bound(tmp_path: Path) -> None:
    one, other = model_in(tmp_path, 1.0, 1.0), model_in(tmp_path, LENGTH, FORCE)
    tried = 0
    for at in one.extensions():
        effects = [m.extended((at,)) for m in (one, other)]
        nominal = [
            0.3 * np.array([p.high for p in m.parameters[: len(one.parameters)]]) for m in effects
        ]
        groups = [[p for g in trials(at, m) for p in g] for m in effects]
        assert len(groups[0]) == len(groups[1])
        for points in zip(*groups, strict=True):
            made = [
                m.simulate(np.append(x, p))[0]
                for m, x, p in zip(effects, nominal, points, strict=True)
            ]
            np.testing.assert_allclose(made[1], FORCE * made[0], rtol=1e-12, err_msg=str(at))
            tried += 1
    assert tried > 30
