# SPDX-License-Identifier: Apache-2.0
"""Samples that jump away and back, in every stream: found, left out, said."""

from identify_cases import ROOT
import numpy as np
import pytest

from ros2_ident.recording import check, read_bag, RecordingBuilder

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
