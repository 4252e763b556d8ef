# SPDX-License-Identifier: Apache-2.0
"""Effort that no control law asked for, from start to end."""

from pathlib import Path

import numpy as np
import pytest

from ros2_ident.gates import examine
from ros2_ident.models import load_machine
from ros2_ident.recording import Dataset
from ros2_ident.words.finding import instants

AXIS = load_machine(Path(__file__).parents[2] / 'config/emps.yaml')
TIME = np.arange(12000) * 1e-3
PULSES = ((2.0, 2.05, 120.0), (5.5, 5.62, -90.0), (9.0, 9.2, 60.0))


def dataset(
    *pulses: tuple[float, float, float], gain: float = 1.0, most: float = 351.0
) -> Dataset:
    """Return a log of the law of the file, its gain a little off, and of what is added to it."""
    position = np.round(0.1 * np.sin(2.1 * TIME) / 1e-6) * 1e-6
    late = 1e-4 * np.sin(8.0 * TIME) + 5e-5 * np.sin(23.0 * TIME + 1.0)
    command = 0.1 * np.sin(2.1 * TIME) + 1.3e-3 * np.cos(2.1 * TIME) + late
    speed = np.zeros_like(TIME)
    speed[2:] = (position[2:] - position[:-2]) / 2e-3
    kp, kv = AXIS.number('position_gain'), AXIS.number('velocity_gain')
    effort = np.clip(gain * kv * (kp * (command - position) - speed), -most, most)
    for begin, end, size in pulses:
        effort[(begin <= TIME) & (end > TIME)] += size
    effort += np.random.default_rng(1).normal(0.0, 0.3, TIME.size)
    rows = [row[None] for row in (command, np.gradient(command, 1e-3), position)]
    return Dataset(AXIS.drives, 1e-3, 0, *rows, None, effort[None])


def test_pulses_behind_a_law_are_found_and_its_gain_without_them() -> None:
    report = examine(AXIS, [dataset(*PULSES, gain=1.02)])
    ((asked,),) = report.asked
    found = [(e.time, e.end, e.effort) for e in asked.pushes]
    assert np.abs(np.array(found)[:, :2] - np.array(PULSES)[:, :2]).max() < 3e-3
    assert [size for _, _, size in found] == pytest.approx([120.0, -90.0, 60.0], rel=0.03)
    assert instants(asked.pushes, 'N').startswith('2.00 to 2.05 s (+120 N), 5.50 to 5.62 s')
    (law,) = report.laws
    assert law.gains[0].ratio == pytest.approx(1.02, abs=1e-3)
    assert not report.of('asked') and len(report.of('not_asked')) == 1


@pytest.mark.parametrize('changed', [{}, {'gain': 1.02}, {'most': 150.0}])
def test_a_law_that_is_a_little_off_or_limited_adds_nothing(changed: dict[str, float]) -> None:
    assert examine(AXIS, [dataset(**changed)]).asked == ((),)
