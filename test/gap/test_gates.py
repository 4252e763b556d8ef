# SPDX-License-Identifier: Apache-2.0
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from ros2_ident.gates.controller import check_law
from ros2_ident.gates.examine import check_streams
from ros2_ident.gates.law import fit_law
from ros2_ident.identify.run import read_data
from ros2_ident.models import load_machine
from ros2_ident.recording import StreamQuality
from ros2_ident.recording.streams import Dataset

ROOT = Path(__file__).parents[2]
MACHINE = load_machine(ROOT / 'config/tripod.yaml')


def test_a_log_of_the_package_passes_its_own_law():
    machine = load_machine(ROOT / 'config/emps.yaml')
    data = read_data(ROOT / 'bags/axis_reversals', machine).datasets[0]
    law = fit_law(machine, data, 'emps_axis')
    # The bag holds positions in steps of 1 um.
    assert law.steps == pytest.approx(machine.number('velocity_gain') * 1e-6 / 4e-3, rel=1e-6)
    assert [g.level for g in check_law(machine, law, 'emps_axis', 0.3)] == ['ok']
    for name in ('velocity_gain', 'position_gain'):
        assert [law.refutes(name, x) for x in (1.0, 0.8, 1.2)] == [False, True, True]
    moved = np.array(data.position) + 1e-7 * np.random.default_rng(0).standard_normal(data.cycles)
    assert fit_law(machine, replace(data, position=moved), 'emps_axis').steps < 1e-6


def _rubbing_joint(way, gain=1.0, late=0.025):
    """Return 6 s of a joint with dry friction under a PI law; its effort is noisy and late."""
    names = ('cycle', 'position_gain', 'velocity_gain', 'integral_gain')
    cycle, kp, kv, ki = (MACHINE.number(name, 'drive_1') for name in names)
    time = cycle * np.arange(12000)
    goal = way * np.sin(0.8 * np.pi * time) * np.sin(0.14 * np.pi * time)
    rate = np.gradient(goal, cycle)
    position, velocity, effort = np.empty((3, 1, time.size))
    place = speed = total = 0.0
    for k in range(time.size):
        slip = kp * (goal[k] - place) + rate[k] - speed
        total += cycle * slip
        torque = gain * kv * slip + ki * total
        position[0, k], velocity[0, k], effort[0, k] = place, speed, torque
        for _ in range(5):
            speed += 0.2 * cycle * (torque - 0.1 * np.tanh(speed / 5e-3)) / 0.03
            place += 0.2 * cycle * speed
    effort = np.interp(time - late, time, effort[0])
    effort += 0.01 * np.random.default_rng(0).standard_normal(time.size)
    command = goal[None], rate[None]
    return Dataset(('drive_1',), cycle, 0, *command, position, velocity, effort[None])


@pytest.mark.parametrize('way', [0.002, 0.01])
def test_a_slow_motion_does_not_make_a_late_effort_a_wrong_gain(way):
    law = fit_law(MACHINE, _rubbing_joint(way), 'drive_1')
    assert law.effort_delay == pytest.approx(0.025, abs=2e-3)
    assert law.misfit_file == pytest.approx(0.01, rel=0.02)
    (gate,) = check_law(MACHINE, law, 'drive_1', 0.01)
    assert (gate.gate, gate.level) == ('law', 'ok')


@pytest.mark.parametrize('gain', [0.5, 1.3])
def test_a_gain_that_no_delay_makes_right_is_named(gain):
    law = fit_law(MACHINE, _rubbing_joint(0.1, gain), 'drive_1')
    (gate,) = check_law(MACHINE, law, 'drive_1', 0.01)
    assert (gate.key, gate.contradicts) == ('velocity_gain', True)
    assert gate.number == pytest.approx(gain, rel=0.05)


@pytest.mark.parametrize(('missing', 'level'), [(0, 'ok'), (50, 'warn'), (500, 'fail')])
def test_missing_samples(missing, level):
    stream = StreamQuality(1000, missing, 1000.0, 1e-5, 2)
    assert check_streams(SimpleNamespace(streams={'effort': stream}))[0].level == level
