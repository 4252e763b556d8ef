# SPDX-License-Identifier: Apache-2.0
from types import SimpleNamespace

import numpy as np
import pytest

from ros2_ident.gap.screen import limits_shown
from ros2_ident.models import EffectAt

NOISE = 0.01


def _log(limit: float) -> np.ndarray:
    generator = np.random.default_rng(1)
    time = np.arange(8000) * 1e-3
    effort = 0.2 + 0.6 * np.sin(2.0 * np.pi * time) * np.sin(0.7 * time)
    return np.clip(effort, -limit, limit) + NOISE * generator.standard_normal(time.size)


def _positions(*efforts: np.ndarray) -> list[SimpleNamespace]:
    """Return models that compare positions, on logs that hold efforts too."""
    return [
        SimpleNamespace(
            places=('one',), outputs=[SimpleNamespace(quantity='position')], noise=0.0,
            measured=np.zeros((1, effort.size)),
            data=SimpleNamespace(names=('two', 'one'), effort=np.stack([9.0 * effort, effort])),
            scaled=lambda at: (SimpleNamespace(low=0.02, high=1.0),),
            effort_limit=lambda place: 10.0,
        )
        for effort in efforts
    ]  # fmt: skip


LIMIT, GAIN = EffectAt('torque_saturation', 'one'), EffectAt('position_gain_error', 'one')
THETAS = [np.array([1.0]), np.array([1.0])]


def test_a_limit_is_looked_for_at_the_highest_logged_effort_whatever_is_compared() -> None:
    cut, free = _log(0.5), _log(10.0)
    cut[::3] = np.nan
    # By what the law shows, or where most is missing; a mean of nine keeps a third of the noise.
    assert limits_shown(LIMIT, _positions(cut), THETAS[:1], {}, False) == []
    (share,) = limits_shown(LIMIT, _positions(cut), THETAS[:1], {}, True)
    assert share == pytest.approx(0.05, abs=2e-3)
    (share,) = limits_shown(LIMIT, _positions(cut, free), THETAS, {}, True)
    assert share == pytest.approx(0.1 * np.abs(free).max(), abs=3e-3)
    (share,) = limits_shown(LIMIT, _positions(free), THETAS[:1], {'one': 0.3}, False)
    assert share == pytest.approx(0.03)
    assert limits_shown(GAIN, _positions(cut), THETAS[:1], {'one': 0.3}, True) == []


def test_without_a_logged_effort_a_limit_is_looked_for_below_what_the_model_makes() -> None:
    silent = _positions(_log(0.5), _log(0.5))
    for number, model in enumerate(silent, 1):
        model.data.effort = None
        model.simulated_effort = lambda theta, n=number: n * theta[0] * np.array([[-3.0, 1.0]])

    def starts(scale: float) -> list[float]:
        found = limits_shown(LIMIT, silent, [scale * x for x in THETAS], {}, True)
        return np.array(found).ravel().tolist()

    assert starts(1.0) == pytest.approx([0.3, 0.39, 0.48, 0.552])
    # No share beyond its bounds, and each once.
    assert starts(10.0) == [1.0]
    assert starts(0.0) == []
