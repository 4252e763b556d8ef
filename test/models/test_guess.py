# SPDX-License-Identifier: Apache-2.0
"""What a search of an arm in MuJoCo begins with; MuJoCo itself is not needed for it."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import scipy

from ros2_ident.models.mujoco.guess import by_inverse_dynamics, NAMES
from ros2_ident.recording import Dataset


def test_what_is_known_of_a_joint_that_stands_is_left_and_nothing_is_solved(monkeypatch) -> None:
    nnls = scipy.optimize.nnls

    def solved(columns: np.ndarray, right: np.ndarray) -> Any:
        # without an unknown scipy 1.17 aborts the whole process
        assert columns.shape[1]
        return nnls(columns, right)

    monkeypatch.setattr(scipy.optimize, 'nnls', solved)
    time = np.arange(0.0, 8.0, 0.004)
    place = np.stack([np.sin(2.0 * time), np.zeros(time.size)])
    late = np.stack([np.sin(2.0 * time) + 0.2 * np.cos(2.0 * time), np.zeros(time.size)])
    data = Dataset(('a', 'b'), 0.004, 0, late, None, place, None, None)
    plant = SimpleNamespace(
        places=[SimpleNamespace(sense=1.0)] * 2,
        inverse=lambda q, v, a: 0.5 * a,
        stated=lambda name, d: 1.0,
    )
    known: dict[str, np.ndarray] = {name: np.array([0.0, 3.0]) for name in NAMES}
    known |= {name: np.zeros((2, 1)) for name in ('joint_zero', 'velocity_feedforward')}
    known['damping'] = np.array([np.nan, 3.0])
    known['kp'] = np.array([10.0, 3.0])
    found = by_inverse_dynamics(plant, data, [0, 1], np.zeros(2), known)
    # kp 0.2 cos(2 t) = 0.5 (-4 sin(2 t)) + damping 2 cos(2 t), by the cosine
    assert found['damping'] == pytest.approx([1.0, 3.0], rel=0.02)
