# SPDX-License-Identifier: Apache-2.0
from gap_signals import CYCLE, motion, NOISE, residual
import numpy as np
import pytest

from ros2_ident.gap.floor import find_repeats, repeated
from ros2_ident.recording import Dataset

OF = motion(3.0)
RATE = np.tile(OF.velocity, 4)


def data(rate):
    return Dataset(OF.drives, CYCLE, 0, np.cumsum(rate, axis=1) * CYCLE, rate, None, None, None)


def noise(seed=1):
    return NOISE * np.random.default_rng(seed).standard_normal(RATE.shape)


def test_repeats_are_found_and_cancel_what_repeats():
    row = noise() + np.tile(0.1 * np.sign(OF.velocity), 4)
    assert find_repeats(data(RATE)) == OF.velocity.shape[1]
    assert repeated([row], [data(RATE)]) == pytest.approx([NOISE, NOISE], rel=0.04)


def test_an_impact_that_comes_once_is_no_noise():
    row = noise()
    row[:, 4000:4100] += 1.0
    assert repeated([row], [data(RATE)]) == pytest.approx([NOISE, NOISE], rel=0.05)


def test_recordings_that_repeat_tell_the_noise_together():
    once = motion()
    found = repeated(
        [2.0 * residual(once), noise(1), noise(2)], [data(once.velocity), data(RATE), data(RATE)]
    )
    alone = [repeated([noise(seed)], [data(RATE)]) for seed in (1, 2)]
    assert (np.min(alone, axis=0) <= found).all() and (found <= np.max(alone, axis=0)).all()


def test_a_motion_without_repeats_has_none():
    once = motion()
    assert find_repeats(data(once.velocity)) is None
    assert repeated([residual(once)], [data(once.velocity)]) is None
    assert repeated([np.full_like(RATE, np.nan)], [data(RATE)]) is None
