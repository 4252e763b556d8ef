# SPDX-License-Identifier: Apache-2.0
"""How the grid of cycles is found, part by part, on times made of numbers."""

import numpy as np
import pytest

from ros2_ident.errors import IdentError
from ros2_ident.recording.grid import (
    _line,
    _number,
    _regular,
    _search,
    _stride,
    find_ticks,
    sample_period,
)

CYCLE = 1e-3
MS = 1_000_000


def stamps(ms):
    return np.round(np.asarray(ms, dtype=float) * MS).astype(np.int64)


# ---------------------------------------------------------------------- the typical spacing


@pytest.mark.parametrize(
    ('steps', 'period'),
    [
        ([10], 10.0),
        ([10, 10, 20, 30], 10.0),
        ([10] * 4 + [20] * 6, 10.0),  # six of ten are drops
        ([10] * 3 + [20] * 7, 20.0),
        ([9, 11, 10, 10, 50], 10.0),
        ([10, 14, 10, 14, 10], 11.6),  # jitter averages out
        ([4, 10, 10, 10, 10], 10.0),  # less than half of it is none
        ([6, 10, 10, 10, 10], 9.2),
        ([10, 10, 10, 10, 14.9], 10.98),
        ([10, 10, 10, 10, 16], 10.0),
    ],
)
def test_the_spacing_is_the_mean_of_steps_of_one_period(steps, period):
    stamp = stamps(np.concatenate([[0.0], np.cumsum(steps)]))
    assert sample_period(stamp) == pytest.approx(period * 1e-3)
    assert sample_period(stamp[:1]) == 0.0


# ---------------------------------------------------------------------- numbers


@pytest.mark.parametrize(
    ('positions', 'numbers'),
    [
        ([0.1, 1.2, 1.9, 5.0], [0, 1, 2, 5]),
        ([0.0, 0.4, 2.0, 3.0], [0, 1, 2, 3]),  # two may not share a cycle
        ([0.0, 0.9, 1.1, 3.0], [0, 1, 2, 3]),
        ([0.0, 1.3, 2.0], [0, 1, 2]),
        ([-0.2, 1.0, 1.1, 1.2, 4.0], [-1, 0, 1, 2, 4]),
        ([7.2], [7]),
    ],
)
def test_numbers_increase_and_are_the_nearest_together(positions, numbers):
    assert _number(np.array(positions)).tolist() == numbers


def test_a_line_is_fitted_without_what_lies_apart():
    model = np.arange(100.0)
    slope, offset = _line(model, 1.0003 * model + 0.25)
    assert (slope, offset) == (pytest.approx(3e-4), pytest.approx(0.25))
    time = 1.0003 * model + 0.25 + 1e-3 * np.random.default_rng(0).normal(size=100)
    clean = _line(model, time)
    time[[3, 40, 77]] += 9.0
    slope, offset = _line(model, time)
    assert slope == pytest.approx(clean[0], abs=2e-5)
    assert offset == pytest.approx(clean[1], abs=2e-3)
    assert _line(np.array([2.0]), np.array([2.5])) == (0.0, 0.5)
    assert _line(np.full(5, 3.0), np.full(5, 4.0)) == (0.0, 1.0)


# ---------------------------------------------------------------------- phase and drift


@pytest.mark.parametrize('drift', [0.0, 2e-4, -9e-4])
@pytest.mark.parametrize('phase', [0.0, 3e-4, -4e-4])
def test_the_grid_on_which_times_cluster_is_found(drift, phase):
    time = phase + CYCLE * (1.0 + drift) * np.arange(20_000)
    found, at, sharp = _search(time, CYCLE)
    assert found == pytest.approx(drift, abs=2e-6)
    # Within the resolution of the drift the phase at the middle is right.
    middle = (
        time[10_000]
        - at
        - np.round((time[10_000] - at) / (CYCLE * (1.0 + found))) * CYCLE * (1.0 + found)
    )
    assert abs(middle) < 2e-5
    assert sharp > 0.97


def test_a_drift_beyond_a_thousandth_is_another_cycle():
    rng = np.random.default_rng(0)
    time = CYCLE * 1.0015 * np.arange(20_000)
    assert abs(_search(time, CYCLE)[0]) <= 1e-3
    assert _regular(time, 1, CYCLE, 0.1) is None
    assert _regular(time / 1.0015 * 1.0009, 1, CYCLE, 0.1).drift == pytest.approx(9e-4)
    random = np.sort(rng.uniform(0.0, 20.0, 20_000))
    assert _search(random, CYCLE)[2] < 0.1
    assert _regular(random, 1, CYCLE, 0.1) is None
    assert _regular(time, 0, CYCLE, 0.1) is None


@pytest.mark.parametrize(('spread', 'sharp'), [(0.03, True), (0.2, False)])
def test_stamps_that_scatter_cluster_less(spread, sharp):
    rng = np.random.default_rng(1)
    time = CYCLE * (np.arange(5000) + spread * rng.normal(size=5000))
    length = _search(time, CYCLE)[2]
    assert length == pytest.approx(np.exp(-0.5 * (2.0 * np.pi * spread) ** 2), abs=0.02)
    found = _regular(time, 1, CYCLE, 0.8)
    assert (found is not None) is sharp
    if sharp:
        assert found.jitter == pytest.approx(spread * CYCLE, rel=0.05)


def test_a_few_samples_that_cluster_by_chance_are_no_grid():
    near = CYCLE * np.array([0.0, 1.1, 1.9, 3.1, 3.9, 5.0])
    assert _regular(near, 1, CYCLE, 0.1) is not None
    apart = CYCLE * np.array([0.0, 1.3, 2.5, 3.2, 4.6, 5.35])
    assert _regular(apart, 1, CYCLE, 0.1) is None


def test_a_drift_that_chance_makes_is_none():
    rng = np.random.default_rng(2)
    ticks = np.arange(2000)
    noisy = CYCLE * (ticks + 0.02 * rng.normal(size=2000))
    found = _regular(noisy, 1, CYCLE, 0.1)
    assert found.drift == 0.0
    assert found.phase == pytest.approx(0.0, abs=3e-6)
    # Its standard error is 8e-7: five of them and more are told.
    told = _regular(noisy * (1.0 + 1e-5), 1, CYCLE, 0.1)
    assert told.drift == pytest.approx(1e-5, abs=3e-6)
    exact = _regular(CYCLE * ticks * (1.0 + 5e-9), 1, CYCLE, 0.1)
    assert exact.drift == pytest.approx(5e-9, rel=1e-3)
    assert _regular(CYCLE * ticks * (1.0 + 5e-10), 1, CYCLE, 0.1).drift == 0.0
    two = _regular(CYCLE * np.array([0.0, 1.0005]), 1, CYCLE, 0.1)
    assert two is None or two.drift == 0.0


@pytest.mark.parametrize('stride', [1, 2, 5])
@pytest.mark.parametrize('shift', [-3, 0, 4])
def test_numbers_count_from_the_cycle_nearest_to_the_reference(stride, shift):
    time = CYCLE * (stride * np.arange(300) + shift + 0.3)
    found = _regular(time, stride, CYCLE, 0.1)
    assert found.tick.tolist() == (stride * np.arange(300) + shift).tolist()
    assert found.phase == pytest.approx(3e-4)
    assert found.stride == stride and found.keep.all()
    np.testing.assert_allclose(found.raw, time / CYCLE)
    assert found.jitter == pytest.approx(0.0, abs=1e-12)


# ---------------------------------------------------------------------- every so many cycles


@pytest.mark.parametrize(
    ('cycles', 'stride'),
    [
        (1.0, 1),
        (2.0, 2),
        (7.0, 7),
        (2.03, 2),
        (2.1, 0),
        (1.97, 2),
        (1.9, 0),
        (0.4, 0),
        (100.4, 100),
    ],
)
def test_a_spacing_is_a_multiple_of_the_cycle(cycles, stride):
    time = CYCLE * cycles * np.arange(400)
    assert _stride(time, CYCLE * cycles, CYCLE) == stride


def test_where_several_multiples_are_near_the_one_that_fits_is_taken():
    rng = np.random.default_rng(3)
    for true in (59, 60, 61):
        time = CYCLE * (true * np.arange(300) + 0.05 * rng.normal(size=300))
        assert _stride(time, CYCLE * 60.2, CYCLE) == true
    # Two steps have no scatter to go by.
    assert _stride(CYCLE * np.array([0.0, 1.9, 4.0]), CYCLE * 1.95, CYCLE) == 2


# ---------------------------------------------------------------------- whole streams


def test_stamps_are_sharp_on_the_cycles_without_an_even_spacing():
    ms = np.cumsum(np.random.default_rng(0).integers(9, 12, 500)).astype(float)
    found = find_ticks(stamps(ms), stamps(ms)[0], CYCLE)
    assert found.tick.tolist() == (ms - ms[0]).tolist()
    assert found.stride == 10 and found.keep.all()
    sparse = find_ticks(stamps(ms[:2]), stamps(ms)[0], CYCLE)
    assert sparse.stride in (9, 10, 11)


def test_without_a_grid_each_goes_to_the_nearest_and_the_later_one_counts():
    rng = np.random.default_rng(5)
    ms = np.cumsum(rng.uniform(0.3, 1.9, 400))
    found = find_ticks(stamps(ms), 0, CYCLE)
    assert found.tick.tolist() == np.round(ms).tolist()
    assert (found.stride, found.phase, found.drift) == (0, 0.0, 0.0)
    later = np.r_[np.diff(np.round(ms)) > 0, True]
    assert found.keep.tolist() == later.tolist() and not found.keep.all()
    assert found.jitter == pytest.approx(np.std(ms - np.round(ms)) * 1e-3, rel=1e-6)


@pytest.mark.parametrize('seconds', [100, 20_000])
def test_two_messages_long_apart_are_numbered_at_once(seconds):
    # Any of millions of multiples of the cycle would fit; a set-point is sent when it changes.
    found = find_ticks(np.array([0, seconds * 10**9]), 0, CYCLE)
    assert found.tick.tolist() == [0, seconds * 1000]


def test_more_cycles_than_can_be_laid_out_are_refused():
    stamp = np.array([0, 10**14 + 10**9], dtype=np.int64)
    with pytest.raises(IdentError, match='controller cycles of 0.001 s, more than the 1e.08'):
        find_ticks(stamp, 0, CYCLE)
    assert find_ticks(stamp - np.array([0, 2 * 10**9]), 0, CYCLE).tick.size == 2
