# SPDX-License-Identifier: Apache-2.0
"""Efforts of an arm against the weight and the inertia that its description has."""

from dataclasses import replace
from pathlib import Path
import re

import numpy as np
import pytest

pytest.importorskip('pinocchio', reason='pinocchio is not installed')

from models.test_serial import BOXES, described, moving  # noqa: E402

from ros2_ident.gates import examine, Gate  # noqa: E402
from ros2_ident.models.serial.arm import arm_of  # noqa: E402

KINDS = ('tilt', 'weight', 'behind_gears')
LOSES = 3.0


def found(
    folder: Path, factors: tuple[float, ...] = (1.0,), loses: float = LOSES, **tilt: float
) -> list[Gate]:
    """Return what is said of a log of the described arm, its base tilted otherwise."""
    machine = described(folder, **BOXES)
    log = moving(machine, 2000)
    speed = np.gradient(log.position, log.cycle, axis=1)
    change = np.gradient(speed, log.cycle, axis=1)
    effort = arm_of(machine.with_constants(**tilt)).efforts(log.position, speed, change)
    effort += loses * (np.sign(speed) + speed + 0.1 * change)
    effort *= np.reshape(factors, (-1, 1))
    effort += np.random.default_rng(1).normal(0.0, 0.05, effort.shape)
    report = examine(machine, [replace(log, effort=effort)])
    return [gate for kind in KINDS for gate in report.of(kind)]


@pytest.mark.parametrize(
    ('given', 'gate', 'level', 'number', 'said'),
    [
        (
            {'factors': (0.126,)},
            'weight',
            'fail',
            0.126,
            'all joints: .* 0.13 times .*effort_unit',
        ),
        ({'factors': (1.0, 1.0, 8.0, 1.0)}, 'weight', 'warn', 8.0, 'elbow: the effort is 8 times'),
        ({'factors': (1.0, 1.0, -1.0, 1.0)}, 'weight', 'warn', -1.0, 'elbow: .* negate'),
        (
            {'factors': (1.0, 1.0, -1.7, -2.4)},
            'weight',
            'warn',
            -1.7,
            'negate the effort or the position in the driver, and state effort_unit',
        ),
        (
            {'base_roll': 1.2, 'base_pitch': 0.3},
            'tilt',
            'fail',
            np.nan,
            'base_roll: 1.2, base_pitch: 0.3 ',
        ),
        ({'base_roll': 0.0, 'base_pitch': 1.5707963}, 'tilt', 'fail', np.nan, 'base_pitch: 1.57 '),
        ({'loses': 0.0}, 'behind_gears', 'warn', np.nan, 'coulomb_torque, viscous_torque; remove'),
    ],
)
def test_what_the_description_contradicts_is_said_with_the_remedy(
    tmp_path, given, gate, level, number, said
) -> None:
    (told,) = found(tmp_path, **given)
    assert (told.gate, told.level) == (gate, level)
    assert told.number == pytest.approx(number, rel=0.05, nan_ok=True)
    assert re.search(said, told.sentence), told.sentence


def test_what_fits_the_description_is_not_spoken_of(tmp_path) -> None:
    assert found(tmp_path) == []
    # Neither is a load that the description lacks.
    assert found(tmp_path, (1.0, 1.0, 1.0, 1.6)) == []
