# SPDX-License-Identifier: Apache-2.0
"""Bags of the reference: those that the package holds, and those of drawn machines."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from checks.reference.bag_making import draw_parameters, simulate_bag
from ros2_ident.errors import IdentError
from ros2_ident.models import load_machine
from ros2_ident.recording import read_bag
from ros2_ident.simulate.bag import nuisance_of
from ros2_ident.simulate.motions import draw_motion

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


def test_torque_stays_well_inside_the_limit():
    for seed in range(4):
        motion = draw_motion('multi_point', MACHINE, 4.0, seed)
        bag = simulate_bag(MACHINE, TRUTH, motion)
        assert np.max(np.abs(bag.log.torque)) < 4.0


MOTION = draw_motion('mixed', MACHINE, 4.0, 1)


@pytest.fixture(scope='module')
def bag():
    return simulate_bag(MACHINE, TRUTH, MOTION, 1)


def test_same_seed_same_bag(bag):
    again = simulate_bag(MACHINE, TRUTH, MOTION, 1)
    other = simulate_bag(MACHINE, TRUTH, MOTION, 2)
    for topic, stream in bag.streams.items():
        assert np.array_equal(stream.stamp, again.streams[topic].stamp)
        assert not np.array_equal(stream.stamp, other.streams[topic].stamp)
    assert np.array_equal(bag.streams['/effort'].effort, again.streams['/effort'].effort)


def test_a_kind_without_a_reference_says_so(bag):
    with pytest.raises(IdentError, match='no reference of a mujoco'):
        simulate_bag(replace(MACHINE, kind='mujoco'), TRUTH, MOTION)


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
def test_bundled_bags_are_what_their_command_makes(name, machine, kind, seconds, seed, truth):
    made = simulate_bag(machine, truth, draw_motion(kind, machine, seconds, seed), seed)
    (kept,) = read_bag(ROOT / 'bags' / name)
    stream = made.streams['/effort']
    assert np.array_equal(kept.effort.stamp, stream.stamp)
    # A last bit of another processor may tip a rounding over one step.
    step = 0.2 * nuisance_of(machine).effort_noise
    assert np.max(np.abs(kept.effort.effort - stream.effort)) < 1.01 * step
    assert sum(file.stat().st_size for file in (ROOT / 'bags' / name).iterdir()) < 1.5e6


@pytest.mark.parametrize('machine', [MACHINE, EMPS], ids=['tripod', 'axis'])
def test_drawn_machines_lie_in_their_box_and_run(machine):
    for seed in range(3):
        parameters = draw_parameters(machine, np.random.default_rng(seed))
        for name, number in parameters.items():
            low, high, _ = machine.bounds[name.rpartition('.')[2]]
            assert float(low) < number < float(high)
        made = simulate_bag(machine, parameters, draw_motion('mixed', machine, 2.0, seed), seed)
        assert np.all(np.isfinite(made.log.effort))
