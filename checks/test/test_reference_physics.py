# SPDX-License-Identifier: Apache-2.0
"""The reference's physics against hand calculation, conservation laws and other integrators."""

from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from checks.reference import layout as at
from checks.reference.effects import Effect
from checks.reference.rest import at_rest, platform_at
from checks.reference.simulate import simulate, with_effects
from checks.reference.tripod import simulate_tripod, tripod_plant
from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.models import load_machine
from ros2_ident.simulate.motions import draw_motion

ROOT = Path(__file__).parents[2]
TRUTH = {
    'measurement_delay': 0.0249,
    'gear_stiffness': 2.32e5,
    'gear_damping_ratio': 0.396,
    'tool_mass': 1.762,
    'drive_inertia': 8.9e-5,
    'coulomb_torque': 0.08,
    'viscous_torque': 0.03,
}
FRICTIONLESS = TRUTH | {'coulomb_torque': 0.0, 'viscous_torque': 0.0, 'gear_damping_ratio': 0.0}
G = 9.81
GEAR = 2.0 * np.pi / 0.08


@pytest.fixture(scope='module')
def machine():
    return load_machine(ROOT / 'config' / 'tripod.yaml')


def without_controller(plant):
    """The controllers hold the torque they start with."""
    plant.drive[:, [at.VELOCITY_GAIN, at.INTEGRAL_GAIN]] = 0.0
    return plant


def energy(log, plant, hold):
    """Kinetic, elastic, gravitational and frame energy less the work of constant motor torques."""
    shared, drive = plant.shared, plant.drive

    total = np.zeros(log.position.shape[1])
    m_r = shared[at.ROD_MASS]
    v_p = log.platform_velocity
    tool = shared[at.TOOL_MASS]
    total += 0.5 * tool * np.sum(v_p**2, axis=0) + tool * G * log.platform[2]
    for i in range(3):
        stretch = log.position[i] - (log.carriage[i] - log.frame)
        v_c = log.carriage_velocity[i]
        mass = drive[i, at.CARRIAGE_MASS]
        total += (
            0.5 * drive[i, at.MOTOR_MASS] * log.velocity[i] ** 2 - GEAR * hold[i] * log.position[i]
        )
        total += 0.5 * mass * v_c**2 + mass * G * log.carriage[i]
        total += 0.5 * drive[i, at.STIFFNESS] * stretch**2
        # A uniform rod: its velocity is linear, so Gauss's rule of two points is exact.
        for u in 0.5 + np.array([-0.5, 0.5]) / np.sqrt(3.0):
            v = np.stack([u * v_p[0], u * v_p[1], (1.0 - u) * v_c + u * v_p[2]])
            total += 0.25 * m_r * np.sum(v**2, axis=0)
        total += 0.5 * m_r * G * (log.carriage[i] + log.platform[2])
        total += drive[i, at.CONSTANT_FORCE] * (log.carriage[i] - log.frame)
    total += 0.5 * shared[at.FRAME_MASS] * log.frame_velocity**2
    total += 0.5 * shared[at.FRAME_STIFFNESS] * log.frame**2 - shared[at.FRAME_PRELOAD] * log.frame
    return total


class Rods:
    """Uniform rods of 0.1 kg."""

    def apply(self, plant):
        plant.shared[at.ROD_MASS] = 0.1
        plant.shared[[at.ROD_AT_CARRIAGE, at.ROD_AT_PLATFORM]] = 1.0 / 3.0
        plant.shared[[at.ROD_BETWEEN, at.ROD_CENTRE]] = 1.0 / 6.0, 0.5


RODS = Rods()
FRAME = Effect('frame_resonance', ('all',), {'mass': 25.0, 'frequency': 14.0, 'damping': 0.0})


@pytest.mark.parametrize(
    'effects', [(), (RODS,), (RODS, FRAME)], ids=['plain', 'rods', 'rods, frame']
)
def test_energy_is_kept_without_friction_and_controller(machine, effects):
    # Loads that the constant motor torques do not know let the machine fall over its rods.
    loads = [
        Effect('constant_force', (name,), {'force': force})
        for name, force in zip(machine.drives, (5.0, -3.0, 2.0), strict=True)
    ]
    plant = without_controller(tripod_plant(machine, FRICTIONLESS))
    start = np.array([0.45, 0.50, 0.47])
    real = with_effects(plant, [*effects, *loads])
    hold = at_rest(real, start, plant)[1][:, 0]
    position = np.repeat(start[:, None], 600, axis=1)
    log = simulate(plant, position, 0.0 * position, [*effects, *loads])
    kept = energy(log, real, hold)
    kinetic = 0.5 * TRUTH['tool_mass'] * np.max(np.sum(log.platform_velocity**2, axis=0))
    assert kinetic > 0.05
    assert np.ptp(kept) < 1e-9 * kinetic


def test_rods_keep_their_length(machine):
    motion = draw_motion('multi_point', machine, 2.0, 1)
    log = simulate_tripod(machine, TRUTH, motion.position, motion.velocity)
    for i, azimuth in enumerate(machine.numbers('rail_azimuth')):
        foot = np.stack(
            [0.3 * np.cos(azimuth) + 0.0 * log.frame, 0.3 * np.sin(azimuth) + 0.0 * log.frame]
        )
        rod = np.vstack([log.platform[:2] - foot, log.platform[2] - log.carriage[i]])
        assert np.max(np.abs(np.linalg.norm(rod, axis=0) - 0.6)) < 1e-12
    assert log.rod_error < 1e-12


def test_symmetric_pose_carries_a_third_of_the_tool_each(machine):
    position = np.full((3, 2), 0.47)
    log = simulate_tripod(machine, TRUTH, position, 0.0 * position)
    hold = (1.2 + TRUTH['tool_mass'] / 3.0) * G / GEAR
    stretch = hold * GEAR / TRUTH['gear_stiffness']
    assert log.position[:, 0] == pytest.approx(0.47 + stretch, abs=1e-13)
    # The controller sees the motor ahead of its set-point: e_v = -k_p stretch, in P and in I.
    first = hold - 60.0 * stretch * (4.5 + 250.0 * 5e-4)
    assert log.torque[:, 0] == pytest.approx(first, abs=1e-12)
    height = 0.47 - np.sqrt(0.6**2 - 0.3**2)
    assert log.platform[:, 0] == pytest.approx([0.0, 0.0, height], abs=1e-12)


def test_any_pose_carries_the_whole_weight(machine):
    plant = tripod_plant(machine, TRUTH)
    plant = with_effects(plant, [RODS])
    plant.settled = True
    memory = at_rest(plant, np.array([0.42, 0.50, 0.47]), plant)[1]
    weight = (3 * 1.2 + TRUTH['tool_mass'] + 3 * 0.1) * G
    assert np.sum(memory[:, 0]) * GEAR == pytest.approx(weight, rel=1e-12)


def test_forward_kinematics_inverts_the_rail_formula(machine):
    plant = tripod_plant(machine, TRUTH)
    point = np.array([0.05, -0.03, -0.1])
    azimuth = np.array(machine.numbers('rail_azimuth'))
    foot = 0.3 * np.stack([np.cos(azimuth), np.sin(azimuth)])
    carriage = point[2] + np.sqrt(0.36 - np.sum((point[:2, None] - foot) ** 2, axis=0))
    assert platform_at(carriage, plant.shared, plant.drive) == pytest.approx(point, abs=1e-13)
    with pytest.raises(IdentError, match='rods do not reach') as caught:
        platform_at(np.array([0.0, 1.3, 0.5]), plant.shared, plant.drive)
    assert caught.value.code is ErrorCode.BAD_VALUES


def test_settled_machine_stays_at_rest(machine):
    plant = without_controller(tripod_plant(machine, TRUTH))
    plant.settled = True
    drives = tuple(machine.drives)
    effects = [
        RODS,
        Effect('cable_spring', drives, {'stiffness': 60.0, 'place': 0.44}),
        Effect('constant_force', drives[:1], {'force': 7.0}),
        Effect('torque_ripple', drives[1:], {'torque': 0.05, 'order': 2.0, 'phase': 1.0}),
        Effect('transmission_eccentricity', drives, {'amplitude': 1e-4, 'phase': 2.0}),
        Effect('backlash', drives[2:], {'width': 2e-4}),
        Effect('rail_radius_error', ('all',), {'length': 4e-3}),
        Effect('frame_resonance', ('all',), {'mass': 25.0, 'frequency': 14.0, 'damping': 0.05}),
    ]
    position = np.repeat(np.array([[0.45], [0.50], [0.47]]), 400, axis=1)
    log = simulate(plant, position, 0.0 * position, effects)
    assert np.max(np.abs(log.velocity)) < 1e-9
    assert np.max(np.abs(log.frame)) < 1e-11


def test_tighter_steps_converge(machine):
    motion = draw_motion('multi_point', machine, 1.5, 2)
    logs = {
        rtol: simulate_tripod(
            machine, TRUTH, motion.position, motion.velocity, (), rtol, 0.1 * rtol
        )
        for rtol in (1e-5, 1e-7, 1e-9, 1e-12)
    }
    errors = [
        np.sqrt(np.mean((logs[r].torque - logs[1e-12].torque) ** 2)) for r in (1e-5, 1e-7, 1e-9)
    ]
    assert errors[0] > errors[1] > errors[2]
    assert errors[2] < 1e-8


def minimal_coordinates(machine, parameters, held):
    """The tripod in coordinates (z, p), written apart from the package, for scipy."""
    azimuth = np.array(machine.numbers('rail_azimuth'))
    foot = 0.3 * np.stack([np.cos(azimuth), np.sin(azimuth)], axis=1)
    m_e = parameters['drive_inertia'] * GEAR**2
    c = parameters['gear_stiffness']
    d = 2.0 * parameters['gear_damping_ratio'] * np.sqrt(c * m_e * 1.2 / (m_e + 1.2))

    def derivative(time, x):
        z, p, zd, pd = np.split(x, 4)
        across = p[:2] - foot
        rise = np.sqrt(0.36 - np.sum(across**2, axis=1))
        jacobian = np.column_stack([-across / rise[:, None], np.ones(3)])
        sd = jacobian @ pd
        rise_rate = -across @ pd[:2] / rise
        turning = (-pd[:2] / rise[:, None] + across * (rise_rate / rise**2)[:, None]) @ pd[:2]
        force = c * (z - p[2] - rise) + d * (zd - sd)
        friction = (
            parameters['coulomb_torque'] * np.tanh(zd / 5e-3) + parameters['viscous_torque'] * zd
        )
        zdd = (GEAR * (held - friction) - force) / m_e
        mass = parameters['tool_mass'] * np.eye(3) + 1.2 * jacobian.T @ jacobian
        load = jacobian.T @ (force - 1.2 * G - 1.2 * turning) - [
            0.0,
            0.0,
            parameters['tool_mass'] * G,
        ]
        return np.concatenate([zd, pd, zdd, np.linalg.solve(mass, load)])

    return derivative


def test_other_coordinates_and_scipy_agree(machine):
    motion = draw_motion('multi_point', machine, 1.2, 4)
    log = simulate_tripod(machine, TRUTH, motion.position, motion.velocity)
    first, cycles = 1200, 60  # well into the first move
    x = np.concatenate(
        [
            part[:, first]
            for part in (log.position, log.platform, log.velocity, log.platform_velocity)
        ]
    )
    for k in range(first, first + cycles):
        derivative = minimal_coordinates(machine, TRUTH, log.torque[:, k])
        x = solve_ivp(derivative, (0.0, 5e-4), x, 'DOP853', rtol=1e-12, atol=1e-13).y[:, -1]
    end = first + cycles
    assert np.max(np.abs(log.velocity[:, end])) > 0.05
    assert x[:3] == pytest.approx(log.position[:, end], abs=1e-11)
    assert x[3:6] == pytest.approx(log.platform[:, end], abs=1e-11)
    assert x[6:9] == pytest.approx(log.velocity[:, end], abs=1e-8)
    assert x[9:] == pytest.approx(log.platform_velocity[:, end], abs=1e-8)


def test_heavy_stiff_frame_is_no_frame(machine):
    motion = draw_motion('multi_point', machine, 1.0, 5)
    frame = Effect('frame_resonance', ('all',), {'mass': 1e7, 'frequency': 30.0, 'damping': 0.5})
    plain = simulate_tripod(machine, TRUTH, motion.position, motion.velocity)
    framed = simulate_tripod(machine, TRUTH, motion.position, motion.velocity, [frame])
    assert np.max(np.abs(plain.torque - framed.torque)) < 1e-5
