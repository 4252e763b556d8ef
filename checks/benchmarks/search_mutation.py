# SPDX-License-Identifier: Apache-2.0
"""Which mutation law shall be the default? Success and error of both on several costs.

Run: python checks/benchmarks/search_mutation.py [--seeds 40]
"""

import argparse
from pathlib import Path

import numpy as np

from checks.belt_matrix import step_reference
from ros2_ident.models import load_machine
from ros2_ident.models.belt_drive.model import BeltDrive
from ros2_ident.search import GeneticSearch, GeneticSettings, MANY_MINIMA, minimise

MACHINE = load_machine(Path(__file__).parents[2] / 'config' / 'belt_drive.yaml')
BELT = BeltDrive(MACHINE, *step_reference())
BOX = np.array([p.low for p in BELT.parameters]), np.array([p.high for p in BELT.parameters])


def belt(dimension, rng):
    """Return the belt drive's cost with a truth anywhere in its box, and that truth."""
    truth = rng.random(2)
    measured = BELT.simulate((BOX[0] + truth * (BOX[1] - BOX[0]))[None, :])[0]
    return lambda u: BELT.cost(BOX[0] + u * (BOX[1] - BOX[0]), measured), truth


def sphere(dimension, rng):
    """Return a quadratic bowl."""
    truth = rng.random(dimension)
    return lambda u: np.square(u - truth).sum(axis=1), truth


def rastrigin(dimension, rng):
    """Return a bowl with about ten dents along every coordinate."""
    truth = rng.random(dimension)

    def cost(u):
        x = 10.24 * (u - truth)
        return (x**2 + 10.0 - 10.0 * np.cos(2.0 * np.pi * x)).sum(axis=1)

    return cost, truth


def valley(dimension, rng):
    """Return a narrow curved valley (Rosenbrock), its end anywhere in the cube."""
    truth = rng.random(dimension)

    def cost(u):
        x = 1.0 + 4.0 * (u - truth)
        return (100.0 * (x[:, 1:] - x[:, :-1] ** 2) ** 2 + (1.0 - x[:, :-1]) ** 2).sum(axis=1)

    return cost, truth


COSTS = {
    'belt drive, 2': (belt, 2),
    'sphere, 2': (sphere, 2),
    'sphere, 5': (sphere, 5),
    'Rastrigin, 2': (rastrigin, 2),
    'Rastrigin, 5': (rastrigin, 5),
    'Rosenbrock, 2': (valley, 2),
    'Rosenbrock, 5': (valley, 5),
}
SETTINGS = {
    'Table 4': {},
    'Table 2, 20 survivors': {'initial_population': 1000, 'survivors': 20},
    'MANY_MINIMA': {
        name: getattr(MANY_MINIMA, name)
        for name in (
            'initial_population',
            'survivors',
            'children',
            'generations',
            'range_reduction',
            'min_distance',
            'first_step',
            'first_generation',
        )
    },
}


def main():
    """Print success rates and median errors of both laws."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--seeds', type=int, default=40)
    seeds = parser.parse_args().seeds
    print('settings | cost, parameters | within 0.02 of the box, % (root, Laplace) | median error')
    for name, chosen in SETTINGS.items():
        for title, (make, dimension) in COSTS.items():
            errors = {}
            for law in ('gaussian_root', 'laplace'):
                settings = GeneticSettings(mutation=law, **chosen)
                found = []
                for seed in range(seeds):
                    cost, truth = make(dimension, np.random.default_rng([7, seed]))
                    result = minimise(
                        cost,
                        GeneticSearch(dimension, settings, seed),
                        low=np.zeros(dimension),
                        high=np.ones(dimension),
                    )
                    found.append(np.abs(result.theta - truth).max())
                errors[law] = np.array(found)
            rates = [100.0 * np.mean(e < 0.02) for e in errors.values()]
            middle = [np.median(e) for e in errors.values()]
            print(
                f'{name} | {title} | {rates[0]:.0f}, {rates[1]:.0f} | '
                f'{middle[0]:.1e}, {middle[1]:.1e}',
                flush=True,
            )


if __name__ == '__main__':
    main()
