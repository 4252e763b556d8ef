# SPDX-License-Identifier: Apache-2.0
"""Efforts of an arm against the weight and the inertia that its description has."""

from dataclasses import replace
from pathlib import Path
import re

import numpy as np
import pytest

pytest.importorskip('pinocchio', reason='pinocchio is not installed')

from arm_cases import URDF  # noqa: E402
from models.test_serial import BOXES, described, moving  # noqa: E402

from ros2_ident.commissioning import check_both  # noqa: E402
from ros2_ident.gates import examine, Gate  # noqa: E402
from ros2_ident.models.registry import read_machine_file  # noqa: E402
from ros2_ident.models.serial.arm import arm_of  # noqa: E402
from ros2_ident.recording import Recording, Stream  # noqa: E402

KINDS = ('tilt', 'weight', 'behind_gears')
LOSES = 3.0


def found(
    folder: Path,
    factors: tuple[float, ...] = (1.0,),
    loses: float | tuple[float, ...] = LOSES,
    more: float = 0.0,
    unit: str = 'N m',
    **tilt: float,
) -> list[Gate]:
    """Return what is said of a log of the described arm, its base tilted otherwise.

    Its wrist has `more` of an effort that nothing explains.
    """
    machine = described(folder, **BOXES)
    log = moving(machine, 2000)
    speed = np.gradient(log.position, log.cycle, axis=1)
    change = np.gradient(speed, log.cycle, axis=1)
    effort = arm_of(machine.with_constants(**tilt)).efforts(log.position, speed, change)
    effort += np.reshape(loses, (-1, 1)) * (np.sign(speed) + speed + 0.1 * change)
    effort *= np.reshape(factors, (-1, 1))
    effort += np.random.default_rng(1).normal(0.0, 0.05, effort.shape)
    effort[3] += more * np.sin(7.0 * log.cycle * np.arange(effort.shape[1]))
    machine = replace(machine, effort_unit=unit)
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
        (
            {'factors': (0.01,), 'unit': 'A'},
            'weight',
            'warn',
            0.01,
            'asks for .*; correct torque_constant, gear_factor',
        ),
        ({'factors': (1.0, 1.0, 8.0, 1.0)}, 'weight', 'warn', 8.0, 'elbow: the effort is 8 times'),
        ({'factors': (1.0, 1.0, -1.0, 1.0)}, 'weight', 'warn', -1.0, 'elbow: .* negate'),
        (
            {'factors': (1.0, 1.0, -1.7, -2.4)},
            'weight',
            'warn',
            -1.7,
            'negate the effort or the position of elbow, wrist in the driver, and state effort_u',
        ),
        (
            {'factors': (-1.0, -1.0, -1.7, -2.4)},
            'weight',
            'fail',
            -1.0,
            'negate the effort or the position in the driver, or write base_roll: 3.14 where the',
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


def test_an_effort_of_the_other_sign_is_told_where_weight_explains_a_part_of_it(tmp_path) -> None:
    (told,) = found(tmp_path, (1.0, 1.0, 1.0, -1.0), more=0.3)
    assert told.sentence.startswith('wrist: the effort is -1')
    assert '; negate the effort or the position of wrist' in told.sentence
    # friction of the right sign: it is something else that pulls against the weight
    assert not found(tmp_path, (1.0, 1.0, 1.0, -1.0), (LOSES, LOSES, LOSES, -LOSES), more=0.3)


def test_a_sign_that_the_weight_tells_is_not_asked_of_the_motion(tmp_path) -> None:
    machine = described(tmp_path, **BOXES)
    log = moving(machine, 2000)
    speed = np.gradient(log.position, log.cycle, axis=1)
    change = np.gradient(speed, log.cycle, axis=1)
    effort = arm_of(machine).efforts(log.position, speed, change) + LOSES * np.sign(speed)
    time = round(1e9 * log.cycle) * np.arange(effort.shape[1])
    state = Stream(machine.drives, time, log.position.T, None, effort.T)
    report = check_both([Recording(state)], read_machine_file(tmp_path / 'arm.yaml'))
    assert [x.sentence for x in report.of('sign')] == [
        'base: the effort has the sign of what the description asks for (likewise slide, elbow)',
        'wrist: whether the effort has the sign of the motion does not show in this log',
    ]


def test_what_fits_the_description_is_not_spoken_of(tmp_path) -> None:
    assert found(tmp_path) == []
    # Neither is a load that the description lacks.
    assert found(tmp_path, (1.0, 1.0, 1.0, 1.6)) == []


@pytest.mark.parametrize('share', [0.02, 1.0])
def test_a_weight_that_stays_the_same_is_missed_where_no_effort_reaches_it(
    tmp_path, share
) -> None:
    # An upright lift: its weight is a constant, and by shares a constant may be anything.
    lift = URDF.replace('xyz="0 0.1 0.4" rpy="0.1 0 0.2"', 'xyz="0 0.1 0.4"')
    lift = lift.replace(
        'rpy="0 0.7 0"/><axis xyz="0 0.6 0.8"/>', 'rpy="0 0 0"/><axis xyz="0 0 1"/>'
    )
    machine = described(tmp_path, lift, **BOXES).with_constants(base_roll=0.0, base_pitch=0.0)
    log = moving(machine, 2000)
    speed = np.gradient(log.position, log.cycle, axis=1)
    change = np.gradient(speed, log.cycle, axis=1)
    effort = arm_of(machine).efforts(log.position, speed, change) + LOSES * np.sign(speed)
    effort[1] *= share
    told = examine(machine, [replace(log, effort=effort)]).of('weight')
    assert len(told) == (share < 1.0)
    for gate in told:
        assert gate.number == pytest.approx(share, rel=0.2)
        assert gate.sentence.startswith(
            'slide: the effort is 0.019 times what the description asks'
        )
