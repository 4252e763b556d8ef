# SPDX-License-Identifier: Apache-2.0
"""What was identified, in files that pinocchio, MuJoCo, Isaac Lab and ros2_control read."""

from collections.abc import Callable
from dataclasses import replace
import importlib.util
import json
import math
from pathlib import Path
import re
import sys
from types import ModuleType
from unittest.mock import MagicMock
import xml.etree.ElementTree as ET

import numpy as np
import pytest
import yaml

pinocchio = pytest.importorskip('pinocchio', reason='pinocchio is not installed')

from identify_cases import tripod  # noqa: E402
from models.test_serial import BOXES, described, JOINTS, moving  # noqa: E402
from report_cases import diagnosed  # noqa: E402

from ros2_ident.errors import ErrorCode, IdentError  # noqa: E402
from ros2_ident.export.content import Content, content_of  # noqa: E402
from ros2_ident.export.targets import fitting, sentences, TARGETS, write  # noqa: E402
from ros2_ident.files import kind_of  # noqa: E402
from ros2_ident.gap.result import Value  # noqa: E402
from ros2_ident.identify.data import Data  # noqa: E402
from ros2_ident.identify.problem import problem_of  # noqa: E402
from ros2_ident.machine.machine import Machine  # noqa: E402
from ros2_ident.machine.prior import Prior  # noqa: E402
from ros2_ident.models import EffectAt, load_machine, make_model  # noqa: E402
from ros2_ident.models.drives.joints import Gains  # noqa: E402
from ros2_ident.report.diagnosis import write_diagnosis  # noqa: E402
from ros2_ident.report.estimate import Estimate, read_estimate  # noqa: E402

ROOT = Path(__file__).parents[2]
SMOOTH = {name: box for name, box in BOXES.items() if name != 'coulomb_torque'}
# How far the compiled tanh stays below one.
TANH = 3e-8
ROTOR = {'drive_inertia': [0.0, 1.0, 'kg m^2']}
OFFSET = {'constant_force': [-9.0, 9.0, 'N m']}
MJCF = """<mujoco><compiler angle="radian"/><option gravity="0 0 -9.81"/>
  <default><joint damping="7" armature="9"/></default>
  <worldbody><body name="column" pos="0 0 0.4" euler="0.1 0 0.2">
    <joint name="base" axis="0 0 1"/>
    <inertial pos="0.05 -0.1 0.2" mass="7.5" fullinertia="0.3 0.4 0.35 0.01 -0.02 0.03"/>
    <body name="carriage" pos="0.3 0 0.1" euler="0 0.7 0">
      <joint name="slide" type="slide" axis="0 0.6 0.8"/>
      <inertial pos="0 0.1 0.3" mass="4" diaginertia="0.05 0.06 0.03"/>
      <body name="cover" pos="0 0 0.1">
        <inertial pos="0.1 0 0" mass="0.6" diaginertia="0.01 0.01 0.01"/></body>
      <body name="upper" pos="0 0.2 0.5" euler="1.5 0 0">
        <joint name="elbow" axis="0 1 0" pos="0.02 0 0.03"/>
        <inertial pos="0.2 0 0.01" mass="3" diaginertia="0.02 0.05 0.05"/>
        <body name="hand" pos="0.5 0 0" euler="0 -0.4 0.3"><joint name="wrist" axis="1 0 0"/>
          <inertial pos="0.02 0.03 0.1" mass="1.5" diaginertia="0.004 0.005 0.003"/>
  </body></body></body></body></worldbody></mujoco>"""


def in_mjcf(folder: Path, text: str = MJCF, **parameters: object) -> Machine:
    (folder / 'arm.xml').write_text(text)
    boxes = ''.join(f'  {name}: {box}\n' for name, box in parameters.items())
    (folder / 'arm.yaml').write_text(
        f'machine: serial\ndrives: [{", ".join(JOINTS)}]\n'
        f'geometry: {{description: arm.xml}}\ncontroller: {{cycle: 0.004}}\nparameters:\n{boxes}'
    )
    return load_machine(folder / 'arm.yaml')


def known(problem, values: dict[str, float], deviation: float = 1e-3) -> Estimate:
    """Return an estimate: the middle of every box but for some values."""
    middle = {p.name: 0.5 * (p.low + p.high) for p in problem.parameters}
    names = list(middle)
    return Estimate(
        middle | values,
        {},
        problem.drives,
        {},
        '',
        Prior(deviations=dict.fromkeys(names, deviation)),
    )


def content(machine: Machine, effects=(), deviation: float = 1e-3, **values: float) -> Content:
    logged = moving(machine)
    # The band of the motion is that of the log, so the log is made twice.
    for _ in range(2):
        model = make_model(machine, logged, effects=effects)
        theta = np.array([values.get(p.name, 0.5 * (p.low + p.high)) for p in model.parameters])
        model.__dict__['_band'] = None  # all of the log, above its band too
        logged = replace(logged, effort=model.simulate(theta)[0])
    problem = problem_of(machine, Data((logged,), labels=('log',)), effects=effects)
    return content_of(problem, known(problem, values, deviation), 0.3)


def efforts(found: Content) -> np.ndarray:
    """Return what was identified asks of the joints, links consistent."""
    return found.model.simulated_effort(found.theta)


def down(machine: Machine) -> np.ndarray:
    """Return (3,) gravity in the base's frame, which may be tilted."""
    tilt = pinocchio.rpy.rpyToMatrix(machine.number('base_roll'), machine.number('base_pitch'), 0)
    return tilt.T @ [0.0, 0.0, -machine.number('free_fall')]


def by_pinocchio(text: str, found: Content) -> np.ndarray:
    """Return (D, K) what a URDF asks along the log: links, damping and friction."""
    model = pinocchio.buildModelFromXML(text)
    data = model.createData()
    machine = found.model.machine
    model.gravity.linear = down(machine)
    place, speed, bend = found.model.motion
    order = [model.joints[model.getJointId(name)] for name in machine.drives]
    out = np.empty_like(place)
    for k in range(place.shape[1]):
        q, v, a = np.empty(model.nq), np.empty(model.nv), np.empty(model.nv)
        for d, joint in enumerate(order):
            v[joint.idx_v], a[joint.idx_v] = speed[d, k], bend[d, k]
            if joint.nq == 1:
                q[joint.idx_q] = place[d, k]
            else:
                q[joint.idx_q : joint.idx_q + 2] = np.cos(place[d, k]), np.sin(place[d, k])
        asked = pinocchio.rnea(model, data, q, v, a) + model.damping * v
        asked += model.upperDryFrictionLimit * np.sign(v)
        out[:, k] = [asked[joint.idx_v] for joint in order]
    return out


def into_urdf(folder: Path, found: Content) -> tuple[Path, tuple[str, ...]]:
    return write(folder, ('urdf',), found, (folder / 'arm.urdf').read_text())['urdf']


def module_at(path: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location('loaded', path)
    loaded = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(loaded)
    return loaded


def sliding(found: Content) -> np.ndarray:
    """Return (D, K) where friction has turned over altogether."""
    return np.abs(found.model.motion[1]) > 20.0 * found.model.machine.number(
        'coulomb_regularisation'
    )


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


# ---------------------------------------------------------------------- MuJoCo


@pytest.fixture
def mujoco():
    sys.path.append(str(ROOT / 'build/peers'))  # where tools/peers.sh installs it
    return pytest.importorskip('mujoco', reason='MuJoCo is not installed; see CONTRIBUTING.md')


def by_mujoco(mujoco, text, found: Content) -> np.ndarray:
    """Return (D, K) what an MJCF asks along the log, by MuJoCo's inverse dynamics."""
    model = mujoco.MjModel.from_xml_string(text) if isinstance(text, str) else text
    data = mujoco.MjData(model)
    place, speed, bend = found.model.motion
    joints = [model.joint(name) for name in found.model.machine.drives]
    out = np.empty_like(place)
    for k in range(place.shape[1]):
        for d, joint in enumerate(joints):
            data.qpos[joint.qposadr[0]] = place[d, k]
            data.qvel[joint.dofadr[0]] = speed[d, k]
            data.qacc[joint.dofadr[0]] = bend[d, k]
        mujoco.mj_inverse(model, data)
        out[:, k] = [data.qfrc_inverse[joint.dofadr[0]] for joint in joints]
    return out


@pytest.mark.parametrize('gone', ['no name', ' name="upper"'])
def test_an_mjcf_asks_what_was_identified(tmp_path: Path, mujoco, gone) -> None:
    text = MJCF.replace(gone, '')
    found = content(in_mjcf(tmp_path, text, **SMOOTH, **ROTOR), **{'elbow.link_moment_x': 0.9})
    path, words = write(tmp_path, ('mjcf',), found, text)['mjcf']
    off = by_mujoco(mujoco, path.read_text(), found) - efforts(found)
    assert np.abs(off).max() < 1e-9
    assert [w for w in words if 'no place' in w] == []


def test_a_urdf_becomes_an_mjcf_that_asks_what_was_identified(tmp_path: Path, mujoco) -> None:
    found = content(described(tmp_path, **SMOOTH, **ROTOR))
    text = (tmp_path / 'arm.urdf').read_text()
    mesh = '<collision><geometry><mesh filename="none.stl"/></geometry></collision>'
    text = text.replace('<link name="hand">', f'<link name="hand">{mesh}')
    path, words = write(tmp_path, ('mjcf',), found, text)['mjcf']
    model = mujoco.MjModel.from_xml_string(path.read_text())
    model.opt.gravity[:] = down(found.model.machine)
    asked, most = efforts(found), np.abs(efforts(found)).max()
    # MuJoCo writes six digits
    assert np.abs(by_mujoco(mujoco, model, found) - asked).max() < 1e-5 * most
    assert [w for w in words if 'no place' in w] == []


def test_shapes_that_a_description_names_are_found_from_another_folder(tmp_path: Path) -> None:
    found = content(described(tmp_path, **BOXES))
    meshes = ''.join(
        f'<visual><geometry><mesh filename="{way}"/></geometry></visual>'
        for way in ('shapes/hand.stl', '/hand.stl', 'package://arm/hand.stl')
    )
    text = (
        (tmp_path / 'arm.urdf')
        .read_text()
        .replace('<link name="hand">', f'<link name="hand">{meshes}')
    )
    path, _ = write(tmp_path / 'out', ('urdf',), found, text, tmp_path)['urdf']
    ways = [shape.get('filename') for shape in ET.parse(path).getroot().iter('mesh')]
    assert ways == ['../shapes/hand.stl', '/hand.stl', 'package://arm/hand.stl']


@pytest.mark.parametrize(
    ('compiler', 'at'),
    [
        ('', '.'),
        ('<compiler meshdir="shapes"/>', 'shapes'),
        ('<compiler assetdir="shapes"/><compiler angle="radian"/>', 'shapes'),
    ],
)
def test_an_mjcf_finds_its_shapes_from_another_folder(
    tmp_path: Path, mujoco, compiler: str, at: str
) -> None:
    found = content(in_mjcf(tmp_path, **BOXES))
    (tmp_path / 'shapes').mkdir()
    corners = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)]
    faces = [(1, 3, 2), (1, 2, 4), (2, 3, 4), (1, 4, 3)]
    lines = [f'v {x} {y} {z}' for x, y, z in corners] + [f'f {a} {b} {c}' for a, b, c in faces]
    (tmp_path / at / 'hand.obj').write_text('\n'.join(lines))
    text = MJCF.replace(
        '<default>', f'{compiler}<asset><mesh file="hand.obj"/></asset><default>', 1
    )
    path, _ = write(tmp_path / 'out', ('mjcf',), found, text, tmp_path)['mjcf']
    assert mujoco.MjModel.from_xml_path(str(path)).nmesh == 1


def test_what_is_called_as_a_joint_in_an_mjcf_is_none(tmp_path: Path, mujoco) -> None:
    found = content(in_mjcf(tmp_path, **BOXES, **ROTOR))
    other = '<equality><joint name="elbow" joint1="elbow" active="false"/></equality>'
    text = MJCF.replace('<worldbody>', f'{other}<worldbody>')
    path, _ = write(tmp_path, ('mjcf',), found, text)['mjcf']
    model = mujoco.MjModel.from_xml_path(str(path))
    dofs = [model.joint(name).dofadr[0] for name in JOINTS]
    np.testing.assert_allclose(model.dof_damping[dofs], [j.viscous for j in found.joints])


def test_friction_and_limits_in_an_mjcf_hold(tmp_path: Path, mujoco) -> None:
    found = content(in_mjcf(tmp_path, **BOXES, **ROTOR))
    limited = replace(found, joints=tuple(replace(j, limit=7.0) for j in found.joints))
    path, _ = write(tmp_path, ('mjcf',), limited, MJCF)['mjcf']
    model = mujoco.MjModel.from_xml_path(str(path))
    assert model.jnt_actfrclimited.all() and (model.jnt_actfrcrange == [-7.0, 7.0]).all()
    assert model.opt.integrator == mujoco.mjtIntegrator.mjINT_EULER
    model.opt.gravity[:] = 0.0
    data = mujoco.MjData(model)
    wrist = model.joint('wrist')
    data.qfrc_applied[wrist.dofadr[0]] = 0.5 * model.dof_frictionloss[wrist.dofadr[0]]
    mujoco.mj_step(model, data, 500)
    assert model.dof_frictionloss[wrist.dofadr[0]] > 1.0
    assert abs(data.qpos[wrist.qposadr[0]]) < 1e-4


def test_controllers_stand_in_an_mjcf_where_the_actuators_stood(tmp_path: Path, mujoco) -> None:
    found = content(in_mjcf(tmp_path, **BOXES))
    served = {'base', 'elbow', 'wrist'}
    joints = [replace(j, gains=Gains(40.0, 0.0, 3.0, 0.0), limit=9.0) if j.name in served else j
              for j in found.joints]  # fmt: skip
    text = MJCF.replace('<default>', '<default><motor gear="50" ctrlrange="-1 1"/>', 1)
    text = text.replace(
        '</mujoco>',
        """<actuator>
        <position name="turn" joint="base" kp="3" dampratio="1" timeconst="0.1" ctrlrange="-2 2"/>
        <motor name="push" joint="slide"/><motor name="bend" jointinparent="elbow"/>
        <motor name="more" joint="elbow"/></actuator></mujoco>""",
    )
    path, _ = write(tmp_path, ('mjcf',), replace(found, joints=tuple(joints)), text)['mjcf']
    model = mujoco.MjModel.from_xml_path(str(path))
    assert [model.actuator(n).name for n in range(model.nu)] == ['turn', 'push', 'bend', 'wrist']
    assert model.actuator_gear[:, 0].tolist() == [1.0, 50.0, 1.0, 1.0] and model.na == 0
    assert model.actuator_ctrllimited.tolist() == [True, True, False, False]
    assert model.actuator_ctrlrange[0].tolist() == [-2.0, 2.0]
    own = [0, 2, 3]
    assert model.actuator_biasprm[own, :3].tolist() == [[0.0, -40.0, -3.0]] * 3
    assert model.actuator_forcerange[own, 1].tolist() == [9.0] * 3


class Servo:
    """A servo with a load on its arm, identified, and the same arm in MuJoCo."""

    def __init__(self, effects: tuple[EffectAt, ...] = (), **values: float) -> None:
        from models.test_servo import machine, set_points, TRUTH

        from ros2_ident.recording import Dataset

        one = machine()
        self.goals, velocity = set_points()
        seen = np.full_like(self.goals, np.nan)
        seen[:, :12] = self.goals[0, 0]
        seen[:, 12::2] = 0.0
        data = Dataset(one.drives, 1e-3, 0, self.goals, velocity, seen, None, None)
        problem = problem_of(one, Data((data,), labels=('log',)), effects=effects)
        values = {f'joint.{name}': x for name, x in values.items()}
        values |= {f'joint.{name}': TRUTH[name] for name in one.bounds}
        self.found = content_of(problem, known(problem, values), 0.3)
        self.ours = self.found.model.simulate(self.found.theta)[0, 0]
        load, arm = one.number('load_mass'), one.number('arm_mass')
        moment = 0.1 * (load + 0.5 * arm)
        # The arm's inertia about the joint is the load's.
        self.inertia = 4e-4 + (load + arm / 3.0) * 0.1**2 - 0.51 * (moment / 0.51) ** 2
        self.mjcf = f"""<mujoco><option timestep="1e-4" gravity="0 0 -9.81"/><worldbody>
          <body euler="0 {np.degrees(0.03)} 0"><joint name="joint" axis="0 1 0"/>
          <inertial pos="0 0 {-moment / 0.51}" mass="0.51" diaginertia="1 1 1"/></body>
          </worldbody></mujoco>"""

    def apart(self, mujoco, model, act: Callable | None = None) -> float:
        """Return how far off MuJoCo is under the same set-points, as a share of the way."""
        model.body_inertia[1] = self.inertia
        sim = mujoco.MjData(model)
        mujoco.mj_setConst(model, sim)
        sim.qpos[0] = self.goals[0, 0]
        mujoco.set_mjcb_passive(act)
        out = []
        for command in self.goals[0]:
            out.append(sim.qpos[0])
            sim.ctrl[0] = command
            mujoco.mj_step(model, sim, 10)
        mujoco.set_mjcb_passive(None)
        return float(np.sqrt(np.mean((np.array(out) - self.ours) ** 2)) / np.ptp(self.ours))


def test_a_servo_in_an_mjcf_follows_as_it_was_identified(tmp_path: Path, mujoco) -> None:
    servo = Servo()
    path, words = write(tmp_path, ('mjcf',), servo.found, servo.mjcf)['mjcf']
    model = mujoco.MjModel.from_xml_string(path.read_text())
    assert model.opt.integrator == mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    assert servo.apart(mujoco, model) < 0.01
    assert words == ()


def test_effects_act_in_mujoco_as_in_our_own_simulation(tmp_path: Path, mujoco) -> None:
    values = {
        'command_delay.delay': 0.0253,
        'stribeck.torque': 0.05, 'stribeck.velocity': 0.4,
        'torque_ripple.sine': 0.06, 'torque_ripple.cosine': -0.03, 'torque_ripple.order': 7.0,
        'asymmetric_friction.coulomb': 0.01, 'asymmetric_friction.viscous': 0.002,
    }  # fmt: skip
    kinds = dict.fromkeys(name.partition('.')[0] for name in values)
    servo = Servo(tuple(EffectAt(kind, 'joint') for kind in kinds), **values)
    files = write(tmp_path, ('mjcf_effects',), servo.found, servo.mjcf)
    loaded = module_at(files['mjcf_effects'][0])

    def run(effects: bool, late: bool) -> float:
        model = loaded.load() if effects else mujoco.MjModel.from_xml_path(str(files['mjcf'][0]))
        model.actuator_delay[:] *= late
        return servo.apart(mujoco, model, loaded.act if effects else None)

    assert loaded.load().actuator_history[0, 0] * 1e-4 >= 0.0253
    assert run(True, True) < 0.005
    assert run(False, True) > 0.02 and run(True, False) > 0.05
    assert files['mjcf_effects'][1] == ()


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
    monkeypatch.setattr('ros2_ident.export.descriptions.can_write', lambda: False)
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
