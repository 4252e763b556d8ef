# SPDX-License-Identifier: Apache-2.0
"""A user's own MJCF as the model: MuJoCo's numbers, its attributes, what is missing in it."""

from pathlib import Path
import pickle
import sys

import numpy as np
import pytest
import yaml

from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.identify.data import Data
from ros2_ident.identify.run import identify
from ros2_ident.models import EffectAt, load_machine
from ros2_ident.models.mujoco.model import Mujoco
from ros2_ident.recording import Dataset

ROOT = Path(__file__).parents[1]
sys.path.append(str(ROOT / 'build/peers'))
mujoco = pytest.importorskip('mujoco', reason='MuJoCo is not installed; see CONTRIBUTING.md')

# Two links that hang, the second one geared, on position actuators.
MJCF = '''<mujoco><option timestep="0.001" integrator="implicitfast"/>
<compiler angle="radian" autolimits="true"/>
<default><joint damping="0.1" frictionloss="0.05" armature="0.01"/></default>
<worldbody><body name="upper"><joint name="one" axis="0 1 0"/>
<inertial pos="0 0 -0.1" mass="0.5" diaginertia="0.002 0.002 0.001"/>
<body name="lower" pos="0 0 -0.2"><joint name="two" axis="0 1 0"/>
<inertial pos="0 0 -0.1" mass="0.3" diaginertia="0.001 0.001 0.0005"/></body></body></worldbody>
<actuator><position name="first" joint="one" kp="20" kv="0.5" forcerange="-6 6"/>
<position name="second" joint="two" kp="10" kv="0.2"/></actuator></mujoco>'''
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


def plain(command, change=lambda model: None):
    """Return position and joint torque of MuJoCo's own loop, called step by step."""
    model = mujoco.MjModel.from_xml_string(MJCF)
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


def test_a_candidate_does_not_depend_on_its_neighbours(folder) -> None:
    machine = machine_of(folder)
    model = Mujoco(machine, data_with(machine, COMMAND))
    low = np.array([p.low for p in model.parameters])
    high = np.array([p.high for p in model.parameters])
    theta = low + (high - low) * np.random.default_rng(1).random((5, len(low)))
    together = model.simulate(theta)
    alone = np.concatenate([model.simulate(row[None]) for row in theta[::-1]])[::-1]
    assert np.array_equal(together, alone)


def test_what_a_log_of_positions_shows_is_found(folder) -> None:
    def true(model):
        model.actuator_gainprm[0, 0], model.actuator_biasprm[0, 1] = 15.0, -15.0
        model.dof_damping[:] = 0.25, 0.15
        model.dof_frictionloss[:] = 0.12, 0.02

    machine = machine_of(folder)
    position, _ = plain(COMMAND, true)
    noise = np.random.default_rng(3).standard_normal(position.shape) * 5e-4
    found = identify(machine, Data((data_with(machine, position + noise),)))
    values = {p.name: p.value for p in found.parameters}
    assert values['one.kp'] == pytest.approx(15.0, rel=0.02)
    assert values['two.kp'] == pytest.approx(10.0, rel=0.02)
    assert values['one.damping'] == pytest.approx(0.25, rel=0.1)
    assert values['one.frictionloss'] == pytest.approx(0.12, rel=0.1)


def test_effects_change_attributes_where_an_mjcf_has_them(folder) -> None:
    machine = machine_of(folder, {'kp': BOXES['kp']})
    model = Mujoco(machine, data_with(machine, COMMAND))
    offered = {at.effect for at in model.extensions()}
    assert {'viscous_friction', 'coulomb_friction', 'velocity_gain_error'} <= offered
    assert 'position_gain_error' not in offered  # kp is identified
    assert not {'backlash', 'stribeck', 'effort_bias'} & offered
    at = EffectAt('viscous_friction', 'two')
    wider = model.extended([at])
    by_hand = machine_of(folder, {**BOXES})
    same = Mujoco(by_hand, model.data)
    theta = theta_of(model)
    told = wider.simulate(np.append(theta, 0.3)[None])
    expected = same.simulate(theta_of(same, **{'two.damping': 0.4})[None])
    assert told == pytest.approx(expected, abs=1e-12)
    with pytest.raises(IdentError, match='an MJCF has no attribute'):
        model.extended([EffectAt('backlash', 'two')])


@pytest.mark.parametrize(
    ('changed', 'what'),
    [
        ({'drives': ('one', 'three')}, 'no joint three; it has one, two'),
        ({'actuator': ['first', 'third']}, 'no actuator third; it has first, second'),
    ],
)
def test_what_the_description_lacks_is_said(folder, changed, what) -> None:
    machine = machine_of(folder, **changed)
    data = Dataset(machine.drives, CYCLE, 0, COMMAND, COMMAND, None, None, None)
    with pytest.raises(IdentError, match=what) as caught:
        Mujoco(machine, data)
    assert caught.value.code is ErrorCode.BAD_MACHINE_FILE


def test_an_mjcf_that_is_none_and_a_log_without_set_points_are_refused(folder) -> None:
    (folder / 'broken.xml').write_text('<mujoco><worldbody></mujoco>')
    machine = machine_of(folder, description='broken.xml')
    with pytest.raises(IdentError, match='cannot be read'):
        Mujoco(machine, data_with(machine, COMMAND))
    machine = machine_of(folder)
    data = Dataset(machine.drives, CYCLE, 0, None, None, COMMAND, None, None)
    with pytest.raises(IdentError, match='holds no set-point'):
        Mujoco(machine, data)


def test_a_model_goes_to_another_process_and_simulates_the_same(folder) -> None:
    machine = machine_of(folder)
    model = Mujoco(machine, data_with(machine, COMMAND))
    there = pickle.loads(pickle.dumps(model))
    theta = theta_of(model)[None]
    assert np.array_equal(there.simulate(theta), model.simulate(theta))


def test_a_logs_delay_and_gain_act_on_the_effort_alone(folder) -> None:
    machine = machine_of(folder, {**BOXES, 'measurement_delay': [0.0, 0.1, 's']})
    position, effort = plain(COMMAND)
    data = data_with(machine, position, effort)
    model = Mujoco(machine, data, quantities=('effort', 'position'))
    prompt, late = (
        model.simulate(theta_of(model, measurement_delay=delay)[None])[0]
        for delay in (0.0, 3.0 * CYCLE)
    )
    assert late[:2, 3:] == pytest.approx(prompt[:2, :-3], abs=1e-12)
    assert np.array_equal(late[2:], prompt[2:])
