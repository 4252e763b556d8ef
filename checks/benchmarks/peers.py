# SPDX-License-Identifier: Apache-2.0
"""Beside other simulators and optimisers: Exudyn, MuJoCo, SciPy, pycma. Writes a page.

`make bench` installs them into build/peers; the package itself needs none of them.

    PYTHONPATH=build/peers python checks/benchmarks/peers.py [--seeds 8] [--write docs]
"""

import argparse
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from importlib.metadata import version
from pathlib import Path
import sys
import time

import numpy as np

from checks.benchmarks import economy, measure, mujoco_models
from checks.benchmarks import exudyn_models as exudyn
from checks.benchmarks.search_belt import BELT, HIGH, LOW, PAPER_TRUTH, residuals_of, sizes
from checks.reference.belt_drive import simulate_belt
from checks.reference.tripod import simulate_tripod, TABLE_5
from checks.share import table
from ros2_ident.models import load_machine
from ros2_ident.models.belt_drive.model import CONSTANTS
from ros2_ident.models.tripod.model import Tripod
from ros2_ident.recording import Dataset
from ros2_ident.search import GeneticSearch, GeneticSettings, MANY_MINIMA, minimise
from ros2_ident.simulate.motions import draw_motion

Array = np.ndarray
ROOT = Path(__file__).resolve().parents[2]
BOUNDS = {p.name: (p.low, p.high) for p in BELT.parameters}
MEASURED = BELT.simulate(PAPER_TRUTH[None])[0]
TABLE_2 = GeneticSettings(1000, 20, 8, 12, 0.5)
TRIPOD = load_machine(ROOT / 'config' / 'tripod.yaml')
# Their delay belongs to the log and not to the simulation.
VALUES = {**TABLE_5, 'measurement_delay': 0.0}
LOUD, QUIET = 0.13, 0.01  # N m
BATCH = 64


def rms(error: Array) -> float:
    """Return the root of the mean square."""
    return float(np.sqrt(np.mean(error**2)))


def constants(theta: Array) -> dict[str, float]:
    """Return a belt drive's constants by name."""
    return dict(zip(CONSTANTS, BELT.constants(theta[None])[0].tolist(), strict=True))


def exudyn_belt_cost(parameters: Mapping[str, float]) -> float:
    """Return the cost of one candidate, simulated by Exudyn; runs in its processes."""
    theta = np.array([parameters[name] for name in BOUNDS])
    error = exudyn.belt_torque(constants(theta), BELT.cycle, BELT.reference) - MEASURED
    return float(np.sqrt(np.mean(error**2, axis=1)).mean())


def our_job() -> None:
    """Run a whole search on the belt drive."""
    search = GeneticSearch(2, TABLE_2, 1)
    found = minimise(lambda theta: BELT.cost(theta, MEASURED), search, low=LOW, high=HIGH)
    assert found.evaluations == 2760


def speed_table(
    head: tuple[str, str],
    torque: Mapping[str, Callable[[], Array]],
    error: Callable[[Array], str],
    batch: tuple[Callable[[], object], int],
    rounds: int,
) -> str:
    """Return the section on one simulation of a machine.

    Args:
        torque: One simulation by each program; that of this project is `ours`.
        batch: What is timed of ours, and how many simulations it does.
    """
    jobs = {**torque, 'ours': batch[0]}
    times = measure.interleaved(jobs, rounds, shares={'ours': batch[1]})
    rows = [
        (
            name,
            error(torque[name]()),
            f'{1e3 * t.median:.3g}',
            f'{1.0 / t.median:.4g}',
            measure.ratio(t, times['ours']),
            f'{100.0 * t.noise:.0f}',
        )
        for name, t in times.items()
    ]
    figures = 'ms a simulation', 'simulations a second and core', 'times ours', 'noise, %'
    return table((*head, *figures), rows)


def belt_speed(rounds: int) -> str:
    """Return the section on one simulation of the belt drive."""
    c = constants(PAPER_TRUTH)
    truth = simulate_belt(c, BELT.cycle, BELT.reference)
    theta = LOW + np.random.default_rng(0).random((2048, 2)) * (HIGH - LOW)
    belt = partial(exudyn.belt_torque, c, BELT.cycle, BELT.reference)
    torque = {
        'ours': lambda: BELT.simulate(PAPER_TRUTH[None])[0],
        'Exudyn, RK67': belt,
        'Exudyn, RK44, 4 steps': partial(belt, solver='RK44', substeps=4),
        'MuJoCo, RK4, 3 steps': mujoco_models.MujocoBelt(c, BELT.cycle, BELT.reference).torque,
    }
    return speed_table(
        ('belt drive', 'torque error, %'),
        torque,
        lambda found: f'{100.0 * rms(found[1] - truth[1]) / rms(truth[1]):.2g}',
        (lambda: BELT.cost(theta, MEASURED), len(theta)),
        rounds,
    )


def belt_job(rounds: int) -> str:
    """Return the section on a whole job: 2760 simulations."""
    jobs: dict[str, Callable[[], object]] = {
        'ours, one core': lambda: [our_job() for _ in range(30)],
        'Exudyn, GeneticOptimization on two processes': partial(
            exudyn.genetic_optimization, exudyn_belt_cost, BOUNDS, 1, 2
        ),
    }
    times = measure.interleaved(jobs, rounds, time.perf_counter, {'ours, one core': 30})
    rows = [
        (name, f'{t.median:.3g}', f'{t.least:.3g}', measure.ratio(t, times['ours, one core']))
        for name, t in times.items()
    ]
    head = '2760 simulations, settings of Table 2', 's, median', 's, minimum', 'times ours'
    return table(head, rows)


def belt_task(seed: int) -> economy.Task:
    """Return the belt drive with a truth anywhere in the box, without noise."""
    truth = LOW + np.random.default_rng([2760, seed]).random(2) * (HIGH - LOW)
    measured = BELT.simulate(truth[None])[0]
    size = sizes(measured)

    def cost_of(row: Array) -> float:
        parts = np.sqrt(np.mean((row.reshape(2, -1) * size[:, None]) ** 2, axis=1))
        return float(parts.mean())

    return economy.Task(
        tuple(BOUNDS),
        LOW,
        HIGH,
        truth,
        np.ones(2, dtype=bool),
        lambda theta: BELT.cost(theta, measured),
        residuals_of(measured),
        cost_of,
        1e-7,
    )


def mujoco_trials(seeds: int) -> list[economy.Trial]:
    """Return trials of `mujoco.sysid` on its own simulator, from starts anywhere in the box."""
    trials = []
    for seed in range(seeds):
        task = belt_task(seed)
        measured = BELT.simulate(task.truth[None])[0]
        start = LOW + np.random.default_rng([7, seed]).random(2) * (HIGH - LOW)
        model = mujoco_models.MujocoBelt(constants(start), BELT.cycle, BELT.reference)
        before = time.perf_counter()
        found, count = model.identify(
            measured, sizes(measured), BOUNDS, dict(zip(BOUNDS, start.tolist(), strict=True))
        )
        error = np.abs(np.array([found[name] for name in BOUNDS]) / task.truth - 1.0)
        reached = float(count) if (error < economy.WITHIN).all() else np.inf
        trials.append(economy.Trial(reached, count, time.perf_counter() - before))
    return trials


def economy_row(name: str, trials: Sequence[economy.Trial]) -> tuple[object, ...]:
    """Return a table row on the trials of one method."""
    reached = np.sort([t.reached for t in trials])
    good = int(np.isfinite(reached).sum())
    # The least count within which 95 of 100 runs have found the truth.
    needed = reached[int(np.ceil(0.95 * len(reached))) - 1]
    middle = reached[(len(reached) - 1) // 2]
    return (
        name,
        f'{good} of {len(reached)}',
        f'{middle:.0f}' if np.isfinite(middle) else '-',
        f'{needed:.0f}' if np.isfinite(needed) else 'not reached',
        f'{np.median([t.simulations for t in trials]):.0f}',
        f'{np.median([t.seconds for t in trials]):.3g}',
    )


ECONOMY_HEAD = (
    'method',
    'found',
    'simulations to 1 %, median',
    'for 95 % success',
    'simulations of a run',
    's a run',
)


def belt_economy(seeds: int, starts: int, budget: int) -> str:
    """Return the section on how many simulations the belt drive takes."""
    methods: dict[str, tuple[Callable[[economy.Watched, int], None], int]] = {
        'ours: MANY_MINIMA, then refinement': (
            economy.ours(MANY_MINIMA, starts=16, distance=0.01, tolerance=1e-10, most=36),
            2760,
        ),
        "the paper's genetic algorithm, Table 2, 20 survivors": (economy.genetic(TABLE_2), 2760),
        "Exudyn's GeneticOptimization on our simulator": (economy.exudyn_genetic, 2760),
        "SciPy's differential evolution on our simulator": (economy.evolution, budget),
        'pycma with restarts on our simulator': (economy.covariance_adaptation, budget),
    }
    found = {
        name: [economy.attempt(method, belt_task(s), s, budget) for s in range(seeds)]
        for name, (method, budget) in methods.items()
    }
    found['mujoco.sysid on MuJoCo, one start'] = mujoco_trials(starts)
    return table(ECONOMY_HEAD, [economy_row(n, t) for n, t in found.items()])


def tripod_speed(rounds: int) -> str:
    """Return the section on one simulation of the tripod."""
    motion = draw_motion('pick_and_place', TRIPOD, 3.0, 7)
    course = motion.position, motion.velocity
    log = simulate_tripod(TRIPOD, VALUES, *course)
    model = Tripod(TRIPOD, Dataset(TRIPOD.drives, log.cycle, 0, *course, None, None, log.effort))
    values = [VALUES[p.name.split('.')[-1]] for p in model.parameters]
    theta = np.tile(values, (BATCH, 1))
    peer = exudyn.TripodDrive(TRIPOD, VALUES, *course)
    torque = {
        'ours': lambda: model.simulate(theta[:1])[0],
        'Exudyn, RK44, 1 step a cycle': peer.torque,
        'Exudyn, explicit midpoint, 1 step': partial(peer.torque, 'ExplicitMidpoint'),
    }
    return speed_table(
        ('tripod, 3 s, 6000 cycles', 'torque error, N m'),
        torque,
        lambda found: f'{rms(found - log.effort):.1e}',
        (lambda: model.costs(theta), BATCH),
        rounds,
    )


def tripod_economy(seeds: int, seconds: float, budget: int) -> str:
    """Return the section on how many simulations the tripod takes."""
    motion = draw_motion('pick_and_place', TRIPOD, seconds, 2011)
    methods: dict[str, tuple[Callable[[economy.Watched, int], None], int]] = {
        'ours: FEW, then refinement': (economy.ours(economy.FEW), budget),
        "the paper's genetic algorithm, Table 4": (economy.genetic(economy.TABLE_4), 1728),
        "SciPy's differential evolution": (economy.evolution, budget),
        'pycma with restarts': (economy.covariance_adaptation, budget),
    }
    parts = []
    for noise in (QUIET, LOUD):
        trials: dict[str, list[economy.Trial]] = {name: [] for name in methods}
        counts: dict[str, int] = {}
        machine = replace(TRIPOD, effort_noise=noise)
        for seed in range(seeds):
            with economy.tripod_task(machine, motion, noise, seed) as task:
                if not task.judged.any():
                    continue
                for name, judged in zip(task.names, task.judged, strict=True):
                    counts[name] = counts.get(name, 0) + int(judged)
                for name, (method, budget) in methods.items():
                    trials[name].append(economy.attempt(method, task, seed, budget))
            print(f'tripod, {noise} N m: seed {seed} done', file=sys.stderr, flush=True)
        known = ', '.join(f'{n.replace("_", " ")} {c}' for n, c in counts.items() if c)
        if not known:
            parts.append(f'Noise {noise} N m: so short a log determines nothing within 1 %.\n')
            continue
        parts.append(
            f'Noise {noise} N m; judged (in how many of {seeds} machines): {known}.\n\n'
            + table(ECONOMY_HEAD, [economy_row(n, t) for n, t in trials.items()])
        )
    return '\n'.join(parts)


PAGE = Path(__file__).with_name('peers_page.md')


def main() -> None:
    """Run everything, print what comes out, and write the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--seeds', type=int, default=8, help='runs on the tripod, each noise')
    parser.add_argument('--belts', type=int, default=20, help='runs on the belt drive')
    parser.add_argument('--starts', type=int, default=3, help='of mujoco.sysid')
    parser.add_argument('--budget', type=int, default=6000, help='simulations of SciPy and pycma')
    parser.add_argument('--rounds', type=int, default=9, help='rounds of the timings')
    parser.add_argument('--seconds', type=float, default=10.0, help='recording for the tripod')
    parser.add_argument('--write', type=Path, metavar='FOLDER', help='for benchmarks.md; build')
    args = parser.parse_args()
    started = time.monotonic()
    said = [
        f'--{name} {value}'
        for name, value in vars(args).items()
        if value != parser.get_default(name)
    ]
    parts = {
        'arguments': ''.join(f' {x}' for x in said),
        'machine': measure.machine(),
        'versions': ', '.join(f'{n} {version(n)}' for n in ('exudyn', 'mujoco', 'scipy', 'cma')),
        'rounds': args.rounds,
        'batch': BATCH,
        'seconds': args.seconds,
        'budget': args.budget,
        'few': economy.FEW.evaluations,
    }
    for name, section in (
        ('belt_speed', partial(belt_speed, args.rounds)),
        ('belt_job', partial(belt_job, max(1, args.rounds // 6))),
        ('tripod_speed', partial(tripod_speed, args.rounds)),
        ('belt_economy', partial(belt_economy, args.belts, args.starts, args.budget)),
        ('tripod_economy', partial(tripod_economy, args.seeds, args.seconds, args.budget)),
    ):
        parts[name] = section()
        seconds = time.monotonic() - started
        print(
            f'\n{name.replace("_", ", ")} ({seconds:.0f} s)\n', parts[name], sep='\n', flush=True
        )
    page = (args.write or ROOT / 'build') / 'benchmarks.md'
    page.parent.mkdir(parents=True, exist_ok=True)
    page.write_text(PAGE.read_text(encoding='utf-8').format(**parts), encoding='utf-8')
    print(f'{page} is written')


if __name__ == '__main__':
    main()
