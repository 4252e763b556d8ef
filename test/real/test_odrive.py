# SPDX-License-Identifier: Apache-2.0
"""The cogging of a motor on an ODrive, its three orders, against its map."""

from pathlib import Path

import numpy as np
import pytest

from ros2_ident.identify.data import read_data
from ros2_ident.identify.problem import problem_of
from ros2_ident.models import EffectAt, load_machine
from ros2_ident.search.least_squares import least_squares

ROOT = Path(__file__).parents[2]
RECORDED = ROOT.parent / 'shared/data'
NAMES = 'torque_ripple', 'torque_ripple_2', 'torque_ripple_3'
POLE_PAIRS, TORQUE_CONSTANT = 7, 0.0551333

pytestmark = pytest.mark.skipif(
    not (RECORDED / 'odrive_slow003_nocomp').is_dir(), reason='the log of a motor is not here'
)


def test_cogging_of_an_odrive_is_that_of_its_map() -> None:
    machine = load_machine(ROOT / 'config/odrive.yaml')
    data = read_data(str(RECORDED / 'odrive_slow003_nocomp'), machine)
    problem = problem_of(machine, data, effects=[EffectAt(name, 'motor') for name in NAMES])
    start = problem.low + 0.1 * (problem.high - problem.low)
    start[-9:] = [0.0, 0.0, 1.0, 0.0, 0.0, 2.0, 0.0, 0.0, 4.0]
    found = least_squares(
        problem.models[0].residuals, start, problem.low, problem.high, iterations=40
    )
    sine, cosine, order = found.theta[-9:].reshape(3, 3).T
    np.testing.assert_allclose(POLE_PAIRS * order, [7.0, 14.0, 28.0], rtol=0.01)
    published = np.genfromtxt(RECORDED / 'odrive_cogging_map.csv', delimiter=',', skip_header=1)
    angle, current = published[:, 1], published[:, 2]
    waves = np.exp(-1j * np.outer([7, 14, 28], angle))
    size = 2.0 * np.abs(waves @ current) / len(angle)
    ratio = np.hypot(sine, cosine) / TORQUE_CONSTANT / size
    # Amplitudes published with the recording: of this run over those of the map, measured at rest.
    run_of_map = [0.889 / 0.862, 0.305 / 0.349, 0.454 / 0.560]
    assert ratio == pytest.approx(run_of_map, abs=0.1)
