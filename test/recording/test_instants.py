# SPDX-License-Identifier: Apache-2.0
"""How the grid of cycles is found, part by part, on times made of numbers."""

import numpy as np
import pytest

from ros2_ident.errors import IdentError
from ros2_ident.recording.grid import (
    find_ticks,
)

CYCLE = 1e-3
MS = 1_000_000


def stamps(ms):
    return np.round(np.asarray(ms, dtype=float) * MS).astype(np.int64)


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
