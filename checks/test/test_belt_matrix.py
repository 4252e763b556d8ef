# SPDX-License-Identifier: Apache-2.0
"""The belt drive's matrix path against its modal one, and against SciPy."""

from models.test_belt_drive import candidates, constants_of, MACHINE, TRUTH
import numpy as np
import pytest

from checks.belt_matrix import (
    eigenfrequencies,
    matrices,
    matrix_exponential,
    modes,
    simulate_generic,
    step_reference,
)
from checks.paper.belt import eigenfrequencies_over_position
from checks.reference.belt_drive import belt_forces
from ros2_ident.models.belt_drive.model import BeltDrive


def test_generic_path_agrees_with_modal_path():
    belt = BeltDrive(MACHINE, *step_reference())
    theta = candidates(20)
    difference = np.abs(simulate_generic(belt, theta) - belt.simulate(theta)).max(axis=(0, 2))
    assert difference[0] < 1e-11
    assert difference[1] < 1e-9


def test_matrix_exponential_agrees_with_scipy():
    from scipy.linalg import expm

    rng = np.random.default_rng(1)
    matrices_in = rng.normal(size=(20, 7, 7)) * np.logspace(-6, 1, 20)[:, None, None]
    for ours, source in zip(matrix_exponential(matrices_in), matrices_in, strict=True):
        theirs = expm(source)
        np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-12 * np.abs(theirs).max())


def test_modes_are_eigenvalues_and_weights_add_up():
    full = BeltDrive(MACHINE, *step_reference()).constants(candidates(50))
    square, weight = modes(full)
    mass, stiffness = matrices(full)
    for s in range(50):
        root = np.sqrt(mass[s])
        values, vectors = np.linalg.eigh(stiffness[s] / np.outer(root, root))
        np.testing.assert_allclose(square[s], values, rtol=1e-12)
        expected = vectors[0] ** 2 * full[s, 1] / (mass[s, 0] * values)
        np.testing.assert_allclose(weight[s], expected, atol=1e-12)
    np.testing.assert_allclose(weight.sum(axis=1), 1.0, rtol=1e-12)


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
    _, stiffness = matrices(belt.constants(np.array([[2e5, 0.0]])))
    np.testing.assert_allclose(stiffness[0] @ [1.0, 1.0, -r], 0.0, atol=1e-9)


def test_figure_4_is_of_the_stiffness_and_gain_that_were_found():
    found = np.array([2.1e5, 41.0])
    belt = BeltDrive(MACHINE, *step_reference())
    there = eigenfrequencies_over_position(np.array([0.2, 0.5]), found)
    np.testing.assert_allclose(there[0], eigenfrequencies(belt, found[None])[0], rtol=1e-12)
    assert there[1, 0] < there[0, 0]
