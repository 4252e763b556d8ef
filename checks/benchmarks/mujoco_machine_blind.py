# SPDX-License-Identifier: Apache-2.0
"""The diagnosis of `mujoco` machines, checked on sealed cases of tripods and of an arm's MJCF.

A case is a machine whose inertias its owner does not know and, in four of five, one change at one
joint that the description does not have. Its logs come from MuJoCo stepped call by call, from
rest, with dead time between two set-points, positions rounded as an encoder does and noise; the
diagnosis simulates by `mujoco.rollout`. Integrator and time step are the description's: another
step is a gap of its own (`--finer 4`: RK4 at a quarter of it). Logs of tripods hold efforts too,
so that the package's own tripod can be asked about the same bags (`--twins`).

Labels are sealed before the first diagnosis, which is the one of `checks.blind`: a process that is
told the paths of a case and refused every other file of the run. The same command goes on with a
run that was cut short.

    python checks/benchmarks/mujoco_machine_blind.py ur5e.xml --cases 40 --seed 7 \
        --out build/mjcf_40 --keep docs/blind/mjcf_7 --draw-only
    python checks/benchmarks/mujoco_machine_blind.py --verify docs/blind/mjcf_7
"""

import argparse
from collections import Counter
from dataclasses import dataclass
import json
import math
from pathlib import Path
import shlex
import shutil
import sys
from typing import Any

import mujoco
import numpy as np
import yaml

from checks.blind import seal
from checks.blind.keep import keep_labels, keep_seals, opened_labels
from checks.blind.machines import draw_machine, machine_of, read_plain
from checks.blind.planning import spread
from checks.blind.run import ask_all, order_of
from checks.blind.score import (
    covered,
    exact,
    family,
    figure,
    holds,
    named,
    same,
    Score,
    verdict_of,
)
from checks.blind.store import read_json, stamp, Store
from checks.blind.truth import answer_of
from checks.generators.mujoco_mjcf import tripod_mjcf
from checks.share import share_interval
from ros2_ident.files import make_directory, replacing_directory, write_text
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
# Numbers of the cases that the package's own tripod is asked about, beyond the case's.
TWIN = 1000


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
        text: The MJCF.
        log: How it is recorded.
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


# ---------------------------------------------------------------------- machines


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


# ---------------------------------------------------------------------- drawing


@dataclass(frozen=True)
class Wanted:
    """What a case shall be: its machine, and the change and its size, or none."""

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
        out += [Wanted(tripod, name, size) for name, size in some]
        out += [Wanted(tripod, None, 0.0)] * without
    return [out[i] for i in rng.permutation(len(out))]


class Seen:
    """What changes leave on a motion once the hidden inertias are fitted, linearly.

    Args:
        owned: The machine.
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


def write_case(store, number, wanted, text, seed, finer=1):
    """Write bags, machine file and description of a case, and return its sealed label.

    The description lies beside the run's directory, where the diagnosis may read it: it holds
    nothing but what the owner believes.
    """
    rng = np.random.default_rng([seed, number])
    owned = tripod_of(rng, finer) if wanted.tripod else arm_of(text, rng, finer)
    log = owned.plant.log
    motions = [motion(len(owned.plant.joints), s, rng, log) for s in log.seconds]
    change, rho = None, 0.0
    if wanted.effect is not None:
        change, rho = drawn_change(wanted, owned, motions[0], rng)
    described = make_directory(store.root.parent / 'descriptions') / f'case_{number:04d}.xml'
    write_text(described, owned.plant.text)
    way = f'../../../descriptions/{described.name}'
    with replacing_directory(store.case(number), replace=True) as new:
        new.mkdir()
        write_bags(new, owned, change, motions, rng)
        write_machine(new, {**owned.content, 'geometry': {'description': way}})
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


# ---------------------------------------------------------------------- judging


def row_of(label, folder):
    """Return what was in a case and what was answered, as the scores of `checks.blind` have it."""
    change = label['change']
    where = [] if change is None else [{'effect': change[0], 'where': [change[1]]}]
    went = read_json(folder / 'run.json') or {'error': 'no diagnosis'}
    row = {**label, 'effects': where, **went}
    found = read_json(folder / 'diagnosis' / 'diagnosis.json')
    if found is None:
        return row
    row |= answer_of(found)
    row['ranking'] = row['ranking'][:5]
    row['intervals'] = [
        {'name': name, 'true': true, **{k: at.get(k) for k in ('value', 'low', 'high')}}
        for name, true in label['inertia'].items()
        for at in [found['parameters'][name]]
    ]
    return row


def placed(row):
    """Whether effect and joint are the true ones; without a change, whether none is named."""
    if not row['effects']:
        return verdict_of(row) == 'none'
    verdict = row.get('verdict', {})
    return named(row) and same(verdict['effect'], verdict['where'], row['effects'][0])


def of_class(row):
    """Whether the effect named is the true one or of its class."""
    return exact(row) or family(verdict_of(row)) == family(row['effects'][0]['effect'])


def joint_right(row):
    """Whether the joint is the true one."""
    return list(row['verdict']['where']) == row['effects'][0]['where']


def share(name, rows, test, level='', least=0.0):
    """Return a share of rows as a score."""
    hits = sum(bool(test(row)) for row in rows)
    value = hits / len(rows) if rows else math.nan
    low, high = share_interval(hits, len(rows))
    return Score(name, value, low, high, len(rows), level, value >= least if rows else None)


def scores(rows):
    """Return the quantities of a table, or of a part of it."""
    with_one = [row for row in rows if row['effects']]
    said = [row for row in with_one if named(row)]
    well = [at for row in rows if placed(row) for at in row.get('intervals', [])]
    return [
        share('no effect: nothing named', [r for r in rows if not r['effects']], placed,
              '97.5 %', 0.975),
        share('effect and joint right', with_one, placed, '85 %', 0.85),
        share('effect right', with_one, exact, '90 %', 0.9),
        share('effect or its class', with_one, of_class, '97 %', 0.97),
        share('joint right, where one is named', said, joint_right, '98 %', 0.98),
        share('confusable set holds the effect', said, covered, '97 %', 0.97),
        share('no further effect named', said, lambda row: not row['also']),
        share('95 % intervals hold the inertias, answer right', well, holds, '90 to 98 %', 0.9),
        share('diagnoses that ended', rows, lambda row: 'verdict' in row, 'all', 1.0),
    ]  # fmt: skip


def alike(row, twin):
    """Whether the package's own tripod says the same of a case."""
    one, other = row['verdict'], twin['verdict']
    truth = {'effect': other['effect'], 'where': other['where']}
    return one['effect'] == other['effect'] or same(one['effect'], one['where'], truth)


def compatible(row, twin):
    """Whether either names what the other calls not to be told from its own."""
    one, other = row['verdict'], twin['verdict']

    def among(verdict, said):
        truth = {'effect': verdict['effect'], 'where': verdict['where']}
        sets = ((c['effect'], c['where']) for c in said['confusable'])
        return any(same(effect, where, truth) for effect, where in sets)

    return alike(row, twin) or among(one, twin) or among(other, row)


def told(row):
    """Return a verdict in words."""
    if 'verdict' not in row:
        return f'failed: {row["error"][:60]}'
    verdict = row['verdict']
    also = ''.join(f', {a["effect"]} {" ".join(a["where"])}' for a in row['also'])
    return f'{verdict["effect"]} {" ".join(verdict["where"])}{also} {verdict["probability"]:.2f}'


def table(rows, twins):
    """Return a table of all cases in Markdown."""
    lines = ['| case | machine | truth (rho) | verdict, probability | tripod | CPU, s |',
             '| --- | --- | --- | --- | --- | --- |']  # fmt: skip
    for row in rows:
        truth = 'none'
        if row['change'] is not None:
            effect, joint, size = row['change']
            truth = f'{effect} {joint}, {size:g} ({row["rho"]:.1f})'
        twin = told(twins[row['case']]) if row['case'] in twins else ''
        mark = '' if placed(row) else ' **wrong**'
        cost = f'{row["cpu_seconds"]:.0f}' if 'cpu_seconds' in row else ''
        lines.append(
            f'| {row["case"]} | {row["machine"]} | {truth} | {told(row)}{mark} | {twin} | {cost} |'
        )
    return lines


def figures_of(rows, twins):
    """Return all figures as lines of a table in Markdown."""
    lines = [
        '| quantity | all [95 %] | tripods | arms | level |',
        '| --- | --- | --- | --- | --- |',
    ]
    kinds = [[r for r in rows if r['machine'] == kind] for kind in ('tripod', 'arm')]
    for parts in zip(*(scores(some) for some in (rows, *kinds)), strict=True):
        shown = ' | '.join(f'{figure(s)} of {s.count}' for s in parts)
        lines.append(f'| {parts[0].name} | {shown} | {parts[0].level} |')
    both = [r for r in rows if 'verdict' in r and 'verdict' in twins.get(r['case'], {})]
    same_said = share('', both, lambda row: alike(row, twins[row['case']]))
    lines.append(
        f"| the package's own tripod says the same | | {figure(same_said)} of {same_said.count} | "
        '| 95 % |'
    )
    near = share('', both, lambda row: compatible(row, twins[row['case']]))
    lines.append(
        f'| or what either cannot tell from its own | | {figure(near)} of {near.count} | | |'
    )
    return lines


# ---------------------------------------------------------------------- the run


def draw(store, args):
    """Draw and seal what is not drawn yet; return the hash over all seals."""
    text = args.mjcf.read_text(encoding='utf-8')
    for number, wanted in enumerate(planned(args.cases, args.seed), 1):
        if store.sealed(number) is None:
            closed = write_case(store, number, wanted, text, args.seed, args.finer)
            store.seal(number, closed)
    if 'drawn' not in store.about():
        store.note(drawn=stamp())
    return store.close_seals(args.cases)


def twin_cases(store, numbers):
    """Write for each tripod a case that asks the package's own one about the same bags."""
    out = {}
    for number in numbers:
        folder, other = store.case(number), store.case(number + TWIN)
        if not (folder / 'twin.yaml').exists():
            continue
        if not other.exists():
            with replacing_directory(other, replace=True) as new:
                new.mkdir()
                for name in ('fit', 'check'):
                    shutil.copytree(folder / name, new / name)
                shutil.copy(folder / 'twin.yaml', new / 'machine.yaml')
        # By what the description is judged by, or the two would not see the same.
        out[number + TWIN] = {**order_of(store, number + TWIN), 'output': 'position'}
    return out


def asked(store, orders):
    """Diagnose what is not diagnosed yet, one case at a time."""
    left = {n: order for n, order in orders.items() if store.answered(n) is None}
    for number in ask_all(store, left, 1):
        print('answered', number, store.answered(number), file=sys.stderr, flush=True)


def keep(store, folder, rows, twins):
    """Write labels with their nonces, and all answers, beside the seals."""
    keep_labels(store, folder)
    answers = [{**row, 'twin': twins.get(row['case'])} for row in rows]
    write_text(folder / 'table.jsonl', ''.join(json.dumps(a) + '\n' for a in answers))
    write_text(folder / 'run.json', json.dumps(store.about(), indent=1) + '\n')


def verified(folder):
    """Return rows and twins of a kept run whose labels and table are those that were sealed."""
    seals = read_json(folder / 'seals.json')
    labels = opened_labels(folder, seals['seals'])
    if seal.manifest(seals['seals']) != seals['manifest']:
        raise SystemExit('the labels are not those that were sealed')
    rows = [json.loads(line) for line in (folder / 'table.jsonl').read_text().splitlines()]
    for row in rows:
        if any(row[key] != value for key, value in labels[row['case']].items()):
            raise SystemExit(f'the row of case {row["case"]} does not say what its label says')
    print('sealed:', len(labels), seals['manifest'])
    return rows, {row['case']: row['twin'] for row in rows if row['twin']}


def judged(store, args):
    """Diagnose, open the seals, and return rows and the twins' by case."""
    numbers = range(1, args.cases + 1)[: args.first]
    store.diagnosed_by(stamp())
    asked(store, {n: order_of(store, n) for n in numbers})
    labels = {}
    if args.twins:
        asked(store, dict(list(twin_cases(store, numbers).items())[: args.twins]))
    rows, twins = [], {}
    for n in numbers:
        labels[n] = seal.unseal(store.sealed(n), args.seed)
        rows.append(row_of(labels[n], store.case(n)))
        found = read_json(store.case(n + TWIN) / 'diagnosis' / 'diagnosis.json')
        if found is not None:
            went = store.answered(n + TWIN)
            answer = answer_of(found)
            twins[n] = {**went, **answer, 'ranking': answer['ranking'][:5]}
        elif store.answered(n + TWIN) is not None:
            twins[n] = store.answered(n + TWIN)
    return rows, twins


def arguments():
    """Read the command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or '').splitlines()[0])
    parser.add_argument('mjcf', type=Path, nargs='?', help="the arm's description")
    parser.add_argument('--cases', type=int, default=40)
    parser.add_argument('--seed', type=int, default=1)
    parser.add_argument('--out', type=Path, default=Path('build/mujoco_machine_blind'))
    parser.add_argument('--keep', type=Path, help='as of `checks.blind`')
    parser.add_argument('--verify', type=Path, help='check a kept run and print its figures')
    parser.add_argument('--draw-only', action='store_true')
    parser.add_argument('--first', type=int, help='diagnose the first so many cases only')
    parser.add_argument('--twins', type=int, default=0, help="so many tripods as the package's")
    parser.add_argument('--finer', type=int, default=1)
    return parser.parse_args()


def main():
    """Draw, seal, diagnose, open, count."""
    args = arguments()
    if args.verify:
        rows, twins = verified(args.verify)
    else:
        store = Store(args.out / 'run')
        what = {'command': shlex.join(['python', *sys.argv]), 'cases': args.cases}
        store.begin({**what, 'seed': args.seed, 'shares': ''}, TRIPOD)
        print('sealed:', args.cases, draw(store, args), flush=True)
        if args.keep:
            keep_seals(store, args.keep)
        if args.draw_only:
            return
        rows, twins = judged(store, args)
        if args.keep:
            keep(store, args.keep, rows, twins)
    print(*figures_of(rows, twins), '', *table(rows, twins), sep='\n')
    sides = Counter(row['machine'] for row in rows)
    print('', dict(sides), 'diagnosed', sep='\n')


if __name__ == '__main__':
    main()
