# SPDX-License-Identifier: Apache-2.0
"""The reference's controllers, its log, and the axis, against the written law."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from checks.reference.axis import simulate_axis
from checks.reference.simulate import late
from checks.reference.tripod import simulate_tripod
from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.models import load_machine
from ros2_ident.simulate.motions import draw_motion

ROOT = Path(__file__).parents[2]
TRUTH = {
    'gear_stiffness': 2.0e5,
    'gear_damping_ratio': 0.4,
    'tool_mass': 1.5,
    'drive_inertia': 9.0e-5,
    'coulomb_torque': 0.06,
    'viscous_torque': 0.03,
}
EMPS = {
    'moving_mass': 95.1,
    'viscous_friction': 203.5,
    'coulomb_friction': 20.4,
    'constant_force': -3.16,
}


def machine_of(name):
    return load_machine(ROOT / 'config' / f'{name}.yaml')


def test_tripod_law_recomputed_from_the_log():
    machine = machine_of('tripod')
    motion = draw_motion('multi_point', machine, 1.5, 1)
    log = simulate_tripod(machine, TRUTH, motion.position, motion.velocity)
    error = 60.0 * (motion.position - log.position) + motion.velocity - log.velocity
    integral = 250.0 * 5e-4 * np.cumsum(error, axis=1)
    start = log.torque[:, :1] - 4.5 * error[:, :1] - integral[:, :1]
    assert log.torque == pytest.approx(start + integral + 4.5 * error, abs=1e-10)
    assert start[:, 0] == pytest.approx((1.2 + 0.5) * 9.81 * 0.08 / (2.0 * np.pi), abs=1e-12)


def test_torque_is_limited():
    machine = machine_of('tripod').with_constants(torque_limit=0.3)
    motion = draw_motion('multi_point', machine, 1.5, 1)
    log = simulate_tripod(machine, TRUTH, motion.position, motion.velocity)
    assert np.max(np.abs(log.torque)) == 0.3


def test_log_is_late_and_linear_between_cycles():
    torque = np.array([[1.0, 3.0, 2.0, 6.0], [0.0, 1.0, 2.0, 3.0]])
    out = late(torque, np.array([0.0, 0.75]), 0.5)
    assert out[0] == pytest.approx(torque[0])
    assert out[1] == pytest.approx([0.0, 0.0, 0.5, 1.5])


def test_drives_may_differ():
    machine = machine_of('tripod')
    motion = draw_motion('multi_point', machine, 1.0, 1)
    same = simulate_tripod(machine, TRUTH, motion.position, motion.velocity)
    other = simulate_tripod(
        machine, TRUTH | {'drive_2.coulomb_torque': 0.12}, motion.position, motion.velocity
    )
    change = np.sqrt(np.mean((other.effort - same.effort) ** 2, axis=1))
    assert change[1] > 0.01
    assert max(change[0], change[2]) < 0.2 * change[1]


def test_emps_law_recomputed_from_the_log():
    machine = machine_of('emps')
    motion = draw_motion('reversals', machine, 2.0, 3)
    log = simulate_axis(machine, EMPS, motion.position, motion.velocity)
    q = log.position[0]
    filtered = 0.5 * (q[1:] + q[:-1])
    speed = np.diff(filtered) / 1e-3
    force = 8557.4257475 * (160.18 * (motion.position[0, 2:] - q[2:]) - speed)
    assert np.clip(force, -351.5065, 351.5065) == pytest.approx(log.torque[0, 2:], abs=1e-7)


def test_rigid_axis_is_one_mass():
    machine = machine_of('emps')
    motion = draw_motion('multi_point', machine, 3.0, 3)
    log = simulate_axis(machine, EMPS, motion.position, motion.velocity)
    v = log.velocity[0]
    # Impulse over each cycle: the force is held, friction taken at the mean speed.
    middle = 0.5 * (v[1:] + v[:-1])
    net = log.torque[0, :-1] + 3.16 - 203.5 * middle - 20.4 * np.tanh(middle / 1e-3)
    moving = np.minimum(np.abs(v[1:]), np.abs(v[:-1])) > 0.01
    assert moving.sum() > 500
    assert np.diff(v)[moving] * 95.1 == pytest.approx(net[moving] * 1e-3, abs=2e-6)


def test_axis_begins_in_motion():
    machine = machine_of('emps')
    time = np.arange(500) * 1e-3
    target = 0.05 + 0.1 * time
    still = {'moving_mass': 95.1}
    lag = 0.1 / 160.18  # a P controller on position follows a ramp at a distance of v / k_p
    start = (np.array([0.05 - lag]), np.array([0.1]))
    log = simulate_axis(machine, still, target[None], 0.0 * target[None], start=start)
    # The speed filter sees the past of a steady motion, so nothing jerks at the start.
    assert log.velocity[0] == pytest.approx(0.1, abs=1e-9)
    assert np.max(np.abs(log.torque)) < 1e-3


def test_elastic_axis_hangs_in_its_gear():
    tripod = machine_of('tripod')
    constants = {key: each[:1] for key, each in tripod.constants.items()}
    machine = replace(tripod, kind='linear_axis', drives=('axis',), constants=constants)
    parameters = {key: TRUTH[key] for key in TRUTH if key != 'tool_mass'}
    position = np.full((1, 3), 0.4)
    log = simulate_axis(machine, parameters, position, 0.0 * position)
    assert log.position[0, 0] == pytest.approx(0.4 + 1.2 * 9.81 / 2.0e5, abs=1e-13)
    assert log.carriage[0, 0] == 0.4


@pytest.mark.parametrize(
    ('change', 'code', 'text'),
    [
        ({'tool_mas': 1.0}, ErrorCode.UNKNOWN_PARAMETER, 'tool_mas is not one of this machine'),
        ({'drive_9.gear_stiffness': 1e5}, ErrorCode.UNKNOWN_PARAMETER, 'drive_9.gear_stiffness'),
    ],
)
def test_unknown_parameters_are_named(change, code, text):
    with pytest.raises(IdentError, match=text) as caught:
        simulate_tripod(
            machine_of('tripod'), TRUTH | change, np.full((3, 2), 0.47), np.zeros((3, 2))
        )
    assert caught.value.code is code


def test_missing_parameter_is_named():
    with pytest.raises(IdentError, match='needs a value of tool_mass'):
        simulate_tripod(machine_of('tripod'), {}, np.full((3, 2), 0.47), np.zeros((3, 2)))


@pytest.mark.parametrize(
    ('position', 'text'),
    [
        (np.full((2, 5), 0.47), 'have to be \\(3, cycles\\)'),
        (np.full((3, 5), np.nan), 'holds NaN'),
    ],
)
def test_bad_set_points_are_named(position, text):
    with pytest.raises(IdentError, match=text) as caught:
        simulate_tripod(machine_of('tripod'), TRUTH, position, np.zeros_like(position))
    assert caught.value.code is ErrorCode.BAD_VALUES
