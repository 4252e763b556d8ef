# SPDX-License-Identifier: Apache-2.0
"""An SO-101 beside its MJCF: how far the authors' gains, damping and friction are off.

The logs hold set-points and positions. Which way round the log counts a joint, and where its zero
is, comes from the droop under gravity where the arm stands; the attributes are identified on parts
of two bags and judged on others. `kv` and `damping` act alike on a position, so `kv` is held at 0.
Rotation and Wrist_Roll turn about what gravity does not tell: their zero stays.

    python benchmarks/mujoco_arm.py DIRECTORY_OF_BAGS so101.xml
"""

import argparse
from dataclasses import fields, replace
import itertools
from pathlib import Path
import tempfile

import mujoco
import numpy as np
from scipy.optimize import least_squares
import yaml

from ros2_ident.identify.data import Data, read_data
from ros2_ident.identify.run import identify
from ros2_ident.identify.settings import IdentifySettings
from ros2_ident.models import load_machine
from ros2_ident.models.mujoco.model import Mujoco
from ros2_ident.search import GeneticSettings

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
HELD = {'kv': 0.0, 'Rotation.joint_zero': 0.0, 'Wrist_Roll.joint_zero': 0.0}
# Bags to fit on with their seconds, to see signs and zeros on, and to judge on.
FITTED = {'large_amplitude': (0.0, 30.0), 'chirp_sweep': (0.0, 20.0)}
STANDING = ('hold_under_gravity', 'large_amplitude')
JUDGED = ('step_response', 'friction_gravity', 'backlash_detection', 'hold_under_gravity')
SECONDS = 60.0


def machine_of(mjcf, signs):
    """Return the machine of an MJCF whose joints a log counts with these signs."""
    content = {
        'machine': 'mujoco',
        'drives': list(JOINTS),
        'geometry': {'description': 'robot.xml'},
        'drive': {
            'joint': list(JOINTS.values()),
            'direction': ['forward' if s > 0 else 'backward' for s in signs],
        },
        'controller': {'cycle': 0.005},
        'parameters': BOXES,
    }
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / 'robot.xml').write_text(mjcf.read_text())
        (Path(folder) / 'machine.yaml').write_text(yaml.safe_dump(content))
        return load_machine(Path(folder) / 'machine.yaml')


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


def missed(machine, data, theta):
    """Return (5,) RMS position error of a simulation over a data set [mrad], and the goal's."""
    model = Mujoco(machine, data, fixed=HELD)
    told = model.simulate(theta[None])[0]
    there = np.isfinite(data.position)
    goal = data.command_position
    square = [np.where(there, (x - data.position) ** 2, np.nan) for x in (told, goal)]
    return [1e3 * np.sqrt(np.nanmean(x, axis=1)) for x in square]


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
    parser.add_argument('--population', type=int, default=256)
    parser.add_argument('--generations', type=int, default=6)
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
    fitted = tuple(part(bag(name), *ends) for name, ends in FITTED.items())
    settings = IdentifySettings(
        genetic=GeneticSettings(args.population, 8, 8, args.generations), threads=1
    )
    found = identify(machine, Data(fitted), fixed=HELD, settings=settings, seed=1)
    model = Mujoco(machine, fitted[0], fixed=HELD)
    theirs = described(model)
    for p, stated in zip(found.parameters, theirs, strict=True):
        print(f'| {p.name} | {stated:g} | {p.value:.4g} [{p.low:.4g}, {p.high:.4g}] {p.unit} |')
    for name in (*FITTED, *JUDGED):
        whole = bag(name)
        data = part(whole, *FITTED.get(name, (0.0, SECONDS)))
        before, goal = missed(machine, data, theirs)
        after, _ = missed(machine, data, found.theta)
        for d, joint in enumerate(JOINTS):
            print(
                f'| {name} | {joint} | {goal[d]:.1f} | {before[d]:.1f} | {after[d]:.1f} |',
                flush=True,
            )


if __name__ == '__main__':
    main()
