# SPDX-License-Identifier: Apache-2.0
"""Arms under position controllers from MuJoCo: gains, rotors, friction and one effect are hidden.

Every case is two bags of set-points, positions and efforts, the true links as an MJCF whose gains
are off, and the machine file that `ident new-machine` makes of them. `blind.arms` judges whether
`ident identify` and `ident diagnose` find what is hidden. MuJoCo and pinocchio have to be
importable.
"""

from collections.abc import Callable
import contextlib
import io
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt

from checks.blind import arms
from checks.blind.case import CHECK, FIT, MACHINE
from checks.blind.run import Generator, numbered, order_of
from checks.blind.score import SEEN
from checks.blind.seal import close
from checks.blind.store import Store
from checks.generators.arm_cases import (
    coloured,
    DESCRIPTION,
    draw_motion,
    draw_robot,
    ENCODER,
    PANDA,
    Robot,
    SHARE_WITHOUT,
    STEP,
    STRIDE,
    UR10,
)
from ros2_ident.cli.main import main
from ros2_ident.recording import Recording, Stream
from ros2_ident.recording.write import write_bag

Array = npt.NDArray[np.float64]

# Of MuJoCo's integrators RK4 alone lets a set-point act at its own instant, not half a step early.
FINE = 1e-4
CYCLE = STEP * STRIDE
# Of a log, s, at rest before it begins.
SETTLED = 2.0
# A controller's bandwidth [rad/s] by the joint's inertia at the start, and its damping ratio.
BANDWIDTH, RATIO = (20.0, 45.0), (0.4, 0.9)
_TRIES = 6

# (speed, place, size, shape from 0 to 1) -> friction added to the joint's.
Rub = Callable[[float, float, float, float], float]
FRICTION: dict[str, Rub] = {
    'stribeck': lambda v, q, size, shape: size * np.exp(-abs(v) / (0.05 + 0.2 * shape)),
    'asymmetric_friction': lambda v, q, size, shape: size * (v > 0.0),
    'position_dependent_friction': lambda v, q, size, shape: (
        size * (1.0 + np.sin(2.0 * q + 6.28 * shape))
    ),
    'degressive_friction': lambda v, q, size, shape: size * np.sqrt(abs(v)),
}
# The same -> torque along the joint.
TORQUE: dict[str, Rub] = {
    'torque_ripple': lambda v, q, size, shape: size * np.sin((15.0 + 30.0 * shape) * q),
    'cable_spring': lambda v, q, size, shape: -2.0 * size * (q - shape + 0.5),
}


def plant_of(robot: Robot, gains: Array, rotors: bool) -> mujoco.MjSpec:
    """Return an arm with an actuator of (2, D) position and velocity gains at each joint."""
    spec = mujoco.MjSpec.from_string(robot.xml(rotors=rotors))
    for joint, kp, kv in zip(list(spec.joints), *gains, strict=True):
        own = spec.add_actuator(name=joint.name, target=joint.name)
        own.trntype, own.biastype = mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtBias.mjBIAS_AFFINE
        own.gainprm[0], own.biasprm[1:3] = kp, (-kp, -kv)
    return spec


def simulate(
    robot: Robot, gains: Array, wanted: Array, effect: str, joint: int, size: float, shape: float
) -> tuple[Array, Array, Array]:
    """Let the controllers follow (K, D) set-points, each held for a cycle.

    Returns:
        (K, D) places and efforts, and (K,) what the effect added to the friction or torque.
    """
    spec = plant_of(robot, gains, rotors=True)
    spec.option.timestep, spec.option.integrator = FINE, mujoco.mjtIntegrator.mjINT_RK4
    plant = spec.compile()
    plant.dof_frictionloss[:], plant.dof_damping[:] = robot.dry, robot.viscous
    # Friction as firm as steps allow.
    plant.dof_solref[:], plant.dof_solimp[:] = (4.0 * FINE, 1.0), (0.999, 0.9999, 1e-3, 0.5, 2.0)
    data = mujoco.MjData(plant)
    data.qpos[:], data.ctrl[:] = wanted[0], wanted[0]
    mujoco.mj_step(plant, data, nstep=round(SETTLED / FINE))
    rub, push = FRICTION.get(effect), TORQUE.get(effect)
    places, efforts = np.empty((2, *wanted.shape))
    added = np.zeros(len(wanted))
    for k, now in enumerate(wanted):
        data.ctrl[:] = now
        mujoco.mj_forward(plant, data)
        places[k], efforts[k] = data.qpos, data.qfrc_actuator
        for part in range(round(CYCLE / FINE)):
            at = float(data.qvel[joint]), float(data.qpos[joint]), size, shape
            if rub:
                plant.dof_frictionloss[joint] = robot.dry[joint] + rub(*at)
            elif push:
                data.qfrc_applied[joint] = push(*at)
            if not part:
                added[k] = rub(*at) * np.sign(at[0]) if rub else -push(*at) if push else 0.0
            mujoco.mj_step(plant, data)
    return places, efforts, added


def shown(places: Array, added: Array, noise: float) -> float:
    """Return the RMS of what an effect adds beyond friction, by the effort's noise."""
    speed = np.gradient(places, CYCLE)
    columns = np.stack([np.sign(speed), speed, np.gradient(speed, CYCLE)], axis=1)
    left = added - columns @ np.linalg.lstsq(columns, added)[0]
    return float(np.sqrt(np.mean(left**2)) / noise)


def draw_gains(rng: np.random.Generator, robot: Robot, joints: int) -> Array:
    """Draw (2, D) position and velocity gains for a bandwidth."""
    bare = mujoco.MjModel.from_xml_string(robot.xml(rotors=True))
    there, mass = mujoco.MjData(bare), np.empty((joints, joints))
    mujoco.mj_forward(bare, there)
    mujoco.mj_fullM(bare, there, mass)
    pace, ratio = rng.uniform(*BANDWIDTH, joints), rng.uniform(*RATIO, joints)
    return np.asarray(np.diag(mass) * np.stack([pace**2, 2.0 * ratio * pace]))


def draw(folder: Path, seed: int, case: int) -> dict[str, Any]:
    """Draw a case, write its files, and return its label."""
    rng = np.random.default_rng([seed, case])
    table = (UR10, PANDA)[case % 2]
    robot, joints = draw_robot(rng, table), len(table[3])
    names = tuple(f'joint_{n + 1}' for n in range(joints))
    gains = draw_gains(rng, robot, joints)
    folder.mkdir(parents=True, exist_ok=True)
    believed = gains * rng.uniform(0.7, 1.4, gains.shape)
    (folder / DESCRIPTION).write_text(
        plant_of(robot, believed, rotors=False).to_xml(), encoding='utf-8'
    )
    effect, joint, size, shape, rho = 'none', 0, 0.0, 0.0, 0.0
    some, share = rng.uniform() >= SHARE_WITHOUT, rng.uniform(0.005, 0.02)
    motions = [draw_motion(rng, joints)[0, ::STRIDE] for _ in range(2)]
    for _ in range(_TRIES if some else 0):
        effect = str(rng.choice([*FRICTION, *TORQUE]))
        joint, shape = int(rng.integers(joints)), float(rng.uniform())
        size = float(robot.dry[joint] * rng.uniform(0.4, 1.2))
        places, efforts, added = simulate(robot, gains, motions[0], effect, joint, size, shape)
        rho = shown(places[:, joint], added, share * float(efforts[:, joint].std()))
        if rho >= SEEN:
            break
    stamp = 1_700_000_000_000_000_000 + np.arange(len(motions[0])) * round(1e9 * CYCLE)
    for bag, wanted in zip((FIT, CHECK), motions, strict=True):
        places, efforts, _ = simulate(robot, gains, wanted, effect, joint, size, shape)
        noisy = efforts + coloured(rng, len(efforts), share * efforts.std(axis=0))
        seen = Stream(names, stamp, ENCODER * np.round(places / ENCODER), None, noisy)
        write_bag(folder / bag, Recording(seen, command=Stream(names, stamp, wanted)))
    asked = ['--description', folder / DESCRIPTION, '--bag', folder / FIT]
    with contextlib.redirect_stdout(io.StringIO()):
        if main(['new-machine', *map(str, asked), '--out', str(folder / MACHINE)]):
            raise ValueError('no machine file could be made')
    hidden = {
        'position_gain': gains[0],
        'velocity_gain': gains[1],
        'drive_inertia': robot.rotors,
        'coulomb_torque': robot.dry,
        'viscous_torque': robot.viscous,
    }
    return {
        'case': case,
        'effect': effect,
        'where': f'joint_{joint + 1}' if effect != 'none' else '',
        'size': size,
        'shape': shape,
        'rho': rho,
        'truth': {f'{n}.{k}': float(v[d]) for k, v in hidden.items() for d, n in enumerate(names)},
    }


def _draw(store: Store, case: int, seed: int) -> dict[str, str]:
    return close(draw(store.case(case), seed, case), seed)


def _orders(store: Store, case: int) -> dict[int, dict[str, str]]:
    folder = store.case(case).resolve()
    order = order_of(store, case) | {
        'description': str(folder / DESCRIPTION),
        'identify': str(folder / 'identified'),
        'threads': '1',
    }
    del order['check']
    return {case: order}


GENERATOR = Generator(numbered, _draw, _orders, arms.row, arms.told)
