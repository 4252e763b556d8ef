# SPDX-License-Identifier: Apache-2.0

from gap_signals import CYCLE, floor_of, motion, NOISE, residual
import numpy as np
import pytest
from scipy.signal import lfilter

from ros2_ident.gap.bootstrap import BlockBootstrap, length_of
from ros2_ident.gap.noise_floor import find_repeats, repeated
from ros2_ident.recording import Dataset
from ros2_ident.search.noise import correlation_time


def _coloured(generator, phi, shape):
    white = generator.standard_normal((*shape[:-1], shape[-1] + 1000))
    return lfilter([1.0], [1.0, -phi], white, axis=-1)[..., 1000:] * np.sqrt(1.0 - phi**2)


def test_correlation_time_of_an_autoregression():
    series = _coloured(np.random.default_rng(0), 0.9, (200_000,))
    assert correlation_time(series) == pytest.approx(1.9 / 0.1, rel=0.1)
    assert correlation_time(np.random.default_rng(0).standard_normal(20_000)) < 1.2


def test_the_length_of_blocks_is_the_formula_summed_over_the_lags():
    lags = np.arange(4000)
    both = np.where(lags, 2.0, 1.0) * 0.98**lags
    spread, whole = float(both @ lags), float(both.sum())
    cubed = 2.0 * spread**2 / (4.0 / 3.0 * whole**2)
    samples, stride, cycle = 10_000, 5, 1e-4
    expected = stride * (cubed * samples) ** (1.0 / 3.0)
    assert length_of(whole, stride, stride * samples, cycle) == pytest.approx(expected, rel=1e-6)
    # The settling time at least, a sixteenth of the log at most.
    assert length_of(1.0, stride, stride * samples, cycle) == pytest.approx(0.1 / cycle)
    assert length_of(whole, 1.0, 800, cycle) == 50.0


def test_intervals_cover():
    generator = np.random.default_rng(1)
    hits = 0
    for seed in range(100):
        rows = _coloured(generator, 0.9, (2, 6000))
        found = BlockBootstrap([rows], 1e-3, count=300, seed=seed).rms()
        hits += found.low <= 1.0 <= found.high
    assert 86 <= hits <= 100


def test_the_share_closed_covers_and_knows_its_limits():
    generator = np.random.default_rng(2)
    floor = floor_of(2, 1.0)
    hits = 0
    for seed in range(80):
        effect = 1.5 * _coloured(generator, 0.95, (2, 6000))
        noise = generator.standard_normal((2, 6000))
        found = BlockBootstrap([noise + effect, noise + 0.3 * effect], 1e-3, count=300, seed=seed)
        share = found.share_closed(0, 1, floor)
        hits += share.low <= 0.91 <= share.high
    assert 68 <= hits <= 80
    same = BlockBootstrap([noise, noise], 1e-3)
    assert np.isnan(same.share_closed(0, 1, floor_of(2, 2.0)).value)


# ---------------------------------------------------------------------- motions that repeat

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


def test_a_motion_without_repeats_has_none():
    once = motion()
    assert find_repeats(data(once.velocity)) is None
    assert repeated([residual(once)], [data(once.velocity)]) is None
    assert repeated([np.full_like(RATE, np.nan)], [data(RATE)]) is None
