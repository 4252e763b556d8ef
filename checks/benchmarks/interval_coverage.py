# SPDX-License-Identifier: Apache-2.0
"""How often the 95 % intervals cover the truth: one motion of the tripod, many draws of its noise.

The reference simulates one log. Each draw samples it as a recorder would, with fresh noise, jitter
and losses, and is identified on its own: the genetic algorithm runs on the first draw only, the
refinement of every draw starts from the genetic algorithm's result there.

Example: python checks/benchmarks/interval_coverage.py --write build/coverage.md
"""

import argparse
from collections.abc import Mapping
from pathlib import Path
import sys
import time

import numpy as np
import numpy.typing as npt

from checks.blind.store import stamp
from checks.reference.tripod import simulate_tripod, TABLE_5
from checks.share import table
from ros2_ident.identify.data import Data, gather
from ros2_ident.identify.problem import problem_of
from ros2_ident.identify.run import identify
from ros2_ident.machine.machine import Parameter
from ros2_ident.models import load_machine, Machine
from ros2_ident.recording import Recording
from ros2_ident.search import intervals, refine, ThreadedEvaluator
from ros2_ident.simulate.bag import make_streams, nuisance_of
from ros2_ident.simulate.motions import draw_motion
from ros2_ident.threads import processors

Array = npt.NDArray[np.float64]

# Table 5 of the paper, first column; the paper prints no friction. And a machine whose gear is
# ten times softer and whose effort is logged almost at once.
VALUES = {
    'table_5': TABLE_5,
    'soft': {
        'measurement_delay': 0.0021,
        'gear_stiffness': 2.0e4,
        'gear_damping_ratio': 0.3,
        'tool_mass': 1.4,
        'drive_inertia': 9.0e-5,
        'coulomb_torque': 0.05,
        'viscous_torque': 0.03,
    },
}


def run(
    machine: Machine, truth: Mapping[str, float], motion: str, seconds: float, count: int
) -> tuple[tuple[Parameter, ...], Array, Array, Array]:
    """Identify all draws; return (N,) parameters, and of each draw.

    Estimates (M, N), half widths of the intervals (M, N), residual RMS (M,) [N m].
    """
    way = draw_motion(motion, machine, seconds, 3)
    log = simulate_tripod(machine, truth, way.position, way.velocity)
    theta, half, rms = [], [], []
    start: Array | None = None
    for seed in range(count):
        streams = make_streams(log, way, nuisance_of(machine), np.random.default_rng(seed))
        recording = Recording(
            state=streams['/joint_states'],
            effort=streams['/effort'],
            command=streams['/joint_command'],
            source=f'draw {seed}',
        )
        data: Data = gather([recording], machine)
        problem = problem_of(machine, data)
        if start is None:
            first = identify(machine, data, seed=1)
            start = np.array([p.ga_value for p in first.parameters])
            print(
                f'genetic algorithm: {first.cost.ga:.4g} N m, refined {first.cost.refined:.4g} N m'
            )
        before = time.monotonic()
        with ThreadedEvaluator(problem.residuals, processors()) as residuals:
            found = refine(residuals, start[None], problem.low, problem.high, max_evaluations=2000)
        told = intervals(
            found.jacobian,
            found.residual,
            found.theta,
            problem.low,
            problem.high,
            series=problem.series,
        )
        theta.append(found.theta)
        half.append(told.half_width)
        rms.append(found.cost)
        print(f'draw {seed}: {found.cost:.5f} N m, {time.monotonic() - before:.1f} s', flush=True)
    return problem.parameters, np.array(theta), np.array(half), np.array(rms)


def page(args: argparse.Namespace) -> str:
    """Identify the draws and return the page on them."""
    values, count = VALUES[args.values], args.draws
    parameters, theta, half, rms = run(
        load_machine(args.machine), values, args.motion, args.seconds, count
    )
    truth = np.array([values[p.name.rpartition('.')[2]] for p in parameters])
    covered = np.abs(theta - truth) <= half
    error = 100.0 * (theta / truth - 1.0)
    scatter, stated = theta.std(axis=0, ddof=1), half.mean(axis=0) / 1.96
    head = ('parameter', 'truth', 'unit', 'covered', 'mean error', 'largest error',
            'scatter / stated')  # fmt: skip
    rows = [
        (
            p.name,
            f'{truth[n]:g}',
            p.unit,
            f'{int(covered[:, n].sum())} of {count}',
            f'{error[:, n].mean():+.3f} %',
            f'{np.abs(error[:, n]).max():.3f} %',
            f'{scatter[n] / stated[n]:.2f}',
        )
        for n, p in enumerate(parameters)
    ]
    return f"""# Coverage of the 95 % intervals

One log of the reference tripod ({args.motion}, {args.seconds:g} s, all three drives), {count}
draws of its noise (0.01 N m, steps of 0.002 N m, jitter 10 us, one sample in a thousand
lost).
Made by `python {' '.join(sys.argv)}`.
Written at commit {stamp()['commit'][:7]}.

All intervals together cover the truth in {100.0 * covered.mean():.1f} % of {covered.size} cases;
residual {rms.mean():.5f} N m RMS.

{table(head, rows)}
"Scatter / stated" compares the standard deviation of the estimates over the draws with
the one that the intervals state. A fair 95 % interval covers 36 to 40 of 40 in 95 % of
the cases.
"""


def main() -> None:
    """Run and print or write the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--machine', default='config/tripod.yaml')
    parser.add_argument('--motion', default='multi_point')
    parser.add_argument('--seconds', type=float, default=10.0)
    parser.add_argument('--values', choices=VALUES, default='table_5', help='the true parameters')
    parser.add_argument('--draws', type=int, default=40)
    parser.add_argument('--write', type=Path, metavar='FILE', help='write the page here')
    args = parser.parse_args()
    text = page(args)
    print(text)
    if args.write:
        args.write.write_text(text, encoding='utf-8')


if __name__ == '__main__':
    main()
