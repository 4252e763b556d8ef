# SPDX-License-Identifier: Apache-2.0
"""How many integration steps the tripod's kernel needs: its torque against the slow reference."""

import argparse
import itertools
from pathlib import Path

import numpy as np

from checks.reference.tripod import simulate_tripod, TABLE_5
from checks.share import table
from ros2_ident.models import load_machine
from ros2_ident.models.tripod.model import Tripod
from ros2_ident.recording import Dataset
from ros2_ident.simulate.motions import draw_motion

STEPS = (1, 2, 4, 8, 16)
CORNER = 'gear_stiffness', 'gear_damping_ratio', 'drive_inertia', 'coulomb_torque'


def model_and_reference(
    parameters: dict[str, float], kind: str, seconds: float
) -> tuple[Tripod, np.ndarray]:
    """Return the fast model on a motion, and the reference's logged torque (3, K)."""
    machine = load_machine(Path(__file__).parents[2] / 'config' / 'tripod.yaml')
    motion = draw_motion(kind, machine, seconds, 7)
    log = simulate_tripod(machine, parameters, motion.position, motion.velocity)
    course = motion.position, motion.velocity
    data = Dataset(machine.drives, log.cycle, 0, *course, None, None, log.effort)
    return Tripod(machine, data), log.effort


def theta_of(model: Tripod, parameters: dict[str, float]) -> np.ndarray:
    """Return (1, N) the model's parameters at the given values."""
    return np.array([[parameters[p.name.split('.')[-1]] for p in model.parameters]])


def errors(parameters: dict[str, float], kind: str, seconds: float) -> dict[int | None, float]:
    """Return the worst drive's RMS error [N m] by steps a cycle; None: the model's choice."""
    model, effort = model_and_reference(parameters, kind, seconds)
    theta = theta_of(model, parameters)
    out: dict[int | None, float] = {}
    for steps in (*STEPS, None):
        model.substeps = steps
        error = model.simulate(theta)[0] - effort
        out[steps] = float(np.sqrt(np.mean(error**2, axis=1)).max())
    model.substeps = None
    return out


def chosen(parameters: dict[str, float]) -> int:
    """Return the number of steps the model chooses by itself."""
    model, _ = model_and_reference(parameters, 'pick_and_place', 1.0)
    return int(model._steps(model.rows(theta_of(model, parameters)))[0])


def study() -> str:
    """Return the study as a table."""
    values = 'motion', 'c_G [N/m]', 'zeta_G', 'J_D [kg m^2]', 'M_C [N m]'
    head = *values, *(f'{s} ({500 / s:.4g} us)' for s in STEPS), 'chosen', 'error there'
    rows = []
    cases = [(kind, TABLE_5) for kind in ('pick_and_place', 'multi_point', 'chirp', 'creep')]
    for corner in itertools.product((1e2, 1e4, 3e5), (0.0, 0.4, 2.0), (5e-5, 15e-5), (0.0, 0.2)):
        cases.append(('pick_and_place', TABLE_5 | dict(zip(CORNER, corner, strict=True))))
    for kind, p in cases:
        found = errors(p, kind, 3.0)
        numbers = [p[x] for x in CORNER]
        errors_of = [f'{found[s]:.1e}' for s in (*STEPS, None)]
        own = [kind, *(f'{x:.3g}' for x in numbers)]
        rows.append([*own, *errors_of[:-1], chosen(p), errors_of[-1]])
    return table(head, rows)


def main() -> None:
    """Print the study."""
    argparse.ArgumentParser(description=__doc__).parse_args()
    print(study())


if __name__ == '__main__':
    main()
