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

sys.path.insert(0, str(Path(__file__).parent))

import economy  # noqa: E402
import exudyn_models as exudyn  # noqa: E402
import measure  # noqa: E402
import mujoco_models  # noqa: E402
import numpy as np  # noqa: E402

from checks.belt_matrix import cost_generic, simulate_generic, step_reference  # noqa: E402
from checks.reference.belt_drive import simulate_belt  # noqa: E402
from checks.reference.tripod import simulate_tripod  # noqa: E402
from ros2_ident.lanes import WIDTH  # noqa: E402
from ros2_ident.models import load_machine  # noqa: E402
from ros2_ident.models.belt_drive.model import BeltDrive, CONSTANTS  # noqa: E402
from ros2_ident.models.tripod.model import Tripod  # noqa: E402
from ros2_ident.recording import Dataset  # noqa: E402
from ros2_ident.search import (  # noqa: E402
    GeneticSearch,
    GeneticSettings,
    MANY_MINIMA,
    minimise,
    ThreadedEvaluator,
)
from ros2_ident.simulate.motions import draw_motion  # noqa: E402

Array = np.ndarray
ROOT = Path(__file__).resolve().parents[2]
BELT = BeltDrive(load_machine(ROOT / 'config' / 'belt_drive.yaml'), *step_reference())
LOW = np.array([p.low for p in BELT.parameters])
HIGH = np.array([p.high for p in BELT.parameters])
BOUNDS = {p.name: (p.low, p.high) for p in BELT.parameters}
PAPER = np.array([2e5, 45.0])
MEASURED = BELT.simulate(PAPER[None])[0]
TABLE_2 = GeneticSettings(1000, 20, 8, 12, 0.5)
TRIPOD = load_machine(ROOT / 'config' / 'tripod.yaml')
# Table 5 of the paper; its delay belongs to the log and not to the simulation.
VALUES = {
    'measurement_delay': 0.0,
    'gear_stiffness': 232139.0,
    'gear_damping_ratio': 0.396306,
    'tool_mass': 1.76244,
    'drive_inertia': 89.0817e-6,
    'coulomb_torque': 0.05,
    'viscous_torque': 0.05,
}
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


# ---------------------------------------------------------------------- memory, in own processes


def memory_of_ours() -> Callable[[], object]:
    """Prepare a batch of tripod simulations."""
    model, _ = tripod(3.0)
    theta = np.repeat(tripod_theta(model), BATCH, axis=0)
    model.costs(theta[:1])
    return lambda: model.costs(theta)


def memory_of_exudyn() -> Callable[[], object]:
    """Prepare a tripod simulation in Exudyn."""
    motion = draw_motion('pick_and_place', TRIPOD, 3.0, 7)
    return exudyn.TripodDrive(TRIPOD, VALUES, motion.position, motion.velocity).torque


def memory_of_our_belt() -> Callable[[], object]:
    """Prepare a whole job of the belt drive."""
    return lambda: our_job(TABLE_2)


def memory_of_exudyn_belt() -> Callable[[], object]:
    """Prepare a belt drive in Exudyn."""
    return lambda: exudyn_belt_cost(dict(zip(BOUNDS, PAPER.tolist(), strict=True)))


def memory_of_mujoco_belt() -> Callable[[], object]:
    """Prepare a belt drive in MuJoCo."""
    return mujoco_models.MujocoBelt(constants(PAPER), BELT.cycle, BELT.reference).torque


# ---------------------------------------------------------------------- belt drive


def our_job(settings: GeneticSettings, cost: Callable[[Array], Array] | None = None) -> int:
    """Run a whole search on the belt drive; return its simulations."""
    result = minimise(
        cost or (lambda theta: BELT.cost(theta, MEASURED)),
        GeneticSearch(2, settings, 1),
        low=LOW,
        high=HIGH,
    )
    return result.evaluations


def belt_speed(rounds: int) -> tuple[str, dict[str, measure.Timing]]:
    """Return the section on one simulation of the belt drive."""
    c = constants(PAPER)
    truth = simulate_belt(c, BELT.cycle, BELT.reference)
    size = rms(truth[1])
    mujoco = mujoco_models.MujocoBelt(c, BELT.cycle, BELT.reference)
    theta = LOW + np.random.default_rng(0).random((2048, 2)) * (HIGH - LOW)
    belt = partial(exudyn.belt_torque, c, BELT.cycle, BELT.reference)
    torque = {
        'ours, exact': lambda: BELT.simulate(PAPER[None])[0],
        'ours, generic': lambda: simulate_generic(BELT, PAPER[None])[0],
        'Exudyn, first order, RK67': belt,
        'Exudyn, first order, RK44, 4 steps': partial(belt, solver='RK44', substeps=4),
        'Exudyn, mass and stiffness, RK67': partial(belt, second_order=True),
        'MuJoCo, RK4, 3 steps': mujoco.torque,
    }
    jobs: dict[str, Callable[[], object]] = dict(torque)
    jobs['ours, exact'] = lambda: BELT.cost(theta, MEASURED)
    jobs['ours, generic'] = lambda: cost_generic(BELT, theta[:256], MEASURED)
    times = measure.interleaved(
        jobs, rounds, shares={'ours, exact': len(theta), 'ours, generic': 256}
    )
    exact, generic = times['ours, exact'], times['ours, generic']
    rows = [
        (
            name,
            f'{100.0 * rms(torque[name]()[1] - truth[1]) / size:.2g}',
            f'{1e3 * t.median:.3g}',
            f'{1.0 / t.median:.0f}',
            measure.ratio(t, exact),
            measure.ratio(t, generic),
            f'{100.0 * t.noise:.0f}',
        )
        for name, t in times.items()
    ]
    text = measure.table(
        (
            'belt drive',
            'torque error, %',
            'ms a simulation',
            'simulations a second and core',
            'times ours, exact',
            'times ours, generic',
            'noise, %',
        ),
        rows,
    )
    return text, times


def belt_job(rounds: int) -> str:
    """Return the section on a whole job: 2760 simulations."""
    spent = 0.0

    def timed(theta: Array) -> Array:
        nonlocal spent
        before = time.process_time()
        told = BELT.cost(theta, MEASURED)
        spent += time.process_time() - before
        return told

    shares = []
    for _ in range(60):
        spent, before = 0.0, time.process_time()
        assert our_job(TABLE_2, timed) == 2760
        shares.append(1.0 - spent / (time.process_time() - before))

    def theirs() -> None:
        exudyn.genetic_optimization(exudyn_belt_cost, BOUNDS, 1, 2)

    ours, exudyn_times, processor = [], [], []
    for _ in range(rounds):
        for _ in range(30):
            before = time.perf_counter()
            our_job(TABLE_2)
            ours.append(time.perf_counter() - before)
        used = measure.children_seconds()
        before = time.perf_counter()
        theirs()
        exudyn_times.append(time.perf_counter() - before)
        processor.append(measure.children_seconds() - used)
    mine, other = measure.Timing(tuple(ours)), measure.Timing(tuple(exudyn_times))
    text = measure.table(
        ('2760 simulations, settings of Table 2', 's, median', 's, minimum', 'times ours'),
        [
            ('ours, one core', f'{mine.median:.4f}', f'{mine.least:.4f}', 1),
            (
                'Exudyn, GeneticOptimization on two processes',
                f'{other.median:.1f}',
                f'{other.least:.1f}',
                measure.ratio(other, mine),
            ),
        ],
    )
    return text + (
        f'\nOf our time, {100.0 * float(np.median(shares)):.0f} % (median; minimum '
        f'{100.0 * min(shares):.0f} %) is the genetic algorithm and the driver around it, the '
        f"rest simulation. Exudyn's two processes together took {np.median(processor):.1f} s of "
        'processor time.\n'
    )


def belt_task(seed: int) -> economy.Task:
    """Return the belt drive with a truth anywhere in the box, without noise."""
    truth = LOW + np.random.default_rng([2760, seed]).random(2) * (HIGH - LOW)
    measured = BELT.simulate(truth[None])[0]
    size = np.sqrt(np.mean((measured - [BELT.reference, 0.0 * BELT.reference]) ** 2, axis=1))

    def residuals(theta: Array) -> Array:
        return ((BELT.simulate(theta) - measured) / size[:, None]).reshape(len(theta), -1)

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
        residuals,
        cost_of,
        1e-7,
    )


def mujoco_trials(seeds: int) -> tuple[list[economy.Trial], float]:
    """Return trials of `mujoco.sysid` on its own simulator, from starts anywhere in the box."""
    trials = []
    for seed in range(seeds):
        task = belt_task(seed)
        measured = BELT.simulate(task.truth[None])[0]
        size = np.sqrt(np.mean((measured - [BELT.reference, 0.0 * BELT.reference]) ** 2, axis=1))
        start = LOW + np.random.default_rng([7, seed]).random(2) * (HIGH - LOW)
        model = mujoco_models.MujocoBelt(constants(start), BELT.cycle, BELT.reference)
        before = time.perf_counter()
        found, count = model.identify(
            measured, size, BOUNDS, dict(zip(BOUNDS, start.tolist(), strict=True))
        )
        error = np.abs(np.array([found[name] for name in BOUNDS]) / task.truth - 1.0)
        reached = float(count) if (error < economy.WITHIN).all() else np.inf
        trials.append(economy.Trial(reached, count, time.perf_counter() - before))
    return trials, sum(t.seconds for t in trials)


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


def belt_economy(
    seeds: int, starts: int, budget: int
) -> tuple[str, dict[str, list[economy.Trial]]]:
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
    found['mujoco.sysid on MuJoCo, one start'], _ = mujoco_trials(starts)
    text = measure.table(ECONOMY_HEAD, [economy_row(n, t) for n, t in found.items()])
    return text, found


# ---------------------------------------------------------------------- tripod


def tripod(seconds: float) -> tuple[Tripod, Array]:
    """Return our model on a pick-and-place motion, and the reference's torque (3, K)."""
    motion = draw_motion('pick_and_place', TRIPOD, seconds, 7)
    log = simulate_tripod(TRIPOD, VALUES, motion.position, motion.velocity)
    data = Dataset(
        TRIPOD.drives, log.cycle, 0, motion.position, motion.velocity, None, None, log.effort
    )
    return Tripod(TRIPOD, data), log.effort


def tripod_theta(model: Tripod) -> Array:
    """Return (1, N) the true parameters."""
    return np.array([[VALUES[p.name.split('.')[-1]] for p in model.parameters]])


def tripod_speed(rounds: int) -> tuple[str, dict[str, measure.Timing]]:
    """Return the section on one simulation of the tripod."""
    model, truth = tripod(3.0)
    theta = np.repeat(tripod_theta(model), BATCH, axis=0)
    peer = exudyn.TripodDrive(
        TRIPOD, VALUES, model.data.command_position, model.data.command_velocity
    )
    torque: dict[str, Callable[[], Array]] = {
        'ours': lambda: model.simulate(theta[:1])[0],
        'Exudyn, RK44, 1 step a cycle': peer.torque,
        'Exudyn, explicit midpoint, 1 step': partial(peer.torque, 'ExplicitMidpoint'),
    }
    jobs: dict[str, Callable[[], object]] = dict(torque)
    jobs['ours'] = lambda: model.costs(theta)
    times = measure.interleaved(jobs, rounds, shares={'ours': BATCH})
    rows = [
        (
            name,
            f'{rms(torque[name]() - truth):.1e}',
            f'{1e3 * t.median:.3g}',
            f'{1.0 / t.median:.3g}',
            measure.ratio(t, times['ours']),
            f'{100.0 * t.noise:.0f}',
        )
        for name, t in times.items()
    ]
    text = measure.table(
        (
            'tripod, 3 s, 6000 cycles',
            'torque error, N m',
            'ms a simulation',
            'simulations a second and core',
            'times ours',
            'noise, %',
        ),
        rows,
    )
    return text, times


def tripod_economy(
    seeds: int, seconds: float, budget: int
) -> tuple[str, dict[float, dict[str, list]]]:
    """Return the section on how many simulations the tripod takes."""
    motion = draw_motion('pick_and_place', TRIPOD, seconds, 2011)
    methods: dict[str, tuple[Callable[[economy.Watched, int], None], int]] = {
        'ours: FEW, then refinement': (economy.ours(economy.FEW), budget),
        "the paper's genetic algorithm, Table 4": (economy.genetic(economy.TABLE_4), 1728),
        "SciPy's differential evolution": (economy.evolution, budget),
        'pycma with restarts': (economy.covariance_adaptation, budget),
    }
    parts, found = [], {}
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
            + measure.table(ECONOMY_HEAD, [economy_row(n, t) for n, t in trials.items()])
        )
        found[noise] = trials
    return '\n'.join(parts), found


# ---------------------------------------------------------------------- growth


def growth(rounds: int, path: Path) -> str:
    """Draw how time grows with recording, candidates, parameters and cores; return the words."""
    lengths = (1.0, 3.0, 10.0)
    models = {seconds: tripod(seconds)[0] for seconds in lengths}
    jobs: dict[str, Callable[[], object]] = {}
    for seconds, model in models.items():
        theta = np.repeat(tripod_theta(model), BATCH, axis=0)
        peer = exudyn.TripodDrive(
            TRIPOD, VALUES, model.data.command_position, model.data.command_velocity
        )
        jobs[f'ours {seconds}'] = partial(model.costs, theta)
        jobs[f'Exudyn {seconds}'] = peer.torque
    longest = measure.interleaved(
        jobs, max(3, rounds // 3), shares={name: WIDTH for name in jobs if name.startswith('ours')}
    )
    model = models[1.0]
    counts = (1, 8, 16, 64, 256)
    batches = {
        str(n): partial(model.costs, np.repeat(tripod_theta(model), n, axis=0)) for n in counts
    }
    many = measure.interleaved(batches, rounds)
    drives = (1, 2, 3)
    jacobians: dict[str, Callable[[], object]] = {}
    sizes = []
    for number in drives:
        data = replace(model.data, position=model.data.command_position)
        part = Tripod(TRIPOD, data, drives=TRIPOD.drives[:number])
        # A Jacobian by forward differences: the point itself and one candidate a parameter.
        theta = np.repeat(tripod_theta(part), len(part.parameters) + 1, axis=0)
        sizes.append(len(part.parameters))
        jacobians[str(number)] = partial(part.residuals, theta)
    wide = measure.interleaved(jacobians, rounds)
    theta = np.repeat(tripod_theta(model), 256, axis=0)
    with ThreadedEvaluator(model.costs, 2) as two:
        cores = measure.interleaved(
            {'1': lambda: model.costs(theta), '2': lambda: two(theta)}, rounds, time.perf_counter
        )
    with measure.picture(path, 3) as (left, middle, right):
        for name in ('ours', 'Exudyn'):
            y = [1e3 * longest[f'{name} {s}'].median for s in lengths]
            left.loglog(lengths, y, 'o-', label=name)
        left.set(xlabel='recording, s', ylabel='ms a simulation', title='length')
        left.legend()
        y = [1e3 * many[str(n)].median for n in counts]
        middle.loglog(counts, y, 'o-')
        middle.set(xlabel='candidates', ylabel='ms a batch of 1 s', title='candidates')
        right.plot(sizes, [1e3 * wide[str(n)].median for n in drives], 'o-')
        right.set(
            xlabel='parameters', ylabel='ms a Jacobian of 1 s', title='parameters', ylim=(0, None)
        )
    first, last = longest['ours 1.0'], longest['ours 10.0']
    return (
        f'A recording ten times as long takes {last.median / first.median:.1f} times as long. '
        f'{WIDTH} candidates share a vector, so a batch of 1 costs as much as one of {WIDTH} '
        f'({many["1"].median / many["8"].median:.2f} times), and 256 take '
        f'{many["256"].median / many["8"].median:.1f} times as long as {WIDTH}. A Jacobian of '
        f'{sizes[-1]} parameters takes {wide["3"].median / wide["1"].median:.1f} times as long as '
        f'one of {sizes[0]}. Two threads are '
        f'{cores["1"].median / cores["2"].median:.2f} times as fast as one (clock, medians).\n'
    )


# ---------------------------------------------------------------------- pictures and page


def speed_picture(path: Path, belt: Mapping, tripod_times: Mapping) -> None:
    """Draw simulations per second and core."""
    with measure.picture(path, 2) as axes:
        for ax, times, title in zip(
            axes, (belt, tripod_times), ('belt drive, 1 s', 'tripod, 3 s'), strict=True
        ):
            names = list(times)[::-1]
            ax.barh(
                names,
                [1.0 / times[n].median for n in names],
                color=['C0' if n.startswith('ours') else 'C1' for n in names],
            )
            ax.set(xscale='log', title=f'{title}: simulations', xlabel='a second and core')
            ax.set_xlim(1.0, None)


def economy_picture(path: Path, panels: Mapping[str, Mapping[str, Sequence]]) -> None:
    """Draw the share of runs that have found the truth over the simulations they took."""
    colours: dict[str, str] = {}
    with measure.picture(path, len(panels)) as axes:
        for ax, (title, methods) in zip(axes, panels.items(), strict=True):
            for name, trials in methods.items():
                reached = np.sort([t.reached for t in trials])
                share = np.arange(1, len(reached) + 1) / len(reached)
                there = np.isfinite(reached)
                end = max(t.simulations for t in trials)
                x = np.concatenate([[1.0], reached[there], [end]])
                y = np.concatenate([[0.0], share[there], [there.mean()]])
                short = name.split(',')[0].split(' on ')[0]
                colour = colours.setdefault(short.split(':')[0], f'C{len(colours)}')
                ax.step(x, 100.0 * y, where='post', label=short, color=colour)
            ax.set(xscale='log', xlabel='simulations', title=title, xlim=(10, None))
            ax.set_ylim(-3, 103)
            ax.legend(fontsize=6, loc='center left')
        axes[0].set_ylabel('runs within 1 %, %')


def memory_table() -> str:
    """Return the section on memory."""
    jobs = {
        'tripod, ours, 64 candidates at once': 'memory_of_ours',
        'tripod, Exudyn, one': 'memory_of_exudyn',
        'belt drive, ours, 2760 simulations': 'memory_of_our_belt',
        'belt drive, Exudyn, one': 'memory_of_exudyn_belt',
        'belt drive, MuJoCo, one': 'memory_of_mujoco_belt',
    }
    rows = [
        (name, f'{measure.memory(f"peers:{job}", Path(__file__).parent):.1f}')
        for name, job in jobs.items()
    ]
    return measure.table(('job', 'MB beside imports and inputs'), rows)


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
    parser.add_argument(
        '--write',
        type=Path,
        metavar='FOLDER',
        help='for benchmarks.md and its pictures; build by default',
    )
    args = parser.parse_args()
    pictures = (args.write or ROOT / 'build') / 'benchmarks'
    started = time.monotonic()

    def say(what: str, *sections: str) -> None:
        print(f'\n{what} ({time.monotonic() - started:.0f} s)\n')
        print(*sections, sep='\n', flush=True)

    belt_text, belt_times = belt_speed(args.rounds)
    say('Belt drive: one simulation', belt_text)
    job_text = belt_job(max(1, args.rounds // 6))
    say('Belt drive: a whole job', job_text)
    tripod_text, tripod_times = tripod_speed(args.rounds)
    say('Tripod: one simulation', tripod_text)
    growth_text = growth(args.rounds, pictures / 'growth.png')
    memory_text = memory_table()
    say('Growth and memory', growth_text, memory_text)
    belt_economy_text, belt_trials = belt_economy(args.belts, args.starts, args.budget)
    say('Belt drive: simulations to 1 %', belt_economy_text)
    tripod_economy_text, tripod_trials = tripod_economy(args.seeds, args.seconds, args.budget)
    say('Tripod: simulations to 1 %', tripod_economy_text)
    speed_picture(pictures / 'speed.png', belt_times, tripod_times)
    economy_picture(
        pictures / 'economy.png',
        {'belt drive': belt_trials}
        | {f'tripod, {noise} N m': trials for noise, trials in tripod_trials.items()},
    )
    said = [
        f'--{name} {value}'
        for name, value in vars(args).items()
        if value != parser.get_default(name)
    ]
    text = PAGE.read_text(encoding='utf-8').format(
        arguments=''.join(f' {x}' for x in said),
        machine=measure.machine(),
        versions=', '.join(f'{n} {version(n)}' for n in ('exudyn', 'mujoco', 'scipy', 'cma')),
        rounds=args.rounds,
        belt_speed=belt_text,
        belt_job=job_text,
        tripod_speed=tripod_text,
        batch=BATCH,
        belt_economy=belt_economy_text,
        tripod_economy=tripod_economy_text,
        seconds=args.seconds,
        budget=args.budget,
        few=economy.FEW.evaluations,
        growth=growth_text,
        memory=memory_text,
    )
    page = pictures.with_suffix('.md')
    page.write_text(text, encoding='utf-8')
    say(f'{page} is written')


if __name__ == '__main__':
    main()
