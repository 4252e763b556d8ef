# SPDX-License-Identifier: Apache-2.0
"""Eq. 5 in three readings: how near each comes on the paper's belt drive and tripod.

Belt: Table 2's settings, the paper's truth and truths anywhere in the box; a run is a success
where EA and P are within 1 %. Tripod: one drive, Table 4's settings, a simulated log with Table
5's values and the machine file's noise. The genetic algorithm alone, nothing refined.

    python checks/benchmarks/mutation_readings.py [--seeds 100] [--tripod 100] [--law laplace]
"""

import argparse

import numpy as np

from checks.belt_matrix import step_reference
from checks.paper.belt import belt_machine, PAPER_SETTINGS, shipped_machine, trials
from checks.reference.tripod import TABLE_5
from ros2_ident.models.belt_drive.model import BeltDrive
from ros2_ident.models.tripod.model import Tripod
from ros2_ident.recording import Dataset
from ros2_ident.search import GeneticSearch, GeneticSettings, minimise, ThreadedEvaluator
from ros2_ident.search.operators import MUTATIONS
from ros2_ident.simulate.motions import draw_motion

# What the paper found on the belt, errors of EA and P in %; nothing where the run failed.
PAPER = {(8, 0.0): '', (8, 0.5): '22, 18', (20, 0.0): '', (20, 0.5): '0.028, 0.032'}


def belts(seeds, laws):
    """Print how often and how well the belt drive is found."""
    belt = BeltDrive(belt_machine(), *step_reference())
    print('survivors, d | law | found, % | anywhere, % | median error of EA, P, % | paper, %')
    for (survivors, distance), settings in PAPER_SETTINGS.items():
        for law in laws:
            chosen = GeneticSettings(**{**vars(settings), 'mutation': law})
            own = trials(belt, chosen, seeds, lambda _: None)
            other = trials(belt, chosen, seeds, lambda _: None, anywhere=True)
            median = 100.0 * np.median([t.error for t in own], axis=0)
            print(
                f'{survivors}, {distance} | {law} | {np.mean([t.success for t in own]):.0%} | '
                f'{np.mean([t.success for t in other]):.0%} | {median[0]:.3f}, {median[1]:.3f} | '
                f'{PAPER[survivors, distance]}',
                flush=True,
            )


def tripods(seeds, laws):
    """Print how well one drive of the tripod is found."""
    machine = shipped_machine('tripod')
    motion = draw_motion('pick_and_place', machine, 2.0, 7)
    still = np.zeros_like(motion.position)
    asked = Dataset(
        machine.drives, motion.cycle, 0, motion.position, motion.velocity, motion.position, None,
        still,
    )  # fmt: skip
    first = Tripod(machine, asked, quantities=('effort', 'position', 'velocity'))
    truth = np.array([TABLE_5[p.name.split('.')[-1]] for p in first.parameters])
    # The other two drives follow what they did, which is not what was asked of them.
    effort, position, velocity = np.split(first.simulate(truth[None])[0], 3)
    effort += machine.effort_noise * np.random.default_rng(0).standard_normal(effort.shape)
    seen = Dataset(
        machine.drives, motion.cycle, 0, motion.position, motion.velocity, position, velocity,
        effort,
    )  # fmt: skip
    friction = {n: TABLE_5[n] for n in ('coulomb_torque', 'viscous_torque')}
    held = {f'drive_1.{n}': v for n, v in friction.items()}
    model = Tripod(machine, seen, drives=['drive_1'], fixed=held)
    low = np.array([p.low for p in model.parameters])
    high = np.array([p.high for p in model.parameters])
    names = [p.name.split('.')[-1] for p in model.parameters]
    known = np.array([TABLE_5[name] for name in names])
    print(f'\ntripod: cost of the truth {model.costs(known[None])[0]:.5f} N m')
    print(
        'tripod, d | law | cost, 10, 50 and 90 % of seeds, N m | median error in % of '
        + ', '.join(names)
    )
    for law in laws:
        for distance in (0.0, 0.5):
            settings = GeneticSettings(min_distance=distance, mutation=law)
            searches = [GeneticSearch(len(low), settings, seed) for seed in range(seeds)]
            # Survivors are the same to the bit where candidates beyond them are given up.
            with ThreadedEvaluator(model.costs, 1, limited=True) as costs:
                runs = [minimise(costs, search, low=low, high=high) for search in searches]
            error = np.median([np.abs(run.theta / known - 1.0) for run in runs], axis=0)
            cost = np.percentile([run.cost for run in runs], [10, 50, 90])
            words = ', '.join(f'{100.0 * e:.2f}' for e in error)
            found = ', '.join(f'{c:.5f}' for c in cost)
            print(f'{distance} | {law} | {found} | {words}', flush=True)


def main():
    """Print both tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--seeds', type=int, default=100)
    parser.add_argument('--tripod', type=int, default=100, help='seeds of the tripod')
    parser.add_argument('--law', choices=MUTATIONS, help='this reading only')
    args = parser.parse_args()
    laws = [args.law] if args.law else list(MUTATIONS)
    if args.seeds:
        belts(args.seeds, laws)
    if args.tripod:
        tripods(args.tripod, laws)


if __name__ == '__main__':
    main()
