# SPDX-License-Identifier: Apache-2.0
"""An arm under its controllers: the compiled free run beside a slow one of the same scheme."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

pytest.importorskip('pinocchio', reason='pinocchio is not installed')

from arm_cases import described, JOINTS  # noqa: E402

from checks.reference.free_arm import free_arm  # noqa: E402
from ros2_ident.arrays import Array  # noqa: E402
from ros2_ident.gates.law import fit_law  # noqa: E402
from ros2_ident.identify.data import gather  # noqa: E402
from ros2_ident.machine.machine import Machine  # noqa: E402
from ros2_ident.models import EffectAt, load_machine, make_model  # noqa: E402
from ros2_ident.models.drives.joints import joints_of  # noqa: E402
from ros2_ident.models.new_file import followed_file  # noqa: E402
from ros2_ident.models.serial.model import Serial  # noqa: E402
from ros2_ident.recording import Dataset, Recording, Stream  # noqa: E402

CYCLE = 0.004
GAINS = {
    'position_gain': [600.0, 4000.0, 500.0, 200.0],
    'velocity_gain': [50.0, 300.0, 30.0, 10.0],
    'integral_gain': [500.0, 2000.0, 0.0, 300.0],
}
COUPLED = {'coupled_to': ['none', 'none', 'none', 'elbow'], 'coupling': 0.5}
BOXES = {
    'drive_inertia': [0.0, 5.0, 'kg m^2'],
    'coulomb_torque': [0.0, 50.0, 'N m'],
    'viscous_torque': [0.0, 50.0, 'N m s/rad'],
    'constant_force': [-20.0, 20.0, 'N m'],
    'link_mass': [-5.0, 5.0, 'kg'],
    'link_moment': [-5.0, 5.0, 'kg m'],
}
VALUES = {'drive_inertia': 0.4, 'coulomb_torque': 10.0, 'viscous_torque': 2.0, 'constant_force': 3}


def wanted(cycles: int) -> tuple[Array, Array]:
    """Return set-points (4, K) that start at rest, turn and rest again, and their rates."""
    time = np.minimum(CYCLE * np.arange(cycles), 0.7 * CYCLE * cycles)
    rates = 2.0 * np.pi / (0.7 * CYCLE * cycles) * np.arange(1, 5)[:, None]
    place = 0.2 * (1.0 - np.cos(rates * time)) + np.array([[0.3], [0.1], [-0.4], [0.8]])
    speed = 0.2 * rates * np.sin(rates * time)
    return place, speed


def logged(place: Array, speed: Array, position: Array) -> Dataset:
    nothing = np.full_like(place, np.nan)
    return Dataset(JOINTS, CYCLE, 0, place, speed, position, None, nothing)


def free_run(machine: Machine, cycles: int, friction: float = 10.0) -> tuple[Serial, Array]:
    """Return the model of a motion, and a candidate (N,) whose links are as described."""
    place, speed = wanted(cycles)
    model = make_model(
        machine,
        logged(place, speed, place[:, :1] + 0.0 * place),
        quantities=('effort', 'position'),
    )
    assert isinstance(model, Serial)
    links = dict(zip(model.inertials.names, model.inertials.middles, strict=True))
    given = {**VALUES, 'coulomb_torque': friction}
    values = [
        links[p.name] if p.name in links else given[p.name.split('.')[1]] for p in model.parameters
    ]
    return model, np.array(values)


@pytest.mark.parametrize('drive', [None, COUPLED], ids=['plain', 'coupled'])
@pytest.mark.parametrize('friction', [0.0, 10.0])
def test_a_free_run_is_that_of_the_slow_reference(
    tmp_path: Path, drive: dict[str, object] | None, friction: float
) -> None:
    machine = described(tmp_path, drive=drive, controller=GAINS, **BOXES)
    model, theta = free_run(machine, 60, friction)
    own = {
        p.name: x
        for p, x in zip(model.parameters, theta.tolist(), strict=True)
        if p.name not in model.inertials.names
    }
    place, _ = wanted(60)
    slow = free_arm(machine, own, int(model.work(theta[None])[0]))
    position, effort = slow.run(place, place[:, 0], np.zeros(4))
    simulated = model.simulate(theta[None])[0]
    # The issue is rounding: sums in other orders, and friction that settled to a billionth.
    assert np.abs(simulated[4:] - position).max() < 1e-10
    assert np.abs(simulated[:4] - effort).max() < 1e-9 * np.abs(effort).max()


@pytest.mark.parametrize(
    ('integral', 'slow', 'cycles', 'most'),
    # Of fast joints under integral parts, and of one that creeps to a stop while others are fast.
    [(True, 1.0, 600, 3e-5), (False, 0.02, 1500, 5e-6)],
    ids=['integral', 'creeping'],
)
def test_few_steps_of_a_cycle_do_what_many_do(
    tmp_path: Path, integral: bool, slow: float, cycles: int, most: float
) -> None:
    gains = GAINS if integral else {**GAINS, 'integral_gain': [0.0] * 4}
    machine = described(tmp_path, controller=gains, **BOXES)
    place, speed = wanted(cycles)
    share = np.array([[1.0], [1.0], [slow], [1.0]])
    place = place[:, :1] + share * (place - place[:, :1])
    data = logged(place, share * speed, place[:, :1] + 0.0 * place)
    theta = free_run(machine, cycles, friction=2.0)[1]
    model = make_model(machine, data, quantities=('position',))
    model.substeps = 2 if integral else 1
    few = model.simulate(theta[None])[0]
    model.substeps = 64
    off = few - model.simulate(theta[None])[0]
    assert np.sqrt(np.mean(off**2, axis=1)).max() < most


@pytest.mark.parametrize('drive', [None, COUPLED], ids=['plain', 'coupled'])
def test_another_zero_is_the_same_run_with_all_positions_shifted(
    tmp_path: Path, drive: dict[str, object] | None
) -> None:
    machine = described(tmp_path, drive=drive, controller=GAINS, **BOXES)
    model, theta = free_run(machine, 60)
    place, speed = wanted(60)
    by = 0.07 * np.eye(4)[2][:, None]
    found = make_model(
        machine,
        logged(place + by, speed, place[:, :1] + by + 0.0 * place),
        effects=[EffectAt('joint_zero_error', JOINTS[2])],
        quantities=('effort', 'position'),
    )
    effort, position = np.split(model.simulate(theta[None])[0], 2)
    also = np.split(found.simulate(np.append(theta, 0.07)[None])[0], 2)
    np.testing.assert_allclose(also[1], position + by, rtol=0, atol=1e-12)
    np.testing.assert_allclose(also[0], effort, rtol=0, atol=1e-10 * np.abs(effort).max())


def test_a_payload_and_other_links_are_those_of_the_described_arm_with_them(
    tmp_path: Path,
) -> None:
    heavier = (tmp_path / 'a', tmp_path / 'b')
    boxes = {**BOXES, 'payload_mass': [0.0, 5.0, 'kg'], 'payload_x': [-1.0, 1.0, 'm']}
    machine = described(heavier[0], controller=GAINS, **boxes)
    place, speed = wanted(80)
    data = logged(place, speed, place)
    found = make_model(machine, data, fixed={'payload_mass': 2.0, 'payload_x': 0.1})
    bare = make_model(machine, data, fixed={'payload_mass': 0.0, 'payload_x': 0.1})
    assert isinstance(found, Serial) and isinstance(bare, Serial)
    middle = np.array([0.5 * (p.low + p.high) for p in found.parameters])
    carried = found.simulate(middle[None])[0] - bare.simulate(middle[None])[0]
    # Resting at the start, what is added is the weight of the mass at its place.
    arm = found.arm
    with_it = arm.inertials.copy()
    with_it[-10:] += [2.0, 0.2, 0.0, 0.0, 0.0, 0.0, 0.02, 0.0, 0.0, 0.02]
    still = np.zeros((4, 1))
    terms = arm.terms(place[:, :1], still, still)[:, 0]
    assert carried[3, 0] == pytest.approx(0.0, abs=1e-9)  # a gain alone makes the first effort
    nothing = np.empty((1, 0))
    settled, unladen = (
        x.inertials.whole(x.candidates.own_values(middle), nothing)[0] for x in (found, bare)
    )
    added = terms @ (settled - unladen)
    assert added == pytest.approx(terms @ (with_it - arm.inertials))
    load = EffectAt('hand_load', 'all')
    held = make_model(described(heavier[1], controller=GAINS, **BOXES), data, effects=[load])
    block = held.rows(np.array([[*middle, 2.0, 0.2, 0.0, 0.0]]))
    same = found.rows(middle[None])
    np.testing.assert_allclose(block[0, -40:], same[0, -40:], rtol=0, atol=1e-5)


def test_joints_that_are_not_compared_follow_their_recorded_motion(tmp_path: Path) -> None:
    machine = described(tmp_path, controller=GAINS, **BOXES)
    model, theta = free_run(machine, 400, 0.0)
    whole = model.simulate(theta[None])[0]
    place, speed = wanted(400)
    names = [p.name for p in model.parameters]
    part = make_model(
        machine,
        logged(place, speed, whole[4:]),
        drives=('elbow', 'wrist'),
        quantities=('position',),
        fixed=dict(zip(names, theta.tolist(), strict=True)),
    )
    seen = part.simulate(np.empty((1, 0)))[0]
    moved = whole[6:] - whole[6:, :1]
    # The recorded motion is smoothed: what is left is a small share of the way.
    assert np.sqrt(np.mean((seen - whole[6:]) ** 2)) < 0.01 * np.sqrt(np.mean(moved**2))


def test_effects_act_at_a_joint_of_a_free_run(tmp_path: Path) -> None:
    machine = described(tmp_path, controller=GAINS, **BOXES)
    model, theta = free_run(machine, 200)
    ids = {at.effect for at in model.extensions()}
    assert {'stribeck', 'torque_ripple', 'command_delay'} <= ids
    late = model.extended([EffectAt('command_delay', 'elbow')])
    at = next(n for n, p in enumerate(late.parameters) if 'command_delay' in p.name)
    delayed = np.insert(theta, at, 0.02)
    before, after = model.simulate(theta[None])[0], late.simulate(delayed[None])[0]
    shift = np.abs(after - before).max(axis=1)
    assert np.argmax(shift[4:]) == 2
    assert np.abs(after[6, 5:] - before[6, :-5]).max() < 0.3 * shift[6]


def test_gravity_that_is_added_holds_the_arm(tmp_path: Path) -> None:
    gains = {**GAINS, 'integral_gain': 0.0}
    boxes = {name: BOXES[name] for name in ('drive_inertia', 'viscous_torque')}
    place, speed = wanted(50)
    still = np.repeat(place[:, :1], 50, axis=1)
    data = logged(still, 0.0 * speed, still)
    left = {}
    for how in ('none', 'gravity', 'dynamics'):
        machine = described(tmp_path / how, controller={**gains, 'compensation': how}, **boxes)
        model = make_model(machine, data, quantities=('position',))
        theta = [0.4 if 'inertia' in p.name else 2.0 for p in model.parameters]
        left[how] = np.abs(model.simulate(np.array([theta]))[0] - still).max()
    assert left['none'] > 1e-3 and max(left['gravity'], left['dynamics']) < 1e-12


def test_a_search_begins_with_what_the_log_alone_says(tmp_path: Path) -> None:
    boxes = {name: BOXES[name] for name in ('drive_inertia', 'coulomb_torque', 'viscous_torque')}
    searched = {'position_gain': [1.0, 1e5, 'N m/rad'], 'velocity_gain': [0.0, 1e4, 'N m s/rad']}
    gains = {**GAINS, 'integral_gain': 0.0}
    stated = described(tmp_path / 'a', controller=gains, **boxes)
    place, speed = wanted(1500)
    model = make_model(stated, logged(place, speed, place), quantities=('effort', 'position'))
    theta = np.array([VALUES[p.name.split('.')[1]] for p in model.parameters])
    effort, seen = np.split(model.simulate(theta[None])[0], 2)
    data = replace(logged(place, speed, seen), effort=effort)
    free = described(tmp_path / 'b', **boxes, **searched)
    for machine in (stated, free):
        again = make_model(machine, data, quantities=('effort', 'position'))
        found = again.suggested()
        assert found is not None
        for p, value in zip(again.parameters, found.tolist(), strict=True):
            name, key = p.name.split('.')
            if key in GAINS:
                assert value == pytest.approx(GAINS[key][JOINTS.index(name)], rel=0.01)
        # What signals below 15 Hz say of friction, which turns over faster, is a start.
        left = again.simulate(found[None])[0, 4:] - seen
        assert np.sqrt(np.mean(left**2)) < 2e-3 * np.sqrt(np.mean((seen - seen[:, :1]) ** 2))


def test_friction_that_turns_over_with_the_speed_takes_more_steps(tmp_path: Path) -> None:
    drive: dict[str, object] = {'coulomb_regularisation': 0.005}
    machine = described(tmp_path, drive=drive, controller=GAINS, **BOXES)
    model, theta = free_run(machine, 300)
    holds, _ = free_run(described(tmp_path, controller=GAINS, **BOXES), 300)
    assert model.work(theta[None])[0] > 2 * holds.work(theta[None])[0]
    found = model.simulate(theta[None])[0, 4:]
    model.substeps = 64
    assert np.abs(found - model.simulate(theta[None])[0, 4:]).max() < 1e-4


def test_joints_and_motion_of_a_free_run_are_those_for_an_export(tmp_path: Path) -> None:
    machine = described(tmp_path, controller=GAINS, **BOXES)
    model, theta = free_run(machine, 400, 0.0)
    for d, joint in enumerate(joints_of(model, theta)):
        assert joint.gains is not None and joint.coulomb == 0.0
        found = joint.gains.p, joint.gains.i, joint.gains.d
        assert found == tuple(
            GAINS[f'{name}_gain'][d] for name in ('position', 'integral', 'velocity')
        )
    simulated = model.simulate(theta[None])[0]
    place, speed = wanted(400)
    seen = make_model(machine, logged(place, speed, simulated[4:]), quantities=('effort',))
    assert isinstance(seen, Serial)
    asked = seen.links_effort(np.zeros((4, 10)))
    joints = joints_of(seen, theta)
    own = [j.effort(*seen.motion[1:, d]) + j.offset for d, j in enumerate(joints)]
    # Along the motion that they make, links, friction and rotors need what controllers ask, but
    # for what that changes while a set-point holds: it is logged where that is largest.
    left = (asked + own - simulated[:4])[:, 100:250]
    assert np.sqrt(np.mean(left**2)) < 0.1 * np.sqrt(np.mean(simulated[:4] ** 2))


def test_an_arm_without_gains_is_driven_by_its_recorded_motion(tmp_path: Path) -> None:
    machine = described(tmp_path, **BOXES)
    place, speed = wanted(200)
    data = replace(logged(place, speed, place), command_position=None, command_velocity=None)
    assert make_model(machine, data).free_run() is None


@pytest.mark.parametrize(
    ('compensation', 'more'),
    [
        ('none', {}),
        ('gravity', {}),
        ('dynamics', {'velocity_feedforward': 1.0}),
        ('gravity', {'integral_gain': 3000.0}),
    ],
)
def test_a_new_file_has_the_law_by_which_the_log_was_made(
    tmp_path: Path, compensation: str, more: dict[str, float]
) -> None:
    law = {**GAINS, 'integral_gain': 0.0, 'compensation': compensation, **more}
    boxes = {name: BOXES[name] for name in ('drive_inertia', 'coulomb_torque', 'viscous_torque')}
    tilted = described(tmp_path, controller=law, **boxes)
    # What a description does not say, a new file takes for upright.
    machine = tilted.with_constants(free_fall=9.81, base_roll=0.0, base_pitch=0.0)
    place, speed = wanted(1500)
    model = make_model(machine, logged(place, speed, place), quantities=('effort', 'position'))
    theta = [VALUES[p.name.split('.')[1]] for p in model.parameters]
    effort, seen = np.split(model.simulate(np.array([theta]))[0], 2)
    stamp = round(CYCLE * 1e9) * np.arange(1500)
    log = Recording(
        Stream(JOINTS, stamp, position=seen.T, effort=effort.T),
        command=Stream(JOINTS, stamp, position=place.T),
    )
    text = followed_file((), (tmp_path / 'arm.urdf').read_text(), 'arm.urdf', log)
    made = yaml.safe_load(text or '')
    assert made['controller'].get('compensation', 'none') == compensation
    assert {'velocity_feedforward', 'integral_gain'} & set(made['parameters']) == set(more)


MJCF = """<mujoco><compiler angle="radian"/><worldbody>
  <body name="upper"><joint name="lift" axis="0 1 0" damping="2" frictionloss="3" armature="0.3"/>
    <inertial mass="4" pos="0.2 0 0" diaginertia="0.05 0.05 0.05"/>
    <body name="lower" pos="0.5 0 0"><joint name="bend" axis="0 1 0" armature="0.1"/>
      <inertial mass="1.5" pos="0.15 0 0" diaginertia="0.01 0.01 0.01"/>
      <body name="hand" pos="0.3 0 0"><joint name="grip" axis="1 0 0"/>
        <inertial mass="0.2" pos="0 0 0" diaginertia="1e-4 1e-4 1e-4"/></body></body></body>
  </worldbody><actuator>
  <position joint="lift" kp="900" forcerange="-150 150"/>{actuator}
  <general joint="bend" biastype="affine" gainprm="300" biasprm="0 -300 -20" forcerange="-40 40"/>
  </actuator>{more}</mujoco>"""


def log_of(description: str, name: str, tmp_path: Path) -> Recording:
    """Return the log of two joints that this package simulates under stiffer actuators."""
    (tmp_path / name).write_text(description)
    text = (
        f'machine: serial\ndrives: [lift, bend]\ngeometry: {{description: {name}}}\n'
        'controller: {cycle: 0.004, position_gain: [2000, 700], velocity_gain: [90, 30]}\n'
        'parameters: {drive_inertia: [0.0, 5.0, kg m^2], coulomb_torque: [0.0, 9.0, N m]}\n'
    )
    (tmp_path / 'true.yaml').write_text(text)
    time = CYCLE * np.arange(1500)
    rates = np.array([[1.1], [1.7]])
    place, speed = 0.4 * (1.0 - np.cos(rates * time)), 0.4 * rates * np.sin(rates * time)
    data = Dataset(
        ('lift', 'bend'), CYCLE, 0, place, speed, place, None, np.full((2, 1500), np.nan)
    )
    model = make_model(
        load_machine(tmp_path / 'true.yaml'), data, quantities=('effort', 'position')
    )
    effort, seen = np.split(model.simulate(np.array([[0.4, 0.2, 3.0, 1.0]]))[0], 2)
    stamp = round(CYCLE * 1e9) * np.arange(1500)
    return Recording(
        Stream(('lift', 'bend'), stamp, position=seen.T, effort=effort.T),
        command=Stream(('lift', 'bend'), stamp, position=place.T),
    )


def test_an_open_chain_of_an_mjcf_is_simulated_by_this_package(tmp_path: Path) -> None:
    text = MJCF.format(actuator='', more='')
    log = log_of(text, 'arm.xml', tmp_path)
    made = yaml.safe_load(followed_file((), text, 'arm.xml', log) or '')
    assert (made['machine'], made['drives']) == ('serial', ['lift', 'bend'])
    assert made['controller']['torque_limit'] == [150.0, 40.0]
    further = {'velocity_feedforward', 'integral_gain', 'link_moment', 'link_inertia'}
    assert not further & set(made['parameters'])
    # What ran and what is stated lie well within the bounds.
    for name, ran in (('position_gain', (2000, 700)), ('velocity_gain', (90, 30))):
        assert all(box[1] > 2 * x for box, x in zip(made['parameters'][name], ran, strict=True))
    assert made['parameters']['drive_inertia'][0][1] >= 4 * 0.3


def test_links_that_weigh_else_than_described_are_parameters(tmp_path: Path) -> None:
    told = MJCF.format(actuator='', more='')
    log = log_of(told.replace('mass="4"', 'mass="4.6"'), 'arm.xml', tmp_path)
    made = yaml.safe_load(followed_file((), told, 'arm.xml', log) or '')
    for name, least in (('link_moment', 0.6 * 0.2), ('link_inertia', 0.6 * 0.2**2)):
        low, high, _ = made['parameters'][name]
        assert low < -2 * least and high > 2 * least


@pytest.mark.parametrize(
    ('mass', 'sought'),
    [
        ('1.5', False),
        # What a heavy joint does beside hides nothing that a light one tells.
        ('1.8', True),
    ],
)
def test_beside_an_effect_of_one_joint_the_others_tell_the_links(
    tmp_path: Path, mass: str, sought: bool
) -> None:
    told = MJCF.format(actuator='', more='')
    log = log_of(told.replace('mass="1.5"', f'mass="{mass}"'), 'arm.xml', tmp_path)
    assert log.state is not None and log.state.position is not None
    assert log.state.effort is not None
    effort = log.state.effort + 0.05 * np.random.default_rng(4).standard_normal((1500, 2))
    effort[:, 0] += 4.0 * np.sin(25.0 * log.state.position[:, 0])
    log = replace(log, state=replace(log.state, effort=effort))
    made = yaml.safe_load(followed_file((), told, 'arm.xml', log) or '')
    assert ('link_moment' in made['parameters']) is sought


def test_noise_of_positions_is_no_late_set_point(tmp_path: Path) -> None:
    text = MJCF.format(actuator='', more='')
    log = log_of(text, 'arm.xml', tmp_path)
    assert log.state is not None and log.state.position is not None
    assert log.state.effort is not None
    rng = np.random.default_rng(4)
    position = log.state.position + 2e-5 * rng.standard_normal((1500, 2))
    effort = log.state.effort + 0.05 * rng.standard_normal((1500, 2))
    log = replace(log, state=replace(log.state, position=position, effort=effort))
    made = followed_file((), text, 'arm.xml', log) or ''
    # Feed-forward that is to be found, and was none.
    made += '\n  velocity_feedforward: [0.0, 1.5, "1"]\n'
    (tmp_path / 'arm.yaml').write_text(made)
    machine = load_machine(tmp_path / 'arm.yaml')
    data = gather([log], machine).datasets[0]
    for drive in machine.drives:
        law = fit_law(machine, data, drive)
        assert law is not None and law.command_delay == law.effort_delay == 0.0
        assert law.explained > 0.99


@pytest.mark.parametrize(
    ('actuator', 'more'),
    [
        ('<velocity joint="bend"/>', ''),
        ('', '<equality><joint joint1="lift" joint2="bend"/></equality>'),
    ],
)
def test_what_only_mujoco_has_takes_mujoco(tmp_path: Path, actuator: str, more: str) -> None:
    log = log_of(MJCF.format(actuator='', more=''), 'arm.xml', tmp_path)
    text = MJCF.format(actuator=actuator, more=more)
    assert followed_file((), text, 'arm.xml', log) is None
