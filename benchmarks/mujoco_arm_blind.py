# SPDX-License-Identifier: Apache-2.0
"""Arms of six and seven joints from MuJoCo, with links, friction and one effect that are hidden.

Every case is a bag, the description its owner has, whose masses are wrong, and a machine file, so
that `ident` can be run on it by hand. What was drawn is sealed before anything is fitted. Two
questions: do the intervals of `--method algebraic` hold the true base parameters and friction, and
does the diagnosis name the effect and its joint? Goes on where a run was left. MuJoCo and
pinocchio have to be importable.

    python benchmarks/mujoco_arm_blind.py --cases 60 --seed 1 --out build/mujoco_arms
    python benchmarks/mujoco_arm_blind.py --cases 60 --seed 1 --draw-only
"""

import argparse
from collections.abc import Callable
from dataclasses import dataclass
import json
from pathlib import Path
import tempfile
import time

import mujoco
import numpy as np
import numpy.typing as npt

from ros2_ident.checks.blind.seal import close, manifest, unseal
from ros2_ident.checks.share import share_interval
from ros2_ident.gap.diagnose import diagnose
from ros2_ident.identify.data import read_data
from ros2_ident.identify.run import solve
from ros2_ident.identify.settings import IdentifySettings
from ros2_ident.identify.setup import problem_of
from ros2_ident.models import load_machine
from ros2_ident.recording import Stream
from ros2_ident.recording.write import write_bag
from ros2_ident.search.levenberg import difference_jacobian

Array = npt.NDArray[np.float64]

HALF = 0.5 * np.pi
STEP, STRIDE, SECONDS = 1e-3, 4, 10.0
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
# How far an effect stands out of what links and friction can imitate, in units of the noise.
VISIBLE = (2.0, 8.0)
SHARE_WITHOUT = 1.0 / 3.0


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
            f'<mujoco model="arm"><option timestep="{STEP}"><flag contact="disable"/></option>'
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
    for k in range(count):
        other.qpos[:], other.qvel[:], other.qacc[:] = wanted[:, k]
        mujoco.mj_inverse(plan, other)
        missed = wanted[:2, k] - np.stack([data.qpos, data.qvel])
        torque = other.qfrc_inverse + stiff * (missed[0] + 0.05 * missed[1])
        speed = data.qvel.copy()
        rub = robot.dry * np.tanh(speed / WIDTH) + robot.viscous * speed
        if law is not None:
            bristle += STEP / way * (speed - np.abs(speed) * bristle)
            state = State(speed, data.qpos.copy(), carried, bristle)
            rub[joint] += law(state, robot.dry[joint], size, shape)[joint]
        places[k], torques[k] = data.qpos, torque
        data.qfrc_applied[:] = torque - rub
        mujoco.mj_step(plant, data)
        carried = torque - rub - robot.rotors * data.qacc
    return places, torques


def write_case(folder: Path, places: Array, torques: Array, noise: Array) -> None:
    """Write the log: every few steps what encoders and currents say."""
    kept = np.arange(STRIDE, len(places), STRIDE)
    # A torque stands until the next one: the mean of both is that of the instant.
    effort = 0.5 * (torques[kept] + torques[kept - 1]) + noise
    names = tuple(f'joint_{n + 1}' for n in range(places.shape[1]))
    stamp = 1_700_000_000_000_000_000 + np.round(kept * STEP * 1e9).astype(np.int64)
    seen = ENCODER * np.round(places[kept] / ENCODER)
    stream = Stream(names, stamp, seen, None, effort)
    write_bag(folder / 'bag', {'/joint_states': stream}, mark='mujoco arm')


def write_files(folder: Path, robot: Robot) -> Path:
    """Write a description and the machine file beside it; return the latter."""
    names = ', '.join(f'joint_{n + 1}' for n in range(len(robot.masses)))
    (folder / 'arm.xml').write_text(robot.xml(rotors=False), encoding='utf-8')
    path = folder / 'arm.yaml'
    path.write_text(
        f'machine: serial\ndrives: [{names}]\neffort_unit: N m\neffort_noise: 0.1\n'
        'geometry: {description: arm.xml}\n'
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


def truth_of(robot: Robot) -> dict[str, float]:
    """Return the true values of what the machine file looks for."""
    from ros2_ident.models.serial.arm import arm_of
    from ros2_ident.models.serial.parameters import Inertials

    with tempfile.TemporaryDirectory() as folder:
        machine = load_machine(write_files(Path(folder), robot))
    names, values = Inertials(machine, arm_of(machine)).names_and_middles()
    out = dict(zip(names, map(float, values), strict=True))
    for d, drive in enumerate(machine.drives):
        out[f'{drive}.drive_inertia'] = float(robot.rotors[d])
        out[f'{drive}.coulomb_torque'] = float(robot.dry[d])
        out[f'{drive}.viscous_torque'] = float(robot.viscous[d])
    return out


def shown(folder: Path, joint: int, without: Array, noise: Array) -> float:
    """Return what of a joint's effort links and friction cannot imitate, in units of its noise.

    Args:
        folder: Of the case.
        joint: The joint.
        without: (K', D) the noise that was put in.
        noise: (D,) its standard deviation.
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
    rows = [without[: there.shape[1], d][row[: len(without)]] for d, row in enumerate(there)]
    weighted = jacobian * weight[:, None]
    scale = np.maximum(np.linalg.norm(weighted, axis=0), 1e-12)
    clean = (residual - np.concatenate(rows)) * weight
    basis = np.linalg.qr(weighted / scale)[0]
    left = clean - basis @ (basis.T @ clean)
    return float(np.sqrt(np.mean(left[drive == joint] ** 2)))


def draw(folder: Path, seed: int, case: int) -> dict[str, object]:
    """Draw a case, write its files, and return its label."""
    rng = np.random.default_rng([seed, case])
    table = (UR10, PANDA)[case % 2]
    robot = draw_robot(rng, table)
    believed = robot.described(rng)
    joints = len(table[3])
    joint, shape = int(rng.integers(joints)), float(rng.uniform())
    effect = 'none' if rng.uniform() < SHARE_WITHOUT else str(rng.choice(list(FORMS)))
    wanted = draw_motion(rng, joints)
    folder.mkdir(parents=True, exist_ok=True)
    write_files(folder, believed)
    target, size, rho = float(rng.uniform(*VISIBLE)), 1.0, 0.0
    places, torques = simulate(robot, believed, wanted, effect, joint, size, shape)
    usual = rng.uniform(0.005, 0.02) * torques.std(axis=0)
    kept = len(np.arange(STRIDE, len(places), STRIDE))
    noise = _coloured(rng, kept, usual)
    for _ in range(3 if effect != 'none' else 0):
        write_case(folder, places, torques, noise)
        rho = shown(folder, joint, noise, usual)
        if effect == 'presliding' or abs(rho / target - 1.0) < 0.2:
            break
        size *= float(np.clip(target / rho, 0.05, 20.0))
        places, torques = simulate(robot, believed, wanted, effect, joint, size, shape)
    write_case(folder, places, torques, noise)
    if effect != 'none':
        rho = shown(folder, joint, noise, usual)
    return {
        'case': case, 'effect': effect, 'where': f'joint_{joint + 1}' if effect != 'none' else '',
        'size': size, 'shape': shape, 'rho': rho, 'truth': truth_of(robot),
    }  # fmt: skip


def _coloured(rng: np.random.Generator, count: int, size: Array) -> Array:
    """Return (K, D) noise whose neighbouring samples correlate."""
    out = rng.normal(0.0, 1.0, (count, len(size)))
    for k in range(1, count):
        out[k] = 0.5 * out[k - 1] + np.sqrt(0.75) * out[k]
    return out * size


def judge(folder: Path, label: dict[str, object]) -> dict[str, object]:
    """Identify and diagnose a case, and hold it against its label."""
    machine = load_machine(folder / 'arm.yaml')
    data = read_data(folder / 'bag', machine)
    found = solve(problem_of(machine, data), IdentifySettings(method='algebraic'), 0)
    truth = dict(label['truth'])  # type: ignore[call-overload]
    told = [p for p in found.parameters if p.name in truth]
    held = [bool(p.low <= truth[p.name] <= p.high) for p in told]
    begun = time.process_time()
    verdict = diagnose(machine, data.datasets, seed=1)
    named = [(verdict.effect, list(verdict.where))]
    named += [(at.effect, [at.where]) for at in verdict.also]
    return {
        'case': label['case'], 'effect': label['effect'], 'where': label['where'],
        'rho': label['rho'], 'held': sum(held), 'of': len(held),
        'missed': [p.name for p, inside in zip(told, held, strict=True) if not inside],
        'named': named, 'probability': verdict.probability,
        'seconds': time.process_time() - begun,
    }  # fmt: skip


def tell(rows: list[dict[str, object]]) -> None:
    """Print what came of the cases."""
    for row in rows:
        print(json.dumps(row))

    def share(hits: list[bool]) -> str:
        low, high = share_interval(sum(hits), len(hits))
        return f'{sum(hits)} of {len(hits)} [{100.0 * low:.0f}, {100.0 * high:.0f} %]'

    some = [r for r in rows if r['effect'] != 'none' and float(str(r['rho'])) >= 1.5]
    none = [r for r in rows if r['effect'] == 'none']
    first = [r['named'][0] == (r['effect'], [r['where']]) for r in some]  # type: ignore[index]
    held = [n < int(str(r['held'])) for r in rows for n in range(int(str(r['of'])))]
    print(f'intervals hold the truth: {share(held)}')
    print(f'effect and joint named first: {share(first)}')
    alarms = [r['named'][0][0] not in ('none', 'unknown') for r in none]  # type: ignore[index]
    print(f'false alarms: {share(alarms)}')
    print(f'processor seconds a diagnosis: {np.median([r["seconds"] for r in rows]):.0f}')


def main() -> None:
    """Draw, seal, judge, tell."""
    parser = argparse.ArgumentParser(description=(__doc__ or '').splitlines()[0])
    parser.add_argument('--cases', type=int, default=60)
    parser.add_argument('--seed', type=int, default=1)
    parser.add_argument('--out', type=Path, default=Path('build/mujoco_arms'))
    parser.add_argument('--draw-only', action='store_true', help='draw and seal only')
    args = parser.parse_args()
    seals = []
    for case in range(1, args.cases + 1):
        folder = args.out / f'case_{case:02d}'
        path = folder / 'label.json'
        if not path.is_file():
            sealed = close(draw(folder, args.seed, case), args.seed)
            path.write_text(json.dumps(sealed), encoding='utf-8')
        seals.append(json.loads(path.read_text(encoding='utf-8'))['sha256'])
    print(f'sealed: {args.cases} cases, SHA-256 {manifest(seals)}', flush=True)
    if args.draw_only:
        return
    rows = []
    for case in range(1, args.cases + 1):
        folder = args.out / f'case_{case:02d}'
        path = folder / 'judged.json'
        if not path.is_file():
            label = unseal(json.loads((folder / 'label.json').read_text()), args.seed)
            path.write_text(json.dumps(judge(folder, label)), encoding='utf-8')
        rows.append(json.loads(path.read_text(encoding='utf-8')))
    tell(rows)


if __name__ == '__main__':
    main()
