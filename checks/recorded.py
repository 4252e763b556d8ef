# SPDX-License-Identifier: Apache-2.0
"""Logs without a set-point: what is named where nothing is missing, and where something is.

Kinds of machines that a recorded motion drives, from their slow references; with and without
rest, at 25, 100 and 1000 Hz, with 0 to 3 encoder steps of noise on the positions. With `--effect`
each log is made again with an effect that leaves, behind the nominal parameters, a residual of 1.5
to 4 times the floor that its log without one had.

Example: python -m checks.recorded --logs 8 --seed 1 --effect
"""

import argparse
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
import json
from pathlib import Path
import sys
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from checks.reference.bag_making import draw_parameters
from checks.reference.effects import draw_effect, Effect, kinds, suits
from checks.reference.twin import twin_of
from ros2_ident.arrays import Array
from ros2_ident.effects import CATALOGUE
from ros2_ident.errors import IdentError
from ros2_ident.gap.diagnose import diagnose
from ros2_ident.gap.result import Diagnosis
from ros2_ident.identify.data import gather
from ros2_ident.machine.machine import Machine
from ros2_ident.models import load_machine, make_model
from ros2_ident.recording import Dataset, Recording
from ros2_ident.simulate.bag import make_streams, nuisance_of
from ros2_ident.simulate.motions import draw_motion, Motion

CONFIG = Path(__file__).parents[1] / 'config'
MACHINES = ('emps', 'tripod', 'delta', 'double_pendulum')
# Rate of the log, Hz, and its length, s.
RATES = {25: 32.0, 100: 16.0, 1000: 8.0}
MOTIONS = {False: ('multi_point', 'multisine', 'mixed'), True: ('dwell',)}
# Steps of an encoder in the largest travel of a drive.
COUNTS = 40_000
# RMS of what an effect leaves, in floors; drawings to come there.
SIZE, TRIES = (1.5, 4.0), 30


@dataclass(frozen=True)
class Drawn:
    """A machine and what it does.

    Attributes:
        machine: The machine, its bounds about what it is.
        rate: Of the log, Hz.
        noise: Of the positions, in steps of their encoders.
        rest: Whether it stands for a good part of the log.
    """

    machine: Machine
    values: Mapping[str, float]
    motion: Motion
    rate: int
    noise: float
    rest: bool
    seed: int

    def _log(self, effects: tuple[Effect, ...]):  # type: ignore[no-untyped-def]
        twin = twin_of(self.machine)
        motion = self.motion
        return twin.simulate(self.machine, self.values, motion.position, motion.velocity, effects)

    def recording(self, effects: tuple[Effect, ...] = ()) -> Recording:
        """Return its log, without a set-point."""
        log, rng = self._log(effects), np.random.default_rng(self.seed)
        step = np.ptp(log.position, axis=1, keepdims=True).max() / COUNTS
        noisy = log.position + self.noise * step * rng.standard_normal(log.position.shape)
        nuisance = replace(nuisance_of(self.machine), period=1.0 / self.rate, position_step=step)
        streams = make_streams(replace(log, position=noisy), self.motion, nuisance, rng)
        state = replace(streams['/joint_states'], velocity=None)
        return Recording(state, streams['/effort'])

    def dataset(self, effects: tuple[Effect, ...] = ()) -> Dataset:
        """Return its log on the grid."""
        return gather((self.recording(effects),), self.machine).datasets[0]


def draw(number: int, seed: int) -> Drawn:
    """Draw a log; kinds, rates and rests take turns."""
    rng = np.random.default_rng([seed, number])
    name = MACHINES[number % len(MACHINES)]
    with TemporaryDirectory() as folder:
        # Bands by the log, as of a machine file that states none.
        lines = (CONFIG / f'{name}.yaml').read_text().splitlines()
        path = Path(folder) / f'{name}.yaml'
        kept = [x for x in lines if not x.strip().startswith(('bandwidth', 'least_speed'))]
        path.write_text('\n'.join(kept))
        machine = load_machine(path)
    rate = list(RATES)[number // len(MACHINES) % len(RATES)]
    rest = bool(number // (len(MACHINES) * len(RATES)) % 2) ^ bool(number % 2)
    values = draw_parameters(machine, rng)
    values = {name: x for name, x in values.items() if '.link_' not in f'.{name}'}
    values |= {'measurement_delay': 0.0} if 'measurement_delay' in values else {}
    motion = draw_motion(str(rng.choice(MOTIONS[rest])), machine, RATES[rate], rng)
    return Drawn(machine, values, motion, rate, float(rng.integers(0, 4)), rest, number)


def judged(drawn: Drawn, *effects: Effect) -> Diagnosis:
    """Return the diagnosis of a log by the parts of it that are held out."""
    data = gather((drawn.recording(effects),), drawn.machine)
    return diagnose(drawn.machine, data.datasets, labels=data.labels, seed=1)


def left(drawn: Drawn, effect: Effect, theta: Array) -> float:
    """Return the RMS of what an effect leaves of an output behind the nominal parameters.

    To first order about candidate `theta` (N,), in the band in which efforts are compared.
    """
    plain, other = (make_model(drawn.machine, drawn.dataset(x)) for x in ((), (effect,)))
    there = np.isfinite(plain.measured) & np.isfinite(other.measured)
    step = np.array([1e-3 * (p.high - p.low) for p in plain.parameters])
    simulated = plain.simulate(np.stack([theta, *(theta + np.diag(step))]))[:, there]
    columns = ((simulated[1:] - simulated[0]) / step[:, None]).T
    columns /= np.linalg.norm(columns, axis=0) + 1e-300
    change = other.measured[there] - other.simulate(theta[None])[0, there]
    change -= plain.measured[there] - simulated[0]
    out = np.zeros(there.shape)
    out[there] = change - columns @ np.linalg.lstsq(columns, change, rcond=1e-9)[0]
    return float(np.sqrt((out**2).sum(axis=1) / there.sum(axis=1)).max())


def fitting(drawn: Drawn, found: Diagnosis) -> Effect | None:
    """Return an effect whose residual is of the wanted size beside a log's floor."""
    rng = np.random.default_rng([drawn.seed, 2])
    places = {k.name for k in kinds().values() if suits(k, drawn.machine, drawn.values)}
    nominal = make_model(drawn.machine, drawn.dataset())
    there = {at.effect for at in nominal.extensions()}
    names = sorted(places & set(CATALOGUE) & there)
    known = {name: value.value for name, value in found.parameters.items()}
    theta = np.array([known.get(p.name, 0.5 * (p.low + p.high)) for p in nominal.parameters])
    for _ in range(TRIES):
        name, drive = str(rng.choice(names)), str(rng.choice(drawn.machine.drives))
        effect = draw_effect(name, rng, rng.uniform(0.0, 1.0), (drive,), drawn.machine)
        with suppress(IdentError):
            size = left(drawn, effect, theta) / float(found.floor.per_drive.max())
            if SIZE[0] < size < SIZE[1]:
                return effect
    return None


def line(drawn: Drawn, found: Diagnosis, effect: Effect | None = None) -> dict[str, Any]:
    """Return what came of a log."""
    described = make_model(drawn.machine, drawn.dataset()).as_described(drawn.values)
    true = {**drawn.values, **described}
    held = {}
    for name, value in found.parameters.items():
        base = name.rpartition('.')[2]
        if name in true or base in true:
            at = float(true.get(name, true.get(base, 0.0)))
            held[name] = [value.low <= at <= value.high, at, value.value, value.low, value.high]
    return {
        'number': drawn.seed,
        'log': f'{drawn.machine.kind} {drawn.rate} Hz, {drawn.noise:g} steps, {drawn.motion.kind}',
        'effect': effect and f'{effect.name}@{",".join(effect.where)}',
        'named': found.effect,
        'where': list(found.where),
        'probability': found.probability,
        'gap': found.evidence['size'],
        'held': held,
        'seconds': found.seconds,
    }


def main() -> int:
    """Draw, diagnose, count."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--logs', type=int, default=8)
    parser.add_argument('--first', type=int, default=0, help='number of the first log')
    parser.add_argument('--seed', type=int, default=1)
    parser.add_argument('--effect', action='store_true')
    parser.add_argument('--out', type=Path, help='a line of JSON for each log')
    args = parser.parse_args()
    rows = []
    for number in range(args.first, args.first + args.logs):
        drawn = draw(number, args.seed)
        try:
            found = judged(drawn)
        except IdentError as exc:
            print(f'{number}: refused, {exc}', flush=True)
            continue
        rows.append(line(drawn, found))
        if args.effect and drawn.machine.kind != 'serial':
            effect = fitting(drawn, found)
            rows += [line(drawn, judged(drawn, effect), effect)] if effect else []
        for row in rows[-2:]:
            shown = {key: value for key, value in row.items() if key != 'held'}
            held = [x[0] for x in row['held'].values()]
            print(shown, f'{sum(held)} of {len(held)} held', flush=True)
        if args.out:
            args.out.write_text('\n'.join(map(json.dumps, rows)) + '\n')
    null = [row for row in rows if row['effect'] is None]
    held = [x[0] for row in null for x in row['held'].values()]
    print(f'{sum(r["named"] != "none" for r in null)} of {len(null)} without an effect named')
    print(f'{sum(held)} of {len(held)} parameters in their intervals')
    return 0


if __name__ == '__main__':
    sys.exit(main())
