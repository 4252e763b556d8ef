# SPDX-License-Identifier: Apache-2.0
"""What was identified, in an MJCF, by MuJoCo."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
import sys
import xml.etree.ElementTree as ET

from export_cases import (
    content,
    down,
    efforts,
    in_mjcf,
    known,
    MJCF,
    module_at,
    ROOT,
    ROTOR,
    SMOOTH,
)
from models.test_serial import BOXES, described, JOINTS
import numpy as np
import pytest

from ros2_ident.export.content import Content, content_of
from ros2_ident.export.targets import write
from ros2_ident.identify.data import Data
from ros2_ident.identify.problem import problem_of
from ros2_ident.models import EffectAt
from ros2_ident.models.drives.joints import Gains


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


def test_a_usd_of_an_mjcf_has_drives_in_the_place_of_actuators(tmp_path: Path, mujoco) -> None:
    pytest.importorskip('mujoco_usd_converter', reason='the extra usd is not installed')
    from pxr import Usd, UsdPhysics

    found = content(in_mjcf(tmp_path, **BOXES, **ROTOR))
    servo = Gains(40.0, 0.0, 3.0, 0.0)
    own = {'base': {'gains': servo, 'limit': 9.0}, 'wrist': {'limit': 7.0}}
    joints = [replace(joint, **own.get(joint.name, {})) for joint in found.joints]
    shapes = tmp_path / 'shapes'
    shapes.mkdir()
    (shapes / 'cover.obj').write_text(
        'v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n'
    )
    text = MJCF.replace('<compiler ', '<compiler meshdir="shapes" ').replace(
        '<worldbody>',
        '<asset><mesh name="lid" file="cover.obj"/><texture name="wood" type="2d" file="no.png"/>'
        '<material name="wood" texture="wood"/></asset><worldbody>',
    )
    text = text.replace(
        '<body name="cover" pos="0 0 0.1">',
        '<body name="cover" pos="0 0 0.1"><geom type="mesh" mesh="lid" material="wood"/>',
    ).replace(
        '</mujoco>',
        """<actuator><motor name="push" joint="slide" gear="50" forcerange="-3 3"/>
        <position name="bend" joint="elbow" gear="-2" kp="30" kv="0.5"/></actuator></mujoco>""",
    )
    told = replace(found, joints=tuple(joints))
    path, _ = write(tmp_path / 'out', ('usd',), told, text, tmp_path)['usd']
    stage = Usd.Stage.Open(str(path))
    prims = list(stage.Traverse())
    there = {p.GetDisplayName() or p.GetName(): p for p in prims}
    assert not [p for p in prims if p.GetTypeName() == 'MjcActuator']
    assert [p.GetName() for p in prims if p.GetTypeName() == 'Mesh'] == ['lid']
    assert str(tmp_path) not in path.read_text() and 'no.png' not in path.read_text()
    expected = {'base': (9.0, 40.0, 3.0), 'slide': (150.0, 0.0, 0.0), 'wrist': (7.0, 0.0, 0.0),
                'elbow': (np.inf, 120.0, 2.0)}  # fmt: skip
    for joint in joints:
        prim, turns = there[joint.name], joint.travel == 'rad'
        degree, axis = (np.radians(1.0), 'angular') if turns else (1.0, 'linear')
        assert prim.GetAttribute('newton:damping').Get() == pytest.approx(joint.viscous * degree)
        assert prim.GetAttribute('newton:friction').Get() == pytest.approx(joint.coulomb)
        assert prim.GetAttribute('newton:armature').Get() == pytest.approx(joint.armature)
        drive = UsdPhysics.DriveAPI(prim, axis)
        most, p, d = expected[joint.name]
        assert drive.GetMaxForceAttr().Get() == pytest.approx(most)
        assert drive.GetStiffnessAttr().Get() == pytest.approx(p * degree)
        assert drive.GetDampingAttr().Get() == pytest.approx(d * degree)
    for name, mass, *_ in told.inertials():
        assert there[name].GetAttribute('physics:mass').Get() == pytest.approx(mass)


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
