# SPDX-License-Identifier: Apache-2.0
"""Motions stay within their limits, and bags are what a recorder would have made of a log."""

from pathlib import Path

import numpy as np
import pytest

from checks.reference import bag_making
from ros2_ident.models import load_machine
from ros2_ident.models.registry import space_of
from ros2_ident.recording import read_bag
from ros2_ident.simulate.bag import nuisance_of, simulate_bag, START
from ros2_ident.simulate.motions import draw_motion, KINDS

ROOT = Path(__file__).parents[2]
MACHINE = load_machine(ROOT / 'config' / 'tripod.yaml')
EMPS = load_machine(ROOT / 'config' / 'emps.yaml')
TRUTH = {
    'measurement_delay': 0.0249,
    'gear_stiffness': 2.32e5,
    'gear_damping_ratio': 0.396,
    'tool_mass': 1.762,
    'drive_inertia': 8.9e-5,
    'coulomb_torque': 0.08,
    'viscous_torque': 0.03,
}


@pytest.mark.parametrize('kind', [kind for kind in KINDS if kind != 'steps'])
@pytest.mark.parametrize('machine', [MACHINE, EMPS], ids=['tripod', 'axis'])
def test_motion(kind, machine):
    for seed in range(3):
        motion = draw_motion(kind, machine, 5.0, seed)
        again = draw_motion(kind, machine, 5.0, seed)
        assert np.array_equal(motion.position, again.position)
        assert motion.seconds == pytest.approx(5.0)
        assert np.all(motion.velocity[:, :100] == 0.0)
        slope = (motion.position[:, 2:] - motion.position[:, :-2]) / (2.0 * motion.cycle)
        space = space_of(machine)
        scale = space.speed * (motion.cycle / 1e-3)
        assert np.max(np.abs(slope - motion.velocity[:, 1:-1])) < 0.01 * scale
        steps = np.diff(motion.velocity, axis=1) / motion.cycle
        # Rods lean: a carriage may go somewhat faster than the platform.
        assert np.max(np.abs(motion.velocity)) < 1.8 * space.speed
        assert np.max(np.abs(steps)) < 2.2 * space.acceleration
        assert np.ptp(motion.position) > 1e-3


@pytest.fixture(scope='module')
def motion():
    return draw_motion('mixed', MACHINE, 4.0, 1)


@pytest.fixture(scope='module')
def bag(motion):
    return simulate_bag(MACHINE, TRUTH, motion, 1)


def test_streams_are_a_log(bag):
    assert list(bag.streams) == ['/joint_states', '/effort', '/joint_command']
    for stream in bag.streams.values():
        assert 3950 < stream.stamp.size < 4001
        step = np.diff(stream.stamp) / 1e6
        assert np.median(step) == pytest.approx(1.0, abs=1e-3)
        assert 5e-3 < np.std(step[step < 1.5]) < 30e-3
    states, effort = bag.streams['/joint_states'], bag.streams['/effort']
    assert states.effort is None and effort.position is None
    assert np.max(np.abs(effort.effort / 0.002 - np.round(effort.effort / 0.002))) < 1e-9
    cycle = np.round((effort.stamp - START) / 0.5e6).astype(int)
    residual = effort.effort - bag.log.effort[:, cycle].T
    assert np.std(residual) == pytest.approx(0.01, rel=0.05)
    assert np.abs(np.mean(residual)) < 5e-4


# The package's model, and the slow reference, which shares no equations of motion with it.
BY_BOTH = pytest.mark.parametrize('simulate', [simulate_bag, bag_making.simulate_bag])


@BY_BOTH
def test_same_seed_same_bag(simulate, motion):
    bag, again, other = (simulate(MACHINE, TRUTH, motion, seed) for seed in (1, 1, 2))
    for topic, stream in bag.streams.items():
        assert np.array_equal(stream.stamp, again.streams[topic].stamp)
        assert not np.array_equal(stream.stamp, other.streams[topic].stamp)
    assert np.array_equal(bag.streams['/effort'].effort, again.streams['/effort'].effort)


@BY_BOTH
@pytest.mark.parametrize(
    ('name', 'machine', 'kind', 'seconds', 'seed', 'truth'),
    [
        ('tripod_pick_and_place', MACHINE, 'pick_and_place', 7.0, 1, TRUTH),
        ('tripod_mixed', MACHINE, 'mixed', 6.0, 2, TRUTH),
        (
            'axis_reversals',
            EMPS,
            'reversals',
            6.0,
            3,
            {
                'moving_mass': 95.1,
                'viscous_friction': 203.5,
                'coulomb_friction': 20.4,
                'constant_force': -3.16,
            },
        ),
    ],
)
def test_bundled_bags_are_what_their_command_makes(
    name, machine, kind, seconds, seed, truth, simulate
):
    made = simulate(machine, truth, draw_motion(kind, machine, seconds, seed), seed)
    (kept,) = read_bag(ROOT / 'bags' / name)
    stream = made.streams['/effort']
    assert np.array_equal(kept.effort.stamp, stream.stamp)
    # A last bit of another processor may tip a rounding over one step.
    step = 0.2 * nuisance_of(machine).effort_noise
    assert np.max(np.abs(kept.effort.effort - stream.effort)) < 1.01 * step
    assert sum(file.stat().st_size for file in (ROOT / 'bags' / name).iterdir()) < 1.5e6
