# SPDX-License-Identifier: Apache-2.0
"""The kernels against the slow reference, and what a batch must not change."""

from pathlib import Path

import numpy as np
import pytest

from checks.reference.tripod import simulate_tripod, TABLE_5
from ros2_ident.effects import CATALOGUE, get_effect
from ros2_ident.errors import IdentError
from ros2_ident.models import EffectAt, load_machine, make_model
from ros2_ident.models.tripod.model import Tripod
from ros2_ident.recording import Dataset
from ros2_ident.simulate.motions import draw_motion

CONFIG = Path(__file__).parents[2] / 'config'
MACHINE = load_machine(CONFIG / 'tripod.yaml')


def reference(parameters: dict[str, float], kind: str = 'pick_and_place', seconds: float = 2.0):
    motion = draw_motion(kind, MACHINE, seconds, 7)
    return motion, simulate_tripod(MACHINE, parameters, motion.position, motion.velocity)


def dataset(motion, effort, command=True, position=None) -> Dataset:
    return Dataset(
        MACHINE.drives,
        MACHINE.number('cycle'),
        0,
        motion.position if command else None,
        motion.velocity if command else None,
        position,
        None,
        effort,
    )


def theta_of(model, parameters: dict[str, float]) -> np.ndarray:
    return np.array([parameters[p.name.split('.')[-1]] for p in model.parameters])


@pytest.fixture(scope='module')
def run():
    return reference(TABLE_5)


@pytest.fixture(scope='module')
def model(run) -> Tripod:
    motion, log = run
    return Tripod(MACHINE, dataset(motion, log.effort))


@pytest.mark.parametrize('kind', ['pick_and_place', 'chirp', 'creep'])
def test_torque_follows_the_reference_at_table_5(kind: str) -> None:
    motion, log = reference(TABLE_5, kind)
    model = Tripod(MACHINE, dataset(motion, log.effort))
    error = model.simulate(theta_of(model, TABLE_5)[None])[0] - log.effort
    assert np.sqrt(np.mean(error**2, axis=1)).max() < 1e-5


@pytest.mark.parametrize(('stiffness', 'inertia'), [(1e4, 15e-5), (3e5, 5e-5)])
@pytest.mark.parametrize('damping', [0.4, 2.0])
def test_torque_follows_the_reference_in_the_corners_of_the_box(
    stiffness: float, damping: float, inertia: float
) -> None:
    corner = {
        **TABLE_5,
        'gear_stiffness': stiffness,
        'gear_damping_ratio': damping,
        'drive_inertia': inertia,
        'coulomb_torque': 0.2,
    }
    motion, log = reference(corner)
    model = Tripod(MACHINE, dataset(motion, log.effort))
    error = model.simulate(theta_of(model, corner)[None])[0] - log.effort
    assert np.sqrt(np.mean(error**2, axis=1)).max() < 1e-5


def test_a_candidate_does_not_depend_on_its_neighbours(model: Tripod) -> None:
    rng = np.random.default_rng(8)
    low = np.array([p.low for p in model.parameters])
    high = np.array([p.high for p in model.parameters])
    theta = low + (high - low) * rng.random((21, len(low)))
    assert len(np.unique(model.work(theta))) > 1
    for evaluate in (model.simulate, model.costs, model.residuals):
        together = evaluate(theta)
        alone = np.concatenate([evaluate(row[None]) for row in theta])
        assert np.array_equal(together, alone)
        assert np.array_equal(evaluate(theta[::-1])[::-1], together)


def test_inverse_mode_gives_the_torque_of_the_recorded_motion(run) -> None:
    motion, log = run
    inverse = Tripod(MACHINE, dataset(motion, log.effort, command=False, position=log.position))
    error = inverse.simulated_effort(theta_of(inverse, TABLE_5)[None]) - log.effort
    # Held torque beside motion of the same instant, not half a cycle later, would be 0.006.
    assert np.sqrt(np.mean(error[:, 400:-400] ** 2)) < 0.003


def test_a_diverging_candidate_costs_infinity(run) -> None:
    motion, log = run
    model = Tripod(MACHINE, dataset(motion, log.effort), fixed={'measurement_delay': 0.0})
    theta = theta_of(model, {**TABLE_5, 'gear_stiffness': 1e4, 'gear_damping_ratio': 0.0})
    good = theta_of(model, TABLE_5)
    model.substeps = 1
    wild = np.where([p.name.endswith('drive_inertia') for p in model.parameters], 1e-9, theta)
    costs = model.costs(np.array([good, wild]))
    assert np.isfinite(costs[0])
    assert costs[1] == np.inf


# Presliding has no neutral value: its smallest way is the sharpest friction there is. A flexible
# gear is what the tripod has anyway.
@pytest.mark.parametrize('effect_id', sorted(set(CATALOGUE) - {'presliding', 'gear_flexibility'}))
def test_an_effect_at_its_neutral_values_changes_nothing(model: Tripod, effect_id: str) -> None:
    effect = get_effect(effect_id)
    where = 'all' if effect.place == 'all' else 'drive_2'
    extended = Tripod(MACHINE, model.data, effects=[EffectAt(effect_id, where)])
    neutral = [p.neutral for p in extended.scaled(extended.effects[0])]
    theta = theta_of(model, TABLE_5)
    plain = model.simulate(theta[None])[0]
    with_it = extended.simulate(np.concatenate([theta, neutral])[None])[0]
    assert np.abs(with_it - plain).max() < 1e-9


def test_a_flexible_gear_belongs_to_a_rigid_axis(model: Tripod) -> None:
    with pytest.raises(IdentError, match='its parameter is gear_stiffness'):
        Tripod(MACHINE, model.data, effects=[EffectAt('gear_flexibility', 'drive_1')])
    with pytest.raises(IdentError, match='cannot sit on'):
        Tripod(MACHINE, model.data, effects=[EffectAt('stribeck', 'elbow')])
    machine = load_machine(CONFIG / 'emps.yaml')
    time = np.arange(3000) * 1e-3
    position = (0.1 * np.sin(2.0 * time) ** 2)[None]
    velocity = np.gradient(position, 1e-3, axis=1)
    data = Dataset(machine.drives, 1e-3, 0, position, velocity, None, None, np.zeros((1, 3000)))
    theta = [95.0, 200.0, 20.0, -3.0]
    rigid = make_model(machine, data).simulate(np.array([theta]))[0, 0]
    at = [EffectAt('gear_flexibility', 'emps_axis')]
    flexible = make_model(machine, data, effects=at)
    soft = flexible.simulate(np.array([[*theta, 0.3, f, 0.05] for f in (8.0, 60.0)]))[:, 0]
    change = np.sqrt(np.mean((soft - rigid) ** 2, axis=1))
    # The stiffer the gear, the more it is one mass again.
    assert change[0] > 3.0 * change[1] > 0.0
