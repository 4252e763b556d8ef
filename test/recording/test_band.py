# SPDX-License-Identifier: Apache-2.0
"""Up to which frequency a log's positions tell efforts."""

import math

import numpy as np
import pytest

from ros2_ident.recording import Stream
from ros2_ident.recording.band import LOWEST, told_band

RATE, INERTIA, NOISE = 250.0, 8.0, 1.0
TIME = np.arange(0.0, 20.0, 1.0 / RATE)


def log(step: float, inertia: float = INERTIA, **parts: None) -> Stream:
    """Return a joint's log, its encoder with steps, its effort with noise."""
    random = np.random.default_rng(2)
    place = 0.8 * np.sin(2.1 * TIME) + 0.2 * np.sin(7.3 * TIME)
    change = -0.8 * 2.1**2 * np.sin(2.1 * TIME) - 0.2 * 7.3**2 * np.sin(7.3 * TIME)
    effort = inertia * change + 3.0 + random.normal(0.0, NOISE, TIME.size)
    seen = step * np.round(place / step) if step else place
    fields = {'position': seen[:, None], 'effort': effort[:, None], **parts}
    return Stream(('hip',), np.round(TIME * 1e9).astype(np.int64), **fields)


def test_readings_ask_for_less_than_the_noise() -> None:
    step = 2e-5
    wrong = step / math.sqrt(12.0)
    wanted = math.sqrt(math.sqrt(5.0) * NOISE / (3.0 * INERTIA * wrong)) / (2.0 * math.pi)
    assert told_band(log(step)) == pytest.approx(wanted, rel=0.08)
    assert told_band(log(2.0 * step)) < 0.8 * wanted


def test_what_is_small_beside_the_effort_does_not_count() -> None:
    # Three times as heavy, its readings ask for three times as much, of three times the effort.
    light, heavy = (told_band(log(1e-4, INERTIA * times)) for times in (10.0, 30.0))
    assert light == pytest.approx(heavy, rel=0.06)


def test_no_log_is_compared_above_a_tenth_of_its_rate() -> None:
    assert told_band(log(0.0)) == pytest.approx(0.1 * RATE)
    assert told_band(log(2e-5, effort=None)) == pytest.approx(0.1 * RATE)
    assert told_band(log(2e-5, position=None)) == pytest.approx(0.1 * RATE)


def test_however_coarse_a_reading_slow_motion_is_compared() -> None:
    assert 0.9 * LOWEST < told_band(log(0.05)) <= LOWEST
