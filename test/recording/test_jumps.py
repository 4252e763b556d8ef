# SPDX-License-Identifier: Apache-2.0
"""Jumps of one signal, on signals made of numbers: each rule of the search at its edge."""

import numpy as np
import pytest

from ros2_ident.recording.outliers import (
    _candidates,
    _floor,
    _run_at,
    find_lasting,
    find_lone,
    Jumps,
    leave_out,
    Rule,
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


def test_rules_of_signals():
    assert rule_of('command', 'velocity') is EXACT and rule_of('command', 'position') is EXACT
    assert rule_of('state', 'velocity') is rule_of('command', 'effort') is ROUGH
    assert Rule(3, 8.0, 1e-4, 1.0) == FINE and Rule(1, 12.0, 0.05, 1.0) == ROUGH
    assert Rule(3, 8.0, 1e-4, 0.0) == EXACT


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


@pytest.mark.parametrize('row', [0, 3, SIZE - 1, SIZE - 4])
def test_at_the_ends_nothing_is_known(row):
    assert rows_of(struck([row], 0.02), FINE) == []


@pytest.mark.parametrize('run', [4, 5])
def test_more_in_a_row_are_how_it_was(run):
    assert rows_of(struck(range(1000, 1000 + run), 0.02), FINE) == []


@pytest.mark.parametrize(('rule', 'noise'), [(FINE, 1e-3), (ROUGH, 0.02)])
def test_a_jump_is_many_times_as_far_off_as_the_worst_around(rule, noise):
    values = smooth(noise=noise)
    around = np.r_[987:997, 1004:1014]
    place = np.arange(987, 1014) - 1000.0
    powers = place[:, None] ** np.arange(4)
    fitted = np.linalg.lstsq(powers[around - 987], values[around], rcond=None)[0]
    worst = np.abs(values[around] - powers[around - 987] @ fitted).max()
    for times, told in ((0.98, False), (1.02, True)):
        values[1000] = fitted[0] + times * rule.ratio * worst
        run, size = _run_at(STAMP, values, 1000, rule, 1e-9)
        assert run == ([1000] if told else [])
        if told:
            assert size == pytest.approx(1.02 * rule.ratio * worst, rel=1e-6)
    assert _run_at(STAMP, values, 1000, rule, 1.01 * size) == ([], 0.0)
    assert _run_at(STAMP, values, 1000, rule, 0.99 * size)[0] == [1000]


def test_neighbours_that_are_off_too_make_it_a_blow():
    for share, told in ((0.15, True), (0.25, False)):
        values = smooth(noise=0.0)
        values[[1000, 1001]] += np.array([0.01, 0.01 * share])
        # Off enough to be judged, and not to be one more jump.
        rule = Rule(1, 8.0, 1e-4, 0.0)
        assert (_run_at(STAMP, values, 1000, rule, 0.003)[0] == [1000]) is told


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


def test_two_jumps_apart_are_both_found_and_the_largest_told():
    found = find_lone(STAMP, struck([500], 0.02) + struck([1200], -0.05) - smooth(), FINE)
    assert found.rows.tolist() == [500, 1200]
    assert found.size == pytest.approx(0.05, rel=0.02)


@pytest.mark.parametrize(('count', 'told'), [(20, True), (21, False)])
def test_many_jumps_are_how_the_signal_is(count, told):
    rows = list(range(100, 100 + 60 * count, 60))
    assert (rows_of(struck(rows, 0.02), FINE) == rows) is told


def test_of_a_long_log_a_share_may_jump():
    size = 20_000
    for count, told in ((40, True), (41, False)):
        rows = list(range(100, 100 + 400 * count, 400))
        found = rows_of(struck(rows, 0.02, size=size), FINE, np.arange(size) * MS)
        assert (found == rows) is told


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


# ---------------------------------------------------------------------- what is small


def test_the_least_is_some_steps_of_the_resolution_or_a_share_of_the_range():
    ramp = np.linspace(0.0, 1.0, 1000)
    step = 1.0 / 999.0
    assert _floor(ramp, FINE) == pytest.approx(4.0 * step)
    rough = _floor(ramp, ROUGH)
    assert rough == pytest.approx(0.05 * 0.99, rel=1e-3)  # the range without its ends
    # The smallest step but for one in a hundred; what does not change is no step.
    steps = np.concatenate([np.full(10, 1e-6), np.full(990, 1e-2), np.zeros(500)])
    assert _floor(np.cumsum(steps), FINE) == pytest.approx(4e-2, rel=0.02)
    # What stands still but for a few steps: an encoder's resolution, a set-point's none.
    still = np.zeros(1000)
    still[500:] = 3.0
    still[600:] = 5.0
    assert _floor(still, FINE) == pytest.approx(12.0)
    assert _floor(still, EXACT) == pytest.approx(5e-4)
    nine = np.cumsum(np.r_[np.zeros(500), np.repeat(np.r_[1.0, np.zeros(9)], 1).tolist() * 9])
    assert _floor(nine, EXACT) == pytest.approx(4.0)
    assert _floor(np.zeros(100), FINE) == _floor(np.zeros(100), EXACT) == 1e-300


def test_candidates_are_what_a_cubic_through_four_neighbours_misses():
    values = np.zeros(64)
    values[30] = 1.0
    one, three = Rule(1, 8.0, 0.0, 0.0), Rule(3, 8.0, 0.0, 0.0)
    # Its neighbours are missed by two thirds of it, theirs by a sixth.
    assert _candidates(values, one, 0.99).tolist() == [30]
    assert _candidates(values, one, 0.6).tolist() == [29, 30, 31]
    assert _candidates(values, one, 1.01).tolist() == []
    assert _candidates(values, three, 2.4).tolist() == [30]
    assert _candidates(values, three, 2.6).tolist() == []
    # What is missed six to eight samples beside it makes it none.
    for apart, told in ((3, True), (4, False), (8, False), (10, False), (11, True)):
        both = values.copy()
        both[30 + apart] = 1.0
        assert (30 in _candidates(both, one, 0.99)) is told
    beside = values.copy()
    for height, told in ((0.155, True), (0.158, False)):
        beside[37] = height  # 6.4 times as much is asked for
        assert (30 in _candidates(beside, one, 0.99)) is told


@pytest.mark.parametrize('row', [32_760, 32_767, 32_768, 32_775, 65_535, 65_536])
def test_blocks_leave_no_seam(row):
    size = 70_000
    values = np.zeros(size)
    values[row] = 1.0
    assert _candidates(values, Rule(1, 8.0, 0.0, 0.0), 0.99).tolist() == [row]
    long = struck([row], 0.02, size=size)
    assert rows_of(long, FINE, np.arange(size) * MS) == [row]


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


def test_a_step_has_to_be_eight_times_the_fastest_and_those_around_it():
    slow = np.tile([1e-6, 2e-6], SIZE // 2)
    # Four times the finest step are the least, and eight times that is asked for.
    # Of a few fast steps the twentieth counts, the jump among them.
    cases = [(0, 30e-6, False), (0, 33e-6, True), (18, 33e-6, True), (19, 33e-6, False)]
    for fast, by, told in [*cases, (19, 77e-6, False), (19, 82e-6, True)]:
        steps = slow.copy()
        steps[60 : 60 + 40 * fast : 40] = 1e-5
        steps[1900] += by
        assert lasting(np.cumsum(steps)) == ([1900] if told else [])
    quiet = np.cumsum(np.tile([1e-6, 2e-6], SIZE // 2))
    quiet[1000:] += 0.01
    for at, near in ((974, True), (976, False), (1024, False), (1026, True)):
        beside = quiet.copy()
        beside[at:] += 0.002
        assert (1000 in lasting(beside)) is near


def test_after_a_gap_it_may_have_moved():
    late = STAMP.copy()
    late[1000:] += MS // 2 + 1000
    assert lasting(stays(), late) == []
    late[1000:] -= 2000
    assert lasting(stays(), late) == [1000]


def test_few_samples_tell_nothing_that_lasts():
    short = np.arange(100) * MS
    assert lasting(stays(50, size=100), short) == [50]
    assert lasting(stays(50, size=99), short[:99]) == []
    assert lasting(np.zeros(SIZE)) == []
    holes = stays()
    holes[::7] = np.nan
    assert lasting(holes) == [1000]  # of every seventh step twice as long nothing is said


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


def test_jumps_are_short_unless_said():
    assert Jumps(np.array([1]), 2.0).short
