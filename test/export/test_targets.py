# SPDX-License-Identifier: Apache-2.0
"""What was identified, in files that pinocchio, Isaac Lab, simulators and ros2_control read."""

from dataclasses import replace
import json
import math
from pathlib import Path
import re
import sys
from unittest.mock import MagicMock
import xml.etree.ElementTree as ET

import numpy as np
import pytest
import yaml

pinocchio = pytest.importorskip('pinocchio', reason='pinocchio is not installed')

from export_cases import (  # noqa: E402
    by_pinocchio,
    content,
    down,
    efforts,
    into_urdf,
    known,
    module_at,
    OFFSET,
    ROOT,
    ROTOR,
    sliding,
    SMOOTH,
    TANH,
)
from identify_cases import tripod  # noqa: E402
from models.test_serial import BOXES, described, JOINTS  # noqa: E402
from report_cases import diagnosed  # noqa: E402

from ros2_ident.errors import ErrorCode, IdentError  # noqa: E402
from ros2_ident.export.content import Content, content_of  # noqa: E402
from ros2_ident.export.targets import fitting, sentences, TARGETS, write  # noqa: E402
from ros2_ident.files import kind_of  # noqa: E402
from ros2_ident.gap.result import Value  # noqa: E402
from ros2_ident.identify.data import Data  # noqa: E402
from ros2_ident.identify.problem import problem_of  # noqa: E402
from ros2_ident.models import EffectAt, load_machine  # noqa: E402
from ros2_ident.models.drives.joints import Gains  # noqa: E402
from ros2_ident.report.diagnosis import write_diagnosis  # noqa: E402
from ros2_ident.report.estimate import read_estimate  # noqa: E402


def test_a_urdf_asks_what_was_identified(tmp_path: Path) -> None:
    found = content(described(tmp_path, **SMOOTH), **{'elbow.link_moment_x': 0.5})
    path, words = into_urdf(tmp_path, found)
    off = by_pinocchio(path.read_text(), found) - efforts(found)
    assert np.abs(off).max() < 1e-9
    assert [w for w in words if 'no place' in w] == []


def test_friction_in_a_urdf_turns_over_at_once(tmp_path: Path) -> None:
    found = content(described(tmp_path, **BOXES).with_constants(coulomb_regularisation=0.02))
    path, _ = into_urdf(tmp_path, found)
    there = sliding(found)
    assert there.mean() > 0.5
    off = np.abs(by_pinocchio(path.read_text(), found) - efforts(found))
    assert off[there].max() < TANH * 10.0
    assert 1.0 < off[~there].max() < 10.1


def test_what_a_urdf_cannot_say_is_as_large_as_stated(tmp_path: Path) -> None:
    found = content(
        described(tmp_path, **BOXES, **ROTOR, **OFFSET), **{'wrist.constant_force': 2.0}
    )
    path, words = into_urdf(tmp_path, found)
    exported = found.model.in_band(by_pinocchio(path.read_text(), found))
    told = json.loads((tmp_path / 'export.json').read_text())['targets']['urdf']['joints']
    for d, name in enumerate(JOINTS):
        missed = np.sqrt(np.nanmean((found.measured[d] - exported[d]) ** 2))
        assert told[name]['missed_as_exported'] == pytest.approx(missed, rel=1e-6)
    wrist = told['wrist']
    lost = found.joints[JOINTS.index('wrist')].armature * found.model.motion[2][-1]
    assert wrist['cost'] == {'armature': pytest.approx(np.sqrt(np.mean(lost**2)), rel=0.05)}
    price = f'{wrist["cost"]["armature"]:.3g} of {wrist["effort"]:.3g} N m RMS on wrist'
    assert f'inertia of motors and gears ({price}, the largest share)' in words[0]
    assert 'a constant in the effort (wrist 2 N m, the largest)' in words[0]
    assert 'of the improvement on each joint' in words[-1]


def test_a_file_that_misses_more_than_the_description_is_called_worse(tmp_path: Path) -> None:
    found = content(described(tmp_path, **BOXES, **ROTOR))
    target, text = TARGETS['urdf'], (tmp_path / 'arm.urdf').read_text()
    rows = found.missed(target.holds)
    rows['elbow'] |= {'missed_as_described': 2.0, 'missed_as_exported': 5.0}
    rows['elbow'] |= {'missed_as_identified': 1.0}
    words = [*sentences(found, target, text, rows)]
    assert 'it is worse than as described on elbow; least on elbow, RMS in N m: 2 as ' in words[-1]


def test_pinocchio_gets_friction_and_rotors_by_a_module(tmp_path: Path) -> None:
    found = content(described(tmp_path, **BOXES, **ROTOR))
    files = write(tmp_path / 'out', ('pinocchio',), found, (tmp_path / 'arm.urdf').read_text())
    assert list(files) == ['urdf', 'pinocchio'] and files['pinocchio'][1] == ()
    loaded = module_at(files['pinocchio'][0])
    model = loaded.load()
    rows = [model.joints[model.getJointId(name)].idx_v for name in JOINTS]
    np.testing.assert_allclose(model.armature[rows], [j.armature for j in found.joints])
    q, v, a = pinocchio.neutral(model), *np.random.default_rng(2).uniform(-1, 1, (2, model.nv))
    still = pinocchio.rnea(model, model.createData(), q, v, a)
    off = loaded.torque(model, model.createData(), q, v, a) - still
    asked = [j.effort(v[n : n + 1], a[n : n + 1], ('viscous', 'coulomb'))[0]
             for j, n in zip(found.joints, rows, strict=True)]  # fmt: skip
    np.testing.assert_allclose(off[rows], asked, atol=1e-12)


LAWFUL = {
    'asymmetric_friction': {'coulomb': 1.0, 'viscous': 0.4},
    'cable_spring': {'stiffness': 3.0, 'rest': 0.2},
    'constant_force': {'force': 2.0},
    'degressive_friction': {'torque': 2.0, 'velocity': 0.3},
    'end_stop': {'stiffness': 50.0, 'lower': -0.1, 'upper': 0.2},
    'position_dependent_friction': {'slope': 0.3, 'middle': 0.1},
    'quadratic_drag': {'torque': 0.7},
    'stribeck': {'torque': 2.0, 'velocity': 0.3},
    'torque_ripple': {'sine': 1.0, 'cosine': -0.5, 'order': 3.0},
}


@pytest.mark.parametrize('effect', LAWFUL)
def test_a_law_asks_what_it_does_in_our_own_model(effect: str, tmp_path: Path) -> None:
    machine = described(tmp_path, **BOXES).with_constants(coulomb_regularisation=1e-4)
    values = {f'elbow.{effect}.{name}': value for name, value in LAWFUL[effect].items()}
    there = [EffectAt(effect, 'elbow')]
    found = content(machine, effects=there, **values)
    assert [law.effect for law in found.laws['elbow']] == [effect]
    d = JOINTS.index('elbow')
    place, speed, _ = found.model.motion[:, d]
    plain = found.model.extended(())
    nominal = found.theta[[p.name not in values for p in found.model.parameters]]
    whole = (efforts(found) - plain.simulated_effort(nominal))[d]
    slide = np.abs(speed) > 2e-3
    off = found.laws['elbow'][0].effort(place, speed) - whole
    assert np.abs(off[slide]).max() < TANH * 3.0 and np.abs(whole).max() > 0.1
    # Written down, it is the same, and pinocchio's module has it.
    files = write(tmp_path / 'out', ('pinocchio',), found, (tmp_path / 'arm.urdf').read_text())
    assert files['pinocchio'][1] == ()
    loaded = module_at(files['pinocchio'][0])
    told = loaded.asked('elbow', place, speed, np.sign(speed))
    np.testing.assert_allclose(told, found.laws['elbow'][0].effort(place, speed), atol=1e-12)
    model = loaded.load()
    model.gravity.linear = down(machine)
    rows = [model.joints[model.getJointId(name)] for name in JOINTS]
    k = int(np.argmax(np.where(slide, np.abs(whole), 0.0)))
    q, v, a = pinocchio.neutral(model), np.zeros(model.nv), np.zeros(model.nv)
    for joint, (at, rate, bend) in zip(rows, found.model.motion[:, :, k].T, strict=True):
        q[joint.idx_q : joint.idx_q + joint.nq] = (
            [at] if joint.nq == 1 else [np.cos(at), np.sin(at)]
        )
        v[joint.idx_v], a[joint.idx_v] = rate, bend
    asked = loaded.torque(model, model.createData(), q, v, a)[rows[d].idx_v]
    assert asked == pytest.approx(efforts(found)[d, k], abs=1e-6)


def with_laws(folder: Path, name: str, simulator: MagicMock, monkeypatch) -> tuple:
    """Return what was exported of an elbow with effects, and the module that loads it."""
    there = [EffectAt(effect, 'elbow') for effect in ('stribeck', 'torque_ripple')]
    values = {f'elbow.{at.effect}.{x}': v for at in there for x, v in LAWFUL[at.effect].items()}
    found = content(described(folder, **BOXES), effects=there, **values)
    monkeypatch.setitem(sys.modules, name, simulator)
    text = (folder / 'arm.urdf').read_text()
    path, words = write(folder / 'out', (name,), found, text)[name]
    assert not [word for word in words if 'stribeck' in word or 'ripple' in word]
    return found, module_at(path)


PLACES, SPEEDS = np.array([0.1, 0.2, -0.4, 0.3]), np.array([0.5, -0.2, 0.3, -0.8])


def friction(found: Content, place: np.ndarray, speed: np.ndarray) -> np.ndarray:
    """Return (D,) what Coulomb friction and effects take of the joints."""
    laws = [sum(law.effort(q, v) for law in found.laws.get(j.name, ()))
            for j, q, v in zip(found.beside, place, speed, strict=True)]  # fmt: skip
    return np.array(laws) + np.sign(speed) * [j.coulomb for j in found.beside]


def test_a_velocity_motor_in_pybullet_is_all_friction(tmp_path: Path, monkeypatch) -> None:
    bullet = MagicMock()
    found, loaded = with_laws(tmp_path, 'pybullet', bullet, monkeypatch)
    bullet.getNumJoints.return_value = len(JOINTS)
    bullet.getJointInfo.side_effect = lambda _, n: (n, JOINTS[n].encode())
    bullet.getJointState.side_effect = lambda _, n: (PLACES[n], SPEEDS[n])
    loaded.act(0)
    calls = [(x.args[1], x.args[2], x.kwargs['force'])
             for x in bullet.setJointMotorControl2.mock_calls]  # fmt: skip
    most = np.array([f for _, kind, f in calls if kind is bullet.VELOCITY_CONTROL])
    added = np.array([f for _, kind, f in calls if kind is bullet.TORQUE_CONTROL])
    asked = friction(found, PLACES, SPEEDS) + SPEEDS * [j.viscous for j in found.beside]
    np.testing.assert_allclose(most * np.sign(SPEEDS) - added, asked, atol=1e-12)
    assert np.abs(added).max() > 0.1


def test_newton_gets_controllers_with_late_set_points(tmp_path: Path, monkeypatch) -> None:
    newton = MagicMock()
    monkeypatch.setitem(sys.modules, 'newton', newton)
    monkeypatch.setitem(sys.modules, 'warp', MagicMock())
    found = content(described(tmp_path, **BOXES))
    base, slide, elbow, wrist = found.joints
    base = replace(base, gains=Gains(40.0, 0.0, 3.0, 0.0), limit=9.0)
    elbow = replace(elbow, gains=Gains(20.0, 1.0, 2.0, 0.0), limit=math.inf)
    joints = base, slide, elbow, wrist
    found = replace(found, joints=joints, identified=joints, delays={'elbow': 0.0231})
    text = (tmp_path / 'arm.urdf').read_text()
    path, words = write(tmp_path / 'out', ('newton',), found, text)['newton']
    assert words == ("Newton has no place for the integral part of the controllers' law",)
    builder = MagicMock(
        joint_label=['arm/tool', 'arm/base', 'arm/elbow'],
        joint_q_start=[0, 0, 1], joint_qd_start=[3, 4, 5],
    )  # fmt: skip
    module_at(path).add_controllers(builder, 1e-3)
    pd, most = newton.actuators.DrivePD, newton.actuators.ClampingMaxEffort
    assert [x.args for x in builder.add_actuator.mock_calls] == [(pd, 4), (pd, 5)]
    assert [x.kwargs for x in builder.add_actuator.mock_calls] == [
        {'kp': 40.0, 'kd': 3.0, 'pos_index': 0, 'clamping': [(most, {'max_effort': 9.0})]},
        {'kp': 20.0, 'kd': 2.0, 'pos_index': 1, 'clamping': [(most, {'max_effort': math.inf})],
         'delay_steps': 23},
    ]  # fmt: skip


def test_genesis_gets_effects_as_efforts(tmp_path: Path, monkeypatch) -> None:
    found, loaded = with_laws(tmp_path, 'genesis', MagicMock(), monkeypatch)
    robot = MagicMock()
    robot.get_joint.side_effect = lambda name: MagicMock(dofs_idx_local=[JOINTS.index(name)])
    robot.get_dofs_position().cpu().numpy.return_value = np.stack([PLACES, 2.0 * PLACES])
    robot.get_dofs_velocity().cpu().numpy.return_value = np.stack([SPEEDS, -SPEEDS])
    loaded.set_up(robot)
    losses = np.concatenate([x.args[0] for x in robot.set_dofs_frictionloss.mock_calls])
    for row, scale, turn in zip(loaded.effort(robot), (1.0, 2.0), (1.0, -1.0), strict=True):
        asked = friction(found, scale * PLACES, turn * SPEEDS)
        np.testing.assert_allclose(losses * np.sign(turn * SPEEDS) - row, asked, atol=1e-12)


def test_drake_gets_rotors_by_its_own_tags_and_no_friction(tmp_path: Path) -> None:
    found = content(described(tmp_path, **BOXES, **ROTOR))
    text = (tmp_path / 'arm.urdf').read_text()
    text = text.replace(
        '</robot>', '<transmission name="mine"><joint name="elbow"/></transmission></robot>'
    )
    path, words = write(tmp_path, ('drake',), found, text)['drake']
    root = ET.parse(path).getroot()
    assert [x.find('joint').get('name') for x in root.findall('transmission')] == [*JOINTS]
    tag = './/{http://drake.mit.edu}rotor_inertia'
    rotors = [float(x.find(tag).get('value')) for x in root.findall('transmission')]
    np.testing.assert_allclose(rotors, [j.armature for j in found.joints])
    assert not root.findall('joint/dynamics[@friction]') and root.findall('joint/dynamics')
    assert words[0].startswith('Drake has no place for Coulomb friction (')


def test_gazebo_gets_a_base_that_stands_and_links_that_weigh(tmp_path: Path) -> None:
    found = content(described(tmp_path, **BOXES))
    text = (tmp_path / 'arm.urdf').read_text()
    same, _ = write(tmp_path, ('gazebo',), found, text)['gazebo']
    root = ET.parse(same).getroot()
    assert len(root.findall('link')) == 7 and len(root.findall('joint')) == 6
    floating = text.replace('world', 'floor').replace('<link name="tool">', '<link name="tool"/>')
    bare = re.sub('(<link name="tool"/>).*?</link>', r'\1', floating, flags=re.DOTALL)
    root = ET.fromstring(TARGETS['gazebo'].write(bare, found))
    joint = root.find('joint[@name="world_floor"]')
    assert joint.get('type') == 'fixed' and joint.find('child').get('link') == 'floor'
    masses = {x.get('name'): x.find('inertial/mass') for x in root.findall('link')}
    assert [name for name, mass in masses.items() if mass is None] == ['world']
    light = {
        name
        for name, mass in masses.items()
        if 0.0 < float(getattr(mass, 'attrib', {'value': 9})['value']) < 1e-4
    }
    assert light == {'floor', 'tool'}
    pinocchio.buildModelFromXML(ET.tostring(root, encoding='unicode'))


def test_effort_limits_go_into_a_urdf(tmp_path: Path) -> None:
    found = content(described(tmp_path, **BOXES))
    limited = tuple(replace(j, limit=7.0 + n) for n, j in enumerate(found.joints))
    text = TARGETS['urdf'].write(
        (tmp_path / 'arm.urdf').read_text(), replace(found, joints=limited)
    )
    model = pinocchio.buildModelFromXML(text)
    rows = [model.joints[model.getJointId(name)].idx_v for name in JOINTS]
    assert model.effortLimit[rows].tolist() == [7.0, 8.0, 9.0, 10.0]
    before = pinocchio.buildModelFromXML((tmp_path / 'arm.urdf').read_text())
    assert model.lowerPositionLimit.tolist() == before.lowerPositionLimit.tolist()


def test_limits_of_the_machine_file_and_no_inertia_below_zero_are_exported(
    tmp_path: Path,
) -> None:
    below = {'drive_inertia': [-1.0, 1.0, 'kg m^2']}
    machine = described(tmp_path, **BOXES, **below).with_constants(torque_limit=7.5)
    found = content(machine, **{'elbow.drive_inertia': -0.2, 'base.drive_inertia': 0.3})
    files = write(tmp_path / 'out', ('drake', 'isaac'), found, (tmp_path / 'arm.urdf').read_text())
    root = ET.parse(files['drake'][0]).getroot()
    assert {x.get('effort') for x in root.iterfind('joint/limit')} == {'7.5'}
    told = yaml.safe_load(files['isaac'][0].read_text())
    assert told['joint_effort_limit'] == dict.fromkeys(JOINTS, 7.5)
    assert told['armature']['elbow'] == 0.0 and told['armature']['base'] == pytest.approx(0.3)
    why = 'an inertia of motors and gears below zero, which makes up for links (elbow -0.2 kg m^2'
    assert all(why in words[0] for _, words in files.values())


def test_links_without_mass_and_joints_that_follow_are_named(tmp_path: Path) -> None:
    found = content(described(tmp_path, **BOXES))
    text = (
        (tmp_path / 'arm.urdf')
        .read_text()
        .replace(
            '</robot>',
            '<link name="tip"/><joint name="grip" type="continuous"><parent link="tool"/>'
            '<child link="tip"/><mimic joint="wrist"/></joint></robot>',
        )
    )
    for name, (_, words) in write(tmp_path, ('pybullet', 'drake'), found, text).items():
        if name != 'urdf':
            assert f'links without mass {TARGETS[name].massless}: tip' in words
            assert f'joints that follow others {TARGETS[name].follows}: grip' in words
    assert "MASSLESS = ['tip']" in (tmp_path / 'load_pybullet.py').read_text()


def test_the_rest_of_a_urdf_stays(tmp_path: Path) -> None:
    text = (described(tmp_path, **BOXES), (tmp_path / 'arm.urdf').read_text())[1]
    text = text.replace('<link name="hand">', '<!-- mine --><link name="hand"><visual/>')
    found = content(load_machine(tmp_path / 'arm.yaml'))
    out = TARGETS['urdf'].write(text, found)
    assert '<!-- mine -->' in out and '<visual' in out
    before, after = (pinocchio.buildModelFromXML(t) for t in (text, out))
    tool = after.frames[after.getFrameId('flange')].inertia
    assert tool.isApprox(before.frames[before.getFrameId('flange')].inertia)
    assert after.inertias[0].isApprox(before.inertias[0])


# ---------------------------------------------------------------------- USD


def test_a_usd_has_what_its_converter_leaves_out(tmp_path: Path) -> None:
    sys.path.append(str(ROOT / 'build/peers'))
    pytest.importorskip('urdf_usd_converter', reason='the extra usd is not installed')
    from pxr import Usd, UsdPhysics

    found = content(described(tmp_path, **BOXES, **ROTOR))
    servo = Gains(40.0, 0.0, 3.0, 0.0)
    joints = [replace(j, limit=7.0 + n) for n, j in enumerate(found.joints)]
    joints[0] = replace(joints[0], gains=servo)
    turned = (tmp_path / 'arm.urdf').read_text().replace('name="wrist"', 'name="wrist.1"')
    joints[-1] = replace(joints[-1], name='wrist.1')
    found = replace(found, joints=tuple(joints))
    text = TARGETS['usd'].write(turned, found)
    path = tmp_path / 'robot.usda'
    path.write_text(text)
    stage = Usd.Stage.Open(str(path))
    there = {p.GetDisplayName() or p.GetName(): p for p in stage.Traverse()}
    for joint in joints:
        prim = there[joint.name]
        degree, axis = (math.radians(1.0), 'angular') if joint.travel == 'rad' else (1.0, 'linear')
        assert prim.GetAttribute('newton:damping').Get() == pytest.approx(joint.viscous * degree)
        assert prim.GetAttribute('newton:friction').Get() == pytest.approx(joint.coulomb)
        assert prim.GetAttribute('newton:armature').Get() == pytest.approx(joint.armature)
        drive = UsdPhysics.DriveAPI(prim, axis)
        assert drive.GetMaxForceAttr().Get() == pytest.approx(joint.limit)
        p, d = (40.0, 3.0) if joint.gains else (0.0, 0.0)
        assert drive.GetStiffnessAttr().Get() == pytest.approx(p * degree)
        assert drive.GetDampingAttr().Get() == pytest.approx(d * degree)
    for name, mass, centre, inertia in found.inertials():
        own = there[name]
        assert own.GetAttribute('physics:mass').Get() == pytest.approx(mass)
        assert own.GetAttribute('physics:centerOfMass').Get() == pytest.approx(centre, abs=1e-6)
        sizes = own.GetAttribute('newton:inertia').Get()
        full = [inertia[x] for x in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))]
        assert list(sizes) == pytest.approx(full, abs=1e-6)
    # What is our own is replaced, what is another's is not.
    assert text.startswith('#usda') and b'export' in kind_of(path)
    assert str(tmp_path) not in text and '/tmp' not in text
    with pytest.raises(IdentError, match='no USD can be made of the URDF'):
        TARGETS['usd'].write(turned.replace('type="prismatic"', 'type="sideways"'), found)


def test_a_usd_wants_its_converter(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    found = content(described(tmp_path, **BOXES))
    monkeypatch.setattr('ros2_ident.export.targets.find_spec', lambda _: None)
    text = (tmp_path / 'arm.urdf').read_text()
    assert 'usd' not in fitting(found, text)
    with pytest.raises(IdentError, match='`pip install urdf-usd-converter`'):
        write(tmp_path / 'out', ('usd',), found, text)


# ---------------------------------------------------------------------- tables


def test_effects_become_the_closest_friction_and_are_named(tmp_path: Path) -> None:
    there = [EffectAt('load_dependent_friction', 'elbow')]
    machine = described(tmp_path, **BOXES)
    plain = content(machine)
    found = content(machine, effects=there)
    path, words = into_urdf(tmp_path, found)
    assert 'load_dependent_friction of elbow' in words[0]
    assert 'best approximation of friction and effects' in words[-1]
    elbow = JOINTS.index('elbow')
    assert found.joints[elbow].coulomb > 1.05 * found.identified[elbow].coulomb
    assert found.joints[0].coulomb == pytest.approx(plain.joints[0].coulomb, rel=1e-6)
    # Closer than without.
    row = found.missed(TARGETS['urdf'].holds)['elbow']
    without = replace(found, joints=found.identified).missed(TARGETS['urdf'].holds)['elbow']
    assert row['missed_as_exported'] < 0.8 * without['missed_as_exported']
    assert yaml.safe_load(path.with_name('export.json').read_text())['spread'] == 0.3


def test_isaac_and_ros2_control(tmp_path: Path) -> None:
    machine = load_machine(ROOT / 'config/emps.yaml')
    from ros2_ident.recording import Dataset

    time = np.arange(400) * machine.number('cycle')
    place = 0.1 * np.sin(9.0 * time)[None]
    rate = np.gradient(place, time, axis=1)
    data = Dataset(
        machine.drives, machine.number('cycle'), 0, place, rate, place, rate, 10.0 * rate
    )
    problem = problem_of(machine, Data((data,), labels=('log',)))
    found = content_of(problem, known(problem, {}), 0.3)
    assert fitting(found, '') == ('isaac', 'ros2_control')
    write(tmp_path, ('isaac', 'ros2_control'), found, '')
    joint = found.joints[0]
    late = replace(found, delays={joint.name: 0.01})
    _, words = write(tmp_path / 'late', ('isaac',), late, '')['isaac']
    assert 'how late controllers take their set-points up' in words[0]
    assert f"# Here, s: {{'{joint.name}': 0.01}}" in (tmp_path / 'late/isaac.yaml').read_text()
    actuators = yaml.safe_load((tmp_path / 'isaac.yaml').read_text())
    assert actuators['dynamic_friction'] == {joint.name: pytest.approx(joint.coulomb)}
    limit = {} if math.isinf(joint.limit) else {joint.name: joint.limit}
    assert actuators.get('joint_effort_limit', {}) == limit
    bare = replace(found, joints=(replace(joint, gains=None, limit=math.inf),))
    told = yaml.safe_load(TARGETS['isaac'].write('', bare))
    assert told['stiffness'] is None and told['damping'] is None
    assert 'joint_effort_limit' not in told
    assert actuators['armature'] == {joint.name: pytest.approx(joint.armature)}
    control = yaml.safe_load((tmp_path / 'ros2_control.yaml').read_text())
    gains = control['joint_trajectory_controller']['ros__parameters']['gains'][joint.name]
    position, velocity = (machine.number(f'{name}_gain') for name in ('position', 'velocity'))
    share = machine.number('velocity_feedforward')
    assert gains['p'] == pytest.approx(position * velocity)
    assert gains['d'] == pytest.approx(velocity)
    assert gains['ff_velocity_scale'] == pytest.approx(velocity * (share - 1.0))
    for name in ('a.*: 1', '1e3', 'y', 'nan'):
        odd = replace(found, joints=(replace(joint, name=name),))
        (pattern,) = yaml.safe_load(TARGETS['isaac'].write('', odd))['joint_names_expr']
        assert re.fullmatch(pattern, name) and not re.fullmatch(pattern, 'ab: 1')
        text = TARGETS['ros2_control'].write('', odd)
        told = yaml.safe_load(text)['joint_trajectory_controller']['ros__parameters']
        # ROS reads a truth or a number of the last three where they stand without quotes.
        assert told['joints'] == [*told['gains']] == [name] and text.count(f"'{name}'") == 3


def test_a_target_without_its_description_is_refused(tmp_path: Path) -> None:
    found = content(described(tmp_path, **BOXES))
    for name, word in (('urdf', '--into'), ('ros2_control', 'position_gain')):
        with pytest.raises(IdentError) as caught:
            write(tmp_path / 'out', (name,), found, '')
        assert caught.value.code is ErrorCode.INVALID_GOAL
        assert word in caught.value.message
    other = (tmp_path / 'arm.urdf').read_text().replace('"elbow"', '"knee"')
    with pytest.raises(IdentError, match='no joint elbow'):
        write(tmp_path / 'out', ('urdf',), found, other)
    assert not (tmp_path / 'out').exists()


def test_a_diagnosis_brings_its_effects(tmp_path: Path) -> None:
    nan = math.nan
    parameters = {
        'elbow.coulomb_torque': Value(3.0, 'N m', 2.5, 3.5),
        'elbow.stribeck.size': Value(0.4, 'N m', nan, nan),
        'effort_smoothing.period': Value(0.5, 's', 0.4, 0.6),
    }
    settings = {'drives': ['elbow'], 'fixed': {'payload_mass': 1.0}, 'bags': ['log']}

    def write_found(**more: Value) -> None:
        found = replace(diagnosed(), parameters={**parameters, **more})
        write_diagnosis(tmp_path, found, tripod(), Data((), source='log'), settings=settings)

    write_found()
    estimate = read_estimate(tmp_path)
    assert estimate.effects(['elbow.coulomb_torque']) == (
        EffectAt('stribeck', 'elbow'),
        EffectAt('effort_smoothing', 'all'),
    )
    assert estimate.prior.deviations['elbow.coulomb_torque'] == pytest.approx(0.5 / 1.96)
    assert np.isinf(estimate.prior.deviations['elbow.stribeck.size'])
    assert estimate.fixed == {'payload_mass': 1.0}
    # Values of single recordings are none of the machine's.
    mass = {'payload_mass@log': Value(1.0, 'kg', 0.0, 2.0)}
    write_found(**mass)
    assert 'payload_mass@log' in read_estimate(tmp_path).values  # a joint `payload_mass@log`
    settings['each'] = ['payload_mass']
    write_found(**mass)
    with pytest.raises(IdentError, match='is the value of one recording'):
        read_estimate(tmp_path)
