# SPDX-License-Identifier: Apache-2.0
"""Bags of the reference, those of drawn machines too."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from checks.reference.bag_making import draw_parameters, simulate_bag
from ros2_ident.errors import IdentError
from ros2_ident.models import load_machine
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


def test_a_kind_without_a_reference_says_so():
    with pytest.raises(IdentError, match='no reference of a mujoco'):
        simulate_bag(replace(MACHINE, kind='mujoco'), TRUTH, draw_motion('mixed', MACHINE, 4.0, 1))


@pytest.mark.parametrize('machine', [MACHINE, EMPS], ids=['tripod', 'axis'])
def test_drawn_machines_lie_in_their_box_and_run(machine):
    for seed in range(3):
        parameters = draw_parameters(machine, np.random.default_rng(seed))
        for name, number in parameters.items():
            low, high, _ = machine.bounds[name.rpartition('.')[2]]
            assert float(low) < number < float(high)
        made = simulate_bag(machine, parameters, draw_motion('mixed', machine, 2.0, seed), seed)
        assert np.all(np.isfinite(made.log.effort))
