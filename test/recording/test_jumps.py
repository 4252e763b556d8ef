# SPDX-License-Identifier: Apache-2.0
"""Jumps of one signal, on signals made of numbers: each rule of the search at its edge."""

import numpy as np
import pytest

from ros2_ident.recording.outliers import (
    find_lasting,
    find_lone,
    leave_out,
    rule_of,
)

MS = 1_000_000
SIZE = 2000
STAMP = np.arange(SIZE) * MS
EXACT, FINE, ROUGH = (rule_of(*x) for x in (
    ('command', 'position'), ('state', 'position'), ('state', 'effort')
))  # fmt: skip


def smooth(size=SIZE, seed=0, noise=1e-4):
    """Return a slow wave of one with a little noise."""
    time = 1e-3 * np.arange(size)
    return np.sin(3.0 * time) + noise * np.random.default_rng(seed).uniform(-1.0, 1.0, size)


def struck(rows, by, **more):
    values = smooth(**more)
    values[rows] += by
    return values


def rows_of(values, rule, stamp=None):
    found = find_lone(STAMP[: values.size] if stamp is None else stamp, values, rule)
    return [] if found is None else found.rows.tolist()


@pytest.mark.parametrize('row', [7, 8, 1000, SIZE - 9, SIZE - 8])
@pytest.mark.parametrize('run', [1, 2, 3])
def test_a_lone_jump_is_found_wherever_it_has_neighbours(row, run):
    there = [r for r in range(row, row + run) if r < SIZE - 7]
    found = find_lone(STAMP, struck(there, 0.02), FINE)
    assert found.rows.tolist() == there
    assert found.size == pytest.approx(0.02, rel=0.05)
    assert found.short
    # Efforts are rough: of them only one alone.
    effort = rows_of(struck(there, 3.0, noise=0.02), ROUGH)
    assert effort == (there if len(there) == 1 else [])


def test_a_stamp_that_is_off_explains_what_a_fast_motion_shows():
    values = smooth(noise=1e-5)
    # There it moves by three thousandths in a period.
    values[1047] += 2.5e-3
    assert rows_of(values, FINE) == [] and rows_of(values, EXACT) == [1047]
    values[1047] += 1e-3
    assert rows_of(values, FINE) == [1047]
    late = STAMP.copy()
    late[1003:] += 3 * MS
    line = 5e-3 * np.arange(SIZE)
    line[1003:] += 15e-3
    assert rows_of(line, EXACT, late) == []


@pytest.mark.parametrize(('count', 'told'), [(20, True), (21, False)])
def test_many_jumps_are_how_the_signal_is(count, told):
    rows = list(range(100, 100 + 60 * count, 60))
    assert (rows_of(struck(rows, 0.02), FINE) == rows) is told


@pytest.mark.parametrize(('period', 'short'), [(12, True), (13, False)])
def test_what_a_machine_may_have_done_is_not_short(period, short):
    # From the sample before to the one after.
    found = find_lone(STAMP * period, struck([1000], 0.02), FINE)
    assert found.rows.tolist() == [1000] and found.short is short


def test_samples_that_are_missing_count_by_their_places():
    values = struck([1000], 0.02)
    values[[990, 998, 1003, 1500]] = np.nan
    assert rows_of(values, FINE) == [1000]
    few = np.full(SIZE, np.nan)
    few[:20] = smooth()[:20]
    assert find_lone(STAMP, few, FINE) is None
    few[:21] = struck([10], 0.5)[:21]
    assert rows_of(few, FINE) == [10]
    assert find_lone(STAMP, np.full(SIZE, np.nan), FINE) is None


# ---------------------------------------------------------------------- jumps that stay


def stays(row=1000, by=0.5, **more):
    values = smooth(**more)
    values[row:] += by
    return values


def lasting(values, stamp=None):
    found = find_lasting(STAMP[: values.size] if stamp is None else stamp, values)
    return [] if found is None else found.rows.tolist()


def test_a_position_that_jumps_farther_than_it_moves_and_stays_is_found():
    found = find_lasting(STAMP, stays())
    assert found.rows.tolist() == [1000] and found.short
    assert found.size == pytest.approx(0.5, rel=0.01)
    assert lasting(smooth()) == []
    two = stays() + stays(1400, -0.3) - smooth()
    assert lasting(two) == [1000, 1400]
    assert find_lasting(STAMP, two).size == pytest.approx(0.5, rel=0.01)


def test_after_a_gap_it_may_have_moved():
    late = STAMP.copy()
    late[1000:] += MS // 2 + 1000
    assert lasting(stays(), late) == []
    late[1000:] -= 2000
    assert lasting(stays(), late) == [1000]


# ---------------------------------------------------------------------- streams


def test_what_is_found_is_left_out_or_said():
    position = np.stack([struck([1000], 0.02, noise=0.0), stays(524, noise=0.0)], axis=1)
    velocity = np.stack([smooth(), smooth(noise=1e-3)], axis=1)
    velocity[400, 1] += 3.0
    kept = position.copy()
    said = leave_out('state', STAMP, ('a', 'b'), (position, velocity, None))
    kept[1000, 0] = np.nan
    np.testing.assert_array_equal(position, kept)
    assert np.flatnonzero(np.isnan(velocity[:, 1])).tolist() == [400]
    assert said == [
        'state: position of a jumps by 0.02 at 1.0000 s and back; that is no motion and is left '
        'out',
        'state: position of b jumps by 0.5 at 0.5240 s and stays there; it is used as it is: look '
        'whether the encoder slipped, or cut the log there',
        'state: velocity of b jumps by 3 at 0.4000 s and back; that is no motion and is left out',
    ]
    slow = struck([1000, 1001], 0.02, noise=0.0)[:, None]
    untouched = slow.copy()
    said = leave_out('command', STAMP * 20, ('a',), (slow, None, slow))
    np.testing.assert_array_equal(slow, untouched)
    assert said == [
        'command: position of a jumps by up to 0.02 at 2 samples, first at 20.0000 s, and back; '
        'it is used as it is: look whether that was so, or cut the log there'
    ]
    assert leave_out('command', STAMP, ('a',), (stays()[:, None], None, None)) == []
