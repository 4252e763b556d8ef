# SPDX-License-Identifier: Apache-2.0
"""Arms of six and seven joints from MuJoCo, with links, friction and one effect that are hidden.

Every case is a bag, the description its owner has, whose masses are wrong, and a machine file, so
that `ident` can be run on it by hand. What was drawn is sealed before anything is fitted, and
`ident identify` and `ident diagnose` run in processes of their own that are told these files only.
Two questions: do the intervals of `--method algebraic` hold the true base parameters, and does the
diagnosis name the effect and its joint? Goes on where a run was left. MuJoCo and pinocchio have to
be importable.

    python checks/benchmarks/mujoco_arm_blind.py --cases 60 --seed 1 --out DIR --keep KEPT \
        --draw-only
    python checks/benchmarks/mujoco_arm_blind.py --cases 60 --seed 1 --out DIR --keep KEPT
    python checks/benchmarks/mujoco_arm_blind.py --verify KEPT
"""

import argparse
from collections.abc import Callable
from dataclasses import dataclass
import gzip
import json
from pathlib import Path
import resource
import subprocess
import sys
from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt

from checks.blind.run import scrubbed
from checks.blind.seal import close, digest_of, manifest, unseal
from checks.blind.store import read_json, stamp, write_json
from checks.share import share_interval
from ros2_ident.gap.verdict import NAMELESS
from ros2_ident.identify.data import read_data
from ros2_ident.identify.problem import problem_of
from ros2_ident.models import load_machine
from ros2_ident.models.serial.arm import arm_of
from ros2_ident.models.serial.parameters import Inertials
from ros2_ident.recording import read_bag, Stream
from ros2_ident.recording.motion import told_band
from ros2_ident.recording.write import write_bag
from ros2_ident.search.levenberg import difference_jacobian

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
VISIBLE, SEEN = (2.0, 8.0), 1.5
SHARE_WITHOUT = 1.0 / 3.0
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

    def described(self, rng: np.random.Generator) -> 'Robot':
        """Return what its owner believes: masses and centres that are off by a quarter."""
        off = rng.uniform(0.75, 1.25, self.masses.shape)
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
    write_bag(folder / 'bag', {'/joint_states': stream}, mark='mujoco arm')


def write_files(folder: Path, robot: Robot, band: float) -> Path:
    """Write a description and the machine file beside it; return the latter."""
    names = ', '.join(f'joint_{n + 1}' for n in range(len(robot.masses)))
    (folder / 'arm.xml').write_text(robot.xml(rotors=False), encoding='utf-8')
    path = folder / 'arm.yaml'
    path.write_text(
        f'machine: serial\ndrives: [{names}]\neffort_unit: N m\neffort_noise: 0.1\n'
        'geometry: {description: arm.xml}\n'
        f'drive: {{coulomb_regularisation: {WIDTH}, gear_factor: 1.0, '
        f'travel_per_turn: {2.0 * np.pi / GEAR:.9g}}}\n'
        f'controller: {{cycle: {STEP * STRIDE}, bandwidth: {band:.3g}}}\n'
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
    machine = load_machine(folder / 'arm.yaml')
    arm = arm_of(machine)
    inertials = Inertials(machine, arm)
    joints = len(robot.masses)
    reach = np.array([np.pi, 2.0, 5.0])[:, None, None]
    motion = reach * np.random.default_rng(0).uniform(-1.0, 1.0, (3, joints, 200))
    terms = inertials.terms(arm.terms(*motion))
    rotors = np.eye(joints)[:, None, :] * motion[2][:, :, None]
    columns = np.concatenate([terms[:, :, :-1], rotors], axis=2)
    asked = _torques(robot, motion) - terms[:, :, -1]
    found, *_ = np.linalg.lstsq(columns.reshape(asked.size, -1), asked.ravel())
    if np.abs(columns @ found - asked).max() > 1e-6:
        raise ValueError('the base parameters do not ask what MuJoCo does')
    names, middles = inertials.names, inertials.middles
    values = found + np.pad(middles, (0, joints))
    names += [f'{drive}.drive_inertia' for drive in machine.drives]
    out = dict(zip(names, map(float, values), strict=True))
    for d, drive in enumerate(machine.drives):
        out[f'{drive}.coulomb_torque'] = float(robot.dry[d])
        out[f'{drive}.viscous_torque'] = float(robot.viscous[d])
    return out


def _torques(robot: Robot, motion: Array) -> Array:
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
        folder: Of the case.
        noise: (D,) standard deviation of the noise that was put in.
    """
    machine = load_machine(folder / 'arm.yaml')
    problem = problem_of(machine, read_data(folder / 'bag', machine))
    model = problem.models[0]
    span = problem.high - problem.low
    half = np.full(len(span), 0.5)
    residual, jacobian = difference_jacobian(model.residuals, half, problem.low, span)
    there = ~np.isnan(model.measured)
    drive = np.concatenate([np.full(int(row.sum()), d) for d, row in enumerate(there)])
    weight = 1.0 / noise[drive]
    weighted = jacobian * weight[:, None]
    scale = np.maximum(np.linalg.norm(weighted, axis=0), 1e-12)
    basis = np.linalg.qr(weighted / scale)[0]
    whole = residual * weight
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
    noise = _coloured(rng, len(np.arange(STRIDE, len(places), STRIDE)), usual)
    write_case(folder, places, torques, noise)
    states = read_bag(folder / 'bag')[0].state
    assert states is not None
    write_files(folder, believed, told_band(states))
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


def _coloured(rng: np.random.Generator, count: int, size: Array) -> Array:
    """Return (K, D) noise whose neighbouring samples correlate."""
    out = rng.normal(0.0, 1.0, (count, len(size)))
    for k in range(1, count):
        out[k] = 0.5 * out[k - 1] + np.sqrt(0.75) * out[k]
    return out * size


# ---------------------------------------------------------------------- answers

PROGRAM = 'import sys; from ros2_ident.cli.main import main; sys.exit(main(sys.argv[1:]))'
IDENTIFY = (
    'identify bag --machine arm.yaml --method algebraic --out identified --no-overlay --quiet'
)
DIAGNOSE = (
    'diagnose bag --machine arm.yaml --out diagnosis --no-overlay --no-report --quiet --resume '
    '--threads 1'
)
# Parameters of the links and rotors, as against those of friction.
BASE = ('link_moment', 'link_inertia', 'drive_inertia')


def answer(folder: Path) -> dict[str, Any]:
    """Identify and diagnose a case by processes that are told its files only.

    Returns:
        Of each command its exit code, the end of what it said, and its processor seconds.
    """
    out: dict[str, Any] = {}
    for name, words in (('identify', IDENTIFY), ('diagnose', DIAGNOSE)):
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        command = [sys.executable, '-c', PROGRAM, *words.split()]
        done = subprocess.run(
            command, cwd=folder, env=scrubbed(), check=False, capture_output=True, text=True
        )
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        used = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
        said = done.stderr.strip()[-500:] if done.returncode else ''
        out[name] = {'code': done.returncode, 'said': said, 'seconds': round(used, 1)}
    return out


def judge(folder: Path, label: dict[str, Any]) -> dict[str, Any]:
    """Hold the answers to a case against its label."""
    row = {key: label[key] for key in ('case', 'effect', 'where', 'rho', 'size')}
    row['run'] = read_json(folder / 'answer.json')
    identified = read_json(folder / 'identified' / 'result.json') or {'parameters': {}}
    told = {}
    for name, found in identified['parameters'].items():
        true = label['truth'][name]
        width = found['high'] - found['low']
        told[name] = {
            'true': true, 'value': found['value'], 'low': found['low'], 'high': found['high'],
            'held': found['low'] <= true <= found['high'],
            'identifiable': found['identifiable'] and width > 0.0,
        }  # fmt: skip
    row['parameters'] = told
    found = read_json(folder / 'diagnosis' / 'diagnosis.json')
    row['named'] = []
    if found is not None:
        verdict = found['verdict']
        every = [verdict, *found['also']]
        row['named'] = [[at['effect'], _places(at['where'])] for at in every]
        row['probability'] = verdict['probability']
        row['sentence'] = verdict['sentence']
        row['confusable'] = [[at['effect'], _places(at['where'])] for at in found['confusable']]
    return row


def _places(where: str | list[str]) -> list[str]:
    return [where] if isinstance(where, str) else where


def _commands(row: dict[str, Any]) -> list[dict[str, Any]]:
    return [row['run']['identify'], row['run']['diagnose']]


def figures(rows: list[dict[str, Any]]) -> dict[str, str]:
    """Return what came of the judged cases, by name."""

    def share(hits: list[bool]) -> str:
        low, high = share_interval(sum(hits), len(hits)) if hits else (0.0, 1.0)
        return f'{sum(hits)} of {len(hits)} [{100.0 * low:.0f}, {100.0 * high:.0f} %]'

    def held(kinds: tuple[str, ...], some: list[dict[str, Any]], sure: bool = False) -> str:
        return share(
            [
                p['held']
                for row in some
                for name, p in row['parameters'].items()
                if name.rpartition('.')[2].startswith(kinds) and (p['identifiable'] or not sure)
            ]
        )

    friction = ('coulomb_torque', 'viscous_torque')
    none = [r for r in rows if r['effect'] == 'none']
    some = [r for r in rows if r['effect'] != 'none']
    seen = [r for r in some if r['rho'] >= SEEN]
    first = [bool(r['named']) and r['named'][0] == [r['effect'], [r['where']]] for r in seen]
    there = [[r['effect'], [r['where']]] in r['named'] for r in seen]
    joint = [bool(r['named']) and r['where'] in r['named'][0][1] for r in seen]
    near = [
        hit or [r['effect'], [r['where']]] in r.get('confusable', [])
        for hit, r in zip(there, seen, strict=True)
    ]
    return {
        'cases judged': str(len(rows)),
        'base parameters held, all': held(BASE, rows),
        'base parameters held, of those called identifiable': held(BASE, rows, sure=True),
        'base parameters held, cases without an effect': held(BASE, none),
        'base parameters held, cases with one': held(BASE, some),
        'friction held, cases without an effect': held(friction, none),
        'friction held, cases with one': held(friction, some),
        f'effect and joint named first, rho from {SEEN:g}': share(first),
        'effect and joint among those named': share(there),
        'effect and joint named or called confusable': share(near),
        'joint named first': share(joint),
        'false alarms: anything but `none`': share(
            [not r['named'] or r['named'][0][0] != 'none' for r in none]
        ),
        'false alarms: an effect named': share(
            [bool(r['named']) and r['named'][0][0] not in NAMELESS for r in none]
        ),
        'processor seconds of identify and diagnose, median': ', '.join(
            f'{np.median([one["seconds"] for one in each]):.0f}'
            for each in zip(*map(_commands, rows), strict=True)
        ),
        'failed': str(
            sum(r['run'][n]['code'] != 0 for r in rows for n in ('identify', 'diagnose'))
        ),
    }


# ---------------------------------------------------------------------- the run


def drawn(out: Path, cases: int, seed: int) -> list[dict[str, str]]:
    """Draw and seal what is not drawn yet."""
    sealed = []
    for case in range(1, cases + 1):
        path = out / 'sealed' / f'{case:02d}.json'
        if read_json(path) is None:
            label = draw(out / f'case_{case:02d}', seed, case)
            path.parent.mkdir(exist_ok=True)
            write_json(path, close(label, seed))
        sealed.append(read_json(path))
    return sealed


def keep_seals(sealed: list[dict[str, str]], folder: Path) -> str:
    """Write the digests, to be committed before the first diagnosis; return the one over them."""
    seals = [one['sha256'] for one in sealed]
    what = {'manifest': manifest(seals), 'cases': len(seals), 'seals': seals}
    folder.mkdir(parents=True, exist_ok=True)
    before = read_json(folder / 'seals.json')
    if before not in (None, what):
        raise SystemExit(f'{folder} holds the seals of another run')
    write_json(folder / 'seals.json', what)
    return what['manifest']


def keep_all(
    sealed: list[dict[str, str]], rows: list[dict[str, Any]], seed: int, folder: Path
) -> None:
    """Write labels, table and figures of the judged cases beside the seals."""
    judged = [row['case'] for row in rows]
    labels = [
        {'nonce': one['nonce'], 'label': unseal(one, seed)}
        for case, one in enumerate(sealed, 1)
        if case in judged
    ]
    for name, lines in (('arm_labels.jsonl', labels), ('arm_table.jsonl', rows)):
        text = ''.join(json.dumps(line) + '\n' for line in lines)
        packed = gzip.compress(text.encode(), mtime=0)
        (folder / f'{name}.gz').write_bytes(packed)
    write_json(folder / 'arm_figures.json', figures(rows))


def verify(folder: Path) -> None:
    """Check a kept run: labels against seals, rows against labels, figures against rows."""
    seals = read_json(folder / 'seals.json')
    labels, rows = (
        [json.loads(x) for x in gzip.decompress((folder / name).read_bytes()).splitlines()]
        for name in ('arm_labels.jsonl.gz', 'arm_table.jsonl.gz')
    )
    assert manifest(seals['seals']) == seals['manifest']
    for one, row in zip(labels, rows, strict=True):
        label = one['label']
        assert digest_of(label, one['nonce']) == seals['seals'][label['case'] - 1], label['case']
        assert all(row[key] == label[key] for key in ('case', 'effect', 'where', 'rho', 'size'))
        assert all(p['true'] == label['truth'][name] for name, p in row['parameters'].items())
    assert figures(rows) == read_json(folder / 'arm_figures.json')
    print(f'{len(rows)} of {seals["cases"]} cases are what was sealed; {seals["manifest"]}')


def main() -> None:
    """Draw, seal, let the program answer, open, tell."""
    parser = argparse.ArgumentParser(description=(__doc__ or '').splitlines()[0])
    parser.add_argument('--cases', type=int, default=60)
    parser.add_argument('--seed', type=int, default=1)
    parser.add_argument('--out', type=Path, default=Path('build/mujoco_arms'))
    parser.add_argument('--keep', type=Path, help='folder for seals, labels, table and figures')
    parser.add_argument('--draw-only', action='store_true', help='draw and seal only')
    parser.add_argument('--verify', type=Path, help='check a kept folder, and nothing else')
    args = parser.parse_args()
    if args.verify:
        verify(args.verify)
        return
    sealed = drawn(args.out, args.cases, args.seed)
    keep = args.keep or args.out
    print(f'sealed: {args.cases} cases, SHA-256 {keep_seals(sealed, keep)}', flush=True)
    rows: list[dict[str, Any]] = []
    for case, one in enumerate([] if args.draw_only else sealed, 1):
        folder = args.out / f'case_{case:02d}'
        if read_json(folder / 'answer.json') is None:
            write_json(folder / 'answer.json', {**answer(folder), 'by': stamp()})
        rows.append(judge(folder, unseal(one, args.seed)))
        keep_all(sealed, rows, args.seed, keep)
        row = rows[-1]
        print(case, row['effect'], row['where'], f'{row["rho"]:.2f}', row['named'], flush=True)
    for name, value in figures(rows).items() if rows else ():
        print(f'{name}: {value}')


if __name__ == '__main__':
    main()
