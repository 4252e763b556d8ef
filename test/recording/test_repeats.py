# SPDX-License-Identifier: Apache-2.0
"""Samples that are no measurement are named; logs that are all right are left alone."""

import re

import numpy as np
import pytest

from ros2_ident.recording import check
from ros2_ident.recording.builder import RecordingBuilder

PERIOD = 0.002
TIME = PERIOD * np.arange(5000)
PLACE = 1.2 * np.sin(1.1 * TIME) + 0.5 * np.sin(3.3 * TIME) + 0.2 * np.sin(9.0 * TIME)
SPEED = np.gradient(PLACE, PERIOD)
NOISE = 0.01 * np.random.default_rng(1).normal(size=TIME.size)
EFFORT = 0.05 * np.gradient(SPEED, PERIOD) + 0.3 * np.tanh(SPEED / 0.01) + 0.1 * SPEED + NOISE


def said(place=PLACE, effort=EFFORT, goal=None):
    builder = RecordingBuilder('log', b'')
    stamp = np.round(1e9 * TIME).astype(np.int64)
    rows = {('state', 'arm', 'position'): place, ('effort', 'arm', 'effort'): effort}
    if goal is not None:
        rows['command', 'arm', 'position'] = goal
    builder.add_columns(stamp, rows)
    codes = {'effort_frozen', 'held', 'effort_error', 'effort_register'}
    return {f.code: f.sentence for f in check(builder.build()).findings if f.code in codes}


def frozen(effort):
    out = effort.copy()
    out[:800], out[3500:] = 0.0, effort[3500]
    return out


def polled(effort):
    # every eighth is read, and some readings are those before
    out = np.round(effort[::8], 2)
    return np.repeat(out, 8)[: effort.size]


GOAL = np.interp(TIME - 0.02, TIME, PLACE)
COUNTS = np.round(200.0 * EFFORT)


@pytest.mark.parametrize(
    ('log', 'code', 'text'),
    [
        ({'effort': frozen(EFFORT)}, 'effort_frozen', 'the effort is 0 from 0 to 1.6 s and '),
        ({'place': np.repeat(PLACE[::8], 8)}, 'held', 'stays for 16 ms, .* read at 62.5 Hz'),
        ({'effort': polled(EFFORT)}, 'held', 'each effort stays for 16 ms, .* read at 62.5 Hz'),
        ({'goal': GOAL, 'effort': 4.5 * (GOAL - PLACE)}, 'effort_error', 'is 4.5 times set-point'),
        ({'effort': np.where(COUNTS < 0, 1024 - COUNTS, COUNTS)}, 'effort_register', 'bit 1024'),
    ],
)  # fmt: skip
def test_what_is_no_measurement_is_named(log, code, text):
    found = said(**log)
    assert list(found) == [code]
    assert re.search(text, found[code])


@pytest.mark.parametrize(
    'log',
    [{}, {'place': np.round(PLACE, 2)}, {'effort': np.round(EFFORT, 1)}, {'effort': COUNTS},
     {'goal': GOAL}],
)  # fmt: skip
def test_a_coarse_log_is_left_alone(log):
    assert not said(**log)
