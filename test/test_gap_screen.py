# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest

from ros2_ident.gap.screen import flat_top

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


def test_missing_samples_do_not_count() -> None:
    log = _log(0.3)
    log[::3] = np.nan
    assert flat_top(log, NOISE) == pytest.approx(0.3, abs=0.3 * NOISE)
    assert flat_top(np.full(1000, np.nan), NOISE) is None
