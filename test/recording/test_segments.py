# SPDX-License-Identifier: Apache-2.0
"""Where a recording ends, by stamps in periods of one: each rule at its edge."""


import numpy as np
import pytest

from ros2_ident.errors import IdentError
from ros2_ident.recording.segments import find_stray, match_segments, split_pauses, split_stamps
from ros2_ident.recording.streams import Stream

S = 1_000_000_000


def off(size, changes):
    """Return even stamps of which some are off by so many periods."""
    stamp = np.arange(size)
    for row, by in changes.items():
        stamp[row] += by
    return stamp


def stream(*stamps, name='a'):
    stamp = np.array(stamps, dtype=np.int64)
    return Stream((name,), stamp, np.zeros((stamp.size, 1)))


# ---------------------------------------------------------------------- wrong stamps


@pytest.mark.parametrize(
    ('by', 'found'), [(11, []), (12, [20]), (-11, []), (-12, [20]), (900, [20])]
)
def test_a_stamp_is_stray_from_more_than_ten_periods_on_both_ways(by, found):
    assert find_stray(off(40, {20: by})).tolist() == found


def test_strays_are_left_out_of_the_segments():
    found = split_stamps(off(40, {20: 900}), 'x')
    assert found.stray.tolist() == [20] and found.reordered == 0
    (rows,) = found.segments
    assert rows.tolist() == [k for k in range(40) if k != 20]


# ---------------------------------------------------------------------- overtaken or begun anew


@pytest.mark.parametrize(
    ('stamps', 'segments', 'late'),
    [
        ([0, 1, 2, 4, 3, 5, 6], 1, 1),
        ([0, 1, 2, 5, 3, 4, 6, 7], 1, 2),
        ([0, 1, 2, 6, 3, 4, 5, 7, 8], 1, 3),
        ([0, 1, 2, 7, 3, 4, 5, 6, 8, 9], 2, 0),  # four are no overtaking
        ([0, 1, 2, 3, 4, 6, 5], 1, 1),  # at the very end
        ([0, 1, 2, 3, 7, 4, 5, 6], 1, 3),
        ([0, 1, 2, 8, 4, 5, 6, 7], 2, 0),
        ([0, 1, 2, 3, 4, 5, 2, 6, 7, 8], 2, 0),  # that stamp was there before
        ([0, 1, 2, 3, 4, 5, -1, 6, 7, 8], 2, 0),  # before the beginning
        ([0, 2, 4, 6, 8, 10, 5, 12, 14], 1, 1),  # two and a half periods back
        ([0, 2, 4, 6, 8, 10, 12, 5, 14, 16], 2, 0),  # more than three
        ([5, 6, 7, 8, 0, 1, 2, 3], 2, 0),
        ([5, 6, 0, 1, 3, 2, 4], 2, 1),  # counted from where its own segment begins
    ],
)
def test_a_step_back_is_an_overtaking_or_a_restart(stamps, segments, late):
    found = split_stamps(np.array(stamps), 'x')
    assert (len(found.segments), found.reordered) == (segments, late)
    for rows in found.segments:
        assert (np.diff(np.array(stamps)[rows]) >= 0).all()
    assert sorted(np.concatenate(found.segments).tolist()) == list(range(len(stamps)))


def plays(count, length):
    return np.tile(np.arange(length), count)


@pytest.mark.parametrize(
    ('stamps', 'refused'),
    [
        (plays(11, 8), False),  # ten restarts
        (plays(12, 8), True),
        (plays(21, 50), False),  # twenty in a thousand are one in fifty
        (plays(21, 49), False),
        (plays(22, 49), False),
        (plays(23, 48), False),
        (plays(16, 40), True),
    ],
)
def test_many_restarts_are_two_clocks(stamps, refused):
    restarts = int((np.diff(stamps) < 0).sum())
    assert refused == (restarts > max(10, 0.02 * stamps.size))
    if refused:
        with pytest.raises(IdentError, match=f'x: the stamps step back {restarts} times'):
            split_stamps(stamps, 'x')
    else:
        assert len(split_stamps(stamps, 'x').segments) == restarts + 1


# ---------------------------------------------------------------------- pauses


def spans(parts, role='state'):
    return [(x[role].stamp[0] // S, x[role].stamp[-1] // S) for x in parts if role in x]


@pytest.mark.parametrize(
    ('period', 'pause', 'cut'),
    [(0.1, 10, False), (0.1, 11, True), (1.0, 50, False), (1.0, 51, True)],
)
def test_nothing_for_long_is_the_end_of_a_recording(period, pause, cut):
    first = np.round(np.arange(0, 20, period) * S).astype(np.int64)
    second = first + first[-1] + pause * S
    whole = {'state': stream(*first, *second)}
    parts = split_pauses(whole)
    assert len(parts) == 1 + cut
    if cut:
        assert [p['state'].stamp.tolist() for p in parts] == [first.tolist(), second.tolist()]
    else:
        assert parts[0] is whole


def test_a_pause_is_one_of_all_streams():
    state = [k * S for k in range(0, 300)]
    rare = {'state': stream(*state), 'command': stream(0, 1 * S, 200 * S, 201 * S)}
    assert split_pauses(rare) == [rare]
    # One stream goes on over the other's pause up to here.
    late = {
        'state': stream(*state[:100], *state[200:]),
        'command': stream(*state[90:160]),
    }
    assert len(split_pauses(late)) == 1
    parts = split_pauses(
        {
            'state': stream(*state[:100], *state[200:]),
            'command': stream(*state[90:120]),
        }
    )
    assert spans(parts) == [(0, 99), (200, 299)]
    assert spans(parts, 'command') == [(90, 119)]
    # The quicker stream tells what is long; single samples tell nothing.
    quick = {
        'state': stream(*range(0, 20 * S, S // 10), *range(40 * S, 60 * S, S // 10)),
        'command': stream(0),
    }
    assert spans(split_pauses(quick)) == [(0, 19), (40, 59)]
    for apart, parts in ((5, 1), (10, 1), (11, 2)):
        assert len(split_pauses({'state': stream(0), 'command': stream(apart * S)})) == parts


# ---------------------------------------------------------------------- plays of several topics


def ranges(*pairs):
    return [stream(*range(a, b)) for a, b in pairs]


def test_plays_that_a_topic_missed_stay_empty():
    state = ranges((0, 100), (50, 200), (300, 400), (300, 350))
    command = ranges((120, 190), (310, 390))
    groups = match_segments({'state': state, 'command': command})
    assert [group['state'] for group in groups] == state
    assert [k for k, group in enumerate(groups) if 'command' in group] == [1, 2]
    assert groups[1]['command'] == command[0]
    # With as many of each, the k-th belong together wherever they lie.
    other = ranges((900, 901), (0, 5), (7, 9), (1, 2))
    groups = match_segments({'state': state, 'command': other})
    assert [group['command'] for group in groups] == other
    # Where nothing overlaps, the early ones.
    groups = match_segments({'command': ranges((900, 950)), 'state': state})
    assert [k for k, group in enumerate(groups) if 'command' in group] == [0]
    # The largest overlap of all together, in order.
    three = ranges((0, 10), (20, 30), (40, 50))
    two = ranges((22, 30), (5, 50))
    groups = match_segments({'state': three, 'command': two})
    assert [k for k, group in enumerate(groups) if 'command' in group] == [1, 2]
