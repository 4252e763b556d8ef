# SPDX-License-Identifier: Apache-2.0
"""Recordings made elsewhere: real machines, and a simulator that is not this project's."""

from pathlib import Path

import numpy as np
import pytest

from ros2_ident.recording import align, check, read_bag, Topics

SHARED = Path(__file__).parents[3] / 'shared'
DATA, PRACTICE = SHARED / 'data', SHARED / 'blind' / 'practice'
CYCLES = {'emps': 1e-3, 'kr300': 4e-3, 'ur10': 8e-3, 'so101': 5e-3, 'bam': 1e-3} | {
    'dp': 1e-3,
    'odrive': 1e-3,
}

real = pytest.mark.skipif(not DATA.is_dir(), reason='../shared/data is not there')
practice = pytest.mark.skipif(not PRACTICE.is_dir(), reason='../shared/blind is not there')


def bags():
    return sorted(x.parent.name for x in DATA.glob('*/metadata.yaml'))


@real
@pytest.mark.parametrize('name', bags())
def test_every_measured_bag_comes_onto_a_grid(name):
    # The double pendulum is commanded torques, and no set-point is recorded.
    topics = Topics(command='') if name.startswith('dp_') else Topics()
    (recording,) = read_bag(DATA / name, topics)
    assert recording.warnings == ()
    data = align(recording, recording.state.names, CYCLES[name.split('_')[0]], need=('position',))
    assert data.position.shape == (len(recording.state.names), data.cycles)
    used = np.isfinite(data.position[0]).sum()
    if 'lift_and_drop' in name:
        # the motor is switched off after 2 s, and with it the command
        assert recording.command.stamp.size <= used < recording.state.stamp.size
    else:
        assert used == recording.state.stamp.size
    if recording.command is not None:
        assert np.isfinite(data.command_velocity).all()
        for column, row in enumerate(data.command_position):
            samples = recording.command.position[:, column]
            slack = 0.02 * np.ptp(samples) + 1e-9
            assert samples.min() - slack <= row.min() <= row.max() <= samples.max() + slack


@real
def test_emps_obeys_its_control_law_without_an_offset_of_a_cycle():
    """Force = 35.15 N/V kv (kp (q_ref - q) - dq) with the filter that its authors give."""
    data = align(read_bag(DATA / 'emps_train')[0], ['emps_axis'], 1e-3)
    q = data.position[0]
    filtered = 0.5 * (q + np.r_[q[0], q[:-1]])
    dq = np.diff(filtered, prepend=filtered[0]) / 1e-3

    def error(shift):
        command = np.roll(data.command_position[0], shift)
        law = 35.15065 * 243.45 * (160.18 * (command - q) - dq)
        return np.std((data.effort[0] - law)[10:-10])

    assert error(0) < 0.02 * np.std(data.effort[0])
    assert error(0) < 0.1 * min(error(-1), error(1))


@real
def test_the_check_says_what_is_known_of_the_machines():
    so101 = check(read_bag(DATA / 'so101_large_amplitude'))
    said = [x.sentence for x in so101.of('effort_sign') if x.level == 'error']
    assert len(said) == 5 and all('only its size was logged' in x for x in said)
    assert len(so101.of('velocity_lag')) == 5
    for name in ('emps_train', 'kr300_a', 'ur10_exciting'):
        report = check(read_bag(DATA / name))
        assert report.level != 'error'
        assert len(report.of('effort')) + len(report.of('effort_unexplained')) == len(
            report.drives
        )
    kr300 = check(read_bag(DATA / 'kr300_a'))
    # its velocities lag by one sample of 4 ms and a little
    assert len(kr300.of('velocity_lag')) == 6
    assert check(read_bag(DATA / 'ur10_exciting')).of('no_command')
