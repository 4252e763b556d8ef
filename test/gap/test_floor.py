# SPDX-License-Identifier: Apache-2.0
from dataclasses import replace

from gap_signals import CYCLE, motion, needs_practice, NOISE, practice_case, residual
import numpy as np
import pytest

from ros2_ident.errors import IdentError
from ros2_ident.gap.floor import find_repeats, noise_floor, pooled_floor
from ros2_ident.recording import Dataset


def _data(of, effort, velocity=None):
    rate = of.velocity if velocity is None else velocity
    position = np.cumsum(rate, axis=1) * CYCLE
    return Dataset(of.drives, CYCLE, 0, position, rate, None, None, effort)


def test_white_noise_is_measured():
    of = motion()
    row = residual(of)
    floor = noise_floor(row, _data(of, row))
    assert floor.method == 'high frequency'
    assert floor.per_drive == pytest.approx([NOISE, NOISE], rel=0.04)
    assert (floor.low < floor.per_drive).all()
    assert (floor.per_drive < floor.high).all()


def test_a_log_by_a_clock_of_its_own_tells_its_noise_too():
    of = motion()
    count = of.position.shape[1]
    there = np.round(np.arange(0.0, count, 5.34)).astype(int)
    there = there[there < count]
    row = np.full(of.position.shape, np.nan)
    row[:, there] = NOISE * np.random.default_rng(3).standard_normal((2, there.size))
    row[:, there[200:210]] = np.nan
    floor = noise_floor(row, _data(of, row))
    assert floor.per_drive == pytest.approx([NOISE, NOISE], rel=0.06)


def test_the_step_is_that_of_what_is_compared():
    of = motion()
    step = 0.02
    seen = np.round(of.position / step) * step
    data = replace(_data(of, residual(of)), position=seen)
    assert noise_floor(seen - of.position, data).step[0] == 0.0
    floor = noise_floor(seen - of.position, data, quantity='position')
    assert floor.step[0] == pytest.approx(step, rel=1e-6)
    assert floor.per_drive[0] == pytest.approx(step / np.sqrt(12.0), rel=0.05)


@pytest.mark.parametrize('planted', ['friction', 'spikes', 'ringing'])
def test_an_effect_does_not_change_the_floor(planted):
    of = motion()
    time = np.arange(of.position.shape[1]) * CYCLE
    signal = {
        'friction': 0.1 * np.tanh(of.velocity[0] / 0.003),
        'spikes': np.where(np.arange(time.size) % 1600 == 0, 1.0, 0.0),
        'ringing': 0.05 * np.sin(2.0 * np.pi * 24.0 * time),
    }[planted]
    clean, dirty = residual(of), residual(of, signal)
    one, two = (noise_floor(r, _data(of, r)).per_drive for r in (clean, dirty))
    assert two == pytest.approx(one, rel=0.02)


def test_a_coarse_step_is_part_of_the_floor():
    of = motion()
    step = 0.05
    effort = np.round(residual(of, 0.2 * of.torque[0], noise=1e-4) / step) * step
    floor = noise_floor(effort - 0.2 * of.torque, _data(of, effort))
    assert floor.step[0] == pytest.approx(step)
    assert floor.per_drive[0] == pytest.approx(step / np.sqrt(12.0), rel=0.05)


def test_an_effort_that_hardly_ever_changes_has_a_floor():
    of = motion()
    effort = np.zeros_like(of.position)
    effort[:, 1000:1400] = np.random.default_rng(3).normal(0.0, 0.1, (2, 400))
    floor = noise_floor(effort, _data(of, effort))
    assert (floor.per_drive > 0.0).all() and (floor.per_drive < 0.1).all()


def test_two_recordings_tell_the_floor_better_than_one():
    of = motion()
    rows = [residual(of, seed=seed) for seed in (1, 2)]
    data = [_data(of, row) for row in rows]
    alone = [noise_floor(row, log) for row, log in zip(rows, data, strict=True)]
    both = pooled_floor(rows, data)
    between = np.sort([f.per_drive for f in alone], axis=0)
    assert ((between[0] <= both.per_drive) & (both.per_drive <= between[1])).all()
    for f in alone:
        assert (np.log(both.high / both.low) < np.log(f.high / f.low)).all()
    # A recording too short to tell anything does not spoil the other's.
    short = np.full_like(rows[1], np.nan)
    assert pooled_floor([rows[0], short], data).per_drive == pytest.approx(alone[0].per_drive)
    with pytest.raises(IdentError, match='too few'):
        pooled_floor([short], data[:1])


def test_a_recording_that_repeats_tells_the_floor_alone():
    of = motion(3.0)
    rate = np.tile(of.velocity, 4)
    noise = NOISE * np.random.default_rng(1).standard_normal(rate.shape)
    once = 2.0 * residual(of)
    repeating = noise_floor(noise, _data(of, noise, rate))
    both = pooled_floor([once, noise], [_data(of, once), _data(of, noise, rate)])
    assert both.method == 'repeats'
    assert both.per_drive == pytest.approx(repeating.per_drive)


def test_repeats_are_found_and_cancel_what_repeats():
    of = motion(3.0)
    rate = np.tile(of.velocity, 4)
    effect = np.tile(0.1 * np.sign(of.velocity), 4)
    row = NOISE * np.random.default_rng(1).standard_normal(rate.shape) + effect
    data = _data(of, row, rate)
    repeats = find_repeats(data)
    assert repeats is not None
    assert (repeats.period, repeats.count) == (of.velocity.shape[1], 4)
    floor = noise_floor(row, data)
    assert floor.method == 'repeats'
    assert floor.per_drive == pytest.approx([NOISE, NOISE], rel=0.04)


def test_a_motion_without_repeats_has_none():
    of = motion()
    assert find_repeats(_data(of, residual(of))) is None


def test_too_few_samples_are_refused():
    of = motion()
    row = np.full(of.position.shape, np.nan)
    row[:, :200:2] = 0.0
    with pytest.raises(IdentError, match='too few'):
        noise_floor(row, _data(of, row))


@needs_practice
def test_the_practice_noise_comes_out():
    values = []
    for number in (0, 3, 4, 9, 11, 15):
        case = practice_case(number)
        values.append(noise_floor(case.residual, case.data).per_drive)
    assert np.mean(values) == pytest.approx(NOISE, rel=0.02)
    assert np.array(values) == pytest.approx(NOISE, rel=0.06)
