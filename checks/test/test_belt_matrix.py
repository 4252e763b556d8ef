# SPDX-License-Identifier: Apache-2.0
"""The belt drive's matrix path against its modal one, and against SciPy."""

from models.test_belt_drive import candidates, MACHINE
import numpy as np

from checks.belt_matrix import matrix_exponential, simulate_generic
from ros2_ident.models.belt_drive.model import BeltDrive, step_reference


def test_generic_path_agrees_with_modal_path():
    belt = BeltDrive(MACHINE, step_reference())
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
