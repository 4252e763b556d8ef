# SPDX-License-Identifier: Apache-2.0
"""Arms whose identified values are exported, and what their files ask by pinocchio."""

from dataclasses import replace
import importlib.util
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

pinocchio = pytest.importorskip('pinocchio', reason='pinocchio is not installed')

from models.test_serial import BOXES, JOINTS, moving  # noqa: E402

from ros2_ident.export.content import Content, content_of  # noqa: E402
from ros2_ident.export.targets import write  # noqa: E402
from ros2_ident.identify.data import Data  # noqa: E402
from ros2_ident.identify.problem import problem_of  # noqa: E402
from ros2_ident.machine.machine import Machine  # noqa: E402
from ros2_ident.machine.prior import Prior  # noqa: E402
from ros2_ident.models import load_machine, make_model  # noqa: E402
from ros2_ident.report.estimate import Estimate  # noqa: E402

ROOT = Path(__file__).parents[1]
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
