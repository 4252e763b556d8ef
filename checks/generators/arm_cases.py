# SPDX-License-Identifier: Apache-2.0
"""Arms of six and seven joints from MuJoCo, with links, friction and one effect that are hidden.

Every case is a bag, the description its owner has, whose masses are wrong, and a machine file, so
that `ident` can be run on it by hand. Two questions: do the intervals of `--method algebraic` hold
the true base parameters, and does the diagnosis name the effect and its joint? `blind.arms` judges
them. MuJoCo and pinocchio have to be importable.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt

from checks.blind import arms
from checks.blind.case import FIT, MACHINE
from checks.blind.run import Generator, numbered, order_of
from checks.blind.score import SEEN
from checks.blind.seal import close
from checks.blind.store import Store
from ros2_ident.identify.data import read_data
from ros2_ident.identify.problem import problem_of
from ros2_ident.models import load_machine
from ros2_ident.models.serial.arm import arm_of
from ros2_ident.models.serial.parameters import Inertials
from ros2_ident.recording import Stream
from ros2_ident.recording.write import write_bag
from ros2_ident.search.jacobian import Box
from ros2_ident.search.least_squares import Point

Array = npt.NDArray[np.float64]

HALF = 0.5 * np.pi
STEP, STRIDE, SECONDS = 1e-3, 4, 10.0
# Of a step so many are simulated, and so many steps pass at rest before the log begins.
FINER, SETTLED = 4, 500
# Modified Denavit-Hartenberg a, alpha, d, and what a link weighs [kg], of arms of two makes.
UR10 = (
    (0.0, 0.0, -0.612, -0.5723, 0.0, 0.0),
    (0.0, HALF, 0.0, 0.0, HALF, -HALF),
    (0.1273, 0.0, 0.0, 0.1639, 0.1157, 0.0922),
    (7.8, 12.9, 3.9, 2.0, 2.0, 0.6),
)
PANDA = (
    (0.0, 0.0, 0.0, 0.0825, -0.0825, 0.0, 0.088),
    (0.0, -HALF, HALF, HALF, -HALF, HALF, HALF),
    (0.333, 0.0, 0.316, 0.0, 0.384, 0.0, 0.0),
    (4.0, 3.0, 3.0, 3.0, 3.0, 2.0, 1.0),
)
# A motor's turn per turn of its joint, width of the step in friction [rad/s], encoder [rad].
GEAR, WIDTH, ENCODER = 50.0, 0.02, 2.0 * np.pi / 2**19
# How far an effect stands out of what links and friction can imitate, in units of what they leave
# without it: noise, and the encoder's steps in the acceleration. From SEEN on a name is asked for.
VISIBLE = 2.0, 8.0
SHARE_WITHOUT = 1.0 / 3.0
DESCRIPTION = 'robot.xml'
# So many draws of an effect and its joint at most, until one shows at a size that gears have.
_TRIES = 6


@dataclass(frozen=True)
class State:
    """What a law of friction sees of the joints: speed, place, load, each (D,), and bristles."""

    speed: Array
    place: Array
    load: Array
    bristle: Array


# (the joints, Coulomb friction of the joint [N m], size, shape from 0 to 1) -> torque (D,) against
# the motion, of which one joint's counts.
Law = Callable[[State, float, float, float], Array]


def stribeck(at: State, dry: float, size: float, shape: float) -> Array:
    """Tustin's form: an exponential of the speed, not of its square."""
    return size * np.exp(-np.abs(at.speed) / (0.1 + 0.4 * shape)) * np.tanh(at.speed / WIDTH)


def asymmetric(at: State, dry: float, size: float, shape: float) -> Array:
    """One direction rubs more, less than in proportion to the speed."""
    return size * (shape + (1.0 - shape) * np.abs(at.speed) ** 0.7) * (at.speed > 0.0)


def by_load(at: State, dry: float, size: float, shape: float) -> Array:
    """Teeth rub by what they carry, beyond what they are pressed together by anyhow."""
    pressed = dry * (0.2 + shape)
    return 0.01 * size * (np.hypot(at.load, pressed) - pressed) * np.tanh(at.speed / WIDTH)


def by_place(at: State, dry: float, size: float, shape: float) -> Array:
    """A gear that runs hard once a turn of the joint."""
    return size * (1.0 + np.cos(at.place + 2.0 * np.pi * shape)) * np.tanh(at.speed / WIDTH)


def ripple(at: State, dry: float, size: float, shape: float) -> Array:
    """Cogging, twice a turn of the motor, with steep flanks."""
    angle = 2.0 * GEAR * at.place + 2.0 * np.pi * shape
    return size * np.sin(angle + 0.5 * np.sin(angle))


def degressive(at: State, dry: float, size: float, shape: float) -> Array:
    """Friction of oil that thins: it rises with the root of the speed."""
    return size * np.sign(at.speed) * np.sqrt(np.abs(at.speed))


def bristles(at: State, dry: float, size: float, shape: float) -> Array:
    """LuGre's bristles in the place of the step."""
    return dry * (at.bristle - np.tanh(at.speed / WIDTH))


FORMS: dict[str, Law] = {
    'stribeck': stribeck,
    'asymmetric_friction': asymmetric,
    'load_dependent_friction': by_load,
    'position_dependent_friction': by_place,
    'torque_ripple': ripple,
    'degressive_friction': degressive,
    'presliding': bristles,
}


@dataclass(frozen=True)
class Robot:
    """One arm with its friction.

    Attributes:
        table: As `UR10`.
        masses: (D,) kg.
        centres: (D, 3) centres of mass, m.
        inertias: (D, 3) about the centre, along the link's axes, kg m^2.
        rotors: (D,) inertia of motors at the joints, kg m^2.
        dry: (D,) Coulomb friction, N m.
        viscous: (D,) N m s/rad.
    """

    table: tuple[tuple[float, ...], ...]
    masses: Array
    centres: Array
    inertias: Array
    rotors: Array
    dry: Array
    viscous: Array

    def described(self, rng: np.random.Generator, share: float = 0.25) -> 'Robot':
        """Return what its owner believes: masses off by up to a share, and centres by 2 cm."""
        off = rng.uniform(1.0 - share, 1.0 + share, self.masses.shape)
        moved = self.centres + rng.normal(0.0, 0.02, self.centres.shape)
        return Robot(
            self.table, off * self.masses, moved, off[:, None] * self.inertias, self.rotors,
            self.dry, self.viscous,
        )  # fmt: skip

    def xml(self, rotors: bool) -> str:
        """Return its MJCF, with or without what the motors add."""
        inner = ''
        for d in reversed(range(len(self.masses))):
            a, alpha, along = (row[d] for row in self.table[:3])
            place = (a, -np.sin(alpha) * along, np.cos(alpha) * along)
            turn = (np.cos(0.5 * alpha), np.sin(0.5 * alpha), 0.0, 0.0)
            armature = self.rotors[d] if rotors else 0.0
            inner = (
                f'<body name="link_{d + 1}" pos="{_text(place)}" quat="{_text(turn)}">'
                f'<inertial pos="{_text(self.centres[d])}" mass="{self.masses[d]:.9g}" '
                f'diaginertia="{_text(self.inertias[d])}"/>'
                f'<joint name="joint_{d + 1}" axis="0 0 1" armature="{armature:.9g}"/>'
                f'{inner}</body>'
            )
        return (
            f'<mujoco model="arm"><option timestep="{STEP / FINER}">'
            '<flag contact="disable"/></option>'
            f'<worldbody>{inner}</worldbody></mujoco>'
        )


def _text(numbers: Array | tuple[float, ...]) -> str:
    return ' '.join(f'{x:.9g}' for x in numbers)


def draw_robot(rng: np.random.Generator, table: tuple[tuple[float, ...], ...]) -> Robot:
    """Draw an arm about those of a make."""
    masses = np.array(table[3]) * rng.uniform(0.7, 1.4, len(table[3]))
    count = len(masses)
    size = rng.uniform(0.08, 0.2, (count, 3))
    square = size**2
    inertias = masses[:, None] / 3.0 * (square.sum(axis=1, keepdims=True) - square)
    strong = np.sqrt(masses[::-1].cumsum()[::-1] / masses.sum())
    return Robot(
        table,
        masses,
        rng.uniform(-0.12, 0.12, (count, 3)),
        inertias,
        strong * rng.uniform(0.2, 1.0, count),
        strong * rng.uniform(3.0, 9.0, count),
        strong * rng.uniform(3.0, 12.0, count),
    )


def draw_motion(rng: np.random.Generator, joints: int) -> Array:
    """Return (3, K, D) place, speed and acceleration of a multisine that begins at rest."""
    when = np.arange(round(SECONDS / STEP)) * STEP
    rates = 2.0 * np.pi / SECONDS * np.arange(1, 9)
    sizes = rng.normal(0.0, 1.0, (joints, 8)) / np.arange(1, 9) ** 0.5
    phases = rng.uniform(0.0, 2.0 * np.pi, (joints, 8))
    waves = np.sin(rates[:, None] * when + phases[:, :, None])
    place = np.einsum('dn,dnk->dk', sizes, waves)
    place *= rng.uniform(0.4, 0.9, (joints, 1)) / np.abs(place).max(axis=1, keepdims=True)
    place = place * (1.0 - np.exp(-((when / 0.6) ** 3)))
    speed = np.gradient(place, STEP, axis=1)
    return np.stack([place.T, speed.T, np.gradient(speed, STEP, axis=1).T])


def simulate(
    robot: Robot,
    believed: Robot,
    wanted: Array,
    effect: str,
    joint: int,
    size: float,
    shape: float,
) -> tuple[Array, Array]:
    """Let MuJoCo run an arm under computed torque by what its owner believes of it.

    Returns:
        (K, D) places and the motors' torques from each step on.
    """
    plant = mujoco.MjModel.from_xml_string(robot.xml(rotors=True))
    plan = mujoco.MjModel.from_xml_string(believed.xml(rotors=True))
    data, other = mujoco.MjData(plant), mujoco.MjData(plan)
    mass = np.empty((plan.nv, plan.nv))
    mujoco.mj_forward(plan, other)
    mujoco.mj_fullM(plan, other, mass)
    stiff = 40.0**2 * np.diag(mass)
    data.qpos[:], data.qvel[:] = wanted[0, 0], wanted[1, 0]
    count = wanted.shape[1]
    places, torques = np.empty((2, count, plan.nv))
    bristle, carried = np.zeros(plan.nv), np.zeros(plan.nv)
    way = 0.004 * 8.0**shape
    law = FORMS.get(effect)
    for k in range(-SETTLED, count):
        other.qpos[:], other.qvel[:], other.qacc[:] = wanted[:, max(k, 0)]
        mujoco.mj_inverse(plan, other)
        missed = wanted[:2, max(k, 0)] - np.stack([data.qpos, data.qvel])
        torque = other.qfrc_inverse + stiff * (missed[0] + 0.05 * missed[1])
        if k >= 0:
            places[k], torques[k] = data.qpos, torque
        for _ in range(FINER):
            # MuJoCo's speed is that of half a step before the place.
            speed = data.qvel + 0.5 * STEP / FINER * data.qacc
            rub = robot.dry * np.tanh(speed / WIDTH) + robot.viscous * speed
            if law is not None:
                bristle += STEP / FINER / way * (speed - np.abs(speed) * bristle)
                state = State(speed, data.qpos.copy(), carried, bristle)
                rub[joint] += law(state, robot.dry[joint], size, shape)[joint]
            data.qfrc_applied[:] = torque - rub
            mujoco.mj_step(plant, data)
            carried = torque - rub - robot.rotors * data.qacc
    return places, torques


def write_case(folder: Path, places: Array, torques: Array, noise: Array) -> None:
    """Write the log: every few steps what encoders and currents say."""
    kept = np.arange(STRIDE, len(places), STRIDE)
    # A torque acts at each of the steps from its instant on, in the middle of these on average.
    later = 0.5 * (1.0 - 1.0 / FINER)
    effort = (1.0 - later) * torques[kept] + later * torques[kept - 1] + noise
    names = tuple(f'joint_{n + 1}' for n in range(places.shape[1]))
    stamp = 1_700_000_000_000_000_000 + np.round(kept * STEP * 1e9).astype(np.int64)
    seen = ENCODER * np.round(places[kept] / ENCODER)
    stream = Stream(names, stamp, seen, None, effort)
    write_bag(folder / FIT, {'/joint_states': stream}, mark='mujoco arm')


def write_files(folder: Path, robot: Robot) -> Path:
    """Write a description and the machine file beside it; return the latter."""
    names = ', '.join(f'joint_{n + 1}' for n in range(len(robot.masses)))
    (folder / DESCRIPTION).write_text(robot.xml(rotors=False), encoding='utf-8')
    path = folder / MACHINE
    path.write_text(
        f'machine: serial\ndrives: [{names}]\neffort_unit: N m\neffort_noise: 0.1\n'
        'geometry: {description: robot.xml}\n'
        f'drive: {{coulomb_regularisation: {WIDTH}, gear_factor: 1.0, '
        f'travel_per_turn: {2.0 * np.pi / GEAR:.9g}}}\n'
        f'controller: {{cycle: {STEP * STRIDE}}}\n'
        'parameters:\n'
        '  link_moment: [-10.0, 10.0, kg m]\n'
        '  link_inertia: [-10.0, 10.0, kg m^2]\n'
        '  drive_inertia: [0.0, 5.0, kg m^2]\n'
        '  coulomb_torque: [0.0, 40.0, N m]\n'
        '  viscous_torque: [0.0, 60.0, N m s/rad]\n',
        encoding='utf-8',
    )
    return path


def truth_of(folder: Path, robot: Robot) -> dict[str, float]:
    """Return the true values of what the machine file looks for.

    Base parameters are those that ask MuJoCo's torques of the true arm, beside what the
    description asks: a rotor may stand for what its link is described off by.
    """
    joints = len(robot.masses)
    reach = np.array([np.pi, 2.0, 5.0])[:, None, None]
    motion = reach * np.random.default_rng(0).uniform(-1.0, 1.0, (3, joints, 200))
    names, middles, columns, described = columns_of(folder, motion)
    asked = torques(robot, motion) - described
    found, *_ = np.linalg.lstsq(columns.reshape(asked.size, -1), asked.ravel())
    if np.abs(columns @ found - asked).max() > 1e-6:
        raise ValueError('the base parameters do not ask what MuJoCo does')
    out = dict(zip(names, map(float, found + middles), strict=True))
    for d in range(joints):
        out[f'joint_{d + 1}.coulomb_torque'] = float(robot.dry[d])
        out[f'joint_{d + 1}.viscous_torque'] = float(robot.viscous[d])
    return out


def columns_of(folder: Path, motion: Array) -> tuple[list[str], Array, Array, Array]:
    """Return what base parameters and rotors ask along (3, D, K) motion.

    Returns:
        (C,) names, (C,) what the description makes of them, (D, K, C) what one of each asks, and
        (D, K) what the description does.
    """
    machine = load_machine(folder / MACHINE)
    arm = arm_of(machine)
    inertials, joints = Inertials(machine, arm), len(machine.drives)
    terms = inertials.terms(arm.terms(*motion), hand=False)
    rotors = np.eye(joints)[:, None, :] * motion[2][:, :, None]
    names = inertials.names + [f'{drive}.drive_inertia' for drive in machine.drives]
    columns = np.concatenate([terms[:, :, :-1], rotors], axis=2)
    return names, np.pad(inertials.middles, (0, joints)), columns, terms[:, :, -1]


def torques(robot: Robot, motion: Array) -> Array:
    """Return (D, K) what MuJoCo says that (3, D, K) motion asks of links and rotors."""
    plant = mujoco.MjModel.from_xml_string(robot.xml(rotors=True))
    data = mujoco.MjData(plant)
    out = np.empty(motion.shape[1:])
    for k in range(motion.shape[2]):
        data.qpos[:], data.qvel[:], data.qacc[:] = motion[:, :, k]
        mujoco.mj_inverse(plant, data)
        out[:, k] = data.qfrc_inverse
    return out


def shown(folder: Path, noise: Array) -> Array:
    """Return (D,) what of the efforts links and friction cannot imitate, in units of the noise.

    Args:
        noise: (D,) standard deviation of the noise that was put in.
    """
    machine = load_machine(folder / MACHINE)
    problem = problem_of(machine, read_data(folder / FIT, machine))
    model = problem.models[0]
    box = Box.of(problem.low, problem.high)
    at = Point.at(model.residuals, box, np.full(len(box.low), 0.5))
    there = ~np.isnan(model.measured)
    drive = np.concatenate([np.full(int(row.sum()), d) for d, row in enumerate(there)])
    weight = 1.0 / noise[drive]
    weighted = at.jacobian * weight[:, None]
    scale = np.maximum(np.linalg.norm(weighted, axis=0), 1e-12)
    basis = np.linalg.qr(weighted / scale)[0]
    whole = at.residual * weight
    left = whole - basis @ (basis.T @ whole)
    return np.sqrt(np.bincount(drive, left**2) / np.bincount(drive))


def draw(folder: Path, seed: int, case: int) -> dict[str, Any]:
    """Draw a case, write its files, and return its label."""
    rng = np.random.default_rng([seed, case])
    table = (UR10, PANDA)[case % 2]
    robot = draw_robot(rng, table)
    believed = robot.described(rng)
    joints = len(table[3])
    wanted = draw_motion(rng, joints)
    folder.mkdir(parents=True, exist_ok=True)
    places, torques = simulate(robot, believed, wanted, 'none', 0, 0.0, 0.0)
    usual = rng.uniform(0.005, 0.02) * torques.std(axis=0)
    noise = coloured(rng, len(np.arange(STRIDE, len(places), STRIDE)), usual)
    write_case(folder, places, torques, noise)
    write_files(folder, believed)
    label: dict[str, Any] = {
        'case': case,
        'effect': 'none',
        'where': '',
        'size': 0.0,
        'shape': 0.0,
        'rho': 0.0,
    }
    label['truth'] = truth_of(folder, robot)
    if rng.uniform() < SHARE_WITHOUT:
        return label
    without = shown(folder, usual)
    for _ in range(_TRIES):
        joint, shape = int(rng.integers(joints)), float(rng.uniform())
        effect, target = str(rng.choice(list(FORMS))), float(rng.uniform(*VISIBLE))
        # What gears do: they do not swallow more than half of what they carry.
        most = 50.0 if effect == 'load_dependent_friction' else 1.5 * float(robot.dry[joint])
        size = min(most, 2.0 * target * float(without[joint] * usual[joint]))
        for _ in range(3):
            places, torques = simulate(robot, believed, wanted, effect, joint, size, shape)
            write_case(folder, places, torques, noise)
            left = shown(folder, usual)[joint] / without[joint]
            rho = float(np.sqrt(max(left**2 - 1.0, 0.0)))
            more = min(most / size, float(np.clip(target / max(rho, 1e-3), 0.05, 20.0)))
            if effect == 'presliding' or 0.6 < more < 1.7:
                break
            size *= more
        if rho >= SEEN:
            break
    where = f'joint_{joint + 1}'
    return {**label, 'effect': effect, 'where': where, 'size': size, 'shape': shape, 'rho': rho}


def coloured(rng: np.random.Generator, count: int, size: Array) -> Array:
    """Return (K, D) noise whose neighbouring samples correlate."""
    out = rng.normal(0.0, 1.0, (count, len(size)))
    for k in range(1, count):
        out[k] = 0.5 * out[k - 1] + np.sqrt(0.75) * out[k]
    return out * size


def _draw(store: Store, case: int, seed: int) -> dict[str, str]:
    return close(draw(store.case(case), seed, case), seed)


def orders(store: Store, case: int, **more: str) -> dict[int, dict[str, str]]:
    """Return what is asked about a case: an identification, too, of one log."""
    folder = store.case(case).resolve()
    files = {'description': str(folder / DESCRIPTION), 'identify': str(folder / 'identified')}
    order = order_of(store, case) | files | {'threads': '1'} | more
    del order['check']
    return {case: order}


GENERATOR = Generator(numbered, _draw, partial(orders, method='algebraic'), arms.row, arms.told)
