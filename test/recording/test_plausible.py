# SPDX-License-Identifier: Apache-2.0
"""What is said of one drive's motion and effort, each rule at its edge."""

from dataclasses import replace

import numpy as np
import pytest

from ros2_ident.recording import Recording, Stream
from ros2_ident.recording.motion import best_lag, count_reversals, Motion, motion_of

PERIOD = 0.01
TIME = PERIOD * np.arange(3000)


def motion(effort=None, reported=None):
    """Return a motion of three slow waves."""
    parts = [(0.3, 1.1, 0.0), (0.1, 3.3, 0.7), (0.02, 9.0, 0.2)]
    place = sum(a * np.sin(w * TIME + p) for a, w, p in parts)
    speed = sum(a * w * np.cos(w * TIME + p) for a, w, p in parts)
    change = sum(-a * w * w * np.sin(w * TIME + p) for a, w, p in parts)
    return Motion(
        PERIOD, place, speed, change, reported, effort, np.empty((0, place.size))
    )


FREE = motion()


# ---------------------------------------------------------------------- motion


def test_an_effort_is_taken_as_it_is_logged_unless_a_factor_is_given():
    stamp = (1e9 * TIME).astype(np.int64) + 10**18
    place = FREE.position[:, None]
    recording = Recording(Stream(('a',), stamp, place, effort=3.0 * place))
    for factor, found in ((1.0, motion_of(recording, 'a')), (2.0, motion_of(recording, 'a', 2.0))):
        np.testing.assert_allclose(found.effort, 3.0 * factor * FREE.position, atol=1e-9)


def test_reversals_are_counted_between_stretches_of_real_motion():
    def counted(*speeds):
        values = np.repeat(np.array(speeds, dtype=float), 10)
        return count_reversals(replace(FREE, velocity=values))

    assert counted(1.0, -1.0, 1.0) == 2
    assert counted(1.0, 0.06, 1.0) == 0
    assert counted(1.0, -0.06, 1.0) == 2
    assert counted(1.0, -0.04, 1.0) == 0
    assert counted(1.0, 0.0, -1.0) == 1


# ---------------------------------------------------------------------- lags


@pytest.mark.parametrize('lag', [0.004, 0.03, 0.0333, 0.113])
@pytest.mark.parametrize('gain', [2.0, -3.0])
def test_a_lag_is_found_to_a_fraction_of_a_sample(lag, gain):
    columns = np.stack([np.sin(2.0 * TIME), np.cos(5.0 * TIME)], axis=1)
    late = TIME - lag
    target = gain * np.sin(2.0 * late) + 0.5 * np.cos(5.0 * late)
    found, solution, share = best_lag(columns, target, PERIOD, -0.02)
    assert found == pytest.approx(lag, abs=3e-4)
    np.testing.assert_allclose(solution, [gain, 0.5], rtol=0.02)
    assert share > 0.999
