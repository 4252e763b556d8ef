# SPDX-License-Identifier: Apache-2.0
"""Arms: terms, recursive Newton-Euler and the slow twin against each other; effects at joints."""

from dataclasses import replace
from pathlib import Path
import re
import sys
import xml.etree.ElementTree as ET
from xml.sax.saxutils import quoteattr

import numpy as np
import pytest
import yaml

pytest.importorskip('pinocchio', reason='pinocchio is not installed')

from arm_cases import described, JOINTS, LINKS, TILT, URDF  # noqa: E402

from checks.reference import arm as twin  # noqa: E402
from ros2_ident.cli.main import main  # noqa: E402
from ros2_ident.effects import CATALOGUE  # noqa: E402
from ros2_ident.errors import ErrorCode, IdentError  # noqa: E402
from ros2_ident.gates import examine  # noqa: E402
from ros2_ident.identify.data import Data  # noqa: E402
from ros2_ident.identify.problem import problem_of  # noqa: E402
from ros2_ident.machine.machine import Machine  # noqa: E402
from ros2_ident.models import EffectAt, load_machine, machine_from_mapping, make_model  # noqa: E402
from ros2_ident.models.drives.band import Band  # noqa: E402
from ros2_ident.models.new_file import followed_file, new_machine_file  # noqa: E402
from ros2_ident.models.registry import kind_of, KINDS, travel_of  # noqa: E402
from ros2_ident.models.serial.arm import arm_of, check_reach  # noqa: E402
from ros2_ident.models.serial.log import ArmLog  # noqa: E402
from ros2_ident.recording import Dataset, Recording, Stream  # noqa: E402
from ros2_ident.recording.motion import low_pass  # noqa: E402

TABLE = {
    'dh_a': [0.0, 0.1, 0.4, 0.05],
    'dh_alpha': [0.2, -1.5, 0.3, 1.4],
    'dh_d': [0.3, -0.1, 0.05, 0.2],
    'dh_theta': [0.1, 0.4, -0.7, 0.2],
    'joint': ['revolute', 'prismatic', 'continuous', 'prismatic'],
}
BOXES = {
    'link_moment': [-5.0, 5.0, 'kg m'],
    'link_inertia': [-5.0, 5.0, 'kg m^2'],
    'coulomb_torque': [0.0, 20.0, 'N m'],
    'viscous_torque': [0.0, 20.0, 'N m s/rad'],
}


def tabled(table: dict = TABLE, tilt: dict = TILT, **parameters: object) -> Machine:
    joints = [f'joint_{n}' for n in range(len(table['joint']))]
    return machine_from_mapping(
        {
            'machine': 'serial',
            'drives': joints,
            'geometry': {**table, **tilt},
            'controller': {'cycle': 0.004},
            'parameters': parameters or LINKS,
        }
    )


def of_mjcf(folder: Path, text: str, *drives: str) -> Machine:
    """Write and load the machine file of an MJCF's joints, their rotors alone unknown."""
    (folder / 'arm.xml').write_text(text)
    (folder / 'arm.yaml').write_text(
        f'machine: serial\ndrives: [{", ".join(drives)}]\ngeometry: {{description: arm.xml}}\n'
        'controller: {cycle: 0.01}\nparameters: {drive_inertia: [0, 1, kg m^2]}\n'
    )
    return load_machine(folder / 'arm.yaml')


def motion(drives: int, count: int, seed: int = 1) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return rng.uniform(-2.0, 2.0, (3, drives, count))


def plainly(bodies: tuple[twin.Body, ...], moved: np.ndarray) -> np.ndarray:
    down = twin.gravity_in_base(TILT['free_fall'], TILT['base_roll'], TILT['base_pitch'])
    instants = moved.transpose(2, 0, 1)
    return np.array([twin.inverse_dynamics(bodies, down, *one) for one in instants]).T


def test_a_urdf_in_three_ways(tmp_path: Path) -> None:
    arm = arm_of(described(tmp_path))
    moved = motion(4, 40)
    slowly = plainly(twin.read_urdf(URDF, JOINTS), moved)
    np.testing.assert_allclose(arm.terms(*moved) @ arm.inertials, slowly, rtol=0, atol=1e-9)
    np.testing.assert_allclose(arm.efforts(*moved), slowly, rtol=0, atol=1e-9)
    assert np.abs(slowly).max() > 50.0
    assert arm.prismatic.tolist() == [False, True, False, False]


def test_a_table_in_three_ways() -> None:
    arm = arm_of(tabled())
    rng = np.random.default_rng(3)
    inertials = rng.uniform(-1.0, 1.0, (4, 10))
    rows = [{key: TABLE[f'dh_{key}'][n] for key in ('a', 'alpha', 'd', 'theta')} for n in range(4)]
    bodies = twin.with_inertials(twin.by_table(rows, [False, True, False, True]), inertials)
    moved = motion(4, 40)
    slowly = plainly(bodies, moved)
    np.testing.assert_allclose(arm.terms(*moved) @ inertials.ravel(), slowly, rtol=0, atol=1e-9)
    import pinocchio

    for joint, values in zip(arm.joints, inertials, strict=True):
        arm.model.inertias[int(joint)] = pinocchio.Inertia.FromDynamicParameters(values)
    np.testing.assert_allclose(arm.efforts(*moved), slowly, rtol=0, atol=1e-9)


def where(bodies: tuple[twin.Body, ...], position: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Origins (D, 3) and orientations (D, 3, 3) of the joints' frames in the base."""
    places, turns = [], []
    for body, q in zip(bodies, position, strict=True):
        place, turn = np.zeros(3), np.eye(3)
        if body.parent >= 0:
            place, turn = places[body.parent], turns[body.parent]
        place, turn = place + turn @ body.place, turn @ body.turn
        slid = q * body.axis if body.slides else np.zeros(3)
        places.append(place + turn @ slid)
        turns.append(turn if body.slides else turn @ twin.about(body.axis, q))
    return np.array(places), np.array(turns)


def test_an_arm_in_space_is_where_its_joints_put_it(tmp_path: Path) -> None:
    machine = described(tmp_path)
    position = motion(4, 5)[0]
    drawn = kind_of(machine).scene(machine, position)
    upright = twin.roll_pitch_yaw((TILT['base_roll'], TILT['base_pitch'], 0.0))
    for k in range(5):
        places, turns = where(twin.read_urdf(URDF, JOINTS), position[:, k])
        np.testing.assert_allclose(drawn.blocks[k], places @ upright.T, atol=1e-12)
        tool = places[-1] + turns[-1] @ [0.0, 0.05, 0.15]  # the tool's frame, fixed to the wrist
        np.testing.assert_allclose(drawn.tool[k], upright @ tool, atol=1e-12)
        # one line from the base to the first joint, from each to the next, and to the tool
        chain = np.concatenate([[np.zeros(3)], drawn.blocks[k], [drawn.tool[k]]])
        np.testing.assert_array_equal(drawn.links[k], np.stack([chain[:-1], chain[1:]], axis=1))
    assert drawn.size == np.linalg.norm(drawn.links.reshape(-1, 3), axis=1).max()


def test_another_description_is_another_machine(tmp_path: Path) -> None:
    first = described(tmp_path)
    assert described(tmp_path).digest == first.digest
    (tmp_path / 'arm.urdf').write_text(URDF.replace('7.5', '8.5'))
    assert load_machine(tmp_path / 'arm.yaml').digest != first.digest


LYING = """<mujoco><compiler angle="degree"/><worldbody>
  <body name="other" pos="9 9 9"/>
  <body name="base" euler="90 0 0" pos="0 0 1"><inertial mass="7" pos="0 0 0" diaginertia="1 1 1"/>
    <body name="link"{pose}><joint name="lies" axis="0 0 1"/>
      <inertial mass="3" pos="0.2 0 0" diaginertia="0.1 0.1 0.1"/></body></body>
</worldbody></mujoco>"""


def test_an_mjcf_whose_base_is_turned_weighs_where_it_hangs(tmp_path: Path) -> None:
    nothing = np.zeros((1, 1))
    # Its axis is level, along -y of the world, and holds 3 kg at 0.2 m.
    machine = of_mjcf(tmp_path, LYING.format(pose=''), 'lies')
    effort = arm_of(machine).efforts(nothing, nothing, nothing)
    assert effort == pytest.approx(3.0 * 9.81 * 0.2, rel=1e-12)
    # Tipped by 60 degrees about its own x, the axis is half along the world's z.
    machine = of_mjcf(tmp_path, LYING.format(pose=' axisangle="-3 0 0 60"'), 'lies')
    effort = arm_of(machine).efforts(nothing, nothing, nothing)
    assert effort == pytest.approx(3.0 * 9.81 * 0.2 * 0.5, rel=1e-12)
    machine = of_mjcf(tmp_path, LYING.format(pose='><frame/></body><body name="more"'), 'lies')
    said = refused(arm_of, machine).message
    assert 'frame, which pinocchio passes over' in said


def test_joints_of_one_body_are_joints_one_after_the_other(tmp_path: Path) -> None:
    # A cart of 3 kg at the end of a beam: 0.5 m and as far as it has slid, turned by the beam.
    text = """<mujoco><worldbody><body><joint name="turn" axis="0 1 0"/>
      <joint name="slide" type="slide" axis="1 0 0"/>
      <inertial mass="3" pos="0.5 0 0" diaginertia="0.1 0.1 0.1"/><site name="stands"/>
      <body name="stands"><joint name="stands"/><inertial mass="1e-9" pos="0 0 0"
      diaginertia="1e-9 1e-9 1e-9"/></body></body></worldbody></mujoco>"""
    still, place = np.zeros((2, 1)), np.array([[0.3], [0.2]])
    effort = arm_of(of_mjcf(tmp_path, text, 'turn', 'slide')).efforts(place, still, still)
    weight = 3.0 * 9.81
    expected = -weight * 0.7 * np.cos(0.3), -weight * np.sin(0.3)
    np.testing.assert_allclose(effort[:, 0], expected, rtol=1e-8)


# Masses by hand: of a class, of a class within one, of the density of all, of a stated one.
HEAVY = """<mujoco><default class="robot"><geom density="500" size="0.1"/>
  <default class="rod"><geom type="sphere" mass="3" contype="0" conaffinity="0"/>
    <default class="tip"><geom mass="2"/></default></default></default>
  <worldbody><body><joint name="lies" axis="0 1 0"/>{geom}</body></worldbody></mujoco>"""


@pytest.mark.parametrize(
    'geom, mass',
    [
        ('<geom class="rod" pos="0.2 0 0"/>', 3.0),
        ('<geom class="tip" pos="0.2 0 0"/>', 2.0),
        ('<geom type="box" pos="0.2 0 0" size="0.1 0.1 0.1"/>', 4.0),
        ('<geom class="rod" mass="1" pos="0.2 0 0"/>', 1.0),
    ],
)
def test_a_shape_of_an_mjcf_weighs_what_its_class_states(tmp_path: Path, geom, mass) -> None:
    nothing = np.zeros((1, 1))
    machine = of_mjcf(tmp_path, HEAVY.format(geom=geom), 'lies')
    effort = arm_of(machine).efforts(nothing, nothing, nothing)
    assert effort == pytest.approx(-mass * 9.81 * 0.2, rel=1e-12)


def test_an_mjcf_is_read_and_joints_that_are_not_listed_stand_still(tmp_path: Path) -> None:
    text = """<mujoco><worldbody><body name="a" pos="0 0 1">
      <inertial mass="2" pos="0.1 0 0" diaginertia="0.1 0.2 0.3"/>
      <joint name="turn" axis="0 1 0"/>
      <body name="b" pos="0.5 0 0"><inertial mass="1" pos="0 0 0.2" diaginertia="0.1 0.1 0.1"/>
      <joint name="still" axis="1 0 0"/></body></body></worldbody></mujoco>"""
    arm = arm_of(of_mjcf(tmp_path, text, 'turn'))
    angle = np.array([[0.3]])
    still = np.zeros((1, 1))
    # Masses at 0.1 m and at (0.5, 0.2) m; a positive angle about y lowers x.
    x = 2.0 * 0.1 + 1.0 * 0.5
    expected = -9.81 * (x * np.cos(0.3) + 1.0 * 0.2 * np.sin(0.3))
    np.testing.assert_allclose(arm.efforts(angle, still, still)[0, 0], expected, rtol=1e-12)


def moving(machine: Machine, count: int = 1000, seed: int = 5) -> Dataset:
    """A log of smooth motion in which every joint swings with three frequencies; no effort yet."""
    rng = np.random.default_rng(seed)
    drives = len(machine.drives)
    time = machine.number('cycle') * np.arange(count)
    shape = (drives, 3, 1)
    rate = rng.uniform(0.8, 6.0, shape)
    size = rng.uniform(0.2, 0.5, shape)
    place = (size * np.sin(rate * time + rng.uniform(0.0, 6.0, shape))).sum(axis=1)
    none = np.zeros_like(place)
    return Dataset(machine.drives, machine.number('cycle'), 0, None, None, place, None, none)


def middle(model) -> np.ndarray:
    return np.array([0.5 * (p.low + p.high) for p in model.parameters])


def test_a_log_in_degrees_is_beyond_the_limits_of_the_description(tmp_path: Path) -> None:
    machine = described(tmp_path)
    log = moving(machine)
    degrees = [replace(log, position=np.degrees(log.position))]
    assert travel_of(machine) == {'elbow': (-3.0, 3.0), 'wrist': (-3.0, 3.0)}
    assert examine(machine, [log]).of('reach') == ()
    # Both ways of a joint without an end are sound: counted on and on, and taken back at a turn.
    base = 0.9 * machine.number('cycle') * np.arange(log.position.shape[1])
    for around in (100.0 + base, np.mod(20.0 * base, 2.0 * np.pi)):
        sound = replace(log, position=np.vstack([around, log.position[1:]]))
        assert examine(machine, [sound]).of('reach') == ()
    report = examine(machine, degrees)
    assert report.blocked
    assert re.search('elbow: its position reaches .* allows 3 in rad .* degrees', report.headline)
    # Without ends of its own a joint shows it by its speed.
    urdf = machine.text('description').replace('lower="-3" upper="3"', 'lower="-99" upper="99"')
    report = examine(machine.with_constants(description=urdf), degrees)
    assert 'elbow: its speed reaches' in report.headline


HALF = 0.5 * np.pi
UR10 = {
    'dh_a': [0.0, 0.0, -0.612, -0.5723, 0.0, 0.0],
    'dh_alpha': [0.0, HALF, 0.0, 0.0, HALF, -HALF],
    'dh_d': [0.1273, 0.0, 0.0, 0.163941, 0.1157, 0.0922],
    'dh_theta': [0.0] * 6,
    'joint': ['revolute'] * 6,
}


def test_six_joints_of_a_ur10_have_36_base_parameters() -> None:
    machine = tabled(UR10, {})
    names = [p.name for p in make_model(machine, moving(machine)).parameters]
    assert len(names) == 36
    # Of the first link a vertical joint shows its inertia about itself only.
    assert [n for n in names if n.startswith('joint_0')] == ['joint_0.link_inertia_zz']


def test_a_payload_is_a_point_mass_at_the_last_link(tmp_path: Path) -> None:
    machine = described(
        tmp_path,
        payload_mass=[0.0, 4.0, 'kg'],
        payload_x=[-0.2, 0.4, 'm'],
        payload_z=[0.0, 0.6, 'm'],
    )
    model = make_model(machine, moving(machine))
    assert [p.name for p in model.parameters] == ['payload_mass', 'payload_x', 'payload_z']
    bodies = list(twin.read_urdf(URDF, JOINTS))
    place = np.array([0.1, 0.0, 0.3])
    hand = bodies[-1]
    square = -twin.skew(place) @ twin.skew(place)
    bodies[-1] = twin.Body(
        hand.parent, hand.turn, hand.place, hand.axis, hand.slides,
        hand.mass + 2.0, hand.moment + 2.0 * place, hand.inertia + 2.0 * square,
    )  # fmt: skip
    expected = plainly(tuple(bodies), model.log.followed)
    simulated = model.simulated_effort(np.array([2.0, 0.1, 0.3]))
    np.testing.assert_allclose(simulated, expected, rtol=0, atol=1e-9)


HAND = EffectAt('hand_load', 'all')


def test_a_load_in_the_hand_is_a_payload_that_nobody_stated(tmp_path: Path) -> None:
    place = np.array([0.02, 0.0, 0.04])
    boxes = {'payload_mass': [0.0, 9.0, 'kg'], 'payload_x': [-1.0, 1.0, 'm']}
    stated = described(tmp_path, **boxes, payload_z=[-1.0, 1.0, 'm'])
    data = moving(stated)
    told = make_model(stated, data).simulated_effort(np.array([2.0, *place[[0, 2]]]))
    bare = replace(stated, bounds={'coulomb_torque': (0.0, 1.0, 'N m')})
    held = {f'{joint}.coulomb_torque': 0.0 for joint in bare.drives}
    model = make_model(bare, data, effects=[HAND], fixed=held)
    simulated = model.simulated_effort(np.array([2.0, *(2.0 * place)]))
    np.testing.assert_allclose(simulated, told, rtol=0, atol=1e-5)
    # Without a mass a moment has no place, and is linear.
    more = [model.simulated_effort(np.array([0.0, 0.0, 0.0, x])) for x in (0.0, 0.1, 0.2)]
    np.testing.assert_allclose(more[2] - more[0], 2.0 * (more[1] - more[0]), rtol=0, atol=1e-9)


def test_a_load_is_missing_only_where_links_do_not_make_it_up(tmp_path: Path) -> None:
    joints = described(tmp_path / 'a', coulomb_torque=[0.0, 9.0, 'N m'])
    links = described(
        tmp_path / 'b', link_mass=[-9.0, 9.0, 'kg'], link_moment=[-9.0, 9.0, 'kg m'],
        link_inertia=[-9.0, 9.0, 'kg m^2'], drive_inertia=[0.0, 9.0, 'kg m^2'],
    )  # fmt: skip
    payload = described(tmp_path / 'c', payload_mass=[0.0, 9.0, 'kg'])
    for machine, missing, changed in (
        (joints, True, True), (links, False, True), (payload, False, False),
    ):  # fmt: skip
        model = make_model(machine, moving(machine))
        assert (HAND in model.extensions()) is missing
        assert (HAND in model.extensions(changed=True)) is changed


# ---------------------------------------------------------------------- effects


SLIDE = {
    'dh_a': [0.0],
    'dh_alpha': [0.0],
    'dh_d': [0.0],
    'dh_theta': [0.0],
    'joint': ['prismatic'],
}
FRICTION = {'coulomb_torque': [1.0, 3.0, 'N'], 'viscous_torque': [2.0, 6.0, 'N s/m']}


def slide() -> Machine:
    """A mass on a level slide, as an arm."""
    return tabled(
        SLIDE, {'free_fall': 0.0}, link_mass=[3.0, 5.0, 'kg'], **FRICTION
    ).with_constants(coulomb_regularisation=5e-3, travel_per_turn=0.05)


def test_a_log_that_is_slow_for_its_turns_is_not_asked_to_be_longer_only() -> None:
    machine = slide().with_constants(cycle=0.056)
    place = 0.3 * np.sin(2.0 * np.pi * 1.3 * 0.056 * np.arange(1200))[None]
    noise = np.random.default_rng(1).normal(0.0, 1.0, (2, *place.shape))
    effort = np.gradient(place, 0.056, axis=1) + 0.05 * noise[1]
    log = Dataset(machine.drives, 0.056, 0, None, None, place + 2e-3 * noise[0], None, effort)
    with pytest.raises(IdentError, match='samples beside rest and turns .* a higher rate'):
        problem_of(machine, Data((log,)))


def test_a_joint_without_limits_may_turn_many_times() -> None:
    machine = tabled({**SLIDE, 'joint': ['revolute']}, {'free_fall': 0.0})
    with np.errstate(over='raise'):
        assert not [*check_reach(machine, np.linspace(0.0, 50.0, 100)[None])]


def axis() -> Machine:
    """The same, as a linear axis."""
    return machine_from_mapping(
        {
            'machine': 'linear_axis',
            'drives': ['joint_0'],
            'effort_unit': 'N',
            'drive': {'travel_per_turn': 0.05, 'coulomb_regularisation': 5e-3},
            'controller': {'cycle': 0.004, 'position_gain': 1.0, 'velocity_gain': 1.0},
            'parameters': {
                'moving_mass': [3.0, 5.0, 'kg'],
                'coulomb_friction': [1.0, 3.0, 'N'],
                'viscous_friction': [2.0, 6.0, 'N s/m'],
            },
        }
    )


def test_a_joint_that_slides_has_units_of_its_own(tmp_path: Path) -> None:
    boxes = {**BOXES, 'drive_inertia': [0.0, 5.0, 'kg m^2']}
    machine = described(tmp_path, **boxes)
    log = moving(machine)
    problem = problem_of(machine, Data((log,)))
    units = {p.name: p.unit for p in problem.parameters}
    names = 'drive_inertia', 'coulomb_torque', 'viscous_torque'
    assert [units[f'slide.{name}'] for name in names] == ['kg', 'N', 'N s/m']
    assert [units[f'elbow.{name}'] for name in names] == ['kg m^2', 'N m', 'N m s/rad']
    assert {x.drive: x.unit for x in problem.left(problem.residuals(problem.low[None])[0])} == {
        'base': '',
        'slide': 'N',
        'elbow': '',
        'wrist': '',
    }
    # Behind a gear its motor turns.
    geared = make_model(machine.with_constants(gear_factor=100.0), log)
    told = {p.name: p.unit for p in geared.parameters}
    assert told['slide.drive_inertia'] == 'kg m^2'


def sized(model) -> np.ndarray:
    """Return the middle of the nominal boxes and a quarter of those of effects."""
    return np.array([0.75 * p.low + 0.25 * p.high for p in model.parameters])


EFFECTS = {at.effect for at in make_model(axis(), moving(axis())).extensions()}
# An axis carries its weight only, a joint what its links ask; and what an axis remembers it writes
# while it is integrated between samples. Both have tests of their own below.
OTHERWISE = {'gear_flexibility', 'load_dependent_friction', 'presliding'}
# Written at the motion's samples, not while it is integrated between them.
REMEMBERING = {e.id for e in CATALOGUE.values() if e.keeps is not None}


@pytest.mark.parametrize('effect', sorted(EFFECTS - OTHERWISE))
def test_an_effect_at_a_joint_is_what_it_is_at_an_axis(effect: str, monkeypatch) -> None:
    # An axis's controller holds its effort for a cycle.
    monkeypatch.setattr(ArmLog, 'ahead', 0.5)
    there = [EffectAt(effect, 'joint_0')]
    scales = make_model(axis(), moving(axis())).scales._replace(effort=np.array([40.0]))
    models = [make_model(m, moving(m), effects=there, scales=scales) for m in (slide(), axis())]
    theta = [sized(model) for model in models]
    by_name = [
        {p.name.rpartition('.')[2]: t for p, t in zip(m.parameters, x, strict=True)}
        for m, x in zip(models, theta, strict=True)
    ]
    assert sorted(by_name[0].values()) == sorted(by_name[1].values())
    joint, plain = (m.simulate(x)[0, 0] for m, x in zip(models, theta, strict=True))
    size = float(np.abs(plain).max())
    close = 2e-3 if effect in REMEMBERING else 1e-9
    np.testing.assert_allclose(joint, plain, rtol=0, atol=close * size)
    without = make_model(slide(), moving(slide())).simulate(theta[0][:3])[0, 0]
    assert np.abs(joint - without).max() > 1e-3 * size


def test_friction_at_a_joint_grows_with_what_the_links_ask(tmp_path: Path) -> None:
    boxes = {'link_moment': [-5.0, 5.0, 'kg m'], 'coulomb_torque': [0.0, 4.0, 'N m']}
    machine = described(tmp_path, **boxes).with_constants(coulomb_regularisation=0.02)
    there = [EffectAt('load_dependent_friction', 'elbow')]
    model = make_model(machine, moving(machine), effects=there)
    theta = middle(model)
    plain = make_model(machine, model.data)
    more = model.simulated_effort(theta) - plain.simulated_effort(theta[:-1])
    place, velocity, acceleration = model.log.followed
    asked = model.arm.efforts(place, velocity, acceleration)[2]
    expected = theta[-1] * np.abs(asked) * np.tanh(velocity[2] / 0.02)
    # The kernels' tanh ends 2e-8 below 1.
    np.testing.assert_allclose(more[2], expected, rtol=0, atol=3e-8 * np.abs(expected).max())
    np.testing.assert_array_equal(more[[0, 1, 3]], 0.0)


def test_efforts_that_come_again_are_filtered_once(tmp_path: Path, monkeypatch) -> None:
    machine = described(tmp_path, coulomb_torque=[0.0, 4.0, 'N m'])
    smoothed = [EffectAt('effort_smoothing', 'all')]
    model = make_model(machine, moving(machine), effects=smoothed)
    points = np.repeat(middle(model)[None], 4, axis=0)
    # The first differs from all others, as that of a Jacobian does.
    points[[0, 3], [2, 1]] = 1.0, 3.0
    alone = [model.simulate(x)[0] for x in points]
    rows: dict[str, list[int]] = {'smoothed': [], 'passed': []}

    def counted(values: np.ndarray, *how: float) -> np.ndarray:
        rows['smoothed'].append(len(values))
        return low_pass(values, *how)

    def passing(band: Band, values: np.ndarray, output: int) -> np.ndarray:
        rows['passed'].append(len(values))
        return passed(band, values, output)

    passed = Band._passed
    monkeypatch.setattr(Band, '_passed', passing)
    monkeypatch.setattr('ros2_ident.models.drives.model.low_pass', counted)
    np.testing.assert_array_equal(model.simulate(points), alone)
    assert rows['smoothed'] == [len(JOINTS) + 2]
    # Two joints do otherwise than at last.
    assert rows['passed'] == [1, 1]


# ---------------------------------------------------------------------- mistakes


def refused(call, *args) -> IdentError:
    with pytest.raises(IdentError) as caught:
        call(*args)
    return caught.value


def test_mistakes_are_told_with_the_remedy(tmp_path: Path, monkeypatch) -> None:
    machine = described(tmp_path)
    broken = machine.with_constants(description='<robot')
    assert 'give a URDF or an MJCF file' in refused(arm_of, broken).message
    (tmp_path / 'arm.urdf').unlink()
    assert 'there is no such file' in refused(load_machine, tmp_path / 'arm.yaml').message
    assert 'neither a description nor dh_a' in refused(tabled, {'joint': ['revolute']}, {}).message
    monkeypatch.setitem(sys.modules, 'pinocchio', None)
    error = refused(arm_of, machine)
    assert error.code is ErrorCode.UNKNOWN_MODEL
    assert 'pip install pin' in error.message


@pytest.mark.parametrize(
    ('old', 'new', 'said'),
    [
        ('</robot>', '', 'is no XML (no element found: line'),
        ('"wrist"', '"a&#10;b"', "names a joint 'a\\nb', which holds a line break or another"),
        ('name="wrist"', '', "names a joint '', which is blank; name the joint"),
        ('robot', 'model', 'has the root element model'),
        ('name="bent"', 'name="bent" xmlns:xacro="http://x.org/xacro"><xacro:arm/', 'is a xacro'),
        ('"7.5"', '"${m}"', '${m} as mass value of link column; write a number'),
        ('ixx="0.2" ', '', 'has no inertia ixx of link column; add it'),
        ('xyz="0 0.6 0.8"', 'xyz="0 0 0"', 'the axis "0 0 0" of joint slide'),
        ('"7.5"', '"-1"', 'has -1 as mass value of link column; write a number from 0'),
        ('xyz="0.3 0 0.1"', 'xyz="1e308 0 0"', 'has 1e308 0 0 as origin xyz of joint slide'),
        ('bent', '\0', 'is no XML (not well-formed'),
        ('<robot', '<!DOCTYPE r [<!ENTITY e "9">]><robot', 'has a DOCTYPE'),
        ('effort="1" velocity="1"', '', 'has no limit effort of joint slide; add it'),
        ('<child link="tool"/>', '<child link="hand"/>', 'joint flange between hand and hand'),
        ('<link name="world"/>', '<link name="world"/><link name="w"/>', 'has 2 links that no'),
        ('link="world"', 'link="tool"', 'in a circle of joints'),
        ('<link name="world"/>', '<link name="world"/>' * 995, 'has 1001 elements link'),
        ('<link name="world"/>', '<link>' * 250 + '</link>' * 250, 'has elements 250 deep'),
    ],
)
def test_a_description_that_lost_something_is_refused_in_a_sentence(
    tmp_path: Path, capfd, old: str, new: str, said: str
) -> None:
    machine = described(tmp_path)
    assert old in URDF
    error = refused(arm_of, machine.with_constants(description=URDF.replace(old, new)))
    assert error.code is ErrorCode.BAD_MACHINE_FILE
    assert said in error.message and '; ' in error.message
    assert capfd.readouterr() == ('', '')


@pytest.mark.parametrize('above', ['link_{n}', 'link_0'])
def test_a_giant_is_refused_where_it_is_read_and_where_it_is_heard(tmp_path, above) -> None:
    text = '<robot name="giant"><link name="link_0"/>' + ''.join(
        f'<link name="link_{n + 1}"/><joint name="joint_{n}" type="fixed">'
        f'<parent link="{above.format(n=n)}"/><child link="link_{n + 1}"/></joint>'
        for n in range(1_000 if above == 'link_0' else 250)
    ) + '</robot>'  # fmt: skip
    machine = described(tmp_path).with_constants(description='/robot_description')
    assert refused(machine.described, text).message.startswith('/robot_description has ')
    (tmp_path / 'arm.urdf').write_text(text)
    error = refused(load_machine, tmp_path / 'arm.yaml')
    assert error.code is ErrorCode.BAD_MACHINE_FILE
    assert 'arm.yaml:3: ' in error.message and 'arm.urdf has ' in error.message


STAMP = 10_000_000 * np.arange(600)
WAVE = np.sin(0.01 * np.arange(600))[:, None]


def made_by(log: Recording) -> dict:
    return yaml.safe_load(new_machine_file(KINDS['serial'], (), URDF, 'arm.urdf', log))


def test_joints_of_other_names_are_told_how_to_be_called_as_the_description_does() -> None:
    with pytest.raises(IdentError, match='name the joints of the log .* in its column map'):
        made_by(Recording(Stream(('joint_1',), STAMP, WAVE)))
    with pytest.raises(IdentError, match='; in their order a would be base$'):
        made_by(Recording(Stream(tuple('abcd'), STAMP, WAVE * np.ones(4))))
    assert made_by(Recording(Stream(('elbow',), STAMP, WAVE)))['drives'] == ['elbow']


@pytest.mark.parametrize(('joint', 'sought'), [('slide', True), ('elbow', False)])
def test_the_mass_of_what_slides_is_sought(joint: str, sought: bool) -> None:
    made = made_by(Recording(Stream((joint,), STAMP, WAVE)))
    assert ('link_mass' in made['parameters']) is sought


def test_a_new_file_reads_the_description_once(monkeypatch) -> None:
    read, calls = ET.fromstring, []
    monkeypatch.setattr(ET, 'fromstring', lambda text: calls.append(text) or read(text))
    assert yaml.safe_load(new_machine_file(KINDS['serial'], (), URDF))['drives']
    assert len(calls) == 1


ONE_JOINT = (
    '<worldbody><body name="b"><joint name="j" armature="1"/>'
    '<inertial mass="3" pos="0.5 0 0" diaginertia="1 1 1"/></body></worldbody>'
)


TRUNK = (
    '<mujoco><asset><mesh name="m" file="m.stl"/></asset>'
    '<worldbody><body name="trunk" quat="1 1 0 0">{0}<body name="b"><joint name="j"/>'
    '<inertial mass="3" pos="0.5 0 0" diaginertia="1 1 1"/></body></body></worldbody></mujoco>'
)


@pytest.mark.parametrize('named', ['hip', 'foot'])
def test_a_body_may_have_the_name_of_a_joint_that_stands_still(named: str) -> None:
    text = (
        f'<mujoco><worldbody><body name="{named}"><joint name="hip"/><geom size="0.1"/>'
        '<body name="b" pos="1 0 0"><joint name="j"/><geom size="0.1"/></body></body></worldbody>'
        '</mujoco>'
    )
    mapping = yaml.safe_load(new_machine_file(KINDS['serial'], ('j',), text))
    mapping['geometry']['description'] = '/robot_description'
    assert arm_of(machine_from_mapping(mapping).described(text)).bodies[0].name == 'b'


@pytest.mark.parametrize(
    'base',
    ['<freejoint/>', '<geom mesh="m"/><freejoint/>', '<geom mesh="m"/><joint type="free"/>'],
)
def test_a_floating_base_is_held_as_drawn_and_that_is_said(tmp_path, capsys, base: str) -> None:
    efforts = []
    for part in ('', base):
        text = TRUNK.format(part)
        mapping = yaml.safe_load(new_machine_file(KINDS['serial'], (), text))
        assert mapping['drives'] == ['j']
        mapping['geometry']['description'] = '/robot_description'
        arm = arm_of(machine_from_mapping(mapping).described(text))
        efforts.append(arm.efforts(WAVE.T, 0.0 * WAVE.T, WAVE.T))
    assert np.array_equal(*efforts)
    (tmp_path / 'robot.xml').write_text(text)
    description, out = str(tmp_path / 'robot.xml'), str(tmp_path / 'robot.yaml')
    assert (
        main(['new-machine', '--kind', 'serial', '--description', description, '--out', out]) == 0
    )
    said = 'trunk: floats in the description and is held as drawn, which is right where it stands'
    assert said in capsys.readouterr().out
    log = Recording(
        Stream(('j',), STAMP, WAVE, WAVE, 7.0 * WAVE), command=Stream(('j',), STAMP, 1.1 * WAVE)
    )
    assert (followed_file((), text, 'robot.xml', log) or '').startswith('machine: serial')


def test_a_new_file_of_an_mjcf_bounds_its_links() -> None:
    text = f'<mujoco>{ONE_JOINT}</mujoco>'
    made = yaml.safe_load(new_machine_file(KINDS['serial'], (), text))['parameters']
    assert made['link_moment'] == [-1.5, 1.5, 'kg m']


@pytest.mark.parametrize(
    ('option', 'fall'),
    [
        ('<option/><option timestep="0.01"/>', (0, 0, -9.81)),
        ('<option gravity="0 0 0"/>', (0, 0, 0)),
        ('<option gravity="0 0 -1.62"><flag gravity="disable"/></option>', (0, 0, 0)),
        ('<option gravity="0 3.7 0"/><option timestep="0.01"/>', (0, 3.7, 0)),
        ('<option gravity="3 -4 5"/>', (3, -4, 5)),
    ],
)
def test_a_new_file_of_an_mjcf_has_its_gravity(option: str, fall: tuple[float, ...]) -> None:
    text = f'<mujoco>{option}{ONE_JOINT}</mujoco>'
    wave = Stream(('j',), STAMP, WAVE, WAVE, 7.0 * WAVE)
    log = Recording(wave, command=Stream(('j',), STAMP, 1.1 * WAVE))
    for made in (new_machine_file(KINDS['serial'], (), text), followed_file((), text, '', log)):
        mapping = yaml.safe_load(made or '')
        mapping['geometry']['description'] = '/robot_description'
        arm = arm_of(machine_from_mapping(mapping).described(text))
        assert arm.model.gravity.linear == pytest.approx(fall, abs=1e-7)


@pytest.mark.parametrize('stated', ['0 -9', '0 0 down', '0 0 nan'])
def test_a_gravity_that_is_no_three_numbers_is_refused(stated: str) -> None:
    text = f'<mujoco><option gravity="{stated}"/>{ONE_JOINT}</mujoco>'
    error = refused(new_machine_file, KINDS['serial'], (), text)
    assert error.message.endswith(f' has the gravity {stated}; write three numbers')


def test_rotors_and_friction_are_bounded_by_the_effort_of_the_log_in_its_unit() -> None:
    log = Recording(Stream(('elbow',), STAMP, WAVE, WAVE, 7.0 * WAVE))

    def ends(log: Recording) -> list[float]:
        sought = ('drive_inertia', 'coulomb_torque', 'viscous_torque')
        return [made_by(log)['parameters'][name][0][1] for name in sought]

    # the wave has 1 rad/s and 1 rad/s^2
    rms = float(np.std(WAVE))
    assert ends(log) == pytest.approx([7.0 / rms, 7.0, 35.0 / rms], rel=0.05)
    # 7 A bound no torque, but the description's limit of 1 N m does
    amperes = replace(log, units={('elbow', 'effort'): 'A'})
    assert ends(amperes) == pytest.approx([1.0 / rms, 1.0, 5.0 / rms], rel=0.05)


def test_gains_in_n_m_are_not_sought_by_currents() -> None:
    wave = WAVE * np.ones(4)
    units = {(name, 'effort'): 'A' for name in JOINTS}
    files = []
    for current in (wave, -300.0 * wave):
        state = Stream(JOINTS, STAMP, wave, None, current)
        log = Recording(state, command=Stream(JOINTS, STAMP, 1.1 * wave), units=units)
        files.append(followed_file((), URDF, 'arm.urdf', log))
    assert files[0] == files[1]
    made = yaml.safe_load(files[0])
    assert (made['effort_unit'], made['torque_constant']) == ('A', 0.5)


def test_a_product_with_a_gain_that_is_none_is_none() -> None:
    time = 0.01 * np.arange(600)[:, None]
    place, late = (np.sin(t) + 0.3 * np.sin(3.1 * t) for t in (time, time - 0.03))
    # an effort that pushes along with the motion: there is no gain of the velocity
    effort = 500.0 * np.gradient(place, axis=0)
    state = Stream(('elbow',), STAMP, place, None, effort)
    log = Recording(state, command=Stream(('elbow',), STAMP, late))
    made = yaml.safe_load(followed_file((), URDF, 'arm.urdf', log))['parameters']
    assert made['velocity_feedforward'] == [[0.0, 1.5, '1']]


def test_odd_names_of_a_description_stand_in_a_new_file_as_they_are() -> None:
    named = ('arm: 1', "]'#", '<&"> $$', 'null')
    text = URDF
    for old, new in zip(JOINTS, named, strict=True):
        text = text.replace(f'<joint name="{old}"', f'<joint name={quoteattr(new)}')
    made = yaml.safe_load(new_machine_file(KINDS['serial'], (), text, 'a: #.urdf'))
    assert (tuple(made['drives']), made['geometry']['description']) == (named, 'a: #.urdf')
    wave = WAVE * np.ones(4)
    log = Recording(
        Stream(named, STAMP, wave, wave, wave), command=Stream(named, STAMP, 1.1 * wave)
    )
    made = yaml.safe_load(followed_file((), text, 'a: #.urdf', log))
    assert (tuple(made['drives']), made['geometry']['description']) == (named, 'a: #.urdf')


def test_a_description_is_read_without_a_bag(tmp_path, capsys) -> None:
    described(tmp_path)
    path = tmp_path / 'arm.yaml'
    path.write_text(path.read_text().replace('wrist', 'knee'))
    assert main(['check', '--machine', str(path)]) == 1
    said = 'arm.yaml:3: geometry.description has no joint knee; its joints are base, slide'
    assert said in capsys.readouterr().out
