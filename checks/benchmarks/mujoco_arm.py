# SPDX-License-Identifier: Apache-2.0
"""An SO-101 beside its MJCF: how far the authors' gains, damping and friction are off.

The logs hold set-points and positions. Which way round the log counts a joint, and where its zero
is, comes from the droop under gravity where the arm stands; from there the attributes are fitted
to parts of two bags and judged on others. `kv` and `damping` act alike on a position, so `kv` is
held at 0. Rotation and Wrist_Roll turn about what gravity does not tell: their zero stays.

`--picture` draws goal, position and both simulations of one of the others.

    python checks/benchmarks/mujoco_arm.py DIRECTORY_OF_BAGS so101.xml --picture so101.png
"""

import argparse
from dataclasses import fields, replace
import itertools
from pathlib import Path

from matplotlib.figure import Figure
import numpy as np
from scipy.optimize import least_squares

from checks.benchmarks.mujoco_rollout import written_machine
from ros2_ident.identify.data import read_data
from ros2_ident.models.mujoco.model import Mujoco
from ros2_ident.search.least_squares import least_squares as descended

JOINTS = {
    'Rotation': 'shoulder_pan',
    'Pitch': 'shoulder_lift',
    'Elbow': 'elbow_flex',
    'Wrist_Pitch': 'wrist_flex',
    'Wrist_Roll': 'wrist_roll',
}
HANGING = slice(1, 4)
BOXES = {
    'kp': [0.5, 40.0, 'N m/rad'],
    'kv': [0.0, 5.0, 'N m s/rad'],
    'damping': [0.0, 4.0, 'N m s/rad'],
    'frictionloss': [0.0, 0.5, 'N m'],
    'joint_zero': [-1.6, 1.6, 'rad'],
    'set_point_delay': [0.0, 0.08, 's'],
}
HELD = {f'{joint}.kv': 0.0 for joint in JOINTS} | {
    'Rotation.joint_zero': 0.0,
    'Wrist_Roll.joint_zero': 0.0,
}
# Bags to fit on with their seconds, to see signs and zeros on, and to judge on.
FITTED = {'large_amplitude': (0.0, 30.0), 'chirp_sweep': (0.0, 20.0)}
STANDING = ('hold_under_gravity', 'large_amplitude')
JUDGED = ('step_response', 'friction_gravity', 'backlash_detection', 'hold_under_gravity',
          'single_joint_elbow')  # fmt: skip
SECONDS = 20.0
# What a model may miss, rad.
NOISE = 5e-3
ENDS = 'low', 'high'
PICTURED = 'step_response'


def machine_of(mjcf, signs):
    """Return the machine of an MJCF whose joints a log counts with these signs."""
    direction = ['forward' if s > 0 else 'backward' for s in signs]
    drive = {'joint': list(JOINTS.values()), 'direction': direction}
    return written_machine(mjcf, list(JOINTS), 0.005, BOXES, drive=drive)


def part(data, begin, end):
    """Return a data set from `begin` to `end` [s]."""
    cut = slice(round(begin / data.cycle), round(end / data.cycle))
    rows = {
        f.name: value[:, cut]
        for f in fields(data)
        if isinstance(value := getattr(data, f.name), np.ndarray) and value.ndim == 2
    }
    return replace(data, **rows)


def standing(sets, seconds=0.5):
    """Return (N, 5) positions and what they fall short of the goal, where the arm stands."""
    places, short = [], []
    for data in sets:
        seen = np.flatnonzero(np.isfinite(data.position).all(axis=0))
        position, goal = data.position[:, seen], data.command_position[:, seen]
        count = max(1, round(seconds / (data.cycle * np.diff(seen).mean())))
        moved = [np.abs(x[:, count:] - x[:, :-count]).max(axis=0) for x in (position, goal)]
        still = count + np.flatnonzero((moved[0] < 4e-3) & (moved[1] < 1e-3))[::10]
        places.append(position[:, still].T)
        short.append((goal - position)[:, still].T)
    return np.concatenate(places), np.concatenate(short)


def signs_by_droop(mjcf, places, short):
    """Return signs, zeros and gains by which the joints that hang droop; the best first.

    Each row has the RMS left [rad], the cost, the signs, zeros [rad] and gains [N m/rad].
    """
    import mujoco

    model = mujoco.MjModel.from_xml_path(str(mjcf))
    data = mujoco.MjData(model)

    def pull(signs, zero):
        out = np.empty((len(places), len(JOINTS)))
        for k, place in enumerate(places):
            data.qpos[:] = signs * (place - zero)
            mujoco.mj_forward(model, data)
            out[k] = data.qfrc_bias
        return (signs * out)[:, HANGING]

    def drooping(x, signs):
        torque = pull(signs, np.array([0.0, *x, 0.0]))
        soft = np.sum(torque * short[:, HANGING], axis=0) / np.sum(torque**2, axis=0)
        return torque, np.maximum(soft, 1e-3)

    def left(x, signs):
        torque, soft = drooping(x, signs)
        return (short[:, HANGING] - torque * soft).T.ravel()

    found = []
    for some in itertools.product((1.0, -1.0), repeat=3):
        signs = np.array([1.0, *some, 1.0])
        for first in itertools.product((-1.2, 0.0, 1.2), repeat=2):
            fit = least_squares(
                left, [*first, 0.0], args=(signs,), loss='soft_l1', f_scale=0.02, max_nfev=10
            )
            # What the fit minimises is the soft loss; what is told is the plain RMS.
            rms = float(np.sqrt(np.mean(left(fit.x, signs) ** 2)))
            gains = 1.0 / drooping(fit.x, signs)[1]
            found.append((rms, fit.cost, signs, fit.x, gains))
    found.sort(key=lambda row: row[1])
    return found


def started(parameters, zero, gains):
    """Return (N,) where to start from: zeros and gains as the droop tells them, MJCF's else."""
    droop = dict(zip(list(JOINTS)[HANGING], zip(gains, zero, strict=True), strict=True))
    usual = {'kp': 5.0, 'damping': 0.6, 'frictionloss': 0.05, 'set_point_delay': 0.03}
    out = []
    for p in parameters:
        joint, _, name = p.name.partition('.')
        own = dict(zip(('kp', 'joint_zero'), droop.get(joint, ()), strict=False))
        out.append(own.get(name, usual.get(name, 0.0)))
    return np.array(out)


def along(models, start):
    """Return (N,) parameters fitted to positions along the motion, from a start nearby."""
    low, high = (np.array([getattr(p, end) for p in models[0].parameters]) for end in ENDS)
    seen = [np.isfinite(m.data.position) for m in models]

    def left(theta):
        told = zip(models, seen, strict=True)
        parts = [(m.measured[k] - m.simulate(np.atleast_2d(theta))[:, k]) for m, k in told]
        return np.concatenate(parts, axis=1) / NOISE

    return descended(left, np.clip(start, low, high), low, high).theta


def missed(machine, data, theta):
    """Return (5,) RMS position error of a simulation over a data set [mrad], and the goal's."""
    model = Mujoco(machine, data, fixed=HELD)
    told = model.simulate(theta[None])[0]
    there = np.isfinite(data.position)
    goal = data.command_position
    square = [np.where(there, (x - data.position) ** 2, np.nan) for x in (told, goal)]
    return [1e3 * np.sqrt(np.nanmean(x, axis=1)) for x in square]


def picture(path, machine, whole, before, after):
    """Draw goal, position and what both simulations make of it, joint by joint."""
    figure = Figure(figsize=(10, 12), layout='tight')
    axes = figure.subplots(len(JOINTS), 1, sharex=True)
    model = Mujoco(machine, whole, fixed=HELD)
    told = model.simulate(np.stack([before, after]))
    time = whole.cycle * np.arange(whole.cycles)
    seen = np.isfinite(whole.position[0])
    for d, (joint, axis) in enumerate(zip(JOINTS, axes, strict=True)):
        axis.plot(time, whole.command_position[d], 'k:', lw=0.8, label='goal')
        axis.plot(time[seen], whole.position[d, seen], 'C0', label='measured')
        axis.plot(time, told[0, d], 'C7', lw=0.8, label='described')
        axis.plot(time, told[1, d], 'C1', lw=1.0, label='identified')
        axis.set_ylabel(f'{joint} / rad')
    axes[0].legend(loc='upper right', ncols=4)
    axes[-1].set_xlabel('time / s')
    figure.savefig(path, dpi=90, metadata={'Software': None})


def described(model):
    """Return (N,) the parameters as the description has them, joint zeros left at 0."""
    names = [p.name.split('.') for p in model.parameters]
    drives = list(JOINTS)
    return np.array([
        model.plant.stated(name, drives.index(drive)) if name in ('kp', 'damping', 'frictionloss')
        else 0.0
        for drive, name in names
    ])  # fmt: skip


def main():
    """Print signs and zeros, what was found beside the description, and errors on other bags."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('data', type=Path)
    parser.add_argument('mjcf', type=Path)
    parser.add_argument('--picture', type=Path, help=f'of {PICTURED}')
    args = parser.parse_args()
    machine = machine_of(args.mjcf, np.ones(len(JOINTS)))

    def bag(name):
        return read_data(args.data / f'so101_{name}', machine).datasets[0]

    ranked = signs_by_droop(args.mjcf, *standing([bag(name) for name in STANDING]))
    best = {}
    for row in ranked:
        best.setdefault(tuple(float(s) for s in row[2][HANGING]), row)
    for signs, (rms, cost, _, zero, gains) in best.items():
        print(
            f'signs {signs}: droop left {1e3 * rms:.1f} mrad, cost {cost:.4f}, '
            f'zeros {zero.round(2)}, gains {gains.round(1)}',
            flush=True,
        )
    machine = machine_of(args.mjcf, ranked[0][2])
    models = [Mujoco(machine, part(bag(name), *ends), fixed=HELD) for name, ends in FITTED.items()]
    theirs = described(models[0])
    parameters = models[0].parameters
    found = along(models, started(parameters, *ranked[0][3:]))
    for p, stated, value in zip(parameters, theirs, found, strict=True):
        print(f'| {p.name} | {stated:g} | {value:.4g} {p.unit} |')
    for name in (*FITTED, *JUDGED):
        whole = bag(name)
        data = part(whole, *FITTED.get(name, (0.0, SECONDS)))
        before, goal = missed(machine, data, theirs)
        after, _ = missed(machine, data, found)
        for d, joint in enumerate(JOINTS):
            numbers = [f'{x:.1f}' for x in (goal[d], before[d], after[d])]
            print('|', ' | '.join([name, joint, *numbers]), '|', flush=True)
        if args.picture and name == PICTURED:
            picture(args.picture, machine, data, theirs, found)


if __name__ == '__main__':
    main()
