# SPDX-License-Identifier: Apache-2.0
"""The builder: whatever order messages and joints come in, the same recordings come out."""

from builder_cases import add
from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest

from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.recording import RecordingBuilder
from ros2_ident.recording.limits import Limits

MS = 1_000_000


def play(builder, role, stamps, offset=0.0, names=('a', 'b')):
    for stamp in stamps:
        values = [offset + stamp * 1e-9 + i for i in range(len(names))]
        add(builder, role, stamp, names, position=values)


def test_joints_are_taken_by_name():
    builder = RecordingBuilder()
    add(builder, 'state', 0, ['a', 'b'], [1.0, 2.0], [3.0, 4.0])
    add(builder, 'state', MS, ['b', 'a'], [2.5, 1.5], [4.5, 3.5])
    add(builder, 'state', 2 * MS, ['b'], (), (), [9.0])
    (recording,) = builder.build()
    assert recording.state.names == ('a', 'b')
    np.testing.assert_array_equal(recording.state.position, [[1, 2], [1.5, 2.5], [np.nan, np.nan]])
    np.testing.assert_array_equal(recording.state.velocity, [[3, 4], [3.5, 4.5], [np.nan, np.nan]])
    np.testing.assert_array_equal(recording.state.effort[:, 1], [np.nan, np.nan, 9.0])


@given(
    samples=st.lists(
        st.tuples(st.permutations(['a', 'b', 'c']), st.integers(0, 3), st.booleans()),
        min_size=1,
        max_size=40,
    )
)
def test_any_order_and_any_subset_of_joints(samples):
    # joint j of message k has the value 10 k + j, whatever its place in the message
    value = {'a': 0.0, 'b': 1.0, 'c': 2.0}
    builder = RecordingBuilder()
    expected = np.full((len(samples), 3), np.nan)
    anything = False
    for k, (names, left_out, with_effort) in enumerate(samples):
        names = names[left_out:]
        numbers = [10.0 * k + value[name] for name in names]
        add(builder, 'state', k * MS, names, numbers, (), numbers if with_effort else ())
        anything |= bool(names)
        for name, number in zip(names, numbers, strict=True):
            expected[k, 'abc'.index(name)] = number
    if not anything:
        with pytest.raises(IdentError, match='no measured value arrived'):
            builder.build()
        return
    (recording,) = builder.build()
    stream = recording.state
    for name in stream.names:
        np.testing.assert_array_equal(
            stream.position[:, stream.names.index(name)], expected[:, 'abc'.index(name)]
        )
    assert stream.velocity is None


@given(order=st.permutations(['state'] * 12 + ['effort'] * 9 + ['command'] * 7))
def test_the_interleaving_of_topics_does_not_matter(order):
    def build(roles):
        builder = RecordingBuilder()
        counts = dict.fromkeys(('state', 'effort', 'command'), 0)
        for role in roles:
            k = counts[role]
            # two plays of the same log, in each of which a topic is as long as its place says
            play(builder, role, [(k % (len(role) - 1)) * MS], offset=len(role))
            counts[role] += 1
        return builder.build()

    one, two = build(order), build(sorted(order))
    assert one == two


@given(
    lengths=st.tuples(st.integers(20, 60), st.integers(20, 60), st.integers(20, 60)),
    plays=st.integers(1, 4),
    lag=st.integers(0, 5),
)
def test_a_loop_falls_into_its_plays_though_topics_jump_at_different_moments(lengths, plays, lag):
    builder = RecordingBuilder()
    roles = ('state', 'effort', 'command')
    queues = [[k * MS for _ in range(plays) for k in range(n)] for n in lengths]
    step = 0
    while any(queues):
        for i, queue in enumerate(queues):
            # a later topic is some messages behind the others all the time
            if queue and step >= i * lag:
                play(builder, roles[i], [queue.pop(0)])
        step += 1
    recordings = builder.build()
    assert len(recordings) == plays
    for recording in recordings:
        assert [s.stamp.size for s in recording.streams.values()] == list(lengths)
    assert not recordings[0].warnings


def test_a_role_that_missed_a_play_goes_where_its_stamps_overlap():
    builder = RecordingBuilder()
    play(builder, 'state', range(200 * MS, 300 * MS, MS))
    play(builder, 'state', range(100 * MS, 200 * MS, MS))
    play(builder, 'state', range(0, 100 * MS, MS))
    play(builder, 'effort', range(200 * MS, 290 * MS, MS))
    play(builder, 'effort', range(3 * MS, 95 * MS, MS))
    first, second, third = builder.build()
    assert first.effort.stamp[0] == 200 * MS
    assert second.effort is None
    assert third.effort.stamp[0] == 3 * MS


@given(places=st.sets(st.integers(1, 97), max_size=10), data=st.data())
def test_messages_that_overtook_each_other_are_put_back(places, data):
    stamps = [k * MS + data.draw(st.integers(-200_000, 200_000)) for k in range(1, 101)]
    for place in places:
        if place + 1 not in places and place - 1 not in places:
            stamps[place], stamps[place + 1] = stamps[place + 1], stamps[place]
    builder = RecordingBuilder()
    play(builder, 'state', stamps)
    (recording,) = builder.build()
    np.testing.assert_array_equal(recording.state.stamp, sorted(stamps))
    np.testing.assert_allclose(recording.state.position[:, 0], np.sort(stamps) * 1e-9)
    swapped = sum(b < a for a, b in zip(stamps, stamps[1:], strict=False))
    assert any('overtook' in text for text in recording.warnings) == bool(swapped)


def test_two_clocks_on_one_topic_are_refused():
    builder = RecordingBuilder('bag')
    play(builder, 'state', [k * MS + (k % 2) * 500 * MS for k in range(200)])
    with pytest.raises(IdentError, match='stamps step back .* two publishers') as caught:
        builder.build()
    assert caught.value.code == ErrorCode.BAD_VALUES


def test_drives_that_publish_one_by_one_share_a_sample():
    builder = RecordingBuilder()
    for k in range(5):
        for i, name in enumerate('abc'):
            add(builder, 'effort', k * MS, [name], effort=[10.0 * k + i])
    (recording,) = builder.build()
    np.testing.assert_array_equal(
        recording.effort.effort, 10.0 * np.arange(5)[:, None] + np.arange(3)
    )
    assert not recording.warnings


def test_values_that_come_twice_are_counted_and_the_later_one_counts():
    builder = RecordingBuilder()
    play(builder, 'state', [0, MS])
    add(builder, 'state', MS, ['a'], [7.0])
    (recording,) = builder.build()
    assert recording.state.position[1, 0] == 7.0
    assert recording.warnings == (
        'state: 1 values came twice with the same stamp, the later one counts; '
        'look for two publishers on one topic',
    )


@pytest.mark.parametrize(
    ('message', 'text'),
    [
        (('model', 0, ['a'], [1.0]), "role is 'model'; choose one of state, effort, command"),
        (('state', 0, ['a', 'b'], [1.0]), r'has shape \(1, 1\), expected \(1, 2\)'),
        (('state', 0, ['a', 'a'], [1.0, 2.0]), r'names a joint twice \(a, a\)'),
    ],
)
def test_a_malformed_message_is_refused_and_leaves_no_trace(message, text):
    builder = RecordingBuilder()
    add(builder, 'state', 0, ['a'], [1.0])
    with pytest.raises(IdentError, match=text) as caught:
        add(builder, *message)
    assert caught.value.code == ErrorCode.BAD_VALUES
    add(builder, 'state', MS, ['a'], [2.0])
    np.testing.assert_array_equal(builder.build()[0].state.position[:, 0], [1.0, 2.0])


def test_infinite_values_become_nan_with_a_warning():
    builder = RecordingBuilder()
    add(builder, 'state', 0, ['a'], [1.0], (), [float('inf')])
    (recording,) = builder.build()
    assert np.isnan(recording.state.effort).all()
    assert recording.warnings == ('state: 1 infinite values are taken as not measured',)


def test_building_does_not_end_the_collecting():
    builder = RecordingBuilder('live')
    with pytest.raises(IdentError, match='live: no measured value arrived') as caught:
        builder.build()
    assert caught.value.code == ErrorCode.NO_DATA
    play(builder, 'state', [0, MS])
    first = builder.build()
    play(builder, 'state', [2 * MS])
    assert builder.build()[0].state.stamp.size == 3
    assert first[0].state.stamp.size == 2
    assert builder.counts == {'state': 3, 'effort': 0, 'command': 0}
    builder.clear()
    assert builder.counts == {'state': 0, 'effort': 0, 'command': 0}


@settings(max_examples=30)
@given(
    stamps=st.lists(st.integers(-(2**40), 2**40), min_size=1, max_size=30),
    seed=st.integers(0, 2**16),
)
def test_a_block_is_the_same_as_its_messages(stamps, seed):
    values = np.random.default_rng(seed).normal(size=(len(stamps), 2))
    single, block = RecordingBuilder(), RecordingBuilder()
    for stamp, row in zip(stamps, values, strict=True):
        add(single, 'state', stamp, ['a', 'b'], row, (), row)
    block.add_block('state', np.array(stamps), ['a', 'b'], values, None, values)

    def outcome(builder):
        try:
            return builder.build()
        except IdentError as exc:
            return exc.message

    assert outcome(single) == outcome(block)


# ---------------------------------------------------------------------- each rule at its edge


def test_joints_and_names_are_limited_and_those_known_are_not_counted_twice():
    limits = Limits(joints=3, name=4)
    builder = RecordingBuilder('log', limits=limits)
    add(builder, 'state', 0, ('a', 'b'), (1.0, 2.0))
    add(builder, 'state', MS, ('b', 'cccc'), (1.0, 2.0))
    with pytest.raises(IdentError, match='log: state names more than 3 joints'):
        add(builder, 'state', 2 * MS, ('a', 'd'), (1.0, 2.0))
    with pytest.raises(IdentError, match='a name of 5 characters, more than the 4 allowed'):
        add(builder, 'effort', 2 * MS, ('eeeee',), (1.0,))
    add(builder, 'effort', 2 * MS, ('d', 'e', 'f'), (), (), (1.0, 2.0, 3.0))
    assert builder.counts == {'state': 2, 'effort': 1, 'command': 0}
    (read,) = builder.build()
    assert read.state.names == ('a', 'b', 'cccc') and read.effort.names == ('d', 'e', 'f')
    builder.clear()
    assert builder.counts == {'state': 0, 'effort': 0, 'command': 0}
