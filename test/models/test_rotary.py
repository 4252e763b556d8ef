# SPDX-License-Identifier: Apache-2.0
"""The tripod with rotary drives: fast kernel, slow reference and MuJoCo make the same torque."""

import importlib
from pathlib import Path
import sys

import numpy as np
import pytest
import yaml

from checks.reference import layout as at
from checks.reference.bag_making import simulate_bag
from checks.reference.rest import platform_at
from checks.reference.rotary_tripod import delta_plant, simulate_delta
from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.identify.data import read_data
from ros2_ident.identify.run import identify, IdentifySettings
from ros2_ident.models import EffectAt, load_machine, machine_from_mapping
from ros2_ident.models.tripod.model import Delta
from ros2_ident.models.tripod.reach import set_points_of_delta
from ros2_ident.recording import Dataset, write_bag
from ros2_ident.search import GeneticSettings
from ros2_ident.simulate.motions import draw_motion

ROOT = Path(__file__).parents[2]
MACHINE = load_machine(ROOT / 'config/delta.yaml')
TRUTH = {
    'measurement_delay': 0.0021,
    'gear_stiffness': 6000.0,
    'gear_damping_ratio': 0.2,
    'tool_mass': 0.7,
    'drive_inertia': 4e-5,
    'arm_inertia': 0.02,
    'coulomb_torque': 0.03,
    'viscous_torque': 0.004,
}
SMALL = IdentifySettings(
    genetic=GeneticSettings(initial_population=256, survivors=4, children=8, generations=6)
)
# Everything that may differ from the symmetric machine: signs, zeros, a drive of its own.
CROOKED = MACHINE.with_constants(
    positive='up', arm_zero=(0.2, -0.1, 0.05), shaft_azimuth=(0.3, 2.2, 4.4),
    arm_moment=(0.06, 0.07, 0.08),
)  # fmt: skip


def run(machine, kind='pick_and_place', effects=(), parameters=TRUTH, seconds=2.0):
    motion = draw_motion(kind, machine, seconds, 7)
    return motion, simulate_delta(machine, parameters, motion.position, motion.velocity, effects)


def model_of(machine, motion, log, **more) -> Delta:
    data = Dataset(
        machine.drives, log.cycle, 0, motion.position, motion.velocity, log.position, None,
        log.effort,
    )  # fmt: skip
    return Delta(machine, data, **more)


def theta_of(model, effects=()):
    named = {**TRUTH, **dict(effects)}
    names = [p.name for p in model.parameters]
    return np.array([named.get(name, named.get(name.split('.')[-1])) for name in names])


@pytest.mark.parametrize('kind', ['pick_and_place', 'chirp'])
@pytest.mark.parametrize('machine', [MACHINE, CROOKED], ids=['shipped', 'crooked'])
def test_torque_follows_the_reference(machine, kind) -> None:
    motion, log = run(machine, kind)
    model = model_of(machine, motion, log)
    error = model.simulate(theta_of(model)[None])[0] - log.effort
    assert log.effort.std(axis=1).min() > 5.0 * machine.effort_noise  # something moves
    assert np.sqrt(np.mean(error**2, axis=1)).max() < 1e-5


@pytest.mark.parametrize('machine', [MACHINE, CROOKED], ids=['shipped', 'crooked'])
def test_torque_follows_mujoco(machine) -> None:
    sys.path.append(str(ROOT / 'build/peers'))
    pytest.importorskip('mujoco', reason='MuJoCo is not installed; see CONTRIBUTING.md')
    mujoco_rotary = importlib.import_module('checks.generators.mujoco_rotary')
    motion, log = run(machine, 'multi_point', seconds=1.2)
    effort, course = mujoco_rotary.simulate(machine, TRUTH, motion)
    model = model_of(machine, motion, log)
    fast = model.simulate(theta_of(model)[None])[0]
    assert np.abs(course.rods).max() < 1e-6
    assert np.sqrt(np.mean((effort - fast) ** 2, axis=1)).max() < 1e-5


# The true numbers of a structural effect, in the reference's columns and in the model's terms.
STRUCTURE = {
    'rod_mass': ({at.ROD_MASS: 0.08, at.ROD_AT_CARRIAGE: 0.5, at.ROD_AT_PLATFORM: 0.5,
                  at.ROD_CENTRE: 0.5}, {'rod_mass.mass': 0.08}),
    'payload_change': ({at.PAYLOAD: 0.3, at.PAYLOAD_FROM: 0.7, at.PAYLOAD_UNTIL: 1.3},
                       {'payload_change.mass': 0.3, 'payload_change.time': 0.7,
                        'payload_change.duration': 0.6}),
    'frame_resonance': ({at.FRAME_MASS: 5.0, at.FRAME_STIFFNESS: 5.0 * (40.0 * np.pi) ** 2,
                         at.FRAME_DAMPING: 2.0 * 0.05 * 40.0 * np.pi * 5.0},
                        {'frame_resonance.inverse_mass': 0.2, 'frame_resonance.frequency': 20.0,
                         'frame_resonance.damping': 0.05}),
}  # fmt: skip


class Written:
    """An effect by its columns."""

    def __init__(self, columns):
        self.columns = columns

    def apply(self, plant) -> None:
        for column, number in self.columns.items():
            plant.shared[column] = number
        plant.settled = True


@pytest.mark.parametrize('name', STRUCTURE)
def test_effects_of_the_structure_follow_the_reference(name) -> None:
    columns, values = STRUCTURE[name]
    motion, log = run(MACHINE, 'multi_point', [Written(columns)])
    without = run(MACHINE, 'multi_point')[1]
    model = model_of(MACHINE, motion, log, effects=[EffectAt(name, 'all')])
    error = model.simulate(theta_of(model, values)[None])[0] - log.effort
    change = np.abs(log.effort - without.effort).max()
    assert change > 3.0 * MACHINE.effort_noise
    assert np.sqrt(np.mean(error**2, axis=1)).max() < 0.01 * change


def test_set_points_put_the_platform_where_it_shall_be() -> None:
    rng = np.random.default_rng(4)
    centre = np.array([[0.0], [0.0], [-0.52]])
    points = centre + rng.uniform(-0.08, 0.08, (3, 40))
    speeds = rng.uniform(-1.0, 1.0, (3, 40))
    plant = delta_plant(CROOKED, TRUTH)
    angle, rate = set_points_of_delta(points, speeds, CROOKED)
    for k in range(40):
        assert platform_at(angle[:, k], plant.shared, plant.drive) == pytest.approx(points[:, k])
    step = 1e-6
    ahead = set_points_of_delta(points + step * speeds, speeds, CROOKED)[0]
    behind = set_points_of_delta(points - step * speeds, speeds, CROOKED)[0]
    assert (ahead - behind) / (2.0 * step) == pytest.approx(rate, abs=1e-6)
    with pytest.raises(IdentError, match='reach of the rods') as caught:
        set_points_of_delta(points + [[0.0], [0.0], [-0.5]], speeds, MACHINE)
    assert caught.value.code is ErrorCode.BAD_VALUES


def test_a_bag_gives_the_parameters_back(tmp_path) -> None:
    motion = draw_motion('multi_point', MACHINE, 3.0, 3)
    bag = write_bag(tmp_path / 'bag', simulate_bag(MACHINE, TRUTH, motion, 3).streams)
    found = identify(MACHINE, read_data([bag], MACHINE), settings=SMALL)
    assert found.cost.refined < 1.05 * MACHINE.effort_noise
    for p in found.parameters:
        true = TRUTH[p.name.split('.')[-1]]
        assert p.value == pytest.approx(true, rel=0.2), p
        assert abs(p.value - true) < p.high - p.low, p  # twice the interval: twenty are looked at


def test_a_rod_that_is_too_short_is_an_error_of_the_file() -> None:
    content = yaml.safe_load((ROOT / 'config/delta.yaml').read_text())
    content['geometry'] |= {'shaft_radius': 0.5, 'arm_length': 0.1, 'rod_length': 0.3}
    with pytest.raises(IdentError, match='does not reach the middle'):
        machine_from_mapping(content)
