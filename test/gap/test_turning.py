# SPDX-License-Identifier: Apache-2.0
"""A joint that turns: what is looked for in metres is looked for in radians, and named in them."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from checks.reference.axis import simulate_axis
from checks.reference.effects import Effect
from ros2_ident.effects import CATALOGUE
from ros2_ident.gap.diagnose import diagnose
from ros2_ident.gap.diagnosis import Diagnosis
from ros2_ident.gap.reading import LARGEST
from ros2_ident.machine.units import angular_factor
from ros2_ident.models import EffectAt, load_machine, machine_from_mapping, make_model
from ros2_ident.recording import Dataset
from ros2_ident.words.finding import where
from ros2_ident.words.verdict import advice, sentence

CYCLE = 1e-3
NOISE = 0.01
JOINT = machine_from_mapping(
    {
        'machine': 'linear_axis',
        'drives': ['joint'],
        'drive': {'coulomb_regularisation': 0.02},
        'controller': {
            'cycle': CYCLE,
            'position_gain': 40.0,
            'velocity_gain': 3.0,
            'integral_gain': 100.0,
            'velocity_feedforward': 1.0,
            'torque_limit': 40.0,
        },
        'effort_noise': NOISE,
        'parameters': {
            'moving_mass': [0.01, 1.0, 'kg m^2'],
            'coulomb_friction': [0.0, 2.0, 'N m'],
            'viscous_friction': [0.0, 1.0, 'N m s/rad'],
        },
    }
)
TRUTH = {'moving_mass': 0.1, 'coulomb_friction': 0.3, 'viscous_friction': 0.1}


def recording(seed: int, effect: Effect) -> Dataset:
    rng = np.random.default_rng(seed)
    time = np.arange(6000) * CYCLE
    position = np.zeros_like(time)
    for _ in range(4):
        rate, phase, size = rng.uniform(0.8, 6.0), rng.uniform(0.0, 6.28), rng.uniform(0.1, 0.5)
        position += size * (np.sin(rate * time + phase) - np.sin(phase))
    ramp = np.clip(time / 0.5, 0.0, 1.0)
    position *= ramp**3 * (10.0 - 15.0 * ramp + 6.0 * ramp**2)
    velocity = np.gradient(position, CYCLE)
    log = simulate_axis(JOINT, TRUTH, position[None], velocity[None], [effect])
    effort = log.effort + NOISE * rng.standard_normal(log.effort.shape)
    return Dataset(
        JOINT.drives, CYCLE, 0, position[None], velocity[None], log.position, log.velocity, effort
    )


def diagnosed(name: str, values: dict[str, float], form: str = 'same') -> Diagnosis:
    effect = Effect(name, JOINT.drives, values, form)
    return diagnose(JOINT, [recording(1, effect)], [recording(2, effect)], seed=1)


def test_stribeck_friction_of_half_a_radian_a_second_is_found() -> None:
    found = diagnosed('stribeck', {'torque': 0.4, 'speed': 0.5})
    assert (found.effect, found.where) == ('stribeck', JOINT.drives)
    speed, torque = (found.parameters[f'joint.stribeck.{n}'] for n in ('velocity', 'torque'))
    assert speed.unit == 'rad/s' and speed.value == pytest.approx(0.5, rel=0.1)
    assert torque.unit == 'N m' and torque.value == pytest.approx(0.4, rel=0.1)
    told = ' '.join([sentence(found), *advice(found), *map(where, found.localisation)])
    assert ' m/s' not in told and 'mm' not in told and ' um' not in told


def test_steps_of_an_encoder_of_twelve_bits_are_found() -> None:
    # The controller smooths the speed it reads, as those of coarse encoders do.
    found = diagnosed('encoder_quantisation', {'step': 1.5e-3}, 'other')
    assert (found.effect, found.where) == ('encoder_quantisation', JOINT.drives)
    step = found.parameters['joint.encoder_quantisation.step']
    assert step.unit == 'rad' and step.value == pytest.approx(1.5e-3, rel=0.01)
    assert 'reads its position in steps of 0.0015 rad' in sentence(found)
    assert ' um' not in sentence(found)


def test_numbers_of_a_joint_are_those_of_a_carriage_on_its_lever() -> None:
    factors = [angular_factor(unit) for unit in ('m', 'm/s', '1/m', 'N/m', 'N', 'kg', '1/kg', 's')]
    assert factors == pytest.approx([20, 20, 0.05, 0.0025, 0.05, 0.0025, 400, 1], rel=1e-12)
    assert angular_factor('effort s^2/m^2') == pytest.approx(1.0 / 400.0)
    assert pytest.approx(3e-3) == 20.0 * LARGEST


def test_a_straight_axis_has_the_catalogues_numbers() -> None:
    axis = load_machine(Path(__file__).parents[2] / 'config/emps.yaml')
    still = np.zeros((1, 400))
    data = Dataset(axis.drives, 1e-3, 0, still, still, None, None, still + 7.0)
    model = make_model(axis, data)
    turning = make_model(JOINT, replace(data, names=JOINT.drives))
    for effect in CATALOGUE.values():
        if effect.place == 'all':
            continue
        straight = model.scaled(EffectAt(effect.id, axis.drives[0]))
        turned = turning.scaled(EffectAt(effect.id, 'joint'))
        for p, own, other in zip(effect.parameters, straight, turned, strict=True):
            if 'effort' not in p.unit and p.unit != '1/W':
                assert own == p
            factor = angular_factor(p.unit) if p.unit != '1/W' else 0.05
            numbers = [other.low, other.high, other.neutral, *other.starts]
            expected = [factor * x for x in (own.low, own.high, own.neutral, *own.starts)]
            assert numbers == pytest.approx(expected, rel=1e-12), (effect.id, p.name)
            if p.unit in ('m', 'm/s', '1/m'):
                assert other.unit == p.unit.replace('m', 'rad')
