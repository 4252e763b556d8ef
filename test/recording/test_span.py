# SPDX-License-Identifier: Apache-2.0
"""Which cycles of a log are used, and what is said of the others: each rule at its edge."""

import numpy as np
import pytest

from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.recording import align, Recording, Stream
from ros2_ident.recording.limits import Limits
from ros2_ident.recording.placing import place

CYCLE = 1e-3
MS = 1_000_000
NAMES = ('a',)


def sampled(ticks, effort=True, moving=True, names=NAMES):
    ticks = np.asarray(ticks)
    place = np.sin(0.01 * ticks) if moving else np.zeros(ticks.size)
    columns = np.repeat(place[:, None], len(names), axis=1)
    return Stream(names, ticks * MS, columns, None, columns + 2.0 if effort else None)


def spanned(state, command, **more):
    found = align(
        Recording(sampled(state), command=sampled(command, effort=False)), NAMES, CYCLE, **more
    )
    return found, ' | '.join(found.quality.warnings)


@pytest.mark.parametrize(
    ('first', 'begin'),
    [(0, 0), (-10, -10), (-11, 0), (3, 0)],  # ten milliseconds may have been dropped
)
def test_a_first_sample_of_the_command_may_have_been_dropped(first, begin):
    found, _ = spanned(np.arange(first, 2000), np.arange(0, 2000))
    assert (found.start // MS, found.cycles) == (begin, 2000 - begin)


@pytest.mark.parametrize(('last', 'cycles'), [(1999, 2000), (2009, 2010), (2010, 2000)])
def test_so_may_a_last_one(last, cycles):
    found, _ = spanned(np.arange(0, last + 1), np.arange(0, 2000))
    assert found.cycles == cycles


def test_of_a_slow_command_five_samples_are_waited_for():
    command = np.arange(0, 2001, 10)
    assert spanned(np.arange(-50, 2000), command)[0].start == -50 * MS
    assert spanned(np.arange(-51, 2000), command)[0].start == 0


@pytest.mark.parametrize(
    ('outside', 'said'), [(15, False), (20, False), (60, True)]
)  # more than one in fifty
def test_samples_that_are_not_used_are_told(outside, said):
    found, words = spanned(np.arange(-outside, 1000), np.arange(0, 1000))
    assert (f'state: {outside} of {1000 + outside} samples lie outside the command' in words) is (
        said
    )
    few = align(
        Recording(sampled(np.arange(-60, 40, 20)), command=sampled(np.arange(0, 100), False)),
        NAMES,
        CYCLE,
    )
    assert not any('outside' in x for x in few.quality.warnings)


@pytest.mark.parametrize(
    ('gap', 'step', 'hole'), [(50, 1, False), (52, 1, True), (100, 10, False), (110, 10, True)]
)
def test_a_hole_is_long_by_samples_and_by_time(gap, step, hole):
    early = np.arange(0, 1000, step)
    late = np.arange(0, 1500, step) + early[-1] + gap
    found, said = spanned(np.arange(0, late[-1] + 1), np.r_[early, late])
    if hole:
        assert found.start == late[0] * MS and found.cycles == late[-1] - late[0] + 1
        assert f'command: has 1 holes of up to {gap * 1e-3:.3g} s' in said
        assert f'{(late[-1] - late[0]) * 1e-3:.4g} s of {late[-1] * 1e-3:.4g} s, is used' in said
    else:
        assert found.cycles == late[-1] + 1 and 'holes' not in said


def test_the_longest_of_three_stretches_is_used():
    parts = np.r_[np.arange(0, 500), np.arange(700, 1500), np.arange(1700, 2000)]
    found, said = spanned(np.arange(0, 2000), parts)
    assert (found.start // MS, found.cycles) == (700, 800)
    assert 'has 2 holes of up to 0.201 s' in said


@pytest.mark.parametrize(
    ('last', 'step', 'off'),
    [(940, 1, True), (960, 1, False), (890, 10, True), (910, 10, False)],
)
def test_a_command_that_stops_before_the_state_switches_the_motors_off(last, step, off):
    command = np.arange(last % step, last + 1, step)
    found, said = spanned(np.arange(0, 1000), command, released=True)
    if off:
        assert (found.released, found.cycles) == (last + 1, 1000)
        assert f'stops {(1000 - last) * 1e-3:.3g} s before the state' in said
        assert 'outside the command' not in said
    else:
        assert found.released is None
    kept, _ = spanned(np.arange(0, 1000), command)
    assert kept.released is None


def test_memory_of_the_grid_is_bounded():
    recording = Recording(sampled(np.arange(0, 1000)))
    needed = 10 * 1000 * 8
    assert align(recording, NAMES, CYCLE, limits=Limits(memory=needed)).cycles == 1000
    with pytest.raises(IdentError, match='a grid of 1000 controller cycles takes') as caught:
        align(recording, NAMES, CYCLE, limits=Limits(memory=needed - 1))
    assert caught.value.code is ErrorCode.BAD_VALUES


def test_other_joints_are_kept_beside_as_many_as_are_worth_it():
    names = tuple('abcdefghijklmnop')
    state = sampled(np.arange(300, 400, 2), names=names)
    found = align(Recording(state), NAMES, CYCLE)
    assert list(found.beside) == list(names[1:13])
    np.testing.assert_allclose(found.beside['b'][::2], np.sin(0.01 * np.arange(300, 400, 2)))
    assert found.beside['b'].shape == (99,)
    silent = np.array(state.position)
    silent[:, 1] = np.nan
    silent[::2, 2] = np.nan
    less = Stream(names, state.stamp, silent, None, state.effort)
    beside = align(Recording(less), NAMES, CYCLE).beside
    assert 'b' not in beside
    np.testing.assert_allclose(beside['c'][2::2], np.sin(0.01 * np.arange(302, 400, 2)), atol=3e-4)


def test_the_account_of_a_stream_is_that_of_its_cycles():
    ticks = np.delete(np.arange(0, 400, 2), [10, 11, 70])
    stream = sampled(ticks)
    effort = np.array(stream.effort)
    effort[5:9] = np.nan
    state = Stream(NAMES, stream.stamp, stream.position, None, effort)
    command = sampled(np.arange(100, 300, 2), effort=False)
    found = align(Recording(state, command=command), NAMES, CYCLE)
    whole = align(Recording(state), NAMES, CYCLE).quality.stream('state')
    assert (whole.samples, whole.missing, whole.nan) == (197, 3, {'effort a': 4})
    assert whole.rate == pytest.approx(500.0) and whole.stride == 2
    part = found.quality.stream('state')
    assert (part.samples, part.missing, part.nan) == (99, 1, {})
    assert found.effort is not None and found.effort.shape == (1, 199)
    # Where all are missing it is no gap of the log.
    effort[:] = np.nan
    silent = Stream(NAMES, stream.stamp, stream.position, None, effort)
    assert align(Recording(silent), NAMES, CYCLE, need=()).quality.stream('state').nan == {}


# ---------------------------------------------------------------------- how samples fell


def test_stamps_come_back_from_cycles():
    state = sampled(np.arange(0, 1000, 2))
    drifted = Stream(NAMES, np.round(state.stamp * 1.0002).astype(np.int64) + 7 * MS + 300_000,
                     state.position, None, state.effort)  # fmt: skip
    placed = place(Recording(drifted), NAMES, CYCLE, [])['state']
    assert placed.reference == drifted.stamp[0]
    for row in (0, 250, 499):
        stamp = placed.stamp_of(int(placed.tick[row]), CYCLE)
        assert abs(stamp - drifted.stamp[row]) < 2_000
    assert placed.instants.tolist() == placed.tick.tolist() == list(range(0, 1000, 2))
    np.testing.assert_array_equal(placed.samples('effort'), state.effort)
    assert placed.samples('velocity') is None
