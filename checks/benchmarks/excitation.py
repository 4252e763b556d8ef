# SPDX-License-Identifier: Apache-2.0
"""What `ident excite` is worth beside the motions that people record.

Rivals are pick and place, moves between random points, and random Fourier series. The limits are
what the first two take, set-points and simulation together, so that all keep to the same. The
reference then simulates the planned motion at the expected parameters and at others.

    python checks/benchmarks/excitation.py MACHINE [--seconds 5] [--criterion d] [--limits FILE]
        [--set NAME=VALUE] [--out DIR]
"""

import argparse
from contextlib import suppress
from dataclasses import replace
import json
from pathlib import Path

import numpy as np
import yaml

from checks.reference import twin_of
from ros2_ident.errors import IdentError
from ros2_ident.excite.course import courses_for, derived
from ros2_ident.excite.files import write_excitation
from ros2_ident.excite.information import Sensitivity
from ros2_ident.excite.limits import KEYS, limits_of
from ros2_ident.excite.plan import excite, largest, SEARCH
from ros2_ident.machine.kind import Space
from ros2_ident.models import load_machine
from ros2_ident.models.registry import kind_of, set_points_of, space_of
from ros2_ident.simulate import motions
from ros2_ident.simulate.motions import Path as Way

RIVALS = ('pick_and_place', 'multi_point')
SEEDS = (1, 2, 3)
# Of the speeds in a file of limits, what an arm's rivals are drawn with.
PACE = 0.9


def workspace(machine, limits):
    """Return where the rivals move: the limits' room where the kind has no twin."""
    try:
        return space_of(machine)
    except IdentError:
        reach = 0.5 * (limits.high - limits.low)
        speeds = PACE * limits.velocity.min(), PACE * limits.acceleration.min()
        return Space(0.5 * (limits.high + limits.low), reach, *speeds)


def rival(kind, machine, limits, seconds, seed):
    """Return a motion of a kind, with its derivatives."""
    space = workspace(machine, limits)
    cycle = machine.number('cycle')
    way = Way(space.centre, cycle)
    way.rest(0.25)
    motions.KINDS[kind](way, space, np.random.default_rng(seed), seconds)
    points, speeds = way.sampled(seconds)
    with suppress(IdentError):
        points, speeds = set_points_of(machine, points, speeds)
    return derived(points, speeds, cycle)


def simulated(machine, sensitivity, planned, values):
    """Return what the reference makes of set-points."""
    named = {p.name: v for p, v in zip(sensitivity.parameters, values, strict=True)}
    log = twin_of(machine).simulate(machine, named, planned.position, planned.velocity)
    seen = derived(log.position, log.velocity, log.cycle)
    tool = log.platform if kind_of(machine).set_points else None
    return replace(seen, jerk=None, effort=log.torque, tool=tool)


def taken(limits, moved):
    """Return limits widened to what motions take."""
    out = {}
    for name in ('velocity', 'acceleration', 'jerk'):
        rows = [row for m in moved if (row := getattr(m, name)) is not None]
        out[name] = np.max([np.abs(row).max(axis=1) for row in rows], axis=0)
    return replace(limits, **out)


def main():
    """Plan, compare, simulate."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('machine')
    parser.add_argument('--limits')
    parser.add_argument('--seconds', type=float, default=5.0)
    parser.add_argument('--criterion', default='d')
    parser.add_argument('--generations', type=int, default=SEARCH.generations)
    parser.add_argument('--threads', type=int, default=1)
    parser.add_argument('--set', action='append', default=[])
    parser.add_argument('--out', default='excitation')
    args = parser.parse_args()
    machine = load_machine(args.machine)
    given = {k: float(v) for k, v in (text.split('=') for text in args.set)}
    sensitivity = Sensitivity(machine, values=given)
    stated = limits_of(machine, args.limits)
    drawn = {
        (kind, seed): rival(kind, machine, stated, args.seconds, seed)
        for kind in RIVALS
        for seed in SEEDS
    }
    shown = {key: sensitivity.of(motion) for key, motion in drawn.items()}
    moved = [m for key in drawn for m in (drawn[key], shown[key].moved)]
    limits = taken(stated, moved)
    courses = courses_for(machine, limits, args.seconds)
    shrink = SEARCH.range_reduction ** (SEARCH.generations / args.generations)
    settings = replace(SEARCH, generations=args.generations, range_reduction=shrink)
    search = {'criterion': args.criterion, 'settings': settings, 'threads': args.threads}
    found = excite(courses, sensitivity, **search)
    folder = Path(args.out)
    write_excitation(folder, found, 3.0)
    by_drive = {
        drive: {KEYS[n]: float(x) for n in KEYS if np.isfinite(x := getattr(limits, n)[d])}
        for d, drive in enumerate(machine.drives)
    }
    (folder / 'joint_limits.yaml').write_text(yaml.safe_dump({'joint_limits': by_drive}))
    report(args, machine, sensitivity, found, shown, limits, folder)


def report(args, machine, sensitivity, found, shown, limits, folder):
    """Print intervals beside the rivals', and what the reference takes of the limits."""
    width = sensitivity.box.width
    mine = found.half_widths / width
    print(
        f'{machine.kind}, {args.seconds:g} s, criterion {args.criterion}, '
        f'{found.evaluations} motions, worst interval {100 * mine.max():.3g} % of its range'
    )
    others = {
        kind: [sensitivity.half_widths(shown[kind, s]) / width for s in SEEDS] for kind in RIVALS
    }
    others['random series'] = [found.chance / width]
    for kind, several in others.items():
        worst = [other.max() / mine.max() for other in several]
        ratio = np.median(np.concatenate([other / mine for other in several]))
        least = min(float((other / mine).min()) for other in several)
        print(
            f'  {kind}: worst interval {min(worst):.2f} to {max(worst):.2f} times as wide, '
            f'median parameter {ratio:.2f}, least {least:.2f}'
        )
    print('  of the limits, planned and simulated:', shares(found.loads))
    low, high = sensitivity.box.low, sensitivity.box.low + width
    for name, values in (
        ('expected', sensitivity.values),
        ('a quarter lower', np.maximum(0.75 * sensitivity.values, low)),
        ('a quarter higher', np.minimum(1.25 * sensitivity.values, high)),
    ):
        seen = simulated(machine, sensitivity, found.planned, values)
        loads = largest(limits, found.planned, seen)
        print(f'  reference, {name}:', shares(loads))
    rows = {kind: [x.tolist() for x in several] for kind, several in others.items()}
    rows |= {'names': [p.name for p in sensitivity.parameters], 'this': mine.tolist()}
    (folder / 'rivals.json').write_text(json.dumps(rows))


def shares(loads):
    """Return shares of limits as text."""
    return ', '.join(f'{name} {100 * x:.1f} %' for name, x in loads.items() if x > 0.0)


if __name__ == '__main__':
    main()
