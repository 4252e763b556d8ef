# SPDX-License-Identifier: Apache-2.0
"""Section 3 of the paper: the belt drive's experiments, as numbers."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ros2_ident.cli.example import shipped
from ros2_ident.models import load_machine, Machine
from ros2_ident.models.belt_drive.model import BeltDrive, CONSTANTS
from ros2_ident.search import GeneticSearch, GeneticSettings, MANY_MINIMA, minimise

Array = NDArray[np.float64]

TRUTH = np.array([2e5, 45.0])  # EA [N] and P [Nm/rad], Table 1
SUCCESS = 0.01  # relative error of both parameters that counts as found

# Table 2: both numbers of survivors, both distances.
PAPER_SETTINGS: dict[tuple[int, float], GeneticSettings] = {
    (survivors, distance): GeneticSettings(1000, survivors, 8, 12, 0.5, distance)
    for survivors in (8, 20)
    for distance in (0.0, 0.5)
}
OURS = MANY_MINIMA


@dataclass(frozen=True)
class Trial:
    """One search.

    Attributes:
        truth: (2,) EA [N] and P [Nm/rad] behind the data.
        found: (2,) the same as found.
        cost: RMS error averaged over phi1 and M1, eq. 2.
        points: (E, 2) every candidate, physical units; empty unless asked for.
        costs: (E,) their costs.
    """

    truth: Array
    found: Array
    cost: float
    evaluations: int
    points: Array
    costs: Array

    @property
    def error(self) -> Array:
        """Relative errors (2,)."""
        return np.abs(self.found / self.truth - 1.0)

    @property
    def success(self) -> bool:
        """Whether both parameters are within 1 %."""
        return bool((self.error < SUCCESS).all())


def shipped_machine(name: str) -> Machine:
    """Return a machine that comes with the package, from the source tree or installed.

    Args:
        name: Its file without the ending: `belt_drive`, `tripod`.
    """
    return load_machine(shipped(f'config/{name}.yaml'))


def belt_machine() -> Machine:
    """Return the belt drive that comes with the package."""
    return shipped_machine('belt_drive')


def box(belt: BeltDrive) -> tuple[Array, Array]:
    """Return the lower and upper bounds (N,) of a belt drive's parameters."""
    return (
        np.array([p.low for p in belt.parameters]),
        np.array([p.high for p in belt.parameters]),
    )


def step_reference(*, duration: float = 1.0) -> tuple[float, Array]:
    """Return the set-point of Fig. 5: nine steps of 0.1 degrees, evenly spread.

    Args:
        duration: Length, s.

    Returns:
        The interval, and (K,) the set-point from 0 to `duration`, both included.
    """
    cycle, steps = 2e-4, 9
    count = round(duration / cycle) + 1
    at = [round(duration / cycle * (i + 1) / (steps + 1)) for i in range(steps)]
    change = np.zeros(count)
    np.add.at(change, at, np.pi / 1800.0)
    return cycle, np.cumsum(change)


def matrices(belt: BeltDrive, theta: Array) -> tuple[Array, Array]:
    """Return inertias (S, 3) and stiffness matrices (S, 3, 3), eq. 21, of candidates (S, N)."""
    full = belt.constants(theta)
    c = {name: full[:, n] for n, name in enumerate(CONSTANTS)}
    k1 = c['axial_stiffness'] / (c['length_1'] + c['rail_position'])
    k2 = c['axial_stiffness'] / (c['length_2'] - c['rail_position'])
    k3 = c['axial_stiffness'] / c['length_3']
    r, gain = c['radius'], c['position_gain']
    # The sign of x as eqs. 10 and 21 are printed: the mass moves against the gears.
    rows = [
        [r * r * (k1 + k3) + gain, -r * r * k3, r * k1],
        [-r * r * k3, r * r * (k2 + k3), r * k2],
        [r * k1, r * k2, k1 + k2],
    ]
    inertia = [c['driving_inertia'], c['driven_inertia'], c['rail_mass']]
    return np.stack(inertia, axis=-1), np.moveaxis(np.array(rows), -1, 0)


def eigenfrequencies(belt: BeltDrive, theta: Array) -> Array:
    """Return the eigenfrequencies (S, 3) [Hz], rising, of candidates (S, N), eq. 22."""
    inertia, stiffness = matrices(belt, theta)
    root = np.sqrt(inertia)
    square = np.linalg.eigvalsh(stiffness / (root[:, :, None] * root[:, None, :]))
    return np.asarray(np.sqrt(square) / (2.0 * np.pi))


def eigenfrequencies_over_position(positions: Array, found: Array = TRUTH) -> Array:
    """Return the eigenfrequencies (X, 3) [Hz] at rail positions x0 (X,) [m], Fig. 4.

    Args:
        positions: (X,).
        found: (2,) EA [N] and P [Nm/rad].
    """
    bounds = {'rail_position': (0.0, 0.7, 'm')}
    stiffness, gain = (float(x) for x in found)
    machine = belt_machine().with_constants(axial_stiffness=stiffness, position_gain=gain)
    machine = replace(machine, bounds=bounds, own_bounds={})
    return eigenfrequencies(BeltDrive(machine, *step_reference()), positions[:, None])


def identify(
    belt: BeltDrive, truth: Array, settings: GeneticSettings, seed: int, *, record: bool = False
) -> Trial:
    """Identify a belt drive from noise-free data.

    Args:
        truth: (2,) EA [N] and P [Nm/rad] behind the data.
    """
    measured = belt.simulate(truth[None, :])[0]
    tried: list[Array] = []
    costs: list[Array] = []

    def evaluate(theta: Array) -> Array:
        told = belt.cost(theta, measured)
        if record:
            tried.append(theta)
            costs.append(told)
        return told

    low, high = box(belt)
    result = minimise(evaluate, GeneticSearch(2, settings, seed), low=low, high=high)
    return Trial(
        truth=truth,
        found=result.theta,
        cost=result.cost,
        evaluations=result.evaluations,
        points=np.concatenate(tried) if tried else np.empty((0, 2)),
        costs=np.concatenate(costs) if costs else np.empty(0),
    )


def trial(belt: BeltDrive, settings: GeneticSettings, seed: int, *, anywhere: bool) -> Trial:
    """Identify the paper's truth, or one drawn anywhere in the box."""
    low, high = box(belt)
    drawn = low + np.random.default_rng([2011, seed]).random(2) * (high - low)
    return identify(belt, drawn if anywhere else TRUTH, settings, seed)


def local_minima(belt: BeltDrive) -> int:
    """Return how many local minima the cost has along EA through the paper's truth."""
    low, high = box(belt)
    line = np.column_stack([np.linspace(low[0], high[0], 8001), np.full(8001, TRUTH[1])])
    cost = belt.cost(line, belt.simulate(TRUTH[None, :])[0])
    return int(((cost[1:-1] < cost[:-2]) & (cost[1:-1] < cost[2:])).sum())
