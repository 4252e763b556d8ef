# SPDX-License-Identifier: Apache-2.0
"""Blind cases of `mujoco` machines: tripods, and an arm's MJCF; `blind.mjcf` judges them.

A case is a machine whose inertias its owner does not know and, in four of five, one change at one
joint that the description does not have. Its logs come from MuJoCo stepped call by call, from
rest, with dead time between two set-points, positions rounded as an encoder does and noise; the
diagnosis simulates by `mujoco.rollout`. Integrator and time step are the description's: another
step is a gap of its own (`--finer 4`: RK4 at a quarter of it). Logs of tripods hold efforts too,
so that the package's own tripod can be asked about the same bags (`--twins`).
"""

from dataclasses import dataclass
import math
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import yaml

from checks.blind import mjcf, seal
from checks.blind.machines import draw_machine, machine_of, read_plain
from checks.blind.planning import spread
from checks.blind.run import Generator, order_of
from checks.generators.mujoco_mjcf import tripod_mjcf
from ros2_ident.files import replacing_directory, write_text
from ros2_ident.recording import Stream, write_bag

TRIPOD = Path(__file__).parents[2] / 'config/tripod.yaml'
SETTLED = 3.0  # s, before the logs
SHARE_WITHOUT = 0.2
# What a change leaves after the best fit of the hidden inertias, worst joint, over the noise.
SIZES = 1.5, 8.0
# What can be hidden: first size, and between what it may be. That of a limit is by how much it was
# divided, less 1; of a gain by how much it was multiplied or divided, less 1.
HIDDEN = {
    'coulomb_friction': (2.0, 1e-5, 60.0),
    'viscous_friction': (5.0, 1e-5, 100.0),
    'position_gain_error': (0.05, 1e-4, 0.9),
    'torque_saturation': (1.0, 0.05, 40.0),
    'command_delay': (0.01, 1e-3, 0.028),
}
DESCRIPTION = 'robot.xml'


@dataclass(frozen=True)
class Log:
    """How a machine is driven and recorded.

    Attributes:
        cycle: How long a set-point holds [s].
        seconds: Of the recording to fit on and of the one held out.
        noise: Standard deviation of positions [rad or m].
        step: Of the encoder.
        reach: Factor on the motion's sizes; 1 for an arm's in rad.
    """

    cycle: float
    seconds: tuple[float, float]
    noise: float
    step: float
    reach: float


ARM_LOG = Log(0.008, (8.0, 6.0), 1e-4, 2.0 * math.pi / 2**17, 1.0)
TRIPOD_LOG = Log(1e-3, (4.0, 3.0), 5e-6, 5e-6, 0.12)


class Plant:
    """An MJCF's joints and actuators, stepped by hand.

    Args:
        finer: Steps of RK4 in one of the description's; 1 for the description's own.
    """

    def __init__(self, text: str, log: Log = ARM_LOG, finer: int = 1) -> None:
        self.text, self.log, self.finer = text, log, finer
        model = mujoco.MjModel.from_xml_string(text)
        at = model.actuator_trnid[:, 0]
        self.joints = [model.joint(int(j)).name for j in at]
        self.dof = [int(model.jnt_dofadr[j]) for j in at]
        self.place = [int(model.jnt_qposadr[j]) for j in at]
        self.limits = model.actuator_forcerange[:, 1].copy()

    def _model(self, inertia, change, count):
        """Return the model with hidden inertias and a change, and (D,) dead times [s]."""
        model = mujoco.MjModel.from_xml_string(self.text)
        model.opt.timestep = self.log.cycle / count
        if self.finer > 1:
            model.opt.integrator = mujoco.mjtIntegrator.mjINT_RK4
        model.dof_armature[self.dof] = inertia[: len(self.dof)]
        if len(inertia) > len(self.dof):
            model.body_mass[model.body('tool').id] = inertia[-1]
        late = np.zeros(len(self.joints))
        if change is not None:
            effect, joint, size = change
            d = self.joints.index(joint)
            if effect == 'coulomb_friction':
                model.dof_frictionloss[self.dof[d]] += size
            elif effect == 'viscous_friction':
                model.dof_damping[self.dof[d]] += size
            elif effect == 'position_gain_error':
                factor = 1.0 + size if size > 0.0 else 1.0 / (1.0 - size)
                model.actuator_gainprm[d, 0] *= factor
                model.actuator_biasprm[d, 1] *= factor
            elif effect == 'torque_saturation':
                limit = self.limits[d] / (1.0 + size)
                model.actuator_forcerange[d] = [-limit, limit]
            else:
                late[d] = size
        mujoco.mj_setConst(model, mujoco.MjData(model))
        return model, late

    def run(self, inertia, change, command):
        """Return (D, K) positions and efforts.

        Args:
            inertia: (D,) armatures, and of a tripod the tool's mass.
            change: An effect, its joint and its size, or None.
            command: (D, K) set-points, at rest at first.
        """
        step = mujoco.MjModel.from_xml_string(self.text).opt.timestep
        count = max(1, math.ceil(self.log.cycle / step - 1e-6)) * self.finer
        model, late = self._model(inertia, change, count)
        data = mujoco.MjData(model)
        data.qpos[self.place] = command[:, 0]
        position, effort = np.empty((2, *command.shape))
        rows = np.arange(len(late))
        # Without dead time all steps of a cycle have one set-point.
        parts = range(count) if late.any() else (0,)
        for k in range(command.shape[1]):
            position[:, k] = data.qpos[self.place]
            for part in parts:
                now = k + part / count - late / self.log.cycle
                data.ctrl[:] = command[rows, np.maximum(np.floor(now + 1e-9), 0.0).astype(int)]
                mujoco.mj_step(model, data)
                if part == 0:
                    # What the actuators did in the step that began where the position was read.
                    effort[:, k] = data.actuator_force
            mujoco.mj_step(model, data, nstep=count - len(parts))
        return position, effort


def motion(count, seconds, rng, log=ARM_LOG):
    """Return (D, K) set-points: still at first, then sines about a pose."""
    time = log.cycle * np.arange(round((SETTLED + seconds) / log.cycle))
    moved = np.clip((time - SETTLED) / 1.0, 0.0, 1.0)
    fade = moved**3 * (10.0 - 15.0 * moved + 6.0 * moved**2)
    rates = 2.0 * math.pi * rng.uniform(0.15, 1.2, (count, 3, 1))
    phases = rng.uniform(0.0, 2.0 * math.pi, (count, 3, 1))
    sizes = rng.uniform(0.1, 0.5, (count, 3, 1)) / np.sqrt(rates)
    pose = rng.uniform(-1.0, 1.0, (count, 1))
    if log is TRIPOD_LOG:
        pose = 0.0 * pose  # where the description's loops are closed
    return pose + fade * log.reach * np.sum(sizes * np.sin(rates * time + phases), axis=1)


@dataclass(frozen=True)
class Owned:
    """A machine as its owner has it, and what he does not know.

    Attributes:
        plant: The description's.
        content: Of the machine file, its description left out.
        inertia: The hidden numbers, as of `Plant.run`.
        names: What the diagnosis calls them.
        twin: Content of the file for the package's own tripod; None for an arm.
        late: How late efforts are logged [s].
    """

    plant: Plant
    content: dict[str, Any]
    inertia: Any
    names: list[str]
    twin: dict[str, Any] | None = None
    late: float = 0.0


def arm_of(text, rng, finer=1):
    """Return an arm with other armatures than described."""
    plant = Plant(text, ARM_LOG, finer)
    content = {
        'machine': 'mujoco',
        'drives': plant.joints,
        'controller': {'cycle': ARM_LOG.cycle},
        'parameters': {'armature': [0.0, 1.0, 'kg m^2']},
    }
    inertia = np.round(rng.uniform(0.05, 0.5, len(plant.joints)), 4)
    return Owned(plant, content, inertia, [f'{j}.armature' for j in plant.joints])


def tripod_of(rng, finer=1):
    """Return a drawn tripod with other inertias and another tool than described."""
    plain = draw_machine(read_plain(TRIPOD), rng, True)
    plain['controller'] |= {
        'law': 'cascade_p',
        'integral_gain': 0.0,
        'velocity_feedforward': 0.0,
        'cycle': TRIPOD_LOG.cycle,
    }
    boxes = plain['parameters']
    middle = {name: 0.5 * sum(boxes[name][:2]) for name in ('tool_mass', 'drive_inertia')}
    machine = machine_of(plain)
    gear, rail = plain['drive']['gear_factor'], plain['drive']['rail_mass']
    free = {'coulomb_torque': 0.0, 'viscous_torque': 0.0}
    # Its actuators' forces are held over a cycle, as those of the package's own tripod.
    text = tripod_mjcf(machine, middle | free, 'Euler')
    low, high = (x * gear**2 for x in boxes['drive_inertia'][:2])
    weighed = [0.96 * rail, 1.04 * rail, 'kg']
    content = {
        'machine': 'mujoco',
        'drives': plain['drives'],
        'drive': {'body': ['tool', '', '']},
        'controller': {'cycle': TRIPOD_LOG.cycle},
        'parameters': {
            'armature': [float(low), float(high), 'kg m^2'],  # kg, of joints that slide
            'body_mass': [boxes['tool_mass'], weighed, weighed[:]],
        },
    }
    share = rng.uniform(0.1, 0.9, 4)
    inertia = np.array([low + (high - low) * s for s in share])
    inertia[-1] = boxes['tool_mass'][0] + np.ptp(boxes['tool_mass'][:2]) * share[-1]
    plant = Plant(text, TRIPOD_LOG, finer)
    names = [*(f'{d}.armature' for d in plain['drives']), f'{plain["drives"][0]}.body_mass']
    late = round(rng.uniform(2e-3, 6e-3), 5)
    return Owned(plant, content, inertia, names, _twin(plain), late)


def _twin(plain):
    """Return the file of the package's own tripod: the same machine, its gears hardly giving.

    Efforts are forces there as in the MJCF, so that both read the same bags.
    """
    gear = plain['drive'].pop('gear_factor')
    law = plain['controller']
    for name in ('velocity_gain', 'torque_limit'):
        law[name] = float(law[name] * gear)
    low, high = (float(x * gear**2) for x in plain['parameters']['drive_inertia'][:2])
    plain.pop('effort_noise', None)
    plain['effort_unit'] = 'N'
    plain['drive']['travel_per_turn'] = 2.0 * math.pi / gear
    plain['parameters'] = {
        'measurement_delay': [0.0, 0.05, 's'],
        'gear_stiffness': [1e6, 4e6, 'N/m'],
        'gear_damping_ratio': [0.0, 2.0, '1'],
        'tool_mass': plain['parameters']['tool_mass'],
        'drive_inertia': [low, high, 'kg'],
    }
    return plain


@dataclass(frozen=True)
class Wanted:
    """What a case shall be: its number, its machine, and the change and its size, or none."""

    case: int
    tripod: bool
    effect: str | None
    size: float


def planned(cases, seed):
    """Return what each case shall be: half are tripods, every change comes round in both."""
    rng = np.random.default_rng([seed, 0])
    out = []
    for tripod in (True, False):
        count = cases // 2 if tripod else cases - cases // 2
        without = round(SHARE_WITHOUT * count)
        names: list[str] = []
        while len(names) < count - without:
            names += [str(name) for name in rng.permutation(list(HIDDEN))]
        sizes = spread(rng, SIZES, count - without)
        some = zip(names, sizes, strict=False)
        out += [(tripod, name, size) for name, size in some]
        out += [(tripod, None, 0.0)] * without
    return {n: Wanted(n, *out[i]) for n, i in enumerate(rng.permutation(len(out)), 1)}


class Seen:
    """What changes leave on a motion once the hidden inertias are fitted, linearly.

    Args:
        command: (D, K) the motion.
    """

    def __init__(self, owned: Owned, command: Any) -> None:
        self.owned, self.command = owned, command
        self.cut = round(SETTLED / owned.plant.log.cycle)
        self.plain = self._moved(owned.inertia, None)
        columns = []
        for n, value in enumerate(owned.inertia):
            other = owned.inertia.copy()
            other[n] = 1.02 * value
            columns.append((self._moved(other, None) - self.plain).ravel())
        self.columns = np.stack(columns, axis=1)

    def _moved(self, inertia, change):
        return self.owned.plant.run(inertia, change, self.command)[0][:, self.cut :]

    def rho(self, change):
        """Return the worst joint's RMS, in units of the noise."""
        gap = self._moved(self.owned.inertia, change) - self.plain
        fitted = np.linalg.lstsq(self.columns, gap.ravel(), rcond=None)[0]
        left = gap - (self.columns @ fitted).reshape(gap.shape)
        return float(np.sqrt(np.mean(left**2, axis=1)).max()) / self.owned.plant.log.noise

    def sized(self, effect, joint, aim, sign):
        """Return a change that leaves about `aim`, and what it leaves."""
        size, low, high = HIDDEN[effect]
        best = None
        for _ in range(14):
            change = (effect, joint, float(f'{sign * size:.4g}'))
            rho = self.rho(change)
            miss = abs(math.log(max(rho, 1e-3) / aim))
            if best is None or miss < best[0]:
                best = miss, change, rho
            if miss < 0.15 or high < 1.001 * low:
                break
            low, high = (size, high) if rho < aim else (low, size)
            # In proportion, but for limits, which act from some size on.
            limit = effect == 'torque_saturation'
            wish = math.sqrt(low * high) if limit else size * aim / max(rho, 1e-3)
            size = min(high, max(low, wish))
        return best[1:]


def drawn_change(wanted, owned, command, rng):
    """Return a change and what it leaves: the one wanted, at the first joint that shows it."""
    seen = Seen(owned, command)
    rest = [str(name) for name in rng.permutation(list(HIDDEN)) if name != wanted.effect]
    signed = rng.random() < 0.5
    for effect in (wanted.effect, *rest):
        for joint in rng.permutation(owned.plant.joints):
            sign = -1.0 if signed and effect == 'position_gain_error' else 1.0
            change, rho = seen.sized(effect, str(joint), wanted.size, sign)
            if rho >= 0.8 * SIZES[0]:
                return change, rho
    raise ValueError('no change shows in these motions')


def logged(owned, command, run, rng):
    """Return set-points, positions and efforts of a log, from where the machine has settled."""
    log = owned.plant.log
    position, effort = run
    instants = np.arange(command.shape[1]) * log.cycle
    late = np.stack([np.interp(instants - owned.late, instants, row) for row in effort])
    cut = slice(round(SETTLED / log.cycle), None)
    seen = position[:, cut] + log.noise * rng.standard_normal(position[:, cut].shape)
    if owned.twin is None:
        return command[:, cut], log.step * np.round(seen / log.step), None
    # What the encoder's noise makes of the effort, through both gains.
    law = owned.twin['controller']
    noise = log.noise * law['velocity_gain'] * law['position_gain']
    read = late[:, cut] + noise * rng.standard_normal(seen.shape)
    return command[:, cut], log.step * np.round(seen / log.step), read


def write_bags(folder, owned, change, motions, rng):
    """Write the recording to fit on and the one held out."""
    names = tuple(owned.plant.joints)
    for name, command in zip(('fit', 'check'), motions, strict=True):
        run = owned.plant.run(owned.inertia, change, command)
        goal, seen, effort = logged(owned, command, run, rng)
        stamp = np.round(1e9 * owned.plant.log.cycle * np.arange(goal.shape[1])).astype(np.int64)
        read = None if effort is None else np.ascontiguousarray(effort.T)
        streams = {
            '/joint_states': Stream(names, stamp, np.ascontiguousarray(seen.T), None, read),
            '/joint_command': Stream(names, stamp, np.ascontiguousarray(goal.T), None, None),
        }
        write_bag(folder / name, streams)


def write_machine(folder, content):
    """Write a machine file."""
    write_text(folder / 'machine.yaml', yaml.safe_dump(content, sort_keys=False))


def write_case(store, wanted, text, seed, finer=1):
    """Write bags, machine file and description of a case, and return its sealed label."""
    number = wanted.case
    rng = np.random.default_rng([seed, number])
    owned = tripod_of(rng, finer) if wanted.tripod else arm_of(text, rng, finer)
    log = owned.plant.log
    motions = [motion(len(owned.plant.joints), s, rng, log) for s in log.seconds]
    change, rho = None, 0.0
    if wanted.effect is not None:
        change, rho = drawn_change(wanted, owned, motions[0], rng)
    with replacing_directory(store.case(number), replace=True) as new:
        new.mkdir()
        write_bags(new, owned, change, motions, rng)
        # Nothing but what the owner believes.
        write_text(new / DESCRIPTION, owned.plant.text)
        write_machine(new, {**owned.content, 'geometry': {'description': DESCRIPTION}})
        if owned.twin is not None:
            write_text(new / 'twin.yaml', yaml.safe_dump(owned.twin, sort_keys=False))
    label = {
        'case': number,
        'machine': 'tripod' if wanted.tripod else 'arm',
        'inertia': dict(zip(owned.names, map(float, owned.inertia), strict=True)),
        'change': change,
        'rho': rho,
    }
    return seal.close(label, seed)


def _plan(store):
    about = store.about()
    return planned(int(about['cases']), int(about['seed']))


def _draw(store, wanted, seed):
    about = store.about()
    text = Path(about['mjcf']).read_text(encoding='utf-8')
    return write_case(store, wanted, text, seed, about['finer'])


def orders(store, number):
    """Return what is asked about a case; of the first tripods also the package's own."""
    order = order_of(store, number)
    out = {number: order | {'description': str(store.case(number).resolve() / DESCRIPTION)}}
    about = store.about()
    cases = range(1, int(about['cases']) + 1)
    tripods = [n for n in cases if (store.case(n) / 'twin.yaml').exists()]
    if number in tripods[: about['twins']]:
        other = store.case(number + mjcf.TWIN)
        other.mkdir(exist_ok=True)
        out[number + mjcf.TWIN] = order | {
            'machine': str(store.case(number).resolve() / 'twin.yaml'),
            'out': str(other.resolve() / 'diagnosis'),
            # By what the description is judged by, or the two would not see the same.
            'output': 'position',
        }
    return out


GENERATOR = Generator(_plan, _draw, orders, mjcf.row, mjcf.told)
