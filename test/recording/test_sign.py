# SPDX-License-Identifier: Apache-2.0
"""The sign of an effort at constant speed: sound, reversed, its size alone, one way, in an arm."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import uniform_filter1d
from scipy.signal import lfilter

from ros2_ident.recording.motion import Motion, smooth_motion
from ros2_ident.recording.quality import sign_of


def constant_speeds(seed, both=True, weight=2.0):
    """Return a log of constant speeds: friction, weight and spring, ripple, coloured noise."""
    rng = np.random.default_rng(seed)
    period = 1.0 / rng.choice([25.0, 100.0, 250.0])
    levels = rng.uniform(0.3, 1.0, size=8) * 10.0 ** rng.uniform(-1.0, 1.0)
    speed = np.repeat(levels, int(3.0 / period))
    if both:
        speed *= np.repeat([1.0, -1.0] * 4, int(3.0 / period))
    speed = uniform_filter1d(speed, max(3, int(0.1 / period)))
    position = np.cumsum(speed) * period
    stroke = np.ptp(position)
    step = stroke * 10.0 ** rng.uniform(-5.0, -3.0)
    place, velocity, acceleration = smooth_motion(
        np.round(position / step)[None] * step, period, min(15.0, 0.2 / period)
    )
    top = np.abs(speed).max()
    sides = 1.0 + weight * rng.uniform(-0.2, 0.2) * np.sign(speed)
    effort = np.tanh(speed / (0.01 * top)) * sides
    effort += rng.uniform(0.0, 1.0) * speed / top + 0.02 * np.gradient(speed, period) / top
    effort += weight * (rng.normal() + 0.5 * rng.normal() * position / stroke)
    effort += rng.uniform(0.0, 0.5) * np.sin(60.0 * position / stroke)
    memory = rng.choice([0.0, 0.9, 0.98])
    noise = lfilter([np.sqrt(1.0 - memory**2)], [1.0, -memory], rng.normal(size=effort.size))
    effort += 10.0 ** rng.uniform(-1.5, 0.0) * noise
    alone = np.empty((0, effort.size))
    return Motion(period, place[0], velocity[0], acceleration[0], None, effort, alone)


def test_at_constant_speed_no_sound_log_is_reversed_and_each_reversed_one_is():
    for seed in range(20):
        log = constant_speeds(seed)
        assert sign_of(log) == 'right', seed
        flipped = sign_of(replace(log, effort=-log.effort))
        assert flipped == 'reversed' or (flipped == 'either' and log.effort.max() <= 0.0), seed


@pytest.mark.parametrize('change', [np.positive, np.negative, np.abs])
def test_one_way_an_unknown_load_leaves_the_sign_open(change):
    for seed in range(5):
        log = constant_speeds(seed, both=False)
        assert sign_of(replace(log, effort=change(log.effort))) == 'open', seed


def test_there_and_back_once_the_sign_is_open():
    for seed in range(5):
        log = constant_speeds(seed)
        end = int(5.5 / log.period)
        rows = {n: getattr(log, n)[..., :end] for n in ('position', 'velocity', 'acceleration')}
        once = replace(log, **rows, effort=log.effort[:end], beside=log.beside[:, :end])
        assert sign_of(once) == sign_of(replace(once, effort=-once.effort)) == 'open', seed


def test_the_size_of_a_current_with_an_idle_part_is_told_from_a_reversed_one():
    time = np.arange(0.0, 16.0, 4e-3)
    place = 0.6 * np.sin(1.9 * time) + 0.2 * np.sin(4.4 * time + 1.0)
    moved = smooth_motion(place[None], 4e-3, 15.0)
    place, speed, change = (row[0] for row in moved)
    made = 1.5 * np.tanh(speed / 0.02) + 0.5 * speed + 0.05 * change
    made += np.random.default_rng(0).normal(0.0, 0.02, time.size)
    log = Motion(4e-3, place, speed, change, None, made, np.empty((0, time.size)))
    # Neither changes its sign: the idle part of the one, a weight of the other.
    assert sign_of(replace(log, effort=np.abs(made) + 0.3), alone=True) == 'unsigned'
    assert sign_of(replace(log, effort=6.0 - made), alone=True) == 'reversed'
    assert sign_of(replace(log, effort=6.0 + made), alone=True) == 'right'
