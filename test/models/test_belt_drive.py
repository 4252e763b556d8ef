# SPDX-License-Identifier: Apache-2.0
"""The belt drive against its slow twin, against linear algebra, and at its edges."""

from pathlib import Path

import numpy as np
import pytest

from checks.paper.belt import step_reference
from checks.reference.belt_drive import simulate_belt
from ros2_ident.cli.main import main
from ros2_ident.errors import IdentError
from ros2_ident.identify.data import read_data
from ros2_ident.identify.result import Outcome
from ros2_ident.identify.run import identify
from ros2_ident.identify.settings import IdentifySettings
from ros2_ident.models import EffectAt, load_machine
from ros2_ident.models.belt_drive.model import BeltDrive, RecordedBelt
from ros2_ident.search import GeneticSettings
from ros2_ident.words.identification import message

MACHINE = load_machine(Path(__file__).parents[2] / 'config' / 'belt_drive.yaml')
LOW, HIGH = np.array([1.5e5, 30.0]), np.array([2.5e5, 60.0])
TRUTH = np.array([[2e5, 45.0]])


def candidates(count, seed=0):
    return LOW + np.random.default_rng(seed).random((count, 2)) * (HIGH - LOW)


def constants_of(theta):
    constants = {name: MACHINE.number(name) for name in MACHINE.constants}
    return {**constants, 'axial_stiffness': theta[0], 'position_gain': theta[1]}


@pytest.fixture(scope='module')
def belt():
    return BeltDrive(MACHINE, *step_reference(duration=0.5))


@pytest.mark.parametrize('theta', [LOW, HIGH])
def test_modal_path_agrees_with_reference(belt, theta):
    slow = simulate_belt(constants_of(theta), belt.cycle, belt.reference)
    fast = belt.simulate(theta[None, :])[0]
    rms = np.sqrt(np.mean((fast - slow) ** 2, axis=1))
    assert rms[0] < 1e-10
    assert rms[1] < 1e-8


@pytest.mark.parametrize('kind', ['steps', 'restless', 'one sample'])
def test_fused_costs_are_eq_2_of_the_trajectories(kind):
    rng = np.random.default_rng(3)
    data = {
        'steps': step_reference(duration=0.5),
        'restless': (2e-4, np.cumsum(rng.normal(size=700)) * 1e-4),
        'one sample': (2e-4, np.array([0.3])),
    }[kind]
    belt = BeltDrive(MACHINE, *data)
    theta = candidates(37)
    measured = belt.simulate(TRUTH)[0] + rng.normal(size=(2, belt.reference.size)) * 1e-3
    expected = np.sqrt(((measured - belt.simulate(theta)) ** 2).mean(axis=2)).mean(axis=1)
    np.testing.assert_allclose(belt.cost(theta, measured), expected, rtol=1e-9)


def test_unstable_candidates_cost_inf(belt):
    theta = np.array([[-1e5, 45.0], [2e5, -3.0], [2e5, 45.0], [np.nan, 45.0]])
    cost = belt.cost(theta, belt.simulate(TRUTH)[0])
    assert np.isinf(cost[[0, 1, 3]]).all()
    assert cost[2] < 1e-12
    assert np.isinf(belt.simulate(theta)[[0, 1, 3]]).all()


def bag_of(folder, seed, *more):
    arguments = ['--seconds', '2', '--motion', 'steps', '--seed', str(seed), *more]
    file = Path(__file__).parents[2] / 'config/belt_drive.yaml'
    truth = ['--set', 'axial_stiffness=2.1e5', '--set', 'position_gain=41']
    assert main(['simulate', str(folder), '--machine', str(file), *truth, *arguments]) == 0
    return folder


def test_a_bag_gives_stiffness_and_gain_back(tmp_path):
    bag = bag_of(tmp_path / 'bag', 1, '--noise', '0.005')
    settings = IdentifySettings(genetic=GeneticSettings(1000, 20, 8, 12))
    found = identify(MACHINE, read_data([bag], MACHINE), settings=settings)
    stiffness, gain = found.parameters
    assert stiffness.value == pytest.approx(2.1e5, rel=1e-3)
    assert gain.value == pytest.approx(41.0, rel=1e-3)
    assert stiffness.low < 2.1e5 < stiffness.high


def test_a_recorded_belt_is_the_belt_and_says_what_it_needs(tmp_path):
    data = read_data([bag_of(tmp_path / 'bag', 2, '--clean')], MACHINE).datasets[0]
    model = RecordedBelt(MACHINE, data)
    assert [o.name for o in model.outputs] == ['driving_gear', 'driving_gear.position']
    truth = np.array([[2.1e5, 41.0]])
    # The reference's integration and the log's last digits are all that is left.
    assert model.costs(truth)[0] < 1e-7
    held = RecordedBelt(MACHINE, data, fixed={'position_gain': 41.0})
    assert [p.name for p in held.parameters] == ['axial_stiffness']
    np.testing.assert_array_equal(held.simulate(truth[:, :1]), model.simulate(truth))
    for wrong, what in (
        ({'fixed': {'colour': 1.0}}, "'colour' cannot be fixed"),
        ({'quantities': ('velocity',)}, 'velocity is not simulated'),
        ({'effects': [EffectAt('backlash', 'driving_gear')]}, 'cannot be extended by backlash'),
    ):
        with pytest.raises(IdentError, match=what):
            RecordedBelt(MACHINE, data, **wrong)


def test_a_fit_that_may_have_ended_in_a_wrong_minimum_is_not_identified(tmp_path):
    data = read_data([bag_of(tmp_path / 'bag', 1, '--noise', '0.005')], MACHINE)
    settings = IdentifySettings(genetic=GeneticSettings(initial_population=1024, survivors=20))
    said = []
    for seed in (3, 4):
        found = identify(MACHINE, data, settings=settings, seed=seed)
        right = found.parameters[0].value == pytest.approx(2.1e5, rel=1e-3)
        assert (found.outcome is Outcome.IDENTIFIED) == right, (seed, message(found))
        assert right == all(p.identifiable for p in found.parameters)
        said.append('several minima' in message(found))
    assert set(said) == {True, False}
