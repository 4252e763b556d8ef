# SPDX-License-Identifier: Apache-2.0
"""How fast a candidate of a seven-joint arm is judged, against plainer ways to the same cost.

In turn within one run: the model; the same cost in NumPy, by one matrix product of all candidates;
and inverse dynamics anew for each candidate, by pinocchio. Then the model on all threads. Needs
pinocchio (`pip install pin`). Times are processor time, by medians, with the least
in brackets; the last is by the clock. With --diagnose instead: how long a diagnosis takes of a log
whose second joint has Stribeck friction.

    python checks/benchmarks/serial.py [--seconds 20] [--rounds 5] [--candidates N] [--diagnose]
"""

import argparse
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
import os
import time

from measure import interleaved, machine, ratio
import numpy as np

from ros2_ident.gap.diagnose import diagnose
from ros2_ident.models import EffectAt, machine_from_mapping
from ros2_ident.models.serial.model import Serial
from ros2_ident.recording import Dataset
from ros2_ident.search import Threads

HALF = 0.5 * np.pi
CYCLE = 1e-3
# Candidates of a round; pinocchio is timed on one.
BATCH = 64
# What is hidden for a diagnosis: torque and speed of the Stribeck friction, and the noise, N m.
STRIBECK, NOISE = (1.5, 0.15), 0.1
# Franka Emika's table of the Panda, in modified Denavit-Hartenberg parameters.
PANDA = {
    'dh_a': [0.0, 0.0, 0.0, 0.0825, -0.0825, 0.0, 0.088],
    'dh_alpha': [0.0, -HALF, HALF, HALF, -HALF, HALF, HALF],
    'dh_d': [0.333, 0.0, 0.316, 0.0, 0.384, 0.0, 0.0],
    'dh_theta': [0.0] * 7,
    'joint': ['revolute'] * 7,
}


def panda(seconds: float) -> Serial:
    """Return the arm on a log of that length, in which every joint swings with three rates."""
    rng = np.random.default_rng(0)
    shape = (7, 3, 1)
    time_of = CYCLE * np.arange(round(seconds / CYCLE))
    angle = rng.uniform(0.8, 6.0, shape) * time_of + rng.uniform(0.0, 6.0, shape)
    place = (rng.uniform(0.2, 0.5, shape) * np.sin(angle)).sum(axis=1)
    arm = machine_from_mapping(
        {
            'machine': 'serial',
            'drives': [f'joint_{n}' for n in range(1, 8)],
            'geometry': PANDA,
            'controller': {'cycle': CYCLE},
            'parameters': {
                'link_moment': [-5.0, 5.0, 'kg m'],
                'link_inertia': [-5.0, 5.0, 'kg m^2'],
                'coulomb_torque': [0.0, 5.0, 'N m'],
                'viscous_torque': [0.0, 5.0, 'N m s/rad'],
            },
        }
    )
    effort = rng.normal(0.0, 5.0, place.shape)
    return Serial(arm, Dataset(arm.drives, CYCLE, 0, None, None, place, None, effort))


def plain_costs(model: Serial, theta: np.ndarray) -> np.ndarray:
    """Return (S,) the costs of candidates by NumPy: a product, friction, a mean."""
    drives = len(model.drives)
    values = {p.name: column for p, column in zip(model.parameters, theta.T, strict=True)}
    coefficients = model.rows(theta)[:, -model._terms.shape[2] :]
    velocity = model._motion.reshape(3, drives, -1)[1]
    total = np.zeros(len(theta))
    for d, name in enumerate(model.drives):
        effort = coefficients @ model._terms[d].T
        effort += values[f'{name}.coulomb_torque'][:, None] * np.tanh(velocity[d] / 0.02)
        effort += values[f'{name}.viscous_torque'][:, None] * velocity[d]
        total += np.sqrt(np.mean((model.measured[d] - effort) ** 2, axis=1))
    return total / drives


def diagnosis_of(model: Serial) -> None:
    """Diagnose a log of the arm with Stribeck friction on its second joint, and say how long."""
    wide = model.extended((EffectAt('stribeck', 'joint_2'),))
    rng = np.random.default_rng(5)
    truth = np.array(
        [rng.uniform(p.low, p.high) * (0.3 if 'link' in p.name else 1.0) for p in wide.parameters]
    )
    truth[-2:] = STRIBECK
    effort = wide.simulate(truth[None])[0]
    effort += rng.normal(0.0, NOISE, effort.shape)
    data = replace(model.data, effort=effort)
    begin, used = time.perf_counter(), time.process_time()
    found = diagnose(model.machine, [data], workers=Threads(os.cpu_count() or 1))
    print(
        f'{len(truth) - 2} parameters, {found.effect} on {", ".join(found.where)}: '
        f'{time.perf_counter() - begin:.0f} s by the clock, '
        f'{time.process_time() - used:.0f} s of processor time'
    )


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--seconds', type=float, default=20.0, help='length of the log')
    parser.add_argument('--rounds', type=int, default=5)
    parser.add_argument('--candidates', type=int, default=10000)
    parser.add_argument('--diagnose', action='store_true', help='time a diagnosis instead')
    args = parser.parse_args()
    if args.diagnose:
        print(f'{machine()}\n')
        diagnosis_of(panda(args.seconds))
        return
    begin = time.perf_counter()
    model = panda(args.seconds)
    drives = len(model.drives)
    moved = model._motion.reshape(3, drives, -1)
    terms = model._terms.shape
    print(f'{machine()}\n')
    print(
        f'{args.seconds:g} s at {1.0 / CYCLE:g} Hz, {drives} joints, {len(model.parameters)} '
        f'parameters, {terms[2] - 1} of them of the links; terms of the motion in '
        f'{time.perf_counter() - begin:.1f} s, once a recording'
    )
    low, high = np.array([(p.low, p.high) for p in model.parameters]).T
    rng = np.random.default_rng(1)
    theta = rng.uniform(low, high, (args.candidates, len(low)))
    some = theta[:BATCH]
    np.testing.assert_allclose(model.costs(some), plain_costs(model, some), rtol=1e-7)
    times = interleaved(
        {
            'model': lambda: model.costs(some),
            'NumPy': lambda: plain_costs(model, some),
            'pinocchio': lambda: model.arm.efforts(*moved),
        },
        args.rounds,
        shares={'model': BATCH, 'NumPy': BATCH},
    )
    for name, timing in times.items():
        print(
            f'{name:10s} {1e3 * timing.median:8.3f} ms a candidate ({1e3 * timing.least:.3f}), '
            f'{ratio(timing, times["model"])} times the model'
        )
    threads = os.cpu_count() or 1
    pieces = np.array_split(theta, max(1, args.candidates // 250))
    begin = time.perf_counter()
    with ThreadPoolExecutor(threads) as pool:
        list(pool.map(model.costs, pieces))
    print(
        f'{args.candidates} candidates on {threads} threads: {time.perf_counter() - begin:.1f} s'
    )


if __name__ == '__main__':
    main()
