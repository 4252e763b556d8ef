# SPDX-License-Identifier: Apache-2.0
"""What encoders behind the gears show of a KR 300: lag, play, and how stiff the gears are.

The links' torques are those of `config/kr300.yaml` as identified; the difference between motor and
link encoder is regressed on them, on the speed (a lag of one of the two), on its direction (play
and hysteresis) and, on request, on sine and cosine of the position (an encoder out of centre).
Intervals of 95 % by resampling blocks of half a second. Needs pinocchio.

    python checks/benchmarks/link_encoders.py ../shared/data/kr300_a
"""

import argparse
from pathlib import Path

import numpy as np
import numpy.typing as npt

from ros2_ident.identify.data import read_data
from ros2_ident.identify.problem import problem_of
from ros2_ident.identify.run import solve
from ros2_ident.identify.settings import IdentifySettings
from ros2_ident.models import load_machine
from ros2_ident.recording import read_bag, Topics
from ros2_ident.recording.motion import low_pass, smooth_motion

Array = npt.NDArray[np.float64]

MACHINE = Path(__file__).parents[2] / 'config/kr300.yaml'
HELD = {'measurement_delay': 0.008, 'payload_x': 0.0, 'payload_y': 0.0, 'payload_z': -0.34}
OF_DRIVES = ('coulomb_torque', 'viscous_torque', 'drive_inertia', 'constant_force')
NOMINAL = (4.58e6, 7.52e6, 4.10e6)
CYCLE, BAND, MOTION, BLOCK, DRAWS = 0.004, 10.0, 50.0, 0.5, 400
STEP = 0.01


def torques(bag: Path) -> Array:
    """Return (D, K) what the links ask of the gears, N m."""
    machine = load_machine(MACHINE)
    problem = problem_of(machine, read_data(bag, machine), fixed=HELD)
    found = solve(problem, IdentifySettings(method='algebraic'), 0)
    model, theta = problem.models[0], found.theta.copy()
    for n, parameter in enumerate(model.parameters):
        if parameter.name.rpartition('.')[2] in OF_DRIVES:
            theta[n] = 0.0
    out: Array = model.simulate(theta[None])[0]
    return out


def positions(bag: Path, topic: str) -> tuple[Array, Array]:
    """Return (K,) time and (D, K) positions of a topic."""
    state = read_bag(bag, Topics(state=topic, command='', effort=''))[0].state
    assert state is not None and state.position is not None
    return 1e-9 * state.stamp, state.position.T


def fit(columns: Array, seen: Array, blocks: Array, rng: np.random.Generator) -> Array:
    """Return (C, 3) coefficients with the ends of their intervals."""
    parts = [np.flatnonzero(blocks == b) for b in np.unique(blocks)]
    normal = np.array([columns[p].T @ columns[p] for p in parts])
    right = np.array([columns[p].T @ seen[p] for p in parts])
    drawn = rng.integers(len(parts), size=(DRAWS, len(parts)))
    some = [np.linalg.solve(normal[d].sum(axis=0), right[d].sum(axis=0)) for d in drawn]
    best = np.linalg.solve(normal.sum(axis=0), right.sum(axis=0))
    return np.column_stack([best, *np.quantile(np.array(some), (0.025, 0.975), axis=0)])


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or '').splitlines()[0])
    parser.add_argument('bag', type=Path)
    args = parser.parse_args()
    when, motor = positions(args.bag, '/joint_states')
    at, link = positions(args.bag, '/link_states')
    grid = np.arange(when[0], when[-1], CYCLE)
    here = np.array([np.interp(grid, when, row) for row in motor])
    there = np.array([np.interp(grid, at, row) for row in link])
    place, speed, _ = smooth_motion(here, CYCLE, MOTION)
    asked = torques(args.bag)
    load = np.array([np.interp(grid - when[0], CYCLE * np.arange(len(r)), r) for r in asked])
    rng = np.random.default_rng(0)
    inside = slice(round(0.3 / CYCLE), -round(0.3 / CYCLE))
    blocks = ((grid - grid[0]) / BLOCK).astype(int)[inside]
    heads = 'axis', 'terms', 'compliance, 1e-9 rad/(N m)', 'nominal', 'lag / ms', 'play / urad'
    print(f'| {" | ".join(heads)} | left |')
    print('| --- | --- | --- | --- | --- | --- | --- |')
    for d in range(len(link)):
        seen = low_pass((here[d] - there[d])[None], CYCLE, BAND)[0][inside]
        rows = [load[d], speed[d], np.tanh(speed[d] / STEP), np.ones(len(grid))]
        for name, more in (('', []), ('+ place', [np.sin(place[d]), np.cos(place[d])])):
            columns = low_pass(np.array(rows + more), CYCLE, BAND).T[inside]
            found = fit(columns, seen, blocks, rng)
            left = np.std(seen - columns @ found[:, 0]) / np.std(seen)
            cells = [
                f'{s * v:.3g} [{s * low:.3g}, {s * high:.3g}]'
                for s, (v, low, high) in zip((1e9, 1e3, 2e6), found[:3], strict=True)
            ]
            print(
                f'| {d + 1} | {name} | {cells[0]} | {1e9 / NOMINAL[d]:.0f} | {cells[1]} | '
                f'{cells[2]} | {100.0 * left:.0f} % |'
            )


if __name__ == '__main__':
    main()
