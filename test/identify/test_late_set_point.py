# SPDX-License-Identifier: Apache-2.0
"""A set-point that a filter or a network delays is not what the controller takes."""

from dataclasses import replace
from pathlib import Path

import pytest

from ros2_ident.identify.data import gather
from ros2_ident.models import load_machine
from ros2_ident.recording import read_bag, Recording

HERE = Path(__file__).parents[2]
MACHINE = load_machine(HERE / 'config/emps.yaml')
LOG = read_bag(HERE / 'bags/axis_reversals')[0]


def taken(log: Recording, late: float) -> Recording:
    """Return a log whose controller took its set-point `late` s after it was logged."""
    assert log.command is not None
    command = replace(log.command, stamp=log.command.stamp - round(late * 1e9))
    return replace(log, command=command)


@pytest.mark.parametrize('late', [0.08, 0.25])
def test_a_set_point_that_is_taken_late_is_not_used(late: float) -> None:
    data = gather([taken(LOG, late)], MACHINE)
    assert data.datasets[0].command_position is None
    (said,) = (text for text in data.warnings if 'behind' in text)
    assert said.startswith('emps_axis: the position follows its set-point ')
    assert 'the stated gains make 6.2 ms' in said


def test_a_set_point_within_a_command_delay_is_used() -> None:
    for late in (0.0, 0.02):
        data = gather([taken(LOG, late)], MACHINE)
        assert data.datasets[0].command_position is not None
