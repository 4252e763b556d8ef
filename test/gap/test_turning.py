# SPDX-License-Identifier: Apache-2.0
"""A joint that turns: what is looked for in metres is looked for in radians, and named in them."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from checks.reference.axis import simulate_axis
from checks.reference.effects import Effect
from ros2_ident.gap.diagnose import diagnose
from ros2_ident.gap.result import Diagnosis
from ros2_ident.machine.machine import Machine
from ros2_ident.models import EffectAt, machine_from_mapping, make_model
from ros2_ident.models.trials import orders_shown
from ros2_ident.recording import Dataset
from ros2_ident.words.finding import where
from ros2_ident.words.verdict import advice, sentence

CYCLE = 1e-3
NOISE = 0.01
PLAIN = {
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
JOINT = machine_from_mapping(PLAIN)
TRUTH = {'moving_mass': 0.1, 'coulomb_friction': 0.3, 'viscous_friction': 0.1}


def recording(seed: int, *effects: Effect, rounded: float = 0.0) -> Dataset:
    rng = np.random.default_rng(seed)
    time = np.arange(6000) * CYCLE
    position = np.zeros_like(time)
    for _ in range(4):
        rate, phase, size = rng.uniform(0.8, 6.0), rng.uniform(0.0, 6.28), rng.uniform(0.1, 0.5)
        position += size * (np.sin(rate * time + phase) - np.sin(phase))
    ramp = np.clip(time / 0.5, 0.0, 1.0)
    position *= ramp**3 * (10.0 - 15.0 * ramp + 6.0 * ramp**2)
    velocity = np.gradient(position, CYCLE)
    log = simulate_axis(JOINT, TRUTH, position[None], velocity[None], effects)
    effort = log.effort + NOISE * rng.standard_normal(log.effort.shape)
    seen = rounded * np.round(log.position / rounded) if rounded else log.position
    return Dataset(
        JOINT.drives, CYCLE, 0, position[None], velocity[None], seen, log.velocity, effort
    )


def diagnosed(name: str, values: dict[str, float]) -> Diagnosis:
    effect = Effect(name, JOINT.drives, values)
    return diagnose(JOINT, [recording(1, effect)], [recording(2, effect)], seed=1)


TIME = np.arange(9000) * 2e-3
EVEN = 2.0 * np.arcsin(0.99 * np.sin(TIME))


def turned(
    cogging: Callable[[np.ndarray], np.ndarray], position: np.ndarray = EVEN
) -> tuple[Machine, Dataset]:
    """Return a motor without a load, and its log without set-points."""
    speed = np.gradient(position, 2e-3)
    effort = cogging(position) + 0.05 * np.tanh(speed / 0.02) + 0.02 * np.gradient(speed, 2e-3)
    effort += NOISE * np.random.default_rng(1).standard_normal(TIME.size)
    controller = {'cycle': 2e-3, 'torque_limit': 40.0}
    motor = machine_from_mapping({**PLAIN, 'controller': controller})
    return motor, Dataset(JOINT.drives, 2e-3, 0, None, None, position[None], None, effort[None])


def test_all_orders_of_a_motor_that_does_nothing_but_cog_are_found() -> None:
    motor, data = turned(lambda q: 0.5 * np.sin(9.0 * q + 0.4) + 0.3 * np.sin(30.0 * q + 2.0))
    found = diagnose(motor, [data], seed=1)
    names = [f'torque_ripple{n}' for n in ('', '_2')]
    assert [found.effect, *(at.effect for at in found.also)] == names, sentence(found)
    orders = [found.parameters[f'joint.{name}.order'].value for name in names]
    assert orders == pytest.approx([9.0, 30.0], abs=0.02)
    assert 'bound' not in ' '.join([sentence(found), *advice(found)])


def test_orders_that_the_band_hides_are_not_looked_for() -> None:
    motor, data = turned(np.sin)
    at = EffectAt('torque_ripple', 'joint')
    nominal = make_model(motor.with_constants(bandwidth=5.0), data)
    most, model = nominal.highest_order('joint'), nominal.extended([at])
    assert most < model.scaled(at)[-1].high
    low, high = (
        model.simulate(np.array([[0.1, 0.3, 0.1, 0.1, 0.0, n]]))[0] for n in (9.0, 2.0 * most)
    )
    plain = model.simulate(np.array([[0.1, 0.3, 0.1, 0.0, 0.0, 1.0]]))[0]
    shown, hidden = (np.std((x - plain)[np.isfinite(model.measured)]) for x in (low, high))
    # A hundredth of its power.
    assert shown > 0.05 and hidden < 0.1 * shown


@pytest.mark.parametrize(('size', 'seen'), [(0.05, True), (0.0, False)])
def test_an_order_shows_that_an_uneven_motion_shows_in_others_too(size: float, seen: bool) -> None:
    """Most of the log is of a quarter of the stroke, where orders by the dozen look alike."""
    position = 0.2 * np.sin(2.5 * TIME) + 1.4 * np.clip((TIME - 12.0) / 6.0, 0.0, 1.0)
    motor, data = turned(lambda q: size * np.sin(44.76 * q + 0.4), position)
    at = EffectAt('torque_ripple', 'joint')
    model = make_model(motor, data).extended([at])
    kept, nominal = model.restricted(np.isfinite(model.measured)), np.array([[0.02, 0.05, 0.0]])

    def residual(points: np.ndarray) -> np.ndarray:
        return kept.residuals(np.hstack([nominal.repeat(len(points), axis=0), points]))

    left = residual(np.array([[0.0, 0.0, 1.0]]))[0]
    own, nothing = np.ones(left.size, bool), np.empty((left.size, 0))
    (orders,) = orders_shown(
        model, [at], [own], lambda x: residual(x) - left, left, nothing, clear=True
    )
    assert bool(orders) is seen
    # Between two orders that are looked at.
    turns = np.ptp(position) / (2.0 * np.pi)
    assert all(abs(n - 44.76) < 0.5 / turns for n in orders[:1])


def test_a_ripple_comes_round_once_in_the_stroke() -> None:
    motor, data = turned(np.sin)
    short = replace(data, position=0.1 * data.position)
    for log in (data, short):
        order = make_model(motor, log).scaled(EffectAt('torque_ripple', 'joint'))[-1]
        assert order.low * np.ptp(log.position) == pytest.approx(2.0 * np.pi)


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
    found = diagnosed('encoder_quantisation', {'step': 1.5e-3})
    assert (found.effect, found.where) == ('encoder_quantisation', JOINT.drives)
    step = found.parameters['joint.encoder_quantisation.step']
    assert step.unit == 'rad' and step.value == pytest.approx(1.5e-3, rel=0.01)
    assert 'reads its position in steps of 0.0015 rad' in sentence(found)
    assert ' um' not in sentence(found)


def test_steps_in_which_a_log_is_written_are_not_its_controllers() -> None:
    one, other = (recording(seed, rounded=4e-4) for seed in (1, 2))
    found = diagnose(JOINT, [one], [other], seed=1)
    assert found.effect == 'none', sentence(found)
