# SPDX-License-Identifier: Apache-2.0
"""Full inertials of links: what fit and description say, and that bodies can have them."""

from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import minimize

pytest.importorskip('pinocchio', reason='pinocchio is not installed')

from arm_cases import JOINTS, LINKS  # noqa: E402

from models.test_serial import BOXES, described, middle, moving  # noqa: E402
from ros2_ident.models import EffectAt, machine_from_mapping, make_model  # noqa: E402
from ros2_ident.models.serial.arm import arm_of  # noqa: E402
from ros2_ident.models.serial.cone import nearest, pseudo_inertia  # noqa: E402
from ros2_ident.models.serial.links import effort_of, links_of  # noqa: E402
from ros2_ident.models.serial.parameters import Inertials  # noqa: E402
from ros2_ident.recording import Dataset  # noqa: E402

VERTICAL = """<robot name="r"><link name="base"/><link name="arm"><inertial><mass value="1"/>
  <inertia ixx="0.1" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.15"/></inertial></link>
  <joint name="a" type="continuous"><parent link="base"/><child link="arm"/><axis xyz="0 0 1"/>
  </joint></robot>"""
ROTORS = {**BOXES, 'drive_inertia': [0.0, 1.0, 'kg m^2']}


@pytest.fixture
def model(tmp_path: Path):
    machine = described(tmp_path, **ROTORS)
    return make_model(machine, moving(machine))


def links_alone(model, theta: np.ndarray) -> np.ndarray:
    """Return what a candidate's links and rotors ask, without friction."""
    values = dict(zip([p.name for p in model.parameters], theta, strict=True))
    for name in values:
        if name.endswith(('coulomb_torque', 'viscous_torque')):
            values[name] = 0.0
    return model.simulated_effort(np.array(list(values.values())))


def rotors(model, theta: np.ndarray) -> np.ndarray:
    sizes = [
        t for p, t in zip(model.parameters, theta, strict=True) if p.name.endswith('drive_inertia')
    ]
    return np.array(sizes)[:, None] * model.motion[2]


def test_links_ask_what_the_candidate_asks(model) -> None:
    rng = np.random.default_rng(0)
    low, high = np.array([(p.low, p.high) for p in model.parameters]).T
    theta = middle(model) + 0.01 * rng.normal(size=len(low)) * (high - low)
    found = links_of(model, theta, np.diag((0.05 * (high - low)) ** -2.0), 0.3)
    assert consistent(found.inertials).all()
    expected = links_alone(model, found.theta)
    asked = effort_of(model, found) + rotors(model, found.theta)
    np.testing.assert_allclose(asked, expected, rtol=0, atol=1e-9)
    # Flat: its inertia about z is the sum of the two others.
    assert found.mended == ('upper',)


def test_the_last_link_has_what_it_carries(tmp_path: Path) -> None:
    machine = described(tmp_path, **ROTORS, payload_mass=[0.0, 9.0, 'kg'])
    there = [EffectAt('hand_load', 'all')]
    model = make_model(machine, moving(machine), effects=there, fixed={'payload_mass': 2.0})
    theta = middle(model)
    theta[-4:] = 1.0, 0.05, 0.0, 0.1
    found = links_of(model, theta, np.eye(len(theta)), 0.3)
    described_mass = model.arm.bodies[-1].inertials[0]
    assert found.inertials[-1][0] == pytest.approx(described_mass + 3.0, abs=0.5)
    asked = effort_of(model, found) + rotors(model, found.theta)
    np.testing.assert_allclose(asked, links_alone(model, found.theta), rtol=0, atol=1e-9)


def test_an_arm_none_of_whose_inertias_shows_keeps_its_links(tmp_path) -> None:
    """A joint about the vertical, whose one inertia is its motor's."""
    (tmp_path / 'arm.urdf').write_text(VERTICAL)
    plain = {
        'machine': 'serial', 'drives': ['a'], 'geometry': {'description': 'arm.urdf'},
        'controller': {'cycle': 0.01}, 'parameters': {'drive_inertia': [0.0, 1.0, 'kg m^2']},
    }  # fmt: skip
    machine = machine_from_mapping(plain, 'arm', tmp_path)
    still = np.zeros((1, 50))
    model = make_model(machine, Dataset(('a',), 0.01, 0, still, still, still, still, still))
    found = links_of(model, np.array([0.5]), np.eye(1), 0.3)
    assert found.theta == pytest.approx([0.5])


def test_friction_moves_with_what_it_is_correlated_with(model) -> None:
    names = [p.name for p in model.parameters]
    one, other = names.index('wrist.link_inertia_xx'), names.index('wrist.viscous_torque')
    theta = middle(model)
    # No body: the wrist's inertia about its axis would be below zero.
    theta[one] -= 3.0
    covariance = np.diag(np.full(len(names), 0.1**2))
    covariance[one, other] = covariance[other, one] = 0.5 * 0.1**2
    found = links_of(model, theta, np.linalg.inv(covariance), 0.3)
    moved = found.theta - theta
    assert moved[one] > 1.0
    assert moved[other] == pytest.approx(0.5 * moved[one], rel=1e-6)
    assert consistent(found.inertials).all()


# ---------------------------------------------------------------------- the cone of inertials


FREE = (np.empty((0, 10)), np.empty(0))


def consistent(inertials: np.ndarray) -> np.ndarray:
    """Return (L,) whether bodies can have these (L, 10) inertials."""
    scaled = inertials / np.maximum(np.abs(inertials).max(axis=1, keepdims=True), 1e-300)
    return np.linalg.eigvalsh(pseudo_inertia(scaled)).min(axis=1) > 0.0


def of_points(mass: np.ndarray, place: np.ndarray) -> np.ndarray:
    """Return the ten inertials of points (P,) at (P, 3), by their sums."""
    square = (place**2).sum(axis=1)
    inertia = np.einsum('p,pij->ij', mass, square[:, None, None] * np.eye(3)) - np.einsum(
        'p,pi,pj->ij', mass, place, place
    )
    places = [0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]
    return np.array([mass.sum(), *(mass @ place), *inertia[places]])


def bodies(count: int, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return np.array(
        [of_points(rng.uniform(0.1, 2.0, 6), rng.uniform(-0.3, 0.3, (6, 3))) for _ in range(count)]
    )


def test_it_is_the_minimum() -> None:
    described = bodies(1, seed=3)
    rng = np.random.default_rng(6)
    told, wanted = rng.normal(size=(4, 10)), 0.05 * rng.normal(size=4)
    precision = np.diag([1e2, 1e3, 1e4, 10.0])

    def cost(inertials: np.ndarray) -> float:
        pseudo, first = pseudo_inertia(np.array([inertials, described[0]]))
        if np.linalg.eigvalsh(pseudo).min() <= 0.0:
            return np.inf
        ratio = np.linalg.solve(first, pseudo)
        off = told @ (inertials - described[0]) - wanted
        apart = np.trace(ratio) - np.linalg.slogdet(ratio)[1] - 4.0
        return float(apart / (4.0 * 0.2**2) + 0.5 * off @ precision @ off)

    found = nearest(described, told, wanted, precision, FREE, 0.2)[0]
    best = cost(found)
    for step in rng.normal(size=(200, 10)) * np.abs(described[0]) * 1e-3:
        assert cost(found + step) >= best
    better = minimize(cost, found, method='Nelder-Mead', options={'maxiter': 500})
    assert better.fun >= best - 1e-9


def test_right_angles_that_a_description_rounds_are_no_parameters(tmp_path):
    body = '<inertial><mass value="2"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/>'
    plain = {
        'machine': 'serial', 'drives': ['turn', 'lift', 'roll'],
        'geometry': {'description': 'arm.urdf'}, 'controller': {'cycle': 0.01},
        'parameters': {**LINKS, 'drive_inertia': [0.0, 1.0, 'kg m^2']},
    }  # fmt: skip
    for quarter in ('1.5707963267948966', '1.570796', '1.5708', '1.57'):
        joints = [
            ('base', 'turn', '0'),
            ('turn', 'lift', quarter),
            ('lift', 'roll', f'-{quarter}'),
        ]
        parts = ''.join(
            f'<link name="{own}">{body}</inertial></link><joint name="{own}" type="continuous">'
            f'<parent link="{on}"/><child link="{own}"/><axis xyz="0 0 1"/>'
            f'<origin xyz="0 {0.2 * (angle != "0")} 0" rpy="{angle} 0 0"/></joint>'
            for on, own, angle in joints
        )
        (tmp_path / 'arm.urdf').write_text(f'<robot name="r"><link name="base"/>{parts}</robot>')
        machine = machine_from_mapping(plain, 'arm', tmp_path)
        inertials = Inertials(machine, arm_of(machine))
        # About the first two axes links turn as their rotors do, and add to no other.
        assert len(inertials.names) == 13
        assert not {'turn.link_inertia_zz', 'lift.link_inertia_zz'} & set(inertials.names)
        assert sorted(inertials.rotors) == ['lift.drive_inertia', 'turn.drive_inertia']


@pytest.mark.parametrize(('coupled', 'shown'), [('none', True), ('lower', False)])
def test_a_motor_that_turns_with_two_joints_is_no_other_than_the_link_it_turns(
    tmp_path, coupled, shown
):
    """Level axes, the second link by a belt from the base: it turns as its motor does."""
    plain = {
        'machine': 'serial', 'drives': ['lower', 'upper'],
        'geometry': {
            'dh_a': [0.0, 0.3], 'dh_alpha': [0.5 * np.pi, 0.0], 'dh_d': [0.0, 0.0],
            'dh_theta': [0.0, 0.0],
        },
        'drive': {'coupled_to': ['none', coupled]}, 'controller': {'cycle': 0.01},
        'parameters': {
            'link_moment': [-1.0, 1.0, 'kg m'], 'link_inertia': [-1.0, 1.0, 'kg m^2'],
            'drive_inertia': [0.0, 1.0, 'kg m^2'],
        },
    }  # fmt: skip
    machine = machine_from_mapping(plain, 'arm', tmp_path)
    inertials = Inertials(machine, arm_of(machine))
    assert ('upper.link_inertia_zz' in inertials.names) is shown
    assert ('upper.drive_inertia' in inertials.rotors) is not shown


def test_rotors_stand_for_the_links_that_are_given(tmp_path):
    place, speed, acceleration = np.random.default_rng(4).uniform(-1.0, 1.0, (3, len(JOINTS), 20))
    given = {'elbow.link_mass': 4.0, 'elbow.link_moment_x': 0.7, 'drive_inertia': 2.0}
    efforts = []
    for name, rotor in (('stated', {}), ('sought', {'drive_inertia': [0.0, 9.0, 'kg m^2']})):
        machine = described(tmp_path / name, **LINKS, **rotor)
        arm = arm_of(machine)
        inertials = Inertials(machine, arm)
        told = inertials.as_described(given)
        change = [told[x] for x in inertials.names] - inertials.middles
        terms = inertials.terms(arm.terms(place, speed, acceleration), hand=False)
        own = [told.get(f'{joint}.drive_inertia', 2.0) for joint in JOINTS]
        efforts.append(terms @ np.append(change, 1.0) + np.transpose(acceleration.T * own))
    np.testing.assert_allclose(*efforts, atol=1e-9)
