# SPDX-License-Identifier: Apache-2.0
"""What simulators are compared with: torques beside the slow twin, motion beside a closed form."""

import json
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip('pinocchio', reason='pinocchio is not installed')

from checks.reference import arm as twin  # noqa: E402
from checks.simulators import cases  # noqa: E402
from checks.simulators.run import exported, page  # noqa: E402
from ros2_ident.errors import IdentError  # noqa: E402
from ros2_ident.export.descriptions import urdf  # noqa: E402
from ros2_ident.export.targets import SUMMARY, TARGETS, write  # noqa: E402
from ros2_ident.models.drives.joints import PARTS  # noqa: E402


@pytest.fixture(scope='module', params=['pendulum', 'gimbal'])
def case(request, tmp_path_factory) -> cases.Case:
    folder = tmp_path_factory.mktemp(request.param)
    if request.param == 'pendulum':
        return cases.pendulum(folder)
    values, axes = cases.Values(0.7, 0.4, 0.05), ['roll', 'pitch']
    return cases.case(folder, 'gimbal', cases.GIMBAL, axes, values, np.zeros(2))


def test_torques_are_those_of_the_exported_links_friction_and_rotors(case) -> None:
    bodies = twin.read_urdf(urdf(case.description, case.content), case.joints)
    down = np.array([0.0, 0.0, -9.81])
    values = {n: np.array([getattr(j, n) for j in case.content.joints]) for n in PARTS}
    assert values['coulomb'] == pytest.approx(0.4, rel=0.01)
    for state in case.states.transpose(1, 0, 2):
        links = twin.inverse_dynamics(bodies, down, *state)
        np.testing.assert_allclose(case.torque(*state, of=()), links, atol=1e-9)
        felt = values['coulomb'] * np.sign(state[1]) + values['viscous'] * state[1]
        felt += values['armature'] * state[2]
        np.testing.assert_allclose(case.torque(*state), links + felt, atol=1e-9)


def test_a_decay_ends_where_friction_stops_it(tmp_path: Path) -> None:
    case = cases.pendulum(tmp_path)
    (joint,), (fast,) = case.content.joints, case.fast
    unit = case.torque(np.zeros(1), np.zeros(1), np.ones(1), of=('armature',))
    inertia = float((unit - case.torque(np.zeros(1), np.zeros(1), np.zeros(1), of=()))[0])
    rate, stop = joint.viscous / inertia, joint.coulomb / joint.viscous
    time = min(cases.MOTION, np.log1p(fast / stop) / rate)
    way = (fast + stop) * -np.expm1(-rate * time) / rate - stop * time
    end = case.motion(case.still, case.fast, gravity=False)[0]
    assert end - case.still[0] == pytest.approx(way, rel=1e-3)
    assert case.motion(case.still, 0.0 * case.fast, gravity=False)[0] == case.still[0]


def test_a_simulator_whose_file_cannot_be_written_is_refused(tmp_path: Path, monkeypatch) -> None:
    case = cases.pendulum(tmp_path)
    monkeypatch.setattr('ros2_ident.export.targets.can_convert', lambda: False)
    assert 'drake' in exported(case, tmp_path / 'out', ['drake'])['targets']
    with pytest.raises(IdentError, match='`pip install mujoco`'):
        exported(case, tmp_path / 'out', ['drake', 'warp'])


def test_the_page_marks_what_is_off_beside_what_a_target_lacks(tmp_path: Path) -> None:
    case = cases.pendulum(tmp_path)
    write(tmp_path / 'out', ('urdf', 'drake', 'pybullet'), case.content, case.description)
    told = json.loads((tmp_path / 'out' / SUMMARY).read_text())
    near = {'torque': 0.12, 'torque_held': 0.009, 'decay': 0.3, 'decay_held': 0.021, 'swing': None}
    about = {'version': '9', 'machine': 'pendulum', 'joint': 'swing', 'follows': [0.5, -0.9]}
    about |= {'limits': True}
    rows = [
        {'simulator': 'drake', **about, **near},
        {'simulator': 'pybullet', 'version': '', 'machine': 'pendulum', 'not_run': 'no wheel'},
    ]
    text = page(rows, told, 'cuda:0')
    cost = told['targets']['drake']['joints']['swing']
    price = f'coulomb: {cost["cost"]["coulomb"]:.3g} of {cost["effort"]:.3g} N m on swing'
    assert f'| Drake 9 | `drake.urdf` | yes | yes | no | no | yes | {price} |' in text
    assert '| Drake | pendulum | 12 % (0.9 %) | swing | **30 % (2.1 %)** |  |' in text
    assert '| PyBullet | pendulum | not run |' in text and 'PyBullet not run' in text
    assert f'| Drake | {TARGETS["drake"].massless} |' in text and '0 of 1 rad off' in text
    assert 'MuJoCo Warp and Newton on `cuda:0`' in text
