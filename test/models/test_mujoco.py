# SPDX-License-Identifier: Apache-2.0
"""A user's own MJCF as the model: MuJoCo's numbers, its attributes, what is missing in it."""

from pathlib import Path
import sys

import numpy as np
import pytest
import yaml

from checks.generators.mujoco_mjcf import tripod_mjcf
from checks.reference.tripod import simulate_tripod
from ros2_ident.cli.main import main
from ros2_ident.effects import CATALOGUE
from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.export.content import content_of
from ros2_ident.export.targets import fitting, write
from ros2_ident.gap.diagnose import diagnose
from ros2_ident.identify.data import Data
from ros2_ident.identify.problem import problem_of
from ros2_ident.machine.prior import Prior
from ros2_ident.models import EffectAt, load_machine, make_model
from ros2_ident.models.kinds import MUJOCO
from ros2_ident.models.mujoco.model import Mujoco
from ros2_ident.recording import Dataset
from ros2_ident.report.estimate import Estimate
from ros2_ident.simulate.bag import read_effect, simulate
from ros2_ident.simulate.motions import draw_motion

ROOT = Path(__file__).parents[2]
sys.path.append(str(ROOT / 'build/peers'))
mujoco = pytest.importorskip('mujoco', reason='MuJoCo is not installed; see CONTRIBUTING.md')

# Two links that hang, the second one geared, on position actuators.
MJCF = """<mujoco><option timestep="0.001" integrator="implicitfast"/>
<compiler angle="radian" autolimits="true"/>
<default><joint damping="0.1" frictionloss="0.05" armature="0.01"/></default>
<worldbody><body name="upper"><joint name="one" axis="0 1 0"/>
<inertial pos="0 0 -0.1" mass="0.5" diaginertia="0.002 0.002 0.001"/>
<body name="lower" pos="0 0 -0.2"><joint name="two" axis="0 1 0"/>
<inertial pos="0 0 -0.1" mass="0.3" diaginertia="0.001 0.001 0.0005"/></body></body></worldbody>
<actuator><position name="first" joint="one" kp="20" kv="0.5" forcerange="-6 6"/>
<position name="second" joint="two" kp="10" kv="0.2"/></actuator></mujoco>"""
CYCLE, COUNT = 0.004, 500
TIME = CYCLE * np.arange(COUNT)
TURN = 2.0 * np.pi * TIME
COMMAND = np.stack([0.6 * np.sin(0.9 * TURN), 0.5 * np.sin(1.3 * TURN)])
TRUE = {'kp': (20.0, 10.0), 'damping': (0.1, 0.1), 'frictionloss': (0.05, 0.05)}
BOXES = {'kp': [5.0, 50.0, 'N m/rad'], 'damping': [0.0, 1.0, 'N m s/rad'],
         'frictionloss': [0.0, 0.3, 'N m']}  # fmt: skip


@pytest.fixture(scope='module')
def folder(tmp_path_factory):
    made = tmp_path_factory.mktemp('mjcf')
    (made / 'robot.xml').write_text(MJCF)
    return made


def machine_of(folder, boxes=BOXES, description='robot.xml', drives=('one', 'two'), **drive):
    content = {
        'machine': 'mujoco',
        'drives': list(drives),
        'geometry': {'description': description},
        'controller': {'cycle': CYCLE},
        'effort_noise': 0.01,
        'parameters': boxes,
    }
    path = folder / 'machine.yaml'
    path.write_text(yaml.safe_dump({**content, **({'drive': drive} if drive else {})}))
    return load_machine(path)


def plain(command, change=lambda model: None, text=MJCF):
    """Return position and joint torque of MuJoCo's own loop, called step by step."""
    model = mujoco.MjModel.from_xml_string(text)
    change(model)
    data = mujoco.MjData(model)
    position, effort = np.empty(command.shape), np.empty(command.shape)
    for k in range(command.shape[1]):
        position[:, k] = data.qpos
        data.ctrl[:] = command[:, k]
        mujoco.mj_step1(model, data)
        mujoco.mj_step2(model, data)
        effort[:, k] = data.qfrc_actuator
        mujoco.mj_step(model, data, nstep=3)
    return position, effort


def data_with(machine, position, effort=None, command=COMMAND):
    rate = np.gradient(command, CYCLE, axis=1)
    return Dataset(machine.drives, CYCLE, 0, command, rate, position, None, effort)


def theta_of(model, **changed):
    named = {**TRUE, **changed}
    drives = ('one', 'two')
    found = []
    for p in model.parameters:
        drive, _, name = p.name.partition('.')
        value = named[p.name] if p.name in named else named[name]
        found.append(value if np.isscalar(value) else value[drives.index(drive)])
    return np.array(found)


def test_positions_and_efforts_are_mujocos_to_the_bit(folder) -> None:
    machine = machine_of(folder)
    position, effort = plain(COMMAND)
    data = data_with(machine, position, effort)
    model = Mujoco(machine, data, quantities=('effort', 'position'))
    # The reading of the first samples' speed is all that differs.
    model._begin[:] = 0.0
    told = model.simulate(theta_of(model)[None])[0]
    assert np.array_equal(told[2:], position)
    assert np.abs(told[:2] - effort).max() < 1e-12
    assert np.ptp(position[0]) > 0.5


@pytest.mark.parametrize('tie', ['', '<equality><joint joint1="two" joint2="three"/></equality>'])
def test_a_search_begins_as_described_where_that_is_the_log(tmp_path, tie) -> None:
    more = '<body><joint name="three"/><geom size="0.01"/></body></worldbody>'
    sensors = '<sensor><framepos objtype="body" objname="lower"/></sensor>'
    text = MJCF.replace('</worldbody>', more).replace('</mujoco>', f'{tie}{sensors}</mujoco>')
    (tmp_path / 'tied.xml').write_text(text)
    machine = machine_of(tmp_path, description='tied.xml')
    model = Mujoco(machine, data_with(machine, COMMAND))
    assert model.plant.model.nsensordata == 6  # three of each drive
    log = model.simulate(theta_of(model)[None])[0]
    model = Mujoco(machine, data_with(machine, log))
    assert model.suggested() == pytest.approx(theta_of(model))


FLAGS = {
    'damper': ('damping', 0.3), 'frictionloss': ('frictionloss', 0.3), 'gravity': ('free_fall', 3),
    'constraint': ('frictionloss', 0.3), 'spring': ('stiffness', 2.0),
}  # fmt: skip


@pytest.mark.parametrize('flag', [*FLAGS, 'sensor', 'spring="disable" damper'])
def test_what_a_flag_switches_off_is_zero_and_can_be_sought(tmp_path, flag) -> None:
    joint = '<default><joint stiffness="1 0.5" springref="0.4"'
    text = MJCF.replace('<default><joint', joint).replace(
        '<body name="up', '<body gravcomp="0.5" name="up'
    )
    text = text.replace(
        '<compiler', f'<option viscosity="2"><flag {flag}="disable"/></option><compiler'
    )
    (tmp_path / 'robot.xml').write_text(text)
    position, effort = plain(COMMAND, text=text)
    name, value = FLAGS.get(flag, ('damping', 0.3))
    unit = 'm/s^2' if name == 'free_fall' else UNITS[name]
    machine = machine_of(tmp_path, {name: [0.0, 10.0, unit]})
    model = Mujoco(machine, data_with(machine, position, effort), quantities=('position',))
    model._begin[:] = 0.0
    stated = list(model.as_described({}).values())
    told = model.simulate(np.array([stated, [value] * len(stated)]))
    assert np.abs(told[0] - position).max() < 1e-12
    assert flag == 'sensor' or not any(stated)
    assert np.abs(told[1] - position).max() > 1e-3


@pytest.mark.parametrize('lag', ['timeconst="0.05"', 'delay="0.02" nsample="20"'])
def test_an_actuator_that_takes_its_set_point_late_begins_with_the_first_one(
    tmp_path, lag
) -> None:
    text = MJCF.replace('kv="0.5"', f'kv="0.5" {lag}')
    (tmp_path / 'robot.xml').write_text(text)
    machine = machine_of(tmp_path)
    still = np.full((2, COUNT), 0.8)
    model = Mujoco(machine, data_with(machine, still, command=still), quantities=('effort',))
    effort = model.simulate(theta_of(model)[None])[0]
    assert abs(effort[0, 0]) < 1e-9


@pytest.mark.parametrize(
    'actuator', ['<motor', '<velocity', '<intvelocity actrange="-1 1" kp="9"', 'flag', 'group']
)
def test_an_actuator_that_follows_no_position_is_refused(tmp_path, actuator) -> None:
    wrong = {'flag': '<option><flag actuation="disable"/></option><compiler',
             'group': '<option actuatorgroupdisable="0"/><compiler'}  # fmt: skip
    if actuator in wrong:
        text = MJCF.replace('<compiler', wrong[actuator])
    else:
        text = MJCF.replace(
            '<position name="first" joint="one" kp="20" kv="0.5" forcerange="-6 6"',
            f'{actuator} name="first" joint="one"',
        )
    (tmp_path / 'robot.xml').write_text(text)
    machine = machine_of(tmp_path, {'damping': BOXES['damping']})
    with pytest.raises(IdentError, match='the actuator of joint one .* seek kp and kv'):
        Mujoco(machine, data_with(machine, COMMAND))


def test_a_motor_under_gains_of_the_machine_file_follows_positions(tmp_path) -> None:
    motors = MJCF
    for n, gains in (('one', 'kp="20" kv="0.5"'), ('two', 'kp="10" kv="0.2"')):
        motors = motors.replace(f'joint="{n}" {gains}', f'joint="{n}"')
    (tmp_path / 'robot.xml').write_text(motors.replace('<position', '<motor'))
    machine = machine_of(tmp_path, {**BOXES, 'kv': [0.0, 5.0, UNITS['kv']]})
    position, _ = plain(COMMAND)
    model = Mujoco(machine, data_with(machine, position))
    model._begin[:] = 0.0
    told = model.simulate(theta_of(model, kv=(0.5, 0.2))[None])[0]
    assert np.array_equal(told, position)


CHANGES = {
    'armature': (0.03, lambda m: m.dof_armature.__setitem__(0, 0.03)),
    'damping': (0.4, lambda m: m.dof_damping.__setitem__(0, 0.4)),
    'frictionloss': (0.2, lambda m: m.dof_frictionloss.__setitem__(0, 0.2)),
    'stiffness': (3.0, lambda m: m.jnt_stiffness.__setitem__(0, 3.0)),
    'kv': (1.5, lambda m: m.actuator_biasprm.__setitem__((0, 2), -1.5)),
    'force_limit': (0.5, lambda m: m.actuator_forcerange.__setitem__(0, (-0.5, 0.5))),
    'actuator_gear': (1.3, lambda m: m.actuator_gear.__setitem__((0, 0), 1.3)),
    'body_place': (1.5, lambda m: m.body_pos.__setitem__(1, 1.5 * m.body_pos[1])),
}


@pytest.mark.parametrize('name', CHANGES)
def test_every_attribute_does_what_mujoco_does_with_it(folder, name) -> None:
    value, change = CHANGES[name]
    machine = machine_of(folder, {name: [0.0, 10.0, UNITS[name]]})

    def changed(model):
        change(model)
        mujoco.mj_setConst(model, mujoco.MjData(model))

    position, _ = plain(COMMAND, changed)
    model = Mujoco(machine, data_with(machine, COMMAND), drives=['one'])
    model._begin[:] = 0.0
    told = model.simulate(np.array([[value]]))[0]
    assert np.array_equal(told, position[:1])


UNITS = {
    'armature': 'kg m^2', 'damping': 'N m s/rad', 'frictionloss': 'N m', 'stiffness': 'N m/rad',
    'kv': 'N m s/rad', 'force_limit': 'N m', 'actuator_gear': '1', 'body_place': '1',
}  # fmt: skip


def test_zero_and_direction_of_the_log_are_taken_off(folder) -> None:
    position, effort = plain(COMMAND)
    boxes = {**BOXES, 'joint_zero': [-3.0, 3.0, 'rad'], 'set_point_delay': [0.0, 0.1, 's']}
    machine = machine_of(folder, boxes, direction=['backward', 'forward'])
    zero = np.array([[0.3], [-0.2]])
    sense = np.array([[-1.0], [1.0]])
    logged = sense * position + zero
    data = data_with(machine, logged, sense * effort, sense * COMMAND + zero)
    model = Mujoco(machine, data, quantities=('effort', 'position'))
    alone = make_model(machine, data, quantities=('effort',))
    assert [output.quantity for output in alone.outputs] == ['effort', 'effort']
    model._begin[:] = np.stack([zero[:, 0], np.zeros(2)])
    late = theta_of(model, joint_zero=(0.3, -0.2), set_point_delay=0.0)
    told = model.simulate(late[None])[0]
    assert told[2:] == pytest.approx(logged, abs=1e-9)
    assert told[:2] == pytest.approx(sense * effort, abs=1e-6)
    later = theta_of(model, joint_zero=(0.3, -0.2), set_point_delay=2.0 * CYCLE)
    shifted = np.concatenate([COMMAND[:, :1], COMMAND[:, :1], COMMAND[:, :-2]], axis=1)
    assert model.simulate(later[None])[0, 2:] == pytest.approx(
        sense * plain(shifted)[0] + zero, abs=1e-9
    )


def test_a_log_of_a_description_is_simulated_with_an_effect(folder) -> None:
    machine = machine_of(folder)
    motion = draw_motion('multi_point', machine, 2.0, 1)
    values = {'one.kp': 15.0}
    log = simulate(machine, values, motion)
    model = mujoco.MjModel.from_xml_string(MJCF)
    model.actuator_gainprm[0, 0], model.actuator_biasprm[0, 1] = 15.0, -15.0
    # 4 ms a cycle, 1 ms a step
    data = mujoco.MjData(model)
    for k in range(motion.position.shape[1]):
        assert log.position[:, k] == pytest.approx(data.qpos, abs=1e-9)
        data.ctrl[:] = motion.position[:, k]
        mujoco.mj_step(model, data, nstep=4)
    rubbed = simulate(machine, values, motion, [read_effect('command_delay@two:delay=0.015')])
    assert np.abs(rubbed.position - log.position)[1].max() > 1e-3


def test_effects_change_attributes_where_an_mjcf_has_them(folder) -> None:
    machine = machine_of(folder, {'kp': BOXES['kp']})
    model = Mujoco(machine, data_with(machine, COMMAND))
    offered = {at.effect for at in model.extensions()}
    assert {'viscous_friction', 'coulomb_friction', 'velocity_gain_error'} <= offered
    assert 'position_gain_error' not in offered  # kp is identified
    assert {'stribeck', 'cable_spring', 'torque_ripple'} <= offered
    assert not {'backlash', 'encoder_quantisation', 'effort_bias'} & offered
    at = EffectAt('viscous_friction', 'two')
    wider = model.extended([at])
    by_hand = machine_of(folder, {**BOXES})
    same = Mujoco(by_hand, model.data)
    theta = theta_of(model)
    told = wider.simulate(np.append(theta, 0.3)[None])
    expected = same.simulate(theta_of(same, **{'two.damping': 0.4})[None])
    assert told == pytest.approx(expected, abs=1e-12)
    with pytest.raises(IdentError, match='no force on a joint and no attribute'):
        model.extended([EffectAt('backlash', 'two')])


PUSHED = {
    'cable_spring': ((0.4, 0.3), lambda q, v: (0.0, -0.4 * (q - 0.3))),
    'constant_force': ((0.5,), lambda q, v: (0.0, -0.5)),
    'torque_ripple': ((0.3, 0.0, 7.0), lambda q, v: (0.0, 0.3 * np.sin(7.0 * q))),
    'stribeck': ((0.2, 0.5), lambda q, v: (0.2 * np.exp(-((v / 0.5) ** 2)), 0.0)),
    'quadratic_drag': ((0.2,), lambda q, v: (0.2 * v**2, 0.0)),
}


@pytest.mark.parametrize('effect', PUSHED)
def test_an_effect_is_a_force_on_its_joint_in_every_step(folder, effect) -> None:
    values, law = PUSHED[effect]
    own = mujoco.MjModel.from_xml_string(MJCF)
    data = mujoco.MjData(own)
    expected = np.empty(COMMAND.shape)
    for k in range(COUNT):
        expected[:, k] = data.qpos
        data.ctrl[:] = COMMAND[:, k]
        for _ in range(4):
            friction, data.qfrc_applied[1] = law(data.qpos[1], data.qvel[1])
            own.dof_frictionloss[1] = 0.05 + friction
            mujoco.mj_step(own, data)
    # The log of joint two counts backwards from 0.1 on.
    boxes = {**BOXES, 'joint_zero': [-3.0, 3.0, 'rad']}
    machine = machine_of(folder, boxes, direction=['forward', 'backward'])
    sense, zero = np.array([[1.0], [-1.0]]), np.array([[0.0], [0.1]])
    command = sense * COMMAND + zero
    if effect in ('cable_spring', 'constant_force', 'torque_ripple'):
        # The same force, as the log counts.
        values = {
            'cable_spring': (0.4, 0.1 - 0.3),
            'constant_force': (-0.5,),
            'torque_ripple': (0.3 * np.cos(0.7), -0.3 * np.sin(0.7), 7.0),
        }[effect]
    data = data_with(machine, command, command=command)
    model = Mujoco(machine, data, effects=[EffectAt(effect, 'two')])
    model._begin[:] = np.stack([zero[:, 0], np.zeros(2)])
    nominal = model.extended([])
    theta = theta_of(nominal, joint_zero=(0.0, 0.1))
    told = model.simulate(np.append(theta, values)[None])[0]
    assert told == pytest.approx(sense * expected + zero, abs=1e-7)
    assert np.abs(told - nominal.simulate(theta[None])[0]).max() > 1e-3


def a_log(machine, seed, change):
    """Return 1.6 s of sines with noise on positions and efforts."""
    rng = np.random.default_rng(seed)
    phase, rate = rng.uniform(0, 6, (2, 4)), rng.uniform(0.3, 2.5, (2, 4))
    time = CYCLE * np.arange(400)
    waves = [np.sin(2 * np.pi * rate[:, [k]] * time + phase[:, [k]]) for k in range(4)]
    command = 0.25 * sum(waves)
    command = (command - command[:, :1]) * np.minimum(time, 1)
    position, effort = plain(command, change)
    position = position + 5e-4 * rng.standard_normal(position.shape)
    effort = effort + 0.01 * rng.standard_normal(effort.shape)
    return data_with(machine, position, effort, command)


def test_hidden_friction_is_named_where_it_is(folder) -> None:
    def true(model):
        model.dof_frictionloss[1] = 0.12

    machine = machine_of(folder, {'kp': BOXES['kp'], 'armature': [0.001, 0.05, 'kg m^2']})
    fit, check = (a_log(machine, seed, true) for seed in (1, 2))
    near = {'coulomb_friction', 'viscous_friction'}
    found = diagnose(machine, (fit,), (check,), without=sorted(set(CATALOGUE) - near))
    assert (found.effect, found.where) == ('coulomb_friction', ('two',))
    (size,) = found.ranking[0].parameters.values()
    assert size.value == pytest.approx(0.07, rel=0.02)  # 0.12 less the 0.05 described


@pytest.mark.parametrize(
    ('changed', 'what'),
    [
        ({'drives': ('one', 'three')}, 'no joint three; it has one, two'),
        ({'actuator': ['first', 'third']}, 'no actuator third; it has first, second'),
        ({'body': ['', 'hand']}, 'no body hand; it has world, upper, lower'),
    ],
)
def test_what_the_description_lacks_is_said(folder, changed, what) -> None:
    machine = machine_of(folder, **changed)
    data = Dataset(machine.drives, CYCLE, 0, COMMAND, COMMAND, None, None, None)
    with pytest.raises(IdentError, match=what) as caught:
        Mujoco(machine, data)
    assert caught.value.code is ErrorCode.BAD_MACHINE_FILE


@pytest.mark.parametrize(
    ('old', 'new', 'said'),
    [
        ('</mujoco>', '', 'is no XML'),
        ('<worldbody>', '<include file="other.xml"/><worldbody>', 'other.xml: cannot be read'),
        (
            '<worldbody>', '<asset><model file="/etc/passwd"/></asset><worldbody>',
            'passwd (model)',
        ),
        ('mass="0.3"', 'mass="-1"', 'has -1 as inertial mass of body lower'),
        ('kp="10"', 'kp="nan"', "contains a 'NaN'"),
        ('kp="10"', 'kp="x"', "bad format in attribute 'kp' Element 'position'"),
        ('timestep="0.001"', 'timestep="0"', 'has the timestep 0 s; write one from 4e-07 s'),
        ('<worldbody>',
         '<worldbody><replicate count="60000"><body><geom size="1"/></body></replicate>',
         'more than 512 MiB'),
    ],
)  # fmt: skip
def test_a_bad_mjcf_is_refused_before_a_log_is_read(
    tmp_path, monkeypatch, capfd, old, new, said
) -> None:
    monkeypatch.chdir(tmp_path)
    text = MJCF.replace(old, new)
    (tmp_path / 'robot.xml').write_text(MJCF)
    machine_of(tmp_path)
    (tmp_path / 'robot.xml').write_text(text)
    assert main(['check', '--machine', 'machine.yaml']) == 1
    shown = capfd.readouterr()
    assert said in shown.out and 'machine.yaml:' in shown.out and not shown.err
    assert sorted(path.name for path in tmp_path.iterdir()) == ['machine.yaml', 'robot.xml']


def test_a_candidate_that_is_unstable_has_no_output(folder, monkeypatch, tmp_path, capfd) -> None:
    monkeypatch.chdir(tmp_path)
    machine = machine_of(folder, {'kv': [-1e7, 1.0, 'N m s/rad']})
    model = Mujoco(machine, data_with(machine, COMMAND))
    out = model.simulate(np.array([[0.5, 0.2], [0.5, -1e4]]))
    assert np.isfinite(out[0]).all() and np.isinf(out[1]).all()
    assert capfd.readouterr() == ('', '') and not list(tmp_path.iterdir())


TOOL = {'tool_mass': 1.4, 'drive_inertia': 9e-5, 'coulomb_torque': 0.05, 'viscous_torque': 0.05}


@pytest.fixture(scope='module')
def looped(tmp_path_factory):
    """The linear tripod as MJCF, a log of it by the reference, and where its platform is."""
    tripod = load_machine(ROOT / 'config/tripod.yaml').with_constants(
        law='cascade_p', integral_gain=0.0, velocity_feedforward=0.0
    )
    gears = {'gear_stiffness': 3e6, 'gear_damping_ratio': 0.5, 'measurement_delay': 0.0}
    motion = draw_motion('multi_point', tripod, 1.2, 3)
    log = simulate_tripod(tripod, {**TOOL, **gears}, motion.position, motion.velocity)
    made = tmp_path_factory.mktemp('loop')
    (made / 'robot.xml').write_text(tripod_mjcf(tripod, TOOL))
    content = {
        'machine': 'mujoco',
        'drives': list(tripod.drives),
        'geometry': {'description': 'robot.xml'},
        'drive': {'body': ['tool', '', '']},
        'controller': {'cycle': motion.cycle},
        'parameters': {'body_mass': [0.5, 3.0, 'kg']},
    }
    (made / 'machine.yaml').write_text(yaml.safe_dump(content))
    machine = load_machine(made / 'machine.yaml')
    data = Dataset(
        machine.drives, motion.cycle, 0, motion.position, motion.velocity, log.position, None,
        None,
    )  # fmt: skip
    return machine, data, log


def test_a_tripod_as_mjcf_follows_the_reference_from_where_it_is(looped) -> None:
    machine, data, log = looped
    model = Mujoco(machine, data, drives=['drive_1'])
    assert [p.name for p in model.parameters] == ['drive_1.body_mass']
    told = model.simulate(np.array([[TOOL['tool_mass']], [2.4]]))
    error = np.sqrt(np.mean((told[0, 0] - log.position[0]) ** 2))
    # The gear gives a little, and MuJoCo's law is continuous over a cycle.
    assert np.ptp(log.position[0]) > 0.05 and error < 1e-4
    # Of a kilogram more on the platform a third hangs on this drive's P law: 0.15 mm.
    assert np.sqrt(np.mean((told[1, 0] - log.position[0]) ** 2)) > 1.4e-4


def test_a_damping_stands_beside_a_ratio_of_its_class(folder) -> None:
    text = MJCF.replace('</default>', '<position dampratio="1"/></default>')
    (folder / 'ratio.xml').write_text(text)
    machine = machine_of(folder, description='ratio.xml')
    plant = Mujoco(machine, data_with(machine, COMMAND)).plant
    assert plant.stated('kv', 0) == 0.5 and plant.stated('kv', 1) == 0.2


KEYS = {key.name: key.unit for key in MUJOCO.keys if key.section == 'parameters'}
SOUGHT = {
    'armature': 0.03, 'damping': 0.2, 'frictionloss': 0.07, 'stiffness': 0.4, 'kp': 17.0,
    'kv': 0.6, 'force_limit': 2.5, 'actuator_gear': 1.2, 'body_mass': 0.4, 'body_place': 1.1,
    'body_centre': 0.9, 'body_inertia': 1.3, 'free_fall': 9.7, 'set_point_delay': 3 * CYCLE,
}  # fmt: skip


@pytest.mark.parametrize('tag', ['position', 'general'])
def test_what_was_identified_goes_back_into_the_mjcf(folder, tmp_path, tag) -> None:
    text = MJCF.replace('timestep="0.001"', 'timestep="0.0015"')  # no part of 4 ms
    text = (
        text.replace('body name="lower"', 'body')
        .replace('kv="0.2"', 'kv="0.2" class="stiff"')
        .replace(
            '</default>', '<default class="stiff"><position dampratio="1"/></default></default>'
        )
    )
    if tag == 'general':
        text = text.replace(
            '<position name="first" joint="one" kp="20" kv="0.5"',
            '<general name="first" joint="one" gainprm="20" biastype="affine" biasprm="0 -20 -1"',
        )
    (folder / 'own.xml').write_text(text)
    boxes = {name: [0.0, 1e3, KEYS[name]] for name in SOUGHT}
    machine = machine_of(folder, boxes, 'own.xml')
    position = plain(COMMAND)[0]
    data = data_with(machine, position)
    ripple = EffectAt('torque_ripple', 'two')
    problem = problem_of(machine, Data((data,), labels=('log',)), effects=(ripple,))
    values = {p.name: SOUGHT.get(p.name.rpartition('.')[2], 0.0) for p in problem.parameters}
    estimate = Estimate(values, {}, problem.drives, {}, '', Prior(deviations={}))
    found = content_of(problem, estimate, 0.3)
    files = write(tmp_path / 'out', fitting(found, text), found, text, folder)
    path, words = files['mjcf']
    assert words == ('MuJoCo has no place for torque_ripple of two',)
    if 'usd' in files:
        lost = 'torque_ripple of two and how late controllers take their set-points up'
        assert files['usd'][1] == (f'USD has no place for {lost}',)
    assert 'actuatorfrclimited="false"' in path.read_text()
    with pytest.raises(IdentError, match='give --to mjcf'):
        write(tmp_path / 'none', ('isaac',), found, text)
    model = mujoco.MjModel.from_xml_path(str(path))
    data, ours = mujoco.MjData(model), problem.models[0]
    data.qpos[:], data.qvel[:] = ours._begin
    told = ours.simulate(np.array([list(values.values())]))[0]
    out = np.empty_like(COMMAND)
    for k in range(COUNT):
        out[:, k], data.ctrl[:] = data.qpos, COMMAND[:, k]
        mujoco.mj_step(model, data, nstep=3)
    assert np.abs(out - told).max() < 1e-9 * np.ptp(told)
