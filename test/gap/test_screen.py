# SPDX-License-Identifier: Apache-2.0
from types import SimpleNamespace

import numpy as np
import pytest

from ros2_ident.gap.flat_top import flat_top, highest
from ros2_ident.gap.screen import below_simulated, seen_in_log
from ros2_ident.models import EffectAt

NOISE = 0.01


def _log(limit: float) -> np.ndarray:
    generator = np.random.default_rng(1)
    time = np.arange(8000) * 1e-3
    effort = 0.2 + 0.6 * np.sin(2.0 * np.pi * time) * np.sin(0.7 * time)
    return np.clip(effort, -limit, limit) + NOISE * generator.standard_normal(time.size)


@pytest.mark.parametrize('limit', [0.3, 0.5])
def test_a_flat_top_tells_the_limit(limit: float) -> None:
    assert flat_top(_log(limit), NOISE) == pytest.approx(limit, abs=0.3 * NOISE)


def test_a_log_without_a_limit_has_no_flat_top() -> None:
    assert flat_top(_log(10.0), NOISE) is None


@pytest.mark.parametrize('depth', [0.01, 0.03])
def test_a_limit_that_acts_for_an_instant_shows_beside_other_peaks(depth) -> None:
    """Of a dozen peaks of about one height the highest are cut, for a tenth of a second each."""
    time = np.arange(8000) * 1e-3
    peaks = 0.5 + 0.08 * np.sin(3.0 * time) * np.exp(-0.05 * (time - 4.0) ** 2)
    effort = peaks * np.cos(2.0 * np.pi * 0.7 * time)
    noise = 2e-3 * np.random.default_rng(3).standard_normal(time.size)
    limit = float(np.abs(effort).max()) - depth
    cut = np.clip(effort, -limit, limit)
    assert 20 < (cut != effort).sum() < 400
    assert flat_top(cut + noise) == pytest.approx(limit, abs=1e-3)
    assert flat_top(effort + noise) is None
    assert highest(cut + noise) == pytest.approx(limit, abs=3e-3)


def test_logs_of_motions_without_a_limit_have_no_flat_top() -> None:
    generator = np.random.default_rng(5)
    time = np.arange(6000) * 1e-3
    for _ in range(40):
        rates, phases = generator.uniform(1.0, 8.0, 3), generator.uniform(0.0, 6.0, 3)
        log = np.sin(np.outer(time, rates) + phases).sum(axis=1)
        assert flat_top(log + 0.05 * generator.standard_normal(time.size)) is None


def test_a_log_that_stands_still_has_no_flat_top() -> None:
    assert flat_top(np.full(1000, 0.3)) is None
    assert highest(np.full(1000, -0.3)) == pytest.approx(0.3)
    assert highest(np.empty(0)) == 0.0


def test_missing_samples_do_not_count() -> None:
    log = _log(0.3)
    log[::3] = np.nan
    assert flat_top(log, NOISE) == pytest.approx(0.3, abs=0.3 * NOISE)
    assert flat_top(np.full(1000, np.nan), NOISE) is None


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


def test_a_limit_is_looked_for_in_the_logged_effort_whatever_is_compared() -> None:
    limit, gain = EffectAt('torque_saturation', 'one'), EffectAt('position_gain_error', 'one')
    cut, free, low = _log(0.5), _log(10.0), 0.7 * _log(0.5)
    assert seen_in_log(limit, _positions(free, cut), {}, False) is None  # the other goes beyond
    (share,) = seen_in_log(limit, _positions(low, cut), {}, False)
    assert share == pytest.approx(0.05, abs=1e-4)
    # Where most is missing, the highest effort will do to start from.
    assert seen_in_log(limit, _positions(free), {}, False) is None
    (share,) = seen_in_log(limit, _positions(free), {}, True)
    assert share == pytest.approx(0.1 * highest(free)) and share > 0.077
    assert seen_in_log(limit, _positions(free), {'one': 0.3}, False) == pytest.approx([0.03])
    assert seen_in_log(gain, _positions(cut), {'one': 0.3}, True) is None


def test_without_a_logged_effort_a_limit_is_looked_for_below_what_the_model_makes() -> None:
    limit, gain = EffectAt('torque_saturation', 'one'), EffectAt('position_gain_error', 'one')
    silent = _positions(_log(0.5), _log(0.5))
    for number, model in enumerate(silent, 1):
        model.data.effort = None
        model.simulated_effort = lambda theta, n=number: n * theta[0] * np.array([[-3.0, 1.0]])
    thetas = [np.array([1.0]), np.array([1.0])]
    starts = np.concatenate(below_simulated(limit, silent, thetas))
    assert starts.max() == pytest.approx(0.92 * 0.6) and starts.min() == pytest.approx(0.5 * 0.6)
    # No share beyond its bounds, and each once.
    at_most = np.concatenate(below_simulated(limit, silent, [10.0 * x for x in thetas]))
    assert at_most.tolist() == [1.0]
    assert below_simulated(gain, silent, thetas) == []
    assert below_simulated(limit, _positions(_log(0.5)), thetas[:1]) == []
    assert below_simulated(limit, silent, [0.0 * x for x in thetas]) == []
