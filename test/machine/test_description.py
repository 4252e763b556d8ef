# SPDX-License-Identifier: Apache-2.0
"""Descriptions as people have them: includes, meshes, classes of defaults, keyframes."""

from pathlib import Path
import re
import sys

import pytest
from scipy.spatial.transform import Rotation
import yaml

from ros2_ident.errors import IdentError
from ros2_ident.machine.description import (
    declared,
    description_text,
    judged_tree,
    own_physics,
)
from ros2_ident.models.new_file import new_machine_file
from ros2_ident.models.registry import KINDS

ARM = """<mujoco model="arm">
  <compiler meshdir="assets"/>
  <default>
    <joint armature="0.15" damping="7"/>
    <default class="wrist"><joint damping="2" frictionloss="6"/><geom type="mesh"/></default>
  </default>
  <asset>
    <texture name="wood" type="2d" file="wood.png"/><material name="wood" texture="wood"/>
    <mesh name="link" file="link.stl"/><mesh file="tool.obj"/>
  </asset>
  <worldbody>
    <light pos="0 0 1"/>
    <body name="upper">
      {inertial}<joint name="shoulder"/><geom name="g" class="wrist" mesh="link" material="wood"/>
      <body name="lower" childclass="wrist">
        <inertial mass="1" pos="0 0 0" diaginertia="1 1 1"/><joint name="elbow"/>
        <geom type="sphere" size="0.1" material="wood"/>
      </body>
    </body>
  </worldbody>
  <contact><pair geom1="g" geom2="g"/></contact>
  <actuator><position joint="shoulder" kp="3500"/></actuator>
  <keyframe><key qpos="0 0"/></keyframe>
</mujoco>"""
INERTIAL = '<inertial mass="1" pos="0 0 0" diaginertia="1 1 1"/>'


def test_what_is_for_the_eye_alone_is_left_out_where_an_arm_is_simulated() -> None:
    text = ARM.format(inertial=INERTIAL)
    assert judged_tree(text).find('asset/mesh') is not None
    root = judged_tree(text, shapes=False)
    tags = {element.tag for element in root.iter()}
    assert not tags & {'mesh', 'texture', 'material', 'light', 'keyframe', 'pair'}
    assert [geom.get('type') for geom in root.iterfind('worldbody//geom')] == ['sphere']
    assert not any({'mesh', 'material', 'file'} & {*element.keys()} for element in root.iter())


def test_a_mass_that_only_a_mesh_tells_is_asked_for() -> None:
    with pytest.raises(IdentError, match='has body "?upper.* mesh "?link"?, which is not read'):
        judged_tree(ARM.format(inertial=''), shapes=False)


def test_what_is_said_of_a_mass_that_only_a_mesh_tells_is_the_way_out(tmp_path) -> None:
    sys.path.append(str(Path(__file__).parents[2] / 'build/peers'))
    mujoco = pytest.importorskip('mujoco', reason='MuJoCo is not installed; see CONTRIBUTING.md')
    text = """<mujoco><asset><mesh name="link" vertex="0 0 0 1 0 0 0 1 0 0 0 1"/></asset>
    <worldbody><body name="upper"><joint/><geom type="mesh" mesh="link"/></body></worldbody>
    </mujoco>"""
    with pytest.raises(IdentError) as caught:
        judged_tree(text, shapes=False)
    element = re.search('<compiler [^>]*>', str(caught.value))[0]
    model = mujoco.MjModel.from_xml_string(text.replace('<asset>', f'{element}<asset>'))
    mujoco.mj_saveLastXML(str(tmp_path / 'saved.xml'), model)
    inertial = judged_tree((tmp_path / 'saved.xml').read_text(), shapes=False).find('.//inertial')
    assert float(inertial.get('mass')) == pytest.approx(model.body_mass[1], rel=1e-4)


def test_classes_of_defaults_and_bounds_hold_what_they_state() -> None:
    text = ARM.format(inertial=INERTIAL)
    root = judged_tree(text)
    assert sorted(declared(root, 'joint', 'damping').values()) == [[2.0], [7.0]]
    assert [*declared(root, 'joint', 'frictionloss').values()] == [[6.0]]
    assert [*declared(root, 'joint', 'armature').values()] == [[0.15], [0.15]]
    boxes = yaml.safe_load(new_machine_file(KINDS['mujoco'], (), text, 'arm.xml'))['parameters']
    assert [*KINDS['mujoco'].joints(root)] == ['shoulder']  # no actuator turns the elbow
    for name, value in (('armature', 0.15), ('damping', 7), ('frictionloss', 6), ('kp', 3500)):
        low, high, _ = boxes[name]
        assert low < value < high


CHAIN = """<mujoco><worldbody><body name="base"><site name="foot"/>{base}
  <body name="upper"><joint name="a"{joint}/><site name="bow"/>
    <body name="lower"><joint name="b"/><body name="finger"><joint name="c"/></body></body>
  </body></body></worldbody>
  <actuator><position joint="a"{gear}/>{actuator}</actuator>{more}</mujoco>"""
NOTHING = dict.fromkeys(('base', 'joint', 'gear', 'actuator', 'more'), '')


@pytest.mark.parametrize(
    ('part', 'text', 'said'),
    [
        ('more', '', ''),
        # What only joints that stand still move is none of the arm's.
        ('more', '<equality><joint joint1="c"/></equality>', ''),
        ('more', '<equality><weld body1="lower" body2="finger"/></equality>', ''),
        ('more', '<tendon><fixed><joint joint="c"/></fixed></tendon>', ''),
        ('actuator', '<velocity joint="c"/>', ''),
        ('more', '<equality><joint joint1="b" joint2="a"/></equality>', 'the joint None'),
        ('more', '<equality><weld name="w" body1="lower"/></equality>', 'the weld w'),
        ('more', '<equality><connect site1="foot" site2="bow"/></equality>', 'the connect None'),
        (
            'more',
            '<tendon><spatial name="t"><site site="foot"/><site site="bow"/></spatial></tendon>',
            'the tendon t',
        ),
        ('more', '<tendon><fixed name="t"><joint joint="b"/></fixed></tendon>', 'the tendon t'),
        ('base', '<freejoint/>', ''),
        ('base', '<joint type="ball"/>', 'body base, which floats'),
        ('joint', ' stiffness="3"', 'the stiffness of a'),
        ('gear', ' gear="2"', 'the gear of a'),
        ('actuator', '<velocity joint="b"/>', 'the actuator velocity'),
    ],
)
def test_own_physics_of_an_mjcf_is_named(part: str, text: str, said: str) -> None:
    root = judged_tree(CHAIN.format(**{**NOTHING, part: text}))
    assert own_physics(root, ('a', 'b')) == said


@pytest.mark.parametrize(
    ('compiler', 'turn', 'told'),
    [
        ('', 'axisangle="0 3 4 30"', Rotation.from_rotvec([0.0, 18.0, 24.0], degrees=True)),
        ('angle="radian"', 'axisangle="0 0 1 -0.7"', Rotation.from_rotvec([0.0, 0.0, -0.7])),
        # MuJoCo's upper letters are axes that stay, SciPy's such as turn along
        ('eulerseq="XYZ"', 'euler="10 20 30"', Rotation.from_euler('xyz', [10, 20, 30], True)),
        ('eulerseq="ZYX"', 'euler="10 20 30"', Rotation.from_euler('zyx', [10, 20, 30], True)),
        ('eulerseq="zXy"', 'euler="10 20 30"',
         Rotation.from_euler('x', 20, True) * Rotation.from_euler('ZY', [10, 30], True)),
    ],
)  # fmt: skip
@pytest.mark.parametrize('of', ['body', 'class'])
def test_turns_that_are_no_quaternions_become_such(
    compiler: str, turn: str, told: Rotation, of: str
) -> None:
    own, usual = (f' {turn}', '') if of == 'body' else ('', f' {turn}')
    root = judged_tree(
        f'<mujoco><compiler {compiler}/><default><geom{usual}/></default>'
        f'<worldbody><body><geom{own}/></body></worldbody></mujoco>'
    )
    geom = root.find('worldbody/body/geom')
    assert geom is not None and {*geom.attrib} == {'quat'}
    w, *xyz = map(float, geom.attrib['quat'].split())
    assert (Rotation.from_quat([*xyz, w]) * told.inv()).magnitude() == pytest.approx(0, abs=1e-12)


@pytest.mark.parametrize('sequence', ['xyz', 'zyx'])
def test_turns_that_every_reader_knows_stay(sequence: str) -> None:
    text = f'<mujoco><compiler eulerseq="{sequence}"/><worldbody><body euler="1 2 3"/></worldbody>'
    root = judged_tree(f'{text}<replicate euler="1 2 3"/></mujoco>')
    assert [x.attrib for x in root.iter() if 'euler' in x.attrib] == [{'euler': '1 2 3'}] * 2


def test_includes_are_read_from_the_folder_and_no_further(tmp_path: Path) -> None:
    folder = tmp_path / 'robot'
    (folder / 'parts').mkdir(parents=True)
    scene, arm = folder / 'scene.xml', folder / 'parts/arm.xml'
    scene.write_text('<mujoco><include file="parts/arm.xml"/><worldbody/></mujoco>')
    arm.write_text('<mujocoinclude><include file="joint.xml"/></mujocoinclude>')
    joint = '<worldbody><body><joint name="elbow"/></body></worldbody>'
    (folder / 'parts/joint.xml').write_text(f'<mujoco>{joint}</mujoco>')
    root = judged_tree(description_text(scene))
    assert [x.get('name') for x in root.iter('joint')] == ['elbow']
    (tmp_path / 'other.xml').write_text('<mujoco/>')
    for name in ('../../other.xml', '../scene.xml', '../arm.xml'):
        arm.write_text(f'<mujoco><include file="{name}"/></mujoco>')
        with pytest.raises(IdentError, match=r'is included and not read|cannot be read'):
            description_text(scene)
