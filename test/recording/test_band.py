# SPDX-License-Identifier: Apache-2.0
"""Up to which frequency, and where, a log's positions tell efforts."""

import math

import numpy as np
import pytest

from ros2_ident.recording import Dataset
from ros2_ident.recording.motion import standing, told_band

RATE, INERTIA, NOISE = 250.0, 8.0, 1.0
TIME = np.arange(0.0, 20.0, 1.0 / RATE)


def log(step: float, inertia: float = INERTIA, **parts: None) -> Dataset:
    """Return a joint's log, its encoder with steps, its effort with noise."""
    random = np.random.default_rng(2)
    place = 0.8 * np.sin(2.1 * TIME) + 0.2 * np.sin(7.3 * TIME)
    change = -0.8 * 2.1**2 * np.sin(2.1 * TIME) - 0.2 * 7.3**2 * np.sin(7.3 * TIME)
    effort = inertia * change + 3.0 + random.normal(0.0, NOISE, TIME.size)
    seen = step * np.round(place / step) if step else place
    fields = {'position': seen[None], 'effort': effort[None], **parts}
    nothing = dict.fromkeys(('command_position', 'command_velocity', 'velocity'))
    return Dataset(('hip',), 1.0 / RATE, 0, **fields, **nothing)


def test_readings_ask_for_less_than_the_noise() -> None:
    step = 2e-5
    wrong = step / math.sqrt(12.0)
    wanted = math.sqrt(math.sqrt(5.0) * NOISE / (3.0 * INERTIA * wrong)) / (2.0 * math.pi)
    assert told_band(log(step)) == pytest.approx(wanted, rel=0.08)
    assert told_band(log(2.0 * step)) < 0.8 * wanted


def test_no_log_is_compared_above_a_tenth_of_its_rate() -> None:
    assert told_band(log(0.0)) == pytest.approx(0.1 * RATE)
    assert told_band(log(2e-5, effort=None)) == pytest.approx(0.1 * RATE)
    assert told_band(log(2e-5, position=None)) == pytest.approx(0.1 * RATE)


@pytest.mark.parametrize('noise', [0.0, 1.0, 3.0])
def test_a_joint_stands_where_its_readings_hardly_differ(noise: float) -> None:
    step = 1e-4
    moves = np.where(TIME % 4.0 < 2.0, 1.0, 0.0)
    place = np.cumsum(0.5 * moves) / RATE
    random = np.random.default_rng(3)
    place = step * np.round((place + noise * step * random.normal(size=TIME.size)) / step)
    seen = np.stack([place, np.zeros_like(place)])
    speed = np.ones_like(seen)
    still, never = standing(seen, speed, 1.0 / RATE, 20.0)
    assert (still == (moves == 0.0)).mean() > 0.97
    assert not never.any()  # what never moves has no friction to be spoiled
    assert standing(seen, speed, 1.0 / RATE, 20.0, np.array([0.6, 0.0])).sum() == 0
    # Between two readings nothing tells when friction turned over.
    speed[0, TIME > 5.0] = -1.0
    turned = standing(seen, speed, 1.0 / RATE, 20.0)[0] & ~still
    np.testing.assert_allclose(TIME[turned], 5.0, atol=3.5 / RATE)
    assert turned.sum() > 5
