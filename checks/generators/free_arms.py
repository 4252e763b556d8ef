# SPDX-License-Identifier: Apache-2.0
"""Arms under position controllers from MuJoCo: gains, rotors, friction and one effect are hidden.

Every case is two bags of set-points, positions and efforts, the links as an MJCF whose masses,
centres of mass and gains are off, and the machine file that `ident new-machine` makes of them.
`blind.arms` judges whether `ident identify` and `ident diagnose` find what is hidden. MuJoCo and
pinocchio have to be importable.
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
from checks.blind.run import Generator, numbered
from checks.blind.score import SEEN
from checks.blind.seal import close
from checks.blind.store import Store
from checks.generators.arm_cases import (
    coloured,
    columns_of,
    DESCRIPTION,
    draw_motion,
    draw_robot,
    ENCODER,
    orders,
    PANDA,
    Robot,
    STEP,
    STRIDE,
    torques,
    truth_of,
    UR10,
    write_files,
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
_TRIES = 12
# By which share the description's masses are off at most.
BELIEVED = 0.15
# A joint homed askew, by so many rad.
ZERO, ASKEW = 'joint_zero_error', (0.01, 0.06)

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
    robot: Robot, gains: Array, wanted: Array,
    effect: str = 'none', joint: int = 0, size: float = 0.0, shape: float = 0.0,
) -> tuple[Array, Array, Array]:  # fmt: skip
    """Let the controllers follow (K, D) set-points, each held for a cycle.

    Returns:
        (K, D) places as logged and efforts, and (D, K) what the effect adds along these places.
    """
    askew = size * np.eye(wanted.shape[1])[joint] if effect == ZERO else 0.0
    wanted = wanted - askew
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
    added = np.zeros(wanted.T.shape)
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
                added[joint, k] = rub(*at) * np.sign(at[0]) if rub else -push(*at) if push else 0.0
            mujoco.mj_step(plant, data)
    if effect == ZERO:
        added = torques(robot, motion_of(places)) - torques(robot, motion_of(places + askew))
    return places + askew, efforts, added


def motion_of(places: Array) -> Array:
    """Return (3, D, K) place, speed and acceleration by (K, D) places."""
    speed = np.gradient(places, CYCLE, axis=0)
    return np.stack([places.T, speed.T, np.gradient(speed, CYCLE, axis=0).T])


def shown(folder: Path, places: Array, added: Array, noise: Array) -> float:
    """Return the RMS of what links, rotors and friction cannot imitate, of the worst joint.

    Args:
        folder: That of a machine file whose parameters they are.
        places: (K, D) rad.
        added: (D, K) N m of the effect.
        noise: (D,) standard deviation of the efforts.
    """
    motion = motion_of(places)
    own = np.eye(len(noise))[:, None, :]
    rubs = [own * x[:, :, None] for x in (np.sign(motion[1]), motion[1])]
    columns = np.concatenate([columns_of(folder, motion)[2], *rubs], axis=2)
    columns, whole = columns / noise[:, None, None], added / noise[:, None]
    flat = columns.reshape(whole.size, -1)
    left = whole - columns @ np.linalg.lstsq(flat, whole.ravel())[0]
    return float(np.sqrt(np.mean(left**2, axis=1)).max())


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
    gains = draw_gains(rng, robot, joints)
    described = robot.described(rng, BELIEVED)
    along = folder / 'along'
    along.mkdir(parents=True, exist_ok=True)
    write_files(along, described)
    effect, joint, size, shape, rho = 'none', 0, 0.0, 0.0, 0.0
    others = [*FRICTION, *TORQUE]
    # Of four cases, in any order, one has no effect and one a zero that is off.
    block, place = divmod(case - 1, 4)
    order = np.random.default_rng([seed, 0, block]).permutation(4)
    effects = [[], [ZERO], others, others][order[place]]
    share = rng.uniform(0.005, 0.02)
    motions = [draw_motion(rng, joints)[0, ::STRIDE] for _ in range(2)]
    for _ in range(_TRIES if effects else 0):
        effect, share = str(rng.choice(effects)), rng.uniform(0.005, 0.02)
        joint, shape = int(rng.integers(joints)), float(rng.uniform())
        size = float(robot.dry[joint] * rng.uniform(0.4, 1.2))
        if effect == ZERO:
            size = float(rng.choice([-1.0, 1.0]) * rng.uniform(*ASKEW))
        places, efforts, added = simulate(robot, gains, motions[0], effect, joint, size, shape)
        rho = shown(along, places, added, share * efforts.std(axis=0))
        if rho >= SEEN:
            break
    for bag, wanted in zip((FIT, CHECK), motions, strict=True):
        places, efforts, _ = simulate(robot, gains, wanted, effect, joint, size, shape)
        noisy = efforts + coloured(rng, len(efforts), share * efforts.std(axis=0))
        write_log(folder / bag, wanted, places, noisy)
    believed = gains * rng.uniform(0.7, 1.4, gains.shape)
    write_machine(folder, described, believed, folder / FIT)
    where = [f'joint_{d + 1}' for d in range(joints)]
    hidden = [f'{name}.{gain}' for gain in arms.GAINS for name in where]
    return {
        'case': case,
        'effect': effect,
        'where': where[joint] if effect != 'none' else '',
        'size': size,
        'shape': shape,
        'rho': rho,
        'truth': truth_of(along, robot) | dict(zip(hidden, gains.ravel().tolist(), strict=True)),
    }


def write_log(bag: Path, wanted: Array, at: Array, effort: Array) -> None:
    """Write set-points, positions and efforts, all (K, D), as a bag."""
    names = tuple(f'joint_{n + 1}' for n in range(wanted.shape[1]))
    stamp = 1_700_000_000_000_000_000 + np.arange(len(wanted)) * round(1e9 * CYCLE)
    seen = Stream(names, stamp, ENCODER * np.round(at / ENCODER), None, effort)
    write_bag(bag, Recording(seen, command=Stream(names, stamp, wanted)))


def write_machine(folder: Path, robot: Robot, gains: Array, bag: Path) -> None:
    """Write a description with (2, D) gains, and the machine file made of it and a log."""
    description = folder / DESCRIPTION
    description.write_text(plant_of(robot, gains, rotors=False).to_xml(), encoding='utf-8')
    asked = ['--description', description, '--bag', bag]
    with contextlib.redirect_stdout(io.StringIO()):
        if main(['new-machine', *map(str, asked), '--out', str(folder / MACHINE)]):
            raise ValueError('no machine file could be made')


def _draw(store: Store, case: int, seed: int) -> dict[str, str]:
    return close(draw(store.case(case), seed, case), seed)


GENERATOR = Generator(numbered, _draw, orders, arms.row, arms.told)
