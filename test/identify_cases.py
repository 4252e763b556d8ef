# SPDX-License-Identifier: Apache-2.0
"""Small machines and logs that the tests of the identification share."""

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from values import with_bounds

from checks.reference.bag_making import simulate_bag
from ros2_ident.identify.data import Data, gather
from ros2_ident.identify.result import Identification
from ros2_ident.identify.run import identify, IdentifySettings
from ros2_ident.models import load_machine, Machine
from ros2_ident.recording import Dataset, Recording
from ros2_ident.search import GeneticSettings
from ros2_ident.simulate.bag import nuisance_of, SimulatedBag
from ros2_ident.simulate.motions import draw_motion, Motion

ROOT = Path(__file__).parents[1]
SHARED = ROOT.parent / 'shared'
AXIS_FILE = ROOT / 'config' / 'emps.yaml'
TRIPOD_FILE = ROOT / 'config' / 'tripod.yaml'

AXIS_TRUTH = {
    'moving_mass': 95.0,
    'viscous_friction': 200.0,
    'coulomb_friction': 20.0,
    'constant_force': -3.0,
}
TRIPOD_TRUTH = {
    'measurement_delay': 0.0021,
    'gear_stiffness': 2e4,
    'gear_damping_ratio': 0.3,
    'tool_mass': 1.4,
    'drive_inertia': 9e-5,
    'coulomb_torque': 0.05,
    'viscous_torque': 0.03,
}

# Small enough for a test, large enough for four parameters.
QUICK = IdentifySettings(
    genetic=GeneticSettings(initial_population=64, survivors=4, children=8, generations=4)
)


@cache
def axis() -> Machine:
    """Return the linear axis."""
    return load_machine(AXIS_FILE)


def joint(name: str, noise: float) -> Machine:
    """Return a joint whose recorded motion drives its model, its noise in N m."""
    bounds = {
        'moving_mass': (0.1, 20.0, 'kg m^2'),
        'viscous_friction': (0.0, 50.0, 'N m s/rad'),
        'coulomb_friction': (0.0, 20.0, 'N m'),
        'constant_force': (-50.0, 50.0, 'N m'),
    }
    found = with_bounds(axis(), bounds)
    return replace(found, drives=(name,), effort_unit='N m', effort_noise=noise)


@cache
def tripod() -> Machine:
    """Return the tripod."""
    return load_machine(TRIPOD_FILE)


@cache
def axis_bag(seconds: float = 4.0) -> SimulatedBag:
    """Return a short log of the axis."""
    machine = axis()
    motion = draw_motion('multi_point', machine, seconds, 2)
    nuisance = replace(nuisance_of(machine), position_step=1e-8)
    return simulate_bag(machine, AXIS_TRUTH, motion, 1, nuisance)


@cache
def tripod_bag(seconds: float = 3.0) -> SimulatedBag:
    """Return a short log of the tripod."""
    machine = tripod()
    return simulate_bag(machine, TRIPOD_TRUTH, draw_motion('multi_point', machine, seconds, 3), 1)


def recording_of(bag: SimulatedBag, **changes: object) -> Recording:
    """Return a simulated log as a recording; `changes` replace its streams."""
    streams = {
        'state': bag.streams['/joint_states'],
        'effort': bag.streams['/effort'],
        'command': bag.streams['/joint_command'],
    }
    return Recording(**{**streams, 'source': 'test', **changes})  # type: ignore[arg-type]


def tripod_log(motion: Motion, seed: int, effects: Sequence[Any] = ()) -> Dataset:
    """Return a log of the tripod along a motion, in which no sample is missing."""
    nuisance = replace(nuisance_of(tripod()), drop=0.0)
    bag = simulate_bag(tripod(), TRIPOD_TRUTH, motion, seed, nuisance, effects)
    return gather([recording_of(bag)], tripod()).datasets[0]


@cache
def axis_data() -> Data:
    """Return the axis' log on the grid."""
    return gather([recording_of(axis_bag())], axis())


@cache
def identified(seed: int = 1) -> Identification:
    """Return what a quick search finds in the axis' log."""
    return identify(axis(), axis_data(), settings=QUICK, seed=seed)


def theta_of(names: tuple[str, ...], truth: dict[str, float]) -> np.ndarray:
    """Return true parameters (N,) in the order of their full names."""
    return np.array([truth[name.rpartition('.')[2]] for name in names])


class After:
    """A cancel event that is set when it was asked so often."""

    def __init__(self, count):
        self.left = count

    def is_set(self):
        self.left -= 1
        return self.left < 0
