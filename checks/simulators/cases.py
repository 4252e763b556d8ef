# SPDX-License-Identifier: Apache-2.0
"""Machines with known values, what is exported of them, and how they move by our own model."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
import functools
from pathlib import Path
from types import MappingProxyType
from typing import Any
import xml.etree.ElementTree as ET

import numpy as np
import pinocchio
import yaml

from ros2_ident.arrays import Array
from ros2_ident.export.content import Content, content_of
from ros2_ident.export.laws import Law
from ros2_ident.identify.data import Data
from ros2_ident.identify.problem import problem_of
from ros2_ident.machine.prior import Prior
from ros2_ident.models import EffectAt, machine_from_mapping, make_model
from ros2_ident.models.drives.joints import Joint, PARTS
from ros2_ident.models.new_file import new_machine_file
from ros2_ident.models.registry import KINDS
from ros2_ident.models.serial.model import Serial
from ros2_ident.recording import Dataset
from ros2_ident.report.estimate import Estimate

# Its motion is known by hand: 2 kg at 0.3 m, 0.26 kg m^2 about the axis.
PENDULUM = """<robot name="pendulum">
  <link name="stand"><inertial><origin xyz="0 0 0.5"/><mass value="5"/>
    <inertia ixx="0.1" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.1"/></inertial></link>
  <link name="arm"><inertial><origin xyz="0.1 0.02 -0.3"/><mass value="2"/>
    <inertia ixx="0.05" ixy="0.01" ixz="-0.005" iyy="0.06" iyz="0.008" izz="0.04"/></inertial>
  </link>
  <joint name="swing" type="revolute"><parent link="stand"/><child link="arm"/>
    <origin xyz="0 0 1"/><axis xyz="0 1 0"/>
    <limit lower="-2" upper="2" effort="50" velocity="30"/></joint>
</robot>
"""
# Two axes that cross, with a frame between them that has no mass.
GIMBAL = """<robot name="gimbal">
  <link name="stand"><inertial><origin xyz="0 0 0.5"/><mass value="5"/>
    <inertia ixx="0.1" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.1"/></inertial></link>
  <link name="ring"/>
  <link name="arm"><inertial><origin xyz="0.1 0.02 -0.3"/><mass value="2"/>
    <inertia ixx="0.05" ixy="0.01" ixz="-0.005" iyy="0.06" iyz="0.008" izz="0.04"/></inertial>
  </link>
  <joint name="roll" type="continuous"><parent link="stand"/><child link="ring"/>
    <origin xyz="0 0 1"/><axis xyz="1 0 0"/></joint>
  <joint name="pitch" type="continuous"><parent link="ring"/><child link="arm"/>
    <axis xyz="0 1 0"/></joint>
</robot>
"""
# The second joint is to turn back twice as far as the first one turns, from 0.1 rad on.
FOLLOWER = """<robot name="follower">
  <link name="stand"/>
  <link name="arm"><inertial><mass value="2"/>
    <inertia ixx="0.05" ixy="0" ixz="0" iyy="0.05" iyz="0" izz="0.05"/></inertial></link>
  <link name="finger"><inertial><mass value="0.1"/>
    <inertia ixx="0.001" ixy="0" ixz="0" iyy="0.001" iyz="0" izz="0.001"/></inertial></link>
  <joint name="lead" type="revolute"><parent link="stand"/><child link="arm"/>
    <origin xyz="0 0 1"/><axis xyz="0 1 0"/>
    <limit lower="-6" upper="6" effort="50" velocity="30"/></joint>
  <joint name="follow" type="revolute"><parent link="stand"/><child link="finger"/>
    <origin xyz="0 1 1"/><axis xyz="0 1 0"/>
    <limit lower="-6" upper="6" effort="50" velocity="30"/>
    <mimic joint="lead" multiplier="-2" offset="0.1"/></joint>
</robot>
"""
# Beside Coulomb friction of 0.4 N m: more near rest, to one side and along the way, and the
# motor's ripple.
EFFECTS = {
    'stribeck': {'torque': 0.3, 'velocity': 0.4},
    'asymmetric_friction': {'coulomb': 0.1, 'viscous': 0.05},
    'position_dependent_friction': {'slope': 0.5, 'middle': 0.2},
    'torque_ripple': {'sine': 0.3, 'cosine': 0.2, 'order': 5.0},
}
# What a joint has; speed at which friction has turned over, rad/s.
WHOLE, TURN = (*PARTS, 'laws'), 1e-12
# How far all links are heavier than described.
HEAVIER = 0.1
# Length of the log along which an export is judged, s.
SECONDS = 4.0
# States compared; a motion is compared after so long, s, and ours takes steps of so much.
STATES, MOTION, STEP = 10, 0.5, 1e-4
# Most that a drive makes, N m: more than any of these needs.
LIMIT = 5000.0
# Width of friction's step, rad/s; standard deviations of an estimate as shares of the bounds.
SHARP, SURE = 1e-3, 1e-4


@dataclass(frozen=True)
class Values:
    """What is identified of each joint: N m s/rad, N m, kg m^2."""

    viscous: float
    coulomb: float
    armature: float


@dataclass(frozen=True, eq=False)
class Case:
    """A machine.

    Attributes:
        name: On the page.
        description: Its URDF, joints that are no drives fixed.
        content: What is exported.
        states: (3, S, D) position, velocity and acceleration of the states compared.
        still: (D,) from where it swings; of the same posture it also decays.
        fast: (D,) the speeds from which it decays, rad/s.
    """

    name: str
    description: str
    content: Content
    states: Array
    still: Array
    fast: Array

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the drives."""
        return self.content.model.machine.drives

    @functools.cached_property
    def _model(self) -> Any:
        """Our links as a pinocchio model, its joints in the order of `_order`."""
        found = _arm(self.content).model.copy()
        for joint, own in zip(_arm(self.content).joints, self._links, strict=True):
            if own[0] > 0.0:
                found.inertias[int(joint)] = pinocchio.Inertia.FromDynamicParameters(own)
        return found

    @property
    def _links(self) -> Array:
        """(D, 10) inertials of all that each joint carries: the link, and what hangs on it."""
        arm, links = _arm(self.content), self.content.links
        assert links is not None
        described = arm.inertials.reshape(-1, 10)
        return np.asarray(described + links.inertials - [b.inertials for b in arm.bodies])

    def torque(
        self,
        position: Array,
        velocity: Array,
        acceleration: Array,
        of: Collection[str] = WHOLE,
    ) -> Array:
        """Return (D,) what a state asks of the joints: links, and `of` the parts of joints."""
        columns = [x[:, None] for x in (position, velocity, acceleration)]
        links = _arm(self.content).terms(*columns)[:, 0] @ self._links.ravel()
        joints, laws = self._parts(of)
        each = [joint.effort(velocity[d], acceleration[d], of) for d, joint in enumerate(joints)]
        return np.asarray(links + np.array(each) + _taken(laws, position, velocity))

    def _parts(self, of: Collection[str]) -> tuple[tuple[Joint, ...], list[tuple[Law, ...]]]:
        """Return the joints and their effects; friction stands for these where `of` has none."""
        found = self.content
        if 'laws' not in of:
            return found.joints, [()] * len(found.joints)
        return found.beside, [found.laws.get(joint.name, ()) for joint in found.beside]

    def motion(
        self, start: Array, speed: Array, gravity: bool, of: Collection[str] = WHOLE
    ) -> Array:
        """Return (D,) where the joints are after `MOTION`, nothing driving them.

        Of the joints' own parts those of `of` count; of effects what they take at once where the
        motion turns over counts as Coulomb friction. Friction holds with what it has at most,
        each step's impulses found by projected Gauss-Seidel: Moreau's time-stepping.
        """
        model, arm = self._model.copy(), _arm(self.content)
        if not gravity:
            model.gravity.linear = np.zeros(3)
        data = model.createData()
        order, (joints, laws) = np.argsort(arm.joints), self._parts(of)
        laws = [laws[d] for d in order]
        rows = {
            n: np.array([getattr(j, n) if n in of else 0.0 for j in joints])[order] for n in PARTS
        }
        place, rate, impulse = start[order].copy(), speed[order].copy(), np.zeros(len(joints))
        for _ in range(round(MOTION / STEP)):
            at = arm._places(place[np.argsort(order)][:, None])[0]
            mass = pinocchio.crba(model, data, at)
            mass = np.triu(mass) + np.triu(mass, 1).T + np.diag(rows['armature'])
            ahead, back = (
                _taken(laws, place, sign * TURN * np.ones_like(rate)) for sign in (1, -1)
            )
            dry, way = 0.5 * (ahead - back), np.where(rate < 0.0, -1.0, 1.0)
            most = STEP * np.maximum(rows['coulomb'] + dry, 0.0)
            against = pinocchio.nonLinearEffects(model, data, at, rate)
            against = against + _taken(laws, place, np.where(rate == 0.0, TURN, rate)) - dry * way
            inverse = np.linalg.inv(mass + STEP * np.diag(rows['viscous']))
            free = inverse @ (mass @ rate - STEP * against)
            for _ in range(200):
                before = impulse.copy()
                for d in range(len(joints)):
                    left = free[d] + inverse[d] @ impulse
                    impulse[d] = np.clip(impulse[d] - left / inverse[d, d], -most[d], most[d])
                if np.abs(impulse - before).max() < 1e-12 * (1.0 + most.max()):
                    break
            rate = free + inverse @ impulse
            place += STEP * rate
        return np.asarray(place[np.argsort(order)])


def _taken(laws: Sequence[tuple[Law, ...]], place: Array, rate: Array) -> Array:
    """Return (D,) what effects take, N m."""
    each = [[law.effort(place[d], rate[d]) for law in own] for d, own in enumerate(laws)]
    return np.array([float(sum(own)) for own in each])


def _arm(content: Content) -> Any:
    assert isinstance(content.model, Serial)
    return content.model.arm


def cases(folder: Path, robots: Path) -> list[Case]:
    """Return the machines.

    Args:
        folder: Where their descriptions are written.
        robots: Folder of `example-robot-data`'s descriptions.
    """
    root = Path(__file__).parents[2]
    panda = (robots / 'panda_description/urdf/panda.urdf').read_text('utf-8')
    z1 = (robots / 'z1_description/urdf/z1.urdf').read_text('utf-8')
    kr300 = (root / 'config/kr300.urdf').read_text('utf-8')
    return [
        pendulum(folder),
        case(folder, 'pendulum with effects', PENDULUM, ['swing'], Values(0.7, 0.4, 0.05),
             np.zeros(1), EFFECTS),
        case(folder, 'gimbal', GIMBAL, ['roll', 'pitch'], Values(0.7, 0.4, 0.05), np.zeros(2)),
        case(folder, 'KR 300', kr300, [f'axis_{n}' for n in range(1, 7)],
             Values(25.0, 12.5, 1.25), np.zeros(6)),
        case(folder, 'Panda', panda, [f'panda_joint{n}' for n in range(1, 8)],
             Values(1.0, 0.5, 0.1), np.array([0.0, 0.3, 0.0, -1.6, 0.0, 1.8, 0.0])),
        case(folder, 'Z1', z1, [f'joint{n}' for n in range(1, 7)],
             Values(1.0, 0.5, 0.05), np.array([0.0, 1.4, -1.3, 0.0, 0.0, 0.0])),
    ]  # fmt: skip


def pendulum(folder: Path) -> Case:
    """Return the pendulum."""
    return case(folder, 'pendulum', PENDULUM, ['swing'], Values(0.7, 0.4, 0.05), np.zeros(1))


def follower(folder: Path) -> Case:
    """Return the joint that another one follows, the description with both."""
    found = case(folder, 'follower', FOLLOWER, ['lead'], Values(0.1, 0.1, 0.05), np.zeros(1))
    return replace(found, description=FOLLOWER)


def case(
    folder: Path,
    name: str,
    text: str,
    drives: Sequence[str],
    values: Values,
    centre: Array,
    effects: Mapping[str, Mapping[str, float]] = MappingProxyType({}),
) -> Case:
    """Return one machine, moved about a posture.

    Args:
        folder: Where its description is written.
        name: On the page.
        text: URDF.
        drives: Its joints.
        values: Of each joint.
        centre: (D,) the posture, rad.
        effects: Of each drive, with the values of their parameters.
    """
    text = _without_shapes(text, drives)
    path = folder / f'{name.replace(" ", "_").lower()}.urdf'
    path.write_text(text, 'utf-8')
    written = new_machine_file(KINDS['serial'], drives, description=text, named=path.name)
    machine = machine_from_mapping(yaml.safe_load(written), path, folder)
    machine = machine.with_constants(coulomb_regularisation=SHARP, torque_limit=LIMIT)
    rng = np.random.default_rng(1)
    count = len(drives)
    cycle = machine.number('cycle')
    time = cycle * np.arange(round(SECONDS / cycle))
    rate, size = rng.uniform(1.0, 6.0, (count, 3, 1)), rng.uniform(0.03, 0.12, (count, 3, 1))
    waves = size * np.sin(rate * time + rng.uniform(0.0, 6.0, (count, 3, 1)))
    place = centre[:, None] + waves.sum(axis=1)
    none = np.zeros_like(place)
    data = Dataset(machine.drives, cycle, 0, None, None, place, None, none)
    there = tuple(EffectAt(name, drive) for drive in drives for name in effects)
    model = make_model(machine, data, effects=there)
    assert isinstance(model, Serial)
    # Heavier about every axis but those of the joints, along which rotors count as well.
    told, held = model.inertials.changes
    heavier = HEAVIER * np.concatenate([body.inertials for body in model.arm.bodies])
    more = told @ (heavier - np.linalg.pinv(held) @ held @ heavier)
    truth = dict(zip(model.inertials.names, model.inertials.middles + more, strict=True))
    own = {
        'viscous_torque': values.viscous,
        'coulomb_torque': values.coulomb,
        'drive_inertia': values.armature,
    }
    truth |= {f'{d}.{name}': value for d in drives for name, value in own.items()}
    truth |= {
        f'{at.prefix}{name}': value for at in there for name, value in effects[at.effect].items()
    }
    theta = np.array([truth[p.name] for p in model.parameters])
    data = Dataset(
        machine.drives, cycle, 0, None, None, place, None, np.asarray(model.simulate(theta)[0])
    )
    problem = problem_of(machine, Data((data,), labels=('log',)), effects=there)
    names = [p.name for p in problem.parameters]
    sure = {p.name: SURE * (p.high - p.low) for p in problem.parameters}
    known = {n: truth[n] for n in names}
    estimate = Estimate(known, {}, problem.drives, {}, '', Prior(deviations=sure))
    states = np.stack([
        centre + rng.uniform(-0.5, 0.5, (STATES, count)),
        rng.choice([-1.0, 1.0], (STATES, count)) * rng.uniform(0.3, 1.5, (STATES, count)),
        rng.uniform(-3.0, 3.0, (STATES, count)),
    ])  # fmt: skip
    return Case(
        name,
        text,
        content_of(problem, estimate, 0.3),
        states,
        centre + (1.0 if count == 1 else 0.1),
        np.full(count, 2.0 if count == 1 else 1.0) * (-1.0) ** np.arange(count),
    )


def _without_shapes(text: str, drives: Sequence[str]) -> str:
    """Return a URDF of links and joints only: nothing but the drives moves, and they all round."""
    root = ET.fromstring(text)
    root[:] = [element for element in root if element.tag in ('link', 'joint')]
    for link in root.iterfind('link'):
        link[:] = link.findall('inertial')
    for joint in root.iterfind('joint'):
        if joint.get('name') not in drives:
            joint.set('type', 'fixed')
            joint[:] = [x for x in joint if x.tag in ('parent', 'child', 'origin')]
        limit = joint.find('limit')
        if limit is not None:
            limit.attrib |= {'lower': '-6.3', 'upper': '6.3', 'velocity': '30'}
    return ET.tostring(root, encoding='unicode')
