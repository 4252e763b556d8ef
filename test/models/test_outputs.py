# SPDX-License-Identifier: Apache-2.0
"""Positions and velocities beside the effort: against the reference, and in residuals and costs.

Tolerances are RMS: 1e-5 N m, 2e-8 m and 2e-6 m/s, the worst drive's.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from checks.reference.axis import simulate_axis
from checks.reference.plant import Log
from checks.reference.tripod import simulate_tripod
from checks.reference.tripod import TABLE_5 as TRUTH
from ros2_ident.models import load_machine, machine_from_mapping, make_model
from ros2_ident.models.tripod.model import Tripod
from ros2_ident.recording import Dataset
from ros2_ident.simulate.motions import draw_motion

FILE = Path(__file__).parents[2] / 'config' / 'tripod.yaml'
MACHINE = load_machine(FILE)
ALL = 'effort', 'position', 'velocity'
TOLERANCE = {'effort': 1e-5, 'position': 2e-8, 'velocity': 2e-6}


def dataset(log: Log, command: tuple[np.ndarray, np.ndarray]) -> Dataset:
    return Dataset(log.names, log.cycle, 0, *command, log.position, log.velocity, log.effort)


@pytest.fixture(scope='module')
def data() -> Dataset:
    motion = draw_motion('multi_point', MACHINE, 2.0, 5)
    command = motion.position, motion.velocity
    return dataset(simulate_tripod(MACHINE, TRUTH, *command), command)


def truth(model) -> np.ndarray:
    return np.array([[TRUTH[p.name.split('.')[-1]] for p in model.parameters]])


def misses(model, log, theta=None) -> dict[str, float]:
    """Return the worst drive's RMS difference to the reference, by quantity."""
    theta = truth(model) if theta is None else theta
    simulated = model.simulate(theta)[0].reshape(len(ALL), -1, model.data.cycles)
    return {
        q: float(np.sqrt(np.mean((simulated[i] - getattr(log, q)) ** 2, axis=1)).max())
        for i, q in enumerate(ALL)
    }


def test_the_tripods_motion_is_the_references(data) -> None:
    missed = misses(Tripod(MACHINE, data, quantities=ALL), data)
    assert all(missed[q] < TOLERANCE[q] for q in ALL), missed


P_LAW = {'law': 'cascade_p', 'integral_gain': 0.0}


@pytest.mark.parametrize('elastic', [True, False])
@pytest.mark.parametrize('law', [{}, P_LAW], ids=['pi', 'p'])
def test_an_axis_motion_is_the_references(elastic: bool, law: dict) -> None:
    units = (
        {'drive_inertia': 'kg m^2', 'gear_stiffness': 'N/m', 'gear_damping_ratio': '1'}
        if elastic
        else {'moving_mass': 'kg'}
    )
    units['constant_force'] = 'N m'
    values = {name: TRUTH.get(name, 3.0) for name in units} | {'constant_force': 0.2}
    machine = machine_from_mapping(
        {
            'machine': 'linear_axis',
            'drives': ['lift'],
            'geometry': {'gravity': 9.81 if elastic or law else 0.0},
            'drive': {'gear_factor': 78.54, 'coulomb_regularisation': 5e-3}
            | ({'rail_mass': 1.5} if elastic else {}),
            'controller': yaml.safe_load(FILE.read_text())['controller'] | law,
            'parameters': {name: [0.0, 2.0 * values[name], unit] for name, unit in units.items()},
        }
    )
    time = np.arange(3000) * 5e-4
    position = (0.2 + 0.05 * np.clip(time / 0.5, 0.0, 1.0) ** 3 * np.sin(9.0 * time))[None]
    command = position, np.gradient(position, 5e-4, axis=1)
    log = simulate_axis(machine, values, *command)
    model = make_model(machine, dataset(log, command), quantities=ALL)
    simulated = model.simulate(np.array([list(values.values())]))[0]
    for row, quantity in zip(simulated, ALL, strict=True):
        rms = np.sqrt(np.mean((row - getattr(log, quantity)[0]) ** 2))
        assert rms < TOLERANCE[quantity], quantity


def holed(data: Dataset) -> Dataset:
    """Return the recording with 1 kHz of noisy effort, few positions, one drive without any."""
    rng = np.random.default_rng(2)
    effort = data.effort + 0.01 * rng.standard_normal(data.effort.shape)
    effort[:, 1::2] = np.nan
    position = data.position + 1e-5 * rng.standard_normal(data.effort.shape)
    position[0, :] = np.nan
    position[:, 700:] = np.nan
    return replace(data, effort=effort, position=position)


def around(model, count: int) -> np.ndarray:
    rng = np.random.default_rng(6)
    theta = truth(model) * (1.0 + 0.2 * rng.standard_normal((count, len(model.parameters))))
    theta[0] = truth(model)
    return np.maximum(theta, 0.0)


def test_costs_are_the_weighted_rms_errors_of_the_outputs_that_have_samples(data) -> None:
    data = holed(data)
    model = Tripod(MACHINE, data, quantities=ALL, weights=[1.0, 1e3, 10.0])
    plain = Tripod(MACHINE, data)
    theta = around(model, 11)
    simulated = model.simulate(theta)
    np.testing.assert_allclose(simulated[:, :3], plain.simulate(theta), rtol=0.0, atol=1e-12)
    weights = np.repeat([1.0, 1e3, 10.0], 3)[:, None]
    errors = weights * (np.concatenate([data.effort, data.position, data.velocity]) - simulated)
    there = np.isfinite(model.measured)
    np.testing.assert_allclose(model.residuals(theta), errors[:, there], rtol=1e-12, atol=1e-12)
    rms = [
        np.sqrt(np.mean(errors[:, o, row] ** 2, axis=1))
        for o, row in enumerate(there)
        if row.any()
    ]
    assert len(rms) == 8
    np.testing.assert_allclose(model.costs(theta), np.mean(rms, axis=0), rtol=1e-12)
    assert np.abs(model.costs(theta) / plain.costs(theta) - 1.0).min() > 0.01
