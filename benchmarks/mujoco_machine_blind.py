# SPDX-License-Identifier: Apache-2.0
"""The diagnosis of a `mujoco` machine, checked on sealed cases of an arm's MJCF.

A case is the arm with other armatures and, in four of five, one change at one joint that the
description does not know. Its logs come from MuJoCo stepped call by call, from rest, with dead
time between two set-points, positions rounded as an encoder does and noise; the diagnosis
simulates by `mujoco.rollout`. Integrator and time step are the description's, for another step is
a gap of its own (`--finer 4`: RK4 at a quarter of it). All labels are sealed before the first
diagnosis, which runs in a process of its own and is told bags and machine file only. The same
command goes on with a run that was cut short.

    python benchmarks/mujoco_machine_blind.py ur5e.xml --cases 40 --seed 7 --out build/mujoco_40
"""

import argparse
from collections import Counter
import json
import math
from pathlib import Path
import subprocess
import sys

import mujoco
import numpy as np
import yaml

from ros2_ident.checks.blind import seal
from ros2_ident.checks.blind.run import scrubbed
from ros2_ident.files import write_text
from ros2_ident.recording import Stream, write_bag

CYCLE = 0.008
SETTLED, SECONDS = 3.0, (8.0, 6.0)  # before the logs, to fit on and held out
NOISE, STEP = 1e-4, 2.0 * math.pi / 2**17  # rad
ARMATURE = (0.0, 1.0)
SHARE_WITHOUT = 0.2
# RMS by which a change moves its joint, in units of the noise.
SIZES = 5.0, 40.0
# What can be hidden: first size, how it is put in, and how far it may go.
HIDDEN = {
    'coulomb_friction': (2.0, 60.0),
    'viscous_friction': (5.0, 100.0),
    'position_gain_error': (0.05, 0.5),
    'torque_saturation': (1.2, 20.0),
    'command_delay': (0.01, 0.04),
}


class Arm:
    """An MJCF's joints and actuators, stepped by hand."""

    def __init__(self, path, finer=1):
        self.text, self.finer = path.read_text(), finer
        model = mujoco.MjModel.from_xml_string(self.text)
        at = model.actuator_trnid[:, 0]
        self.joints = [model.joint(int(j)).name for j in at]
        self.dof = [int(model.jnt_dofadr[j]) for j in at]
        self.limits = model.actuator_forcerange[:, 1].copy()

    def run(self, armature, change, command):
        """Return (D, K) positions; `change` is an effect, its joint and its size, or None."""
        model = mujoco.MjModel.from_xml_string(self.text)
        count = max(1, round(CYCLE / model.opt.timestep)) * self.finer
        model.opt.timestep = CYCLE / count
        if self.finer > 1:
            model.opt.integrator = mujoco.mjtIntegrator.mjINT_RK4
        model.dof_armature[self.dof] = armature
        late = np.zeros(len(self.joints))
        if change is not None:
            effect, joint, size = change
            d, dof = self.joints.index(joint), self.dof[self.joints.index(joint)]
            if effect == 'coulomb_friction':
                model.dof_frictionloss[dof] += size
            elif effect == 'viscous_friction':
                model.dof_damping[dof] += size
            elif effect == 'position_gain_error':
                model.actuator_gainprm[d, 0] *= 1.0 + size
                model.actuator_biasprm[d, 1] *= 1.0 + size
            elif effect == 'torque_saturation':
                model.actuator_forcerange[d] = [-self.limits[d] / size, self.limits[d] / size]
            else:
                late[d] = size
        mujoco.mj_setConst(model, mujoco.MjData(model))
        data = mujoco.MjData(model)
        data.qpos[:] = command[:, 0]
        out = np.empty(command.shape)
        rows = np.arange(len(late))
        for k in range(command.shape[1]):
            out[:, k] = data.qpos
            for step in range(count):
                now = k + step / count - late / CYCLE
                data.ctrl[:] = command[rows, np.maximum(np.floor(now + 1e-9), 0.0).astype(int)]
                mujoco.mj_step(model, data)
        return out


def motion(count, seconds, rng):
    """Return (D, K) set-points: still at first, then sines about a pose."""
    time = CYCLE * np.arange(round((SETTLED + seconds) / CYCLE))
    moved = np.clip((time - SETTLED) / 1.0, 0.0, 1.0)
    fade = moved**3 * (10.0 - 15.0 * moved + 6.0 * moved**2)
    rates = 2.0 * math.pi * rng.uniform(0.15, 1.2, (count, 3, 1))
    phases = rng.uniform(0.0, 2.0 * math.pi, (count, 3, 1))
    sizes = rng.uniform(0.1, 0.5, (count, 3, 1)) / np.sqrt(rates)
    pose = rng.uniform(-1.0, 1.0, (count, 1))
    return pose + fade * np.sum(sizes * np.sin(rates * time + phases), axis=1)


def case_of(arm, rng):
    """Return armatures, what is hidden, and both motions."""
    armature = np.round(rng.uniform(0.05, 0.5, len(arm.joints)), 4)
    motions = [motion(len(arm.joints), seconds, rng) for seconds in SECONDS]
    if rng.random() < SHARE_WITHOUT:
        return armature, None, motions
    plain = arm.run(armature, None, motions[0])
    aim = math.exp(rng.uniform(*np.log(SIZES)))
    for _ in range(20):
        effect, joint = str(rng.choice(list(HIDDEN))), str(rng.choice(arm.joints))
        size, most = HIDDEN[effect]
        d = arm.joints.index(joint)
        for _ in range(6):
            moved = arm.run(armature, (effect, joint, size), motions[0])[d] - plain[d]
            rho = float(np.sqrt(np.mean(moved[round(SETTLED / CYCLE) :] ** 2))) / NOISE
            if 0.7 * aim < rho < 1.4 * aim:
                return armature, (effect, joint, float(f'{size:.4g}')), motions
            # A limit acts from some size on, the others about in proportion.
            size = min(most, size * (1.5 if rho == 0.0 else min(4.0, aim / rho)))
        if rho >= SIZES[0]:
            return armature, (effect, joint, float(f'{size:.4g}')), motions
    raise ValueError('no change shows in these motions')


def logged(command, position, rng):
    """Return the streams of a log: set-points and positions from where the arm has settled on."""
    cut = slice(round(SETTLED / CYCLE), None)
    seen = position[:, cut] + NOISE * rng.standard_normal(position[:, cut].shape)
    return np.ascontiguousarray(command[:, cut]), STEP * np.round(seen / STEP)


def write_case(folder, arm, number, seed):
    """Write bags, description and machine file of a case, and return its sealed label."""
    rng = np.random.default_rng([seed, number])
    armature, change, motions = case_of(arm, rng)
    folder.mkdir(parents=True)
    for name, command in zip(('fit', 'check'), motions, strict=True):
        goal, seen = logged(command, arm.run(armature, change, command), rng)
        stamp = np.round(1e9 * CYCLE * np.arange(goal.shape[1])).astype(np.int64)
        names = tuple(arm.joints)
        streams = {
            '/joint_states': Stream(names, stamp, seen.T, None, None),
            '/joint_command': Stream(names, stamp, goal.T, None, None),
        }
        write_bag(folder / name, streams)
    machine = {
        'machine': 'mujoco',
        'drives': arm.joints,
        'geometry': {'description': 'robot.xml'},
        'controller': {'cycle': CYCLE},
        'parameters': {'armature': [*ARMATURE, 'kg m^2']},
    }
    write_text(folder / 'robot.xml', arm.text)
    write_text(folder / 'machine.yaml', yaml.safe_dump(machine, sort_keys=False))
    label = {'case': number, 'armature': armature.tolist(), 'change': change}
    return seal.close(label, seed)


def diagnosed(folder):
    """Return a case's diagnosis, by a process that is told its files only."""
    out = folder / 'diagnosis'
    if not (out / 'diagnosis.json').exists():
        words = ['diagnose', 'fit', '--check', 'check', '--machine', 'machine.yaml']
        quiet = ['--quiet', '--no-overlay', '--no-report', '--resume', '--threads', '1']
        code = 'import sys; from ros2_ident.cli.main import main; sys.exit(main(sys.argv[1:]))'
        command = [sys.executable, '-c', code, *words, '--out', 'diagnosis', *quiet]
        subprocess.run(command, cwd=folder, env=scrubbed(), check=False, capture_output=True)
    return json.loads((out / 'diagnosis.json').read_text())


def judged(label, found):
    """Return what of a case was right, by name."""
    verdict, change = found['verdict'], label['change']
    if change is None:
        return {'no false alarm': verdict['effect'] == 'none'}
    names = [(x['effect'], x['where'][0]) for x in found['confusable']]
    return {
        'effect': verdict['effect'] == change[0],
        'joint': change[1] in verdict['where'],
        'effect and joint': (verdict['effect'], [change[1]]) == (change[0], verdict['where']),
        'confusable set holds it': (change[0], change[1]) in names,
    }


def main():
    """Draw, seal, diagnose, open, count."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('mjcf', type=Path)
    parser.add_argument('--cases', type=int, default=40)
    parser.add_argument('--seed', type=int, default=1)
    parser.add_argument('--out', type=Path, default=Path('build/mujoco_machine_blind'))
    parser.add_argument('--draw-only', action='store_true')
    parser.add_argument('--finer', type=int, default=1)
    args = parser.parse_args()
    arm, sealed = Arm(args.mjcf, args.finer), args.out / 'seals.json'
    if not sealed.exists():
        seals = [
            write_case(args.out / f'case_{n:04}', arm, n, args.seed)
            for n in range(1, args.cases + 1)
        ]
        write_text(sealed, json.dumps(seals))
    seals = json.loads(sealed.read_text())
    print('sealed:', len(seals), seal.manifest([s['sha256'] for s in seals]), flush=True)
    if args.draw_only:
        return
    total, right = Counter(), Counter()
    for n, closed in enumerate(seals, 1):
        found = diagnosed(args.out / f'case_{n:04}')
        label = seal.unseal(closed, args.seed)
        row = judged(label, found)
        total.update(row.keys())
        right.update(name for name, good in row.items() if good)
        verdict = found['verdict']
        print(n, label['change'], verdict['effect'], verdict['where'], row, flush=True)
    for name, count in total.items():
        print(f'{name}: {right[name]} of {count}')


if __name__ == '__main__':
    main()
