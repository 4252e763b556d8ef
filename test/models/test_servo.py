# SPDX-License-Identifier: Apache-2.0
"""The servo's compiled simulation against its slow twin, and what a log without effort needs."""

from dataclasses import replace

import numpy as np
import pytest

from checks.reference.effects import Effect
from checks.reference.servo import servo_plant
from checks.reference.simulate import simulate
from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.models import EffectAt, machine_from_mapping, make_model
from ros2_ident.models.trials import trials
from ros2_ident.recording import Dataset

DRIVE = {
    'supply_voltage': 7.4,
    'torque_constant': 0.37,
    'resistance': 3.1,
    'armature': 1.8e-3,
    'load_mass': 0.45,
    'load_length': 0.1,
    'arm_mass': 0.06,
    'load_inertia': 4e-4,
    'load_angle': -0.03,
    'coulomb_regularisation': 0.02,
}
CONTROLLER = {'cycle': 1e-3, 'position_gain': 0.9, 'velocity_gain': 0.02, 'duty_limit': 0.4}
FRICTION = {
    'coulomb_torque': [0.0, 0.1, 'N m'],
    'viscous_torque': [0.0, 0.05, 'N m s/rad'],
}
GEAR = {
    'gear_stiffness': [10.0, 400.0, 'N m/rad'],
    'gear_damping_ratio': [0.0, 1.0, '1'],
}
TRUTH = {
    'coulomb_torque': 0.011,
    'viscous_torque': 0.004,
    'gear_stiffness': 90.0,
    'gear_damping_ratio': 0.1,
}


def machine(parameters=FRICTION, controller=CONTROLLER, **more):
    return machine_from_mapping(
        {
            'machine': 'servo',
            'drives': ['joint'],
            'geometry': {'gravity': 9.81},
            'drive': dict(DRIVE),
            'controller': dict(controller),
            'parameters': dict(parameters),
            **more,
        }
    )


def set_points(seconds: float = 1.5) -> tuple[np.ndarray, np.ndarray]:
    time = np.arange(round(seconds / 1e-3)) * 1e-3
    wave, rate = 2.0 * np.pi * 0.9, 2.0 * np.pi * 2.3
    position = 0.9 * np.sin(wave * time) + 0.35 * (1.0 - np.cos(rate * time))
    velocity = 0.9 * wave * np.cos(wave * time) + 0.35 * rate * np.sin(rate * time)
    return position[None], velocity[None]


def beside(one, effects=(), values=(), unmodelled=(), quantity='position', release=None):
    """Return the twin's log and that of the compiled simulation, of the same machine."""
    position, velocity = set_points()
    truth = {name: TRUTH[name] for name in one.bounds}
    start = (np.array([0.1]), np.array([0.0]))
    plant = servo_plant(one, truth, 0.0 if release is None else release * 1e-3)
    log = simulate(plant, position, velocity, unmodelled, start=start)
    seen = np.full_like(position, np.nan)
    # Where the encoder stands at first; that many samples tell that it rests.
    seen[:, :12] = 0.1
    data = Dataset(
        one.drives, 1e-3, 0, position, velocity, seen, None, log.effort, released=release
    )
    model = make_model(one, data, effects=effects, quantities=(quantity,))
    theta = np.array([[*truth.values(), *values]])
    model.substeps = 2 * int(model.work(theta)[0])
    out = model.simulate(theta)[0]
    return log, out


def test_the_kernel_agrees_with_its_twin_also_where_the_duty_is_limited() -> None:
    log, out = beside(machine())
    assert np.abs(log.effort).max() == CONTROLLER['duty_limit']
    assert np.ptp(log.carriage) > 0.8
    assert np.abs(out - log.carriage).max() < 1e-6


def test_an_elastic_gear_is_read_behind_it() -> None:
    log, out = beside(machine({**FRICTION, **GEAR}))
    assert np.abs(log.carriage - log.position).max() > 2e-3
    assert np.abs(out - log.carriage).max() < 2e-6


def test_a_motor_that_is_switched_off_neither_drives_nor_brakes() -> None:
    log, out = beside(machine(), release=700)
    assert not log.effort[0, 700:].any()
    assert np.ptp(log.carriage[0, 700:]) > 0.1
    assert np.abs(out - log.carriage).max() < 1e-6


@pytest.mark.parametrize(
    ('effect', 'values', 'theta', 'apart'),
    [
        ('directional_load_friction', {'motor': 0.2, 'load': 0.1}, (0.2, 0.1), 1e-6),
        (
            'stribeck_load_friction',
            {'motor': 0.15, 'load': 0.25, 'speed': 1.5},
            (0.15, 0.25, 1.5),
            1e-6,
        ),
        # It jumps where the motor begins to carry the load.
        (
            'quadratic_load_friction',
            {'motor': 0.7, 'load': 0.4, 'speed': 2.0},
            (0.7, 0.4, 2.0),
            4e-6,
        ),
        ('stribeck', {'torque': 0.02, 'speed': 1.0}, (0.02, 1.0), 1e-6),
        (
            'end_stop',
            {'stiffness': 3e4, 'lower': -0.6, 'upper': 0.8},
            (3e4, -0.6, 0.8),
            1e-4,
        ),
    ],
)
def test_an_effect_acts_as_in_the_twin(effect, values, theta, apart) -> None:
    unmodelled = (Effect(effect, ('joint',), values),)
    at = (EffectAt(effect, 'joint'),)
    log, out = beside(machine(), at, theta, unmodelled)
    plain, _ = beside(machine())
    assert np.abs(log.carriage - plain.carriage).max() > 5e-3
    assert np.abs(out - log.carriage).max() < apart


def test_backlash_lies_between_motor_and_encoder() -> None:
    one = machine({**FRICTION, **GEAR})
    unmodelled = (Effect('backlash', ('joint',), {'width': 0.02}),)
    log, out = beside(one, (EffectAt('backlash', 'joint'),), (0.02,), unmodelled)
    plain, _ = beside(one)
    assert np.abs(log.carriage - plain.carriage).max() > 5e-3
    assert np.abs(out - log.carriage).max() < 2e-5


@pytest.mark.parametrize(
    ('unit', 'of'),
    [
        ('duty', lambda u, w: u),
        ('V', lambda u, w: 7.4 * u),
        ('A', lambda u, w: (7.4 * u - 0.37 * w) / 3.1),
        ('N m', lambda u, w: 0.37 * (7.4 * u - 0.37 * w) / 3.1),
    ],
)
def test_the_log_holds_duty_voltage_current_or_torque(unit, of) -> None:
    one = machine(effort_unit=unit)
    log, out = beside(one, quantity='effort')
    np.testing.assert_allclose(out, of(log.torque, log.velocity), atol=2e-6)
    model = make_model(one, _data(one), quantities=('effort',))
    assert model.outputs[0].unit == unit


def test_an_end_stop_is_looked_for_where_the_joint_came_to_not_where_it_was_sent() -> None:
    seen = np.clip(set_points()[0], -0.5, 0.4)
    one = machine()
    at = EffectAt('end_stop', 'joint')
    model = make_model(one, _data(one, position=seen), effects=[at])
    starts = np.array([phi for group in trials(at, model) for phi in group])
    assert starts[:, 1].max() == pytest.approx(-0.32)
    assert starts[:, 2].min() == pytest.approx(0.22)


def _data(one, **changed) -> Dataset:
    position, velocity = set_points()
    data = Dataset(one.drives, 1e-3, 0, position, velocity, position, None, position)
    return replace(data, **changed)


def test_constants_that_are_identified_reach_the_motor() -> None:
    position, velocity = set_points()
    sought = {'resistance': [1.0, 9.0, 'Ohm'], 'load_mass': [0.1, 1.0, 'kg'], **FRICTION}
    one = machine(sought)
    model = make_model(one, _data(one))
    theta = np.array([[3.1, 0.45, 0.011, 0.004], [5.0, 0.45, 0.011, 0.004]])
    named = [p.name for p in model.parameters]
    assert named == [f'joint.{name}' for name in sought]
    first, second = model.simulate(theta)
    plain = make_model(machine(), _data(machine())).simulate(theta[:1, 2:])[0]
    np.testing.assert_array_equal(first, plain)
    assert np.abs(second - first).max() > 0.05


@pytest.mark.filterwarnings('error')
def test_a_motor_without_resistance_diverges_without_a_word_of_numpy() -> None:
    one = machine({'resistance': [0.0, 9.0, 'Ohm'], **FRICTION})
    model = make_model(one, _data(one))
    none, some = model.simulate(np.array([[0.0, 0.011, 0.004], [3.1, 0.011, 0.004]]))
    assert np.isfinite(some).all()
    assert not np.isfinite(none).all()


def test_a_servo_without_a_set_point_is_refused() -> None:
    one = machine()
    with pytest.raises(IdentError, match='simulated from its set-points') as caught:
        make_model(one, _data(one, command_position=None, command_velocity=None))
    assert caught.value.code == ErrorCode.MISSING_STREAM
