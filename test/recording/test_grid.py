# SPDX-License-Identifier: Apache-2.0
"""The grid finder: the true cycle of every sample, whatever jitter, drops, phase and clocks do."""

from hypothesis import example, given, settings
from hypothesis import strategies as st
import numpy as np
import pytest

from ros2_ident.errors import IdentError
from ros2_ident.recording.grid import find_ticks

CYCLE = 5e-4
START = 1_700_000_000_000_000_000


def sampled(rng, ticks, cycle=CYCLE, jitter=0.0, drift=0.0, offset=0.0):
    """Return stamps of samples taken at cycle numbers, in order, and the numbers."""
    time = ticks * cycle * (1.0 + drift) + offset + rng.normal(0.0, jitter, ticks.size)
    stamp = START + np.round(time * 1e9).astype(np.int64)
    order = np.argsort(stamp, kind='stable')
    stamp, ticks = stamp[order], ticks[order]
    first = np.r_[True, np.diff(stamp) > 0]
    return stamp[first], ticks[first]


def drop(rng, ticks, share):
    kept = ticks[rng.random(ticks.size) >= share]
    return kept if kept.size > 1 else ticks


@settings(max_examples=150, deadline=None)
@given(
    seed=st.integers(0, 2**31),
    stride=st.integers(1, 20),
    size=st.integers(60, 3000),
    share=st.floats(0.0, 0.3),
    jitter=st.floats(0.0, 0.1),
    offset=st.floats(-0.5, 0.5),
)
@example(seed=20, stride=1, size=60, share=0.298828125, jitter=0.0, offset=0.0)
def test_numbers_are_true_up_to_where_they_count_from(seed, stride, size, share, jitter, offset):
    rng = np.random.default_rng(seed)
    ticks = drop(rng, np.arange(size) * stride, share)
    stamp, ticks = sampled(rng, ticks, jitter=jitter * stride * CYCLE, offset=offset)
    found = find_ticks(stamp, int(stamp[0]), CYCLE)
    assert found.keep.all()
    assert found.stride == stride
    assert found.drift == 0.0
    assert np.unique(found.tick - ticks).size == 1


@settings(max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 2**31),
    stride=st.integers(1, 4),
    share=st.floats(0.0, 0.1),
    jitter=st.floats(0.001, 0.08),
    drift=st.floats(-8e-4, 8e-4),
)
def test_clocks_that_run_apart_are_recognised(seed, stride, share, jitter, drift):
    rng = np.random.default_rng(seed)
    ticks = drop(rng, np.arange(8000) * stride, share)
    stamp, ticks = sampled(rng, ticks, jitter=jitter * stride * CYCLE, drift=drift)
    found = find_ticks(stamp, int(stamp[0]), CYCLE)
    assert np.unique(found.tick - ticks).size == 1
    # what is too small to be told from none is none
    assert found.drift == pytest.approx(drift, abs=5e-7 + 20.0 * jitter / ticks.size**1.5)


def test_samples_that_keep_to_no_grid_go_to_the_nearest_cycle():
    time = np.cumsum(np.random.default_rng(0).uniform(0.004, 0.007, 500))
    stamp = START + np.round(time * 1e9).astype(np.int64)
    found = find_ticks(stamp, START, 1e-3)
    assert found.stride == 0
    np.testing.assert_array_equal(found.tick, np.round(time / 1e-3))
    coarse = find_ticks(stamp, START, 7e-3)
    assert not coarse.keep.all()
    assert (np.diff(coarse.tick[coarse.keep]) > 0).all()


def test_a_cycle_that_is_none():
    for cycle in (0.0, -1.0, float('nan'), float('inf'), 1e300, 1e-320):
        with pytest.raises(IdentError, match='give a positive time in the machine file'):
            find_ticks(np.arange(3), 0, cycle)


@pytest.mark.parametrize('seconds', [100, 20_000])
def test_two_messages_long_apart_are_numbered_at_once(seconds):
    # Any of millions of multiples of the cycle would fit; a set-point is sent when it changes.
    found = find_ticks(np.array([0, seconds * 10**9]), 0, 1e-3)
    assert found.tick.tolist() == [0, seconds * 1000]


def test_samples_are_numbered_from_any_cycle_though_the_clock_drifts():
    cycle = 1e-3 * (1.0 + 8e-4)
    late = 10**18 + round(60_000 * cycle * 1e9)
    stamp = 10**18 + np.round(np.arange(5, 90_000, 2) * cycle * 1e9).astype(np.int64)
    np.testing.assert_array_equal(
        find_ticks(stamp, late, 1e-3).tick, np.arange(5, 90_000, 2) - 60_000
    )
