# SPDX-License-Identifier: Apache-2.0
"""Which cycles of a log are used, and what is said of the others."""

import numpy as np
import pytest

from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.recording import align, Recording, Stream

CYCLE = 1e-3
MS = 1_000_000
NAMES = ('a',)


def sampled(ticks, effort=True, names=NAMES):
    columns = np.repeat(np.sin(0.01 * np.asarray(ticks))[:, None], len(names), axis=1)
    return Stream(names, ticks * MS, columns, None, columns + 2.0 if effort else None)


STATE = np.arange(2000)
PARTS = np.r_[np.arange(0, 500), np.arange(700, 1500), np.arange(1700, 2000)]


@pytest.mark.parametrize(
    ('state', 'command', 'begin', 'cycles', 'said'),
    [
        (STATE, STATE, 0, 2000, None),
        # A first or last sample of the command may have been dropped, of a slow one five.
        (np.arange(-10, 2000), STATE, -10, 2010, None),
        (np.arange(-60, 2000), STATE, 0, 2000, '60 of 2060 samples lie outside the command'),
        (np.arange(0, 2009), STATE, 0, 2009, None),
        (np.arange(-50, 2000), np.arange(0, 2001, 10), -50, 2051, None),
        # What is short by samples or by time is bridged; of three stretches the longest is used.
        (STATE, np.delete(STATE, slice(500, 540)), 0, 2000, None),
        (STATE, np.delete(STATE, slice(500, 560)), 560, 1440, 'has 1 holes of up to 0.061 s'),
        (STATE, PARTS, 700, 800, 'has 2 holes of up to 0.201 s, and only the longest stretch'),
    ],
)
def test_the_command_says_which_cycles_are_used(state, command, begin, cycles, said):
    found = align(Recording(sampled(state), command=sampled(command, False)), NAMES, CYCLE)
    assert (found.start // MS, found.cycles) == (begin, cycles)
    words = ' | '.join(found.warnings)
    assert words == '' if said is None else said.split(', and')[0] in words


@pytest.mark.parametrize(('last', 'off'), [(940, True), (960, False)])
def test_a_command_that_stops_before_the_state_switches_the_motors_off(last, off):
    command, state = sampled(np.arange(last + 1), False), sampled(np.arange(1000))
    found = align(Recording(state, command=command), NAMES, CYCLE, released=True)
    assert found.released == (last + 1 if off else None)
    assert found.cycles == (1000 if off else last + 1)
    assert off == any('stops 0.06 s before the state' in x for x in found.warnings)
    assert align(Recording(state, command=command), NAMES, CYCLE).released is None


def test_memory_of_the_grid_is_bounded(monkeypatch):
    monkeypatch.setenv('ROS2_IDENT_MAX_MEMORY', '1')
    most = (1 << 20) // (10 * 8)
    recording = Recording(sampled(np.arange(0, most + 1)))
    assert align(recording.between(0, recording.end), NAMES, CYCLE).cycles == most
    with pytest.raises(IdentError, match=f'a grid of {most + 1} controller cycles') as caught:
        align(recording, NAMES, CYCLE)
    assert caught.value.code is ErrorCode.BAD_VALUES
