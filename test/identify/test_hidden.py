# SPDX-License-Identifier: Apache-2.0
"""Intervals of an identification whose model lacks something small."""

from dataclasses import replace
from pathlib import Path

from identify_cases import axis, axis_data, AXIS_TRUTH, identified, QUICK
import numpy as np
import pytest
from values import with_bounds

from ros2_ident.gap.diagnose import diagnose
from ros2_ident.identify.data import Data
from ros2_ident.identify.run import identify
from ros2_ident.report.schema import from_mapping, to_mapping
from ros2_ident.words import verdict as words


def with_more(data: Data, more: np.ndarray) -> Data:
    (first,) = data.datasets
    return replace(data, datasets=(replace(first, effort=first.effort + more),))


def held(found, low: str, high: str) -> int:
    """Return how many intervals hold the truth."""
    return sum(
        getattr(p, low) <= AXIS_TRUTH[p.name.rpartition('.')[2]] <= getattr(p, high)
        for p in found.parameters
    )


def test_small_imperfections_widen_the_intervals_that_hold_the_truth():
    machine, data = axis(), axis_data()
    rate = data.datasets[0].command_velocity / np.abs(data.datasets[0].command_velocity).max()
    position = data.datasets[0].command_position
    alone = both = 0
    for seed in range(6):
        size = 0.4 * machine.effort_noise * np.random.default_rng(seed).standard_normal(3)
        # Friction that drops with the speed, drag, a ripple: no more than the noise.
        small = (
            size[0] * np.exp(-np.abs(rate) / 0.2) * np.sign(rate)
            + size[1] * rate * np.abs(rate)
            + size[2] * np.sin(2.0 * np.pi * position / 0.02)
        )
        found = identify(machine, with_more(data, small), settings=QUICK, seed=3)
        alone += held(found, 'noise_low', 'noise_high')
        both += held(found, 'low', 'high')
        again = from_mapping(to_mapping(found), Path('x'))
        assert again.parameters[0].noise_low == pytest.approx(found.parameters[0].noise_low)
    assert alone <= 15
    assert both >= 22


def test_a_perfect_model_has_the_intervals_of_noise():
    found = identified(3)
    for p in found.parameters:
        assert p.low <= p.noise_low < p.noise_high <= p.high
        assert p.high - p.low < 1.6 * (p.noise_high - p.noise_low), p.name


def test_a_diagnosis_reports_the_parameters_of_an_identification():
    found = identify(axis(), axis_data(), seed=3)
    also = diagnose(axis(), axis_data().datasets, seed=3)
    assert (also.effect, also.held_out) == ('none', 'blocks')
    for p in found.parameters:
        q, half = also.parameters[p.name], 0.5 * (p.high - p.low)
        assert q.value == pytest.approx(p.value, abs=0.1 * half), p.name
        assert (q.low, q.high) == pytest.approx((p.low, p.high), abs=0.3 * half), p.name


def test_only_a_bound_that_keeps_the_gap_open_is_told():
    """A force that ends 0.1 N short of its value leaves hardly a thing of what friction leaves."""
    near = {'viscous_friction': (0.0, 100.0, 'N s/m'), 'constant_force': (-2.9, -2.5, 'N')}
    machine = with_bounds(axis(), {**axis().bounds, **near})
    found = diagnose(machine, axis_data().datasets, seed=3)
    assert found.parameters['emps_axis.constant_force'].end
    (told,) = words.at_bounds(found)
    assert told.startswith('emps_axis.viscous_friction lies at a bound of the machine file')


def at_an_even_speed(seed: int) -> Data:
    """Return 16 s of the axis at one speed, held by a PI controller against a ripple."""
    rng, cycle = np.random.default_rng(seed), 0.004
    time = np.arange(4000) * cycle
    strays, effort = np.zeros_like(time), np.full_like(time, 27.0)
    for frequency in rng.uniform(0.4, 4.0, 6):
        s = 2j * np.pi * frequency
        pushed = 3.0 * np.exp(s * time + 2j * np.pi * rng.uniform())
        answer = -pushed / (95.0 * s**2 + 4e3 * s + 4e4)
        strays += answer.real
        effort += (95.0 * s**2 * answer + pushed).real
    position = 0.05 * time + strays + 1e-7 * rng.standard_normal(time.size)
    effort += 0.2 * rng.standard_normal(time.size)
    (first,) = axis_data().datasets
    streams = {'position': position[None], 'velocity': None, 'effort': effort[None]}
    unknown = {'command_position': None, 'command_velocity': None, 'goal': None}
    return replace(axis_data(), datasets=(replace(first, cycle=cycle, **unknown, **streams),))


def test_a_controller_that_holds_a_speed_against_a_ripple_is_no_mass():
    bounds = {'moving_mass': (0.0, 5000.0)}
    found = identify(axis(), at_an_even_speed(1), bounds=bounds, settings=QUICK)
    mass = next(p for p in found.parameters if p.name.endswith('moving_mass'))
    assert mass.noise_low > 95.0
    assert mass.low <= 95.0 <= mass.high
