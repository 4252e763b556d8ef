# SPDX-License-Identifier: Apache-2.0
"""The builder: the same recordings whatever the order; what streams and recordings refuse."""

from hypothesis import given
from hypothesis import strategies as st
from identify_cases import ROOT
import numpy as np
import pytest
from reader_cases import add

from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.recording import check, read_bag, Recording, RecordingBuilder, Stream

MS = 1_000_000


def play(builder, role, stamps, offset=0.0, names=('a', 'b')):
    for stamp in stamps:
        values = [offset + stamp * 1e-9 + i for i in range(len(names))]
        add(builder, role, stamp, names, position=values)


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


def test_building_does_not_end_the_collecting():
    builder = RecordingBuilder('live')
    with pytest.raises(IdentError, match='live: no measured value arrived') as caught:
        builder.build()
    assert caught.value.code == ErrorCode.NO_DATA
    play(builder, 'state', [0, MS])
    first = builder.copied().build()
    play(builder, 'state', [2 * MS])
    assert builder.copied().build()[0].state.stamp.size == 3
    assert first[0].state.stamp.size == 2
    builder.clear()
    with pytest.raises(IdentError, match='no measured value arrived'):
        builder.copied().build()


# ---------------------------------------------------------------------- each rule at its edge
def steps(*stamps):
    """Return what is built of a state at so many milliseconds: stamps by recording, and said."""
    builder = RecordingBuilder('bag')
    play(builder, 'state', [x * MS for x in stamps])
    found = builder.build()
    return [(x.state.stamp // MS).tolist() for x in found], ' '.join(found[0].warnings)


def test_two_clocks_on_one_topic_are_refused():
    for stamps in ([k + (k % 2) * 500 for k in range(200)], list(range(8)) * 12):
        with pytest.raises(IdentError, match='stamps step back .* two publishers') as caught:
            steps(*stamps)
        assert caught.value.code == ErrorCode.BAD_VALUES


def test_nothing_from_any_stream_for_long_is_the_end_of_a_recording():
    early, late = list(range(0, 20_000, 100)), list(range(31_000, 50_000, 100))
    found, words = steps(*early, *late)
    assert found == [early, late] and 'nothing came for up to 11.1 s' in words
    assert len(steps(*early, *(x - 2_000 for x in late))[0]) == 1
    builder = RecordingBuilder()
    play(builder, 'state', [x * MS for x in early + late])
    play(builder, 'command', [x * MS for x in range(0, 50_000, 5_000)])
    assert len(builder.build()) == 1


# ---------------------------------------------------------------------- what is refused

STAMP = np.arange(4) * 1_000_000
VALUES = np.arange(8.0).reshape(4, 2)
ENDLESS = np.where(VALUES == 3.0, np.inf, VALUES)


@pytest.mark.parametrize(
    ('changes', 'text'),
    [
        ({'names': ()}, 'the joints of a stream are'),
        ({'names': ('a', 'a')}, 'the joints of a stream are .a, a.; give'),
        ({'stamp': STAMP * 1e-9}, r'integers \[ns\] of shape \(T,\), found float64'),
        ({'stamp': STAMP[:0]}, 'leave out what is empty'),
        ({'stamp': STAMP[::-1]}, 'sample 1 does not'),
        ({'stamp': STAMP * 0}, 'sample 1 does not'),
        ({'position': VALUES[:3]}, r'position has shape \(3, 2\), expected \(4, 2\)'),
        ({'position': ENDLESS}, 'position of b is infinite at sample 1'),
        ({'position': None}, 'holds neither position, velocity nor effort'),
    ],
)
def test_a_stream_refuses_with_one_sentence(changes, text):
    arguments = {'names': ('a', 'b'), 'stamp': STAMP, 'position': VALUES} | changes
    with pytest.raises(IdentError, match=text) as caught:
        Stream(**arguments)
    assert caught.value.code == ErrorCode.BAD_VALUES
    assert '\n' not in caught.value.message


def test_an_empty_recording_is_refused():
    with pytest.raises(IdentError, match='holds no stream at all') as caught:
        Recording(source='x')
    assert caught.value.code == ErrorCode.NO_DATA
    assert caught.value.message.startswith('x: ')
    with pytest.raises(IdentError, match='^recording: holds no stream'):
        Recording()


# ---------------------------------------------------------------------- lone jumps

BAGS = ('axis_reversals', 'tripod_pick_and_place')


def size_in(sentence):
    return float(sentence.split('jumps by up to ')[1].split()[0])


def rebuilt(recording, role, field, row, column, change, run=1):
    """Return a recording with some samples of a signal off."""
    builder = RecordingBuilder('log')
    for name, x in recording.streams.items():
        fields = {
            f: None if (v := x.values(f)) is None else v.copy()
            for f in ('position', 'velocity', 'effort')
        }
        if name == role:
            fields[field][row : row + run, column] += change
        builder.add_block(name, x.stamp, x.names, **fields)
    return builder.build()


@pytest.fixture(scope='module', params=BAGS)
def bundled(request):
    return read_bag(ROOT / 'bags' / request.param)[0]


def test_nothing_is_found_in_the_bundled_bags(bundled):
    assert bundled.warnings == ()


@pytest.mark.parametrize('run', [1, 3])
@pytest.mark.parametrize('role', ['command', 'state'])
def test_a_position_one_millimetre_off_is_left_out(bundled, role, run):
    size = bundled.streams[role].stamp.size
    for row in (size // 7, size // 2, size - 40):
        (read,) = rebuilt(bundled, role, 'position', row, 0, 1e-3, run)
        expected = bundled.streams[role].position.copy()
        expected[row : row + run, 0] = np.nan
        np.testing.assert_array_equal(read.streams[role].position, expected)
        seconds = (bundled.streams[role].stamp[row] - bundled.streams[role].stamp[0]) * 1e-9
        (said,) = read.warnings
        assert f'{role}: position of {bundled.state.names[0]} jumps by' in said
        few = 'a sample' if run == 1 else f'{run} samples'
        assert f'and back in {few}, first at {seconds:.4f} s' in said
        assert 'is left out' in said
        if run == 1:
            assert size_in(said) == pytest.approx(1e-3, rel=0.03)
        assert any(x.code == 'reading' and x.sentence == said for x in check([read]).findings)


def test_an_effort_of_a_wrong_bit_is_left_out(bundled):
    role = 'effort' if bundled.effort is not None else 'state'
    (read,) = rebuilt(bundled, role, 'effort', 777, 0, 1e6)
    assert np.isnan(read.streams[role].effort[777, 0])
    assert f'{role}: effort of' in read.warnings[0]
    (read,) = rebuilt(bundled, role, 'effort', 777, 0, 1e200)
    assert 'infinite values are taken as not measured' in read.warnings[0]
