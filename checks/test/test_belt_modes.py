# SPDX-License-Identifier: Apache-2.0
"""The belt drive's modes against its matrices, eq. 21, by NumPy and SciPy."""

from models.test_belt_drive import candidates, constants_of, MACHINE, TRUTH
import numpy as np
import pytest
from scipy.linalg import expm

from checks.paper.belt import (
    eigenfrequencies,
    eigenfrequencies_over_position,
    matrices,
    step_reference,
)
from checks.reference.belt_drive import belt_forces
from ros2_ident.models.belt_drive.kernels import one_mode_set
from ros2_ident.models.belt_drive.model import BeltDrive


def by_exponential(belt, theta):
    """Return (S, 2, K) as `BeltDrive.simulate`, by the matrix exponential of a sample."""
    gain = belt.constants(theta)[:, 1]
    inertia, stiffness = matrices(belt, theta)
    system = np.zeros((len(theta), 7, 7))
    system[:, :3, 3:6] = np.eye(3)
    system[:, 3:6, :3] = -stiffness / inertia[:, :, None]
    # The set-point is a seventh state that stays constant over the sample.
    system[:, 3, 6] = gain / inertia[:, 0]
    step = expm(system * belt.cycle)
    state = np.zeros((len(theta), 7))
    phi1 = np.empty((belt.reference.size, len(theta)))
    start = belt.reference[0]
    for k, target in enumerate(belt.reference):
        phi1[k], state[:, 6] = start + state[:, 0], target - start
        state = np.einsum('sij,sj->si', step, state)
    return np.stack([phi1.T, gain[:, None] * (belt.reference - phi1.T)], axis=1)


def test_the_matrix_exponential_agrees_with_the_modes():
    belt = BeltDrive(MACHINE, *step_reference())
    theta = candidates(20)
    difference = np.abs(by_exponential(belt, theta) - belt.simulate(theta)).max(axis=(0, 2))
    assert difference[0] < 1e-11
    assert difference[1] < 1e-9


def test_modes_are_eigenvalues_and_weights_add_up():
    belt, theta = BeltDrive(MACHINE, *step_reference()), candidates(50)
    for full, mass, stiffness in zip(belt.constants(theta), *matrices(belt, theta), strict=True):
        square, weight = np.empty(3), np.empty(3)
        assert one_mode_set(full, square, weight)
        root = np.sqrt(mass)
        values, vectors = np.linalg.eigh(stiffness / np.outer(root, root))
        np.testing.assert_allclose(square, values, rtol=1e-12)
        expected = vectors[0] ** 2 * full[1] / (mass[0] * values)
        np.testing.assert_allclose(weight, expected, atol=1e-12)
        assert weight.sum() == pytest.approx(1.0, rel=1e-12)


def test_eigenfrequencies_are_those_of_the_reading():
    belt = BeltDrive(MACHINE, *step_reference())
    np.testing.assert_allclose(eigenfrequencies(belt, TRUTH)[0], [75.4, 272.8, 400.3], atol=0.1)


def test_printed_constants_give_one_hertz():
    machine = MACHINE.with_constants(driving_inertia=1e-2, driven_inertia=1e-2, radius=1e-3)
    first = eigenfrequencies(BeltDrive(machine, *step_reference()), TRUTH)[0, 0]
    assert first == pytest.approx(1.0, abs=0.1)


def test_the_mass_moves_against_the_gears_as_printed():
    constants = constants_of(TRUTH[0])
    r = constants['radius']
    assert belt_forces(constants, 0.3, 0.3, -0.3 * r) == pytest.approx((0.0, 0.0, 0.0))
    belt = BeltDrive(MACHINE, *step_reference())
    _, stiffness = matrices(belt, np.array([[2e5, 0.0]]))
    np.testing.assert_allclose(stiffness[0] @ [1.0, 1.0, -r], 0.0, atol=1e-9)


def test_figure_4_is_of_the_stiffness_and_gain_that_were_found():
    found = np.array([2.1e5, 41.0])
    belt = BeltDrive(MACHINE, *step_reference())
    there = eigenfrequencies_over_position(np.array([0.2, 0.5]), found)
    np.testing.assert_allclose(there[0], eigenfrequencies(belt, found[None])[0], rtol=1e-12)
    assert there[1, 0] < there[0, 0]
