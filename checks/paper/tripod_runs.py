# SPDX-License-Identifier: Apache-2.0
"""Section 4 of the paper: one tripod drive, and all three, identified many times, as numbers."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
import tempfile

import numpy as np
from numpy.typing import NDArray

from checks.paper.belt import shipped_machine
from checks.reference.plant import Log
from checks.reference.tripod import PUBLISHED, simulate_tripod
from ros2_ident.identify.data import Data
from ros2_ident.identify.run import identify, read_data
from ros2_ident.identify.settings import IdentifySettings
from ros2_ident.models import Machine, make_model
from ros2_ident.models.registry import space_of
from ros2_ident.recording import Dataset, write_bag
from ros2_ident.search import GeneticSettings
from ros2_ident.simulate.bag import make_streams, Nuisance
from ros2_ident.simulate.motions import draw_motion, Motion

Array = NDArray[np.float64]

# What the reference machine is made of.
TRUTH: Mapping[str, float] = PUBLISHED
# Known beforehand, as in the paper, which gives no values: N m and N m s/m.
FRICTION: Mapping[str, float] = {'coulomb_torque': 0.06, 'viscous_torque': 0.08}
ONE = 'drive_1'
LOUD, QUIET = 0.13, 0.01  # N m: the paper's residual, and a good drive's noise


@dataclass(frozen=True)
class Plan:
    """What is run.

    Attributes:
        seconds: Duration of the log, s.
        close: Begin and end of Fig. 13, s.
        genetic: The genetic algorithm, Table 4, before the distance is put in.
        speed: Largest speed of the platform, m/s.
        acceleration: Largest acceleration of the platform, m/s².
    """

    seconds: float = 10.0
    close: tuple[float, float] = (7.5, 9.0)
    genetic: GeneticSettings = GeneticSettings()
    motion_seed: int = 2011
    speed: float = 1.5
    acceleration: float = 45.0


@dataclass(frozen=True)
class Case:
    """One row of experiments.

    Attributes:
        noise: Standard deviation of the logged torque, N m.
        all_drives: Whether all three drives are identified, or one beside two that follow.
        distance: d_min,0.
    """

    noise: float
    all_drives: bool
    distance: float

    @property
    def drives(self) -> list[str] | None:
        """The drives to identify."""
        return None if self.all_drives else [ONE]


# In eleven dimensions the distance binds in few searches (a test shows it): one is enough there.
CASES = (
    Case(LOUD, False, 0.0),
    Case(LOUD, False, 0.5),
    Case(QUIET, False, 0.0),
    Case(QUIET, False, 0.5),
    Case(LOUD, True, 0.0),
    Case(QUIET, True, 0.0),
)


@dataclass(frozen=True)
class DriveTrial:
    """One identification.

    Attributes:
        seed: Of the noise and of the search.
        names: (N,) parameters.
        truth: (N,) behind the log.
        ga: (N,) what the genetic algorithm found.
        found: (N,) after the refinement.
        low: (N,) lower ends of the 95 % intervals.
        high: (N,) upper ends.
        ga_cost: Residual of the genetic algorithm's result, eq. 2, N m.
        cost: The same after the refinement.
        ga_evaluations: Simulations of the genetic algorithm.
        evaluations: Simulations with the refinement.
        candidates: (E, N) every candidate of the genetic algorithm; kept for seed 0 only.
        costs: (E,) its cost, inf where it diverged.
        generations: (E,) its generation, from 1.
    """

    seed: int
    names: tuple[str, ...]
    truth: Array
    ga: Array
    found: Array
    low: Array
    high: Array
    ga_cost: float
    cost: float
    ga_evaluations: int
    evaluations: int
    candidates: Array
    costs: Array
    generations: NDArray[np.int64]

    @property
    def ga_error(self) -> Array:
        """Signed relative errors (N,) of the genetic algorithm."""
        return self.ga / self.truth - 1.0

    @property
    def error(self) -> Array:
        """Signed relative errors (N,) after the refinement."""
        return self.found / self.truth - 1.0

    @property
    def half_width(self) -> Array:
        """Half the 95 % intervals (N,), relative to the truth."""
        return 0.5 * (self.high - self.low) / self.truth

    @property
    def covered(self) -> NDArray[np.bool_]:
        """Whether the intervals (N,) hold the truth."""
        return (self.low <= self.truth) & (self.truth <= self.high)

    def columns(self, name: str) -> NDArray[np.int64]:
        """Return the columns of a parameter, one for each drive that has its own."""
        ends = [i for i, full in enumerate(self.names) if full.split('.')[-1] == name]
        return np.array(ends, dtype=np.int64)


class Bench:
    """The reference tripod on its motion, and logs of it."""

    def __init__(self, plan: Plan) -> None:
        self.plan = plan
        self.machine: Machine = shipped_machine('tripod')
        space = space_of(self.machine)
        space = replace(space, speed=plan.speed, acceleration=plan.acceleration)
        self.motion: Motion = draw_motion(
            'pick_and_place', self.machine, plan.seconds, plan.motion_seed, space
        )
        self.log: Log = simulate_tripod(
            self.machine, {**TRUTH, **FRICTION}, self.motion.position, self.motion.velocity
        )

    def machine_of(self, noise: float) -> Machine:
        """Return the machine with the noise that its log has."""
        return replace(self.machine, effort_noise=noise)

    def data(self, noise: float, seed: int) -> Data:
        """Return what is read back from a bag with a draw of noise, jitter and losses."""
        streams = make_streams(
            self.log, self.motion, Nuisance(effort_noise=noise), np.random.default_rng(seed)
        )
        with tempfile.TemporaryDirectory() as folder:
            written = write_bag(Path(folder) / 'tripod', streams)
            return read_data(written, self.machine_of(noise))

    def trial(self, case: Case, seed: int) -> DriveTrial:
        """Identify once."""
        found = identify(
            self.machine_of(case.noise),
            self.data(case.noise, seed),
            drives=case.drives,
            fixed=FRICTION,
            settings=IdentifySettings(
                genetic=replace(self.plan.genetic, min_distance=case.distance),
                give_up=False,  # the figures show every candidate's cost
            ),
            seed=seed,
        )
        names = tuple(p.name for p in found.parameters)
        history = found.history
        kept = slice(None) if seed == 0 else slice(0, 0)
        return DriveTrial(
            seed=seed,
            names=names,
            truth=np.array([TRUTH[name.split('.')[-1]] for name in names]),
            ga=np.array([p.ga_value for p in found.parameters]),
            found=found.theta,
            low=np.array([p.low for p in found.parameters]),
            high=np.array([p.high for p in found.parameters]),
            ga_cost=found.cost.ga,
            cost=found.best_cost,
            ga_evaluations=len(history.costs),
            evaluations=found.evaluations,
            candidates=history.candidates[kept],
            costs=history.costs[kept],
            generations=history.generations[kept],
        )

    def simulated(self, dataset: Dataset, theta: Array) -> Array:
        """Return the logged torque (S, K) of the one drive for candidates (S, 5)."""
        model = make_model(self.machine, dataset, drives=[ONE], fixed=_of_all(FRICTION))
        return np.asarray(model.simulate(np.atleast_2d(theta))[:, 0])

    def influence(self, share: float = 0.1) -> dict[str, float]:
        """Return what one parameter's shift by a share of its box costs, N m, without noise.

        The larger of both directions that stay in the box, all others at the truth.
        """
        dataset = self.data(0.0, 0).datasets[0]
        truth = np.array(list(TRUTH.values()))
        said = {}
        for column, name in enumerate(TRUTH):
            low, high, _ = self.machine.bounds[name]
            moved = []
            for sign in (-1.0, 1.0):
                theta = truth.copy()
                theta[column] += sign * share * (high - low)
                if low <= theta[column] <= high:
                    moved.append(theta)
            torque = self.simulated(dataset, np.array([truth, *moved]))
            apart = np.sqrt(np.mean((torque[1:] - torque[0]) ** 2, axis=1))
            said[name] = float(apart.max())
        return said


def _of_all(values: Mapping[str, float]) -> dict[str, float]:
    machine = shipped_machine('tripod')
    return {f'{drive}.{name}': v for drive in machine.drives for name, v in values.items()}


def tripod_trials(
    bench: Bench, seeds: int, progress: Callable[[float, str], None]
) -> dict[Case, list[DriveTrial]]:
    """Run every case over all seeds.

    Args:
        seeds: Draws of noise, each with a search of its own.
        progress: Takes the part that is done, 0 to 1, and what is being done.
    """
    found: dict[Case, list[DriveTrial]] = {case: [] for case in CASES}
    total, done = len(CASES) * seeds, 0
    for case in CASES:
        drives = 'three drives' if case.all_drives else 'one drive'
        text = f'tripod: {drives}, noise {case.noise} N m, distance {case.distance}'
        for seed in range(seeds):
            progress(done / total, text)
            found[case].append(bench.trial(case, seed))
            done += 1
    return found
