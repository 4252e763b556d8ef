# SPDX-License-Identifier: Apache-2.0
"""Recordings on the controller's grid: samples where they belong, set-points in between."""

import sys

from hypothesis import example, given, settings
from hypothesis import strategies as st
import numpy as np
import pytest
from reader_cases import add
from scipy.interpolate import CubicHermiteSpline, make_interp_spline

from ros2_ident.errors import IdentError
from ros2_ident.recording import align, check, Dataset, Recording, RecordingBuilder, Stream
from ros2_ident.recording.align import interpolate_setpoint
from ros2_ident.recording.grid import find_ticks

CYCLE = 5e-4
START = 1_700_000_000_000_000_000
NAMES = ('drive_1', 'drive_2')


def motion(time):
    """Return set-point and velocity (T, 2) of two drives, smooth, at rest in the beginning."""
    phase = 2.0 * np.pi * np.array([1.0, 1.7]) * time[:, None]
    return 0.05 * (1.0 - np.cos(phase)), 0.05 * np.sin(phase) * phase / time[:, None].clip(1e-9)


def stream(ticks, names=NAMES, fields='pve', jitter=0, seed=0):
    """Return a stream that says where it was sampled: its effort is the cycle's number."""
    rng = np.random.default_rng(seed)
    position, velocity = motion(ticks * CYCLE)
    effort = np.stack([ticks, ticks + 0.5], axis=1).astype(float)
    place = [NAMES.index(name) for name in names]
    values = [
        values[:, place] if letter in fields else None
        for letter, values in zip('pve', (position, velocity, effort), strict=True)
    ]
    noise = rng.integers(-jitter, jitter, ticks.size, endpoint=True)
    return Stream(names, START + ticks * 500_000 + noise, *values)


@settings(max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 2**31),
    jitter=st.integers(0, 150_000),
    order=st.permutations(NAMES),
    begin=st.integers(0, 3),
)
def test_every_sample_is_at_its_cycle(seed, jitter, order, begin):
    rng = np.random.default_rng(seed)

    def ticks(late=0):
        kept = np.arange(late, 1000) * 2
        return kept[rng.random(kept.size) > 0.02]

    recording = Recording(
        state=stream(ticks(), fields='pv', jitter=jitter, seed=seed),
        effort=stream(ticks(), tuple(order), 'e', jitter=jitter, seed=seed + 1),
        command=stream(ticks(begin), tuple(order)[::-1], 'p', jitter=jitter, seed=seed + 2),
    )
    data = align(recording, NAMES, CYCLE)
    shift = round((data.start - START) / 500_000)
    there = np.isfinite(data.effort[0])
    np.testing.assert_array_equal(data.effort[0, there], np.flatnonzero(there) + shift)
    np.testing.assert_array_equal(data.effort[1, there], data.effort[0, there] + 0.5)
    assert np.isfinite(data.effort[1]).sum() == there.sum()
    position, velocity = motion((np.arange(data.cycles) + shift) * CYCLE)
    measured = np.isfinite(data.position)
    np.testing.assert_allclose(data.position[measured], position.T[measured], atol=1e-14)
    np.testing.assert_allclose(data.velocity[measured], velocity.T[measured], atol=1e-12)
    # samples end with a dropped one now and then: the set-point is held there
    inner = slice(20, -20)
    np.testing.assert_allclose(data.command_position[:, inner], position.T[:, inner], atol=1e-9)
    np.testing.assert_allclose(data.command_velocity[:, inner], velocity.T[:, inner], atol=1e-6)


def test_effort_comes_from_the_state_where_the_effort_stream_lacks_a_drive():
    ticks = np.arange(100) * 2
    other = Stream(('drive_1',), START + ticks * 500_000, effort=np.full((100, 1), 7.0))
    data = align(Recording(stream(ticks), other), NAMES, CYCLE)
    assert np.nanmax(data.effort[0]) == 7.0
    assert data.effort[1, 4] == 4.5
    alone = Stream(('x',), START + ticks * 500_000, effort=np.full((100, 1), 7.0))
    data = align(Recording(stream(ticks), alone), NAMES, CYCLE)
    assert data.effort[0, 4] == 4.0
    assert 'holds none of the drives, only x' in data.warnings[0]


@pytest.mark.parametrize('apart', [0, 30_000, 210_000, 730_000])
def test_drives_that_publish_one_by_one(apart):
    """Each drive has messages of its own, stamped some time after those of the other."""
    builder = RecordingBuilder()
    for k in range(0, 400, 2):
        position, velocity = motion(np.array([k * CYCLE]))
        for i, name in enumerate(NAMES):
            stamp = START + k * 500_000 + i * apart
            add(builder, 'state', stamp, [name], position[:, i], velocity[:, i], [k + 0.5 * i])
            add(builder, 'command', stamp, [name], position[:, i])
    (recording,) = builder.build()
    data = align(recording, NAMES, CYCLE)
    late = round(apart / 500_000)
    assert {x.stride for x in data.streams.values()} == {2}
    for i, row in enumerate(data.effort):
        tick = np.flatnonzero(np.isfinite(row))
        assert tick.size == 200
        np.testing.assert_array_equal(row[tick], tick - i * late + 0.5 * i)


def test_a_log_that_goes_on_at_another_rate_is_not_bent_to_the_first():
    time = np.append(10e6 * np.arange(3500), 35e9 + 4.2e6 * np.arange(1500)).astype(np.int64)
    for cycle in (1e-3, 1e-2):
        ticks = find_ticks(time, 0, cycle)
        assert np.abs(ticks.tick * cycle - time * 1e-9).max() < 0.51 * cycle


def test_samples_on_the_grid_are_numbered_once(monkeypatch):
    lost = np.delete(np.arange(500), [7, 100, 101]) * 2
    recording = Recording(stream(lost, fields='pv'), stream(np.arange(500) * 2, fields='e'))
    calls = []

    def counted(*given):
        calls.append(given)
        return find_ticks(*given)

    for module in ('align', 'grid'):
        monkeypatch.setattr(sys.modules[f'ros2_ident.recording.{module}'], 'find_ticks', counted)
    found = align(recording, NAMES, CYCLE).streams
    assert (found['state'].missing, found['effort'].missing) == (3, 0)
    assert len(calls) == 2


def test_errors_name_the_remedy():
    ticks = np.arange(100) * 2
    good = Recording(stream(ticks), source='log')
    still = stream(ticks, fields='pv')
    silent = Stream(NAMES, still.stamp, still.position, None, np.full((100, 2), np.nan))
    half = Stream(NAMES, still.stamp, still.position * [1.0, np.nan], None, None)
    for recording, code, text, more in (
        (good, 'INVALID_GOAL', 'drives are .*; name at least one', {'drives': ()}),
        (good, 'MISSING_STREAM', 'log: state has no joint x, it holds drive_1, drive_2; name',
         {'drives': ('drive_1', 'x')}),
        (still, 'MISSING_STREAM', 'holds effort; record it, or name its topic or column', {}),
        (silent, 'BAD_VALUES', 'every effort of the drives is NaN; switch', {}),
        (half, 'MISSING_STREAM', 'no position of drive_2; leave', {'need': ('position',)}),
        (stream(ticks, fields='e'), 'MISSING_STREAM', 'no stream holds position; record it',
         {'need': ('position',)}),
        (good, 'MISSING_STREAM', 'holds no command stream', {'need': ('command',)}),
        (Recording(command=still), 'MISSING_STREAM',
         'no state or effort stream holds the drives; name their topic or column', {}),
        (Recording(good.state, command=stream(ticks + 10_000, fields='p')), 'NO_DATA',
         'command and state do not overlap in time, they are 4.9 s apart; record them', {}),
        (Recording(good.state, command=stream(ticks, fields='v')), 'MISSING_STREAM',
         'command: holds no position of drive_1', {'need': ('command',)}),
        (stream(ticks[:1]), 'NO_DATA', 'has a single sample of the drives', {}),
    ):  # fmt: skip
        recording = recording if isinstance(recording, Recording) else Recording(recording)
        with pytest.raises(IdentError, match=text) as caught:
            align(recording, cycle=CYCLE, **{'drives': NAMES, **more})
        assert caught.value.code.name == code and '\n' not in caught.value.message
    assert align(Recording(still), NAMES, CYCLE, need=()).effort is None
    half = Stream(NAMES, still.stamp, still.position, None, np.ones((100, 2)) * [1.0, np.nan])
    assert np.isnan(align(Recording(half), NAMES, CYCLE).effort).all(axis=1).tolist() == [
        False,
        True,
    ]


def test_a_data_set_refuses_wrong_shapes():
    values = np.zeros((2, 5))
    with pytest.raises(IdentError, match='arrays of a data set have shapes'):
        Dataset(NAMES, CYCLE, 0, values, values, values[:, :3], None, None)
    with pytest.raises(IdentError, match=r'have shapes .*, expected one \(1, cycles\)'):
        Dataset(('a',), CYCLE, 0, values, values, None, None, None)
    with pytest.raises(IdentError, match='command_velocity has cycles without a value'):
        Dataset(NAMES, CYCLE, 0, values, values * np.nan, None, None, None)
    data = Dataset(NAMES, CYCLE, 0, values, values, None, None, None)
    assert not data.command_position.flags.writeable
    np.testing.assert_allclose(data.time, np.arange(5) * CYCLE)


TIME, FINE = 0.01 * np.arange(40), 0.001 * np.arange(-20, 420)


def test_set_points_between_samples_follow_a_quintic_and_hold_a_step():
    wave = np.sin(7.0 * TIME) + 0.2 * TIME
    inside = np.clip(FINE, 0.0, TIME[-1])
    for speed, spline in (
        (None, make_interp_spline(TIME, wave, k=5)),
        (7.0 * np.cos(7.0 * TIME), CubicHermiteSpline(TIME, wave, 7.0 * np.cos(7.0 * TIME))),
    ):
        found, rate = interpolate_setpoint(TIME, wave, speed, FINE)
        np.testing.assert_allclose(found, spline(inside), atol=1e-12)
        np.testing.assert_allclose(rate[21:400], spline(inside, 1)[21:400], atol=1e-9)
        assert rate[0] == rate[-1] == 0.0
    found, rate = interpolate_setpoint(TIME, np.where(TIME < 0.2, 0.0, 1.0), None, FINE)
    np.testing.assert_allclose(found, FINE > 0.2 - 1e-9, atol=1e-12)
    np.testing.assert_allclose(rate, 0.0, atol=1e-9)


def test_set_points_of_speeds_alone_drive_no_model():
    ticks = np.arange(200) * 2
    recording = Recording(stream(ticks, fields='ve'), command=stream(ticks, fields='v'))
    data = align(recording, NAMES, CYCLE)
    assert data.command_position is None and data.position is not None
    assert any('holds speeds and no positions, so the recorded' in x for x in data.warnings)
    (said,) = check([recording], NAMES).of('no_command')
    assert said.level == 'warn' and said.sentence in data.warnings


def test_speeds_without_positions_are_integrated():
    ticks = np.arange(400) * 5
    data = align(Recording(state=stream(ticks, fields='ve')), NAMES, CYCLE)
    position, _ = motion(ticks * CYCLE)
    moved = position - position[0]
    np.testing.assert_allclose(data.position[:, ::5], moved.T[:, : data.cycles], atol=1e-4)
    assert any('the position of drive_1, drive_2 is the integral' in x for x in data.warnings)
    command = stream(ticks, fields='p')
    assert (
        align(Recording(state=stream(ticks, fields='ve'), command=command), NAMES, CYCLE).position
        is None
    )


def test_a_slow_log_without_set_point_takes_a_grid_of_its_own() -> None:
    ticks = np.delete(np.arange(3, 4000, 40), [5, 17])
    fine = align(Recording(stream(ticks)), NAMES, CYCLE)
    slow = fine.coarse(8)
    assert slow.cycle == pytest.approx(5 * CYCLE)
    for one, other in zip(
        (fine.position, fine.velocity, fine.effort),
        (slow.position, slow.velocity, slow.effort),
        strict=True,
    ):
        there, kept = np.isfinite(one[0]), np.isfinite(other[0])
        np.testing.assert_array_equal(one[:, there], other[:, kept])
        stamps = [d.start * 1e-9 + d.time[x] for d, x in ((fine, there), (slow, kept))]
        np.testing.assert_allclose(stamps[0] - stamps[1], 0.0, atol=1e-6)
    uneven = align(Recording(stream(np.append(ticks, 4001))), NAMES, CYCLE)
    assert uneven.coarse(8).cycle == CYCLE
    followed = Recording(stream(ticks), command=stream(np.arange(4000), fields='pv'))
    assert align(followed, NAMES, CYCLE).coarse(8).cycle == CYCLE


# ---------------------------------------------------------------------- the grid finder


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


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 2**31), cycle=st.floats(0.0101, 0.0109))
def test_steps_of_two_lengths_are_no_grid_of_their_mean(seed, cycle):
    # A loop at 2 ms that logs at every fifth turn or every sixth.
    time = np.cumsum(np.random.default_rng(seed).choice([0.010, 0.012], 3000))
    stamp = START + np.round(time * 1e9).astype(np.int64)
    assert find_ticks(stamp, START, cycle).stride == 0
    assert find_ticks(stamp, START, 0.002).stride in (5, 6)


def test_samples_beside_their_cycle_count_as_on_a_straight_line():
    time = np.cumsum(np.random.default_rng(1).choice([0.010, 0.012], 3000))
    stamp = START + np.round(time * 1e9).astype(np.int64)
    position = np.stack([0.3 * time, 1.0 - time], axis=1)
    position[1500] = np.nan
    data = align(Recording(Stream(NAMES, stamp, position, effort=position)), NAMES, 0.0105)
    there = np.isfinite(data.position[0])
    seconds = (data.start - START) * 1e-9 + np.arange(data.cycles) * data.cycle
    assert 0.9 < there.mean() < 1.0
    np.testing.assert_allclose(
        data.position[:, there], [0.3 * seconds[there], 1.0 - seconds[there]]
    )
    np.testing.assert_array_equal(data.effort, data.position)


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
