# SPDX-License-Identifier: Apache-2.0
"""How fast one candidate of the tripod is simulated, and how far from this machine's limit.

Compares, in turn within one run, the kernel with the same by hand in C (`tripod_limit.c`, built
with gcc; needs AVX-512) and with one compiled with the hooks of effects; then times the paper's
Table 4 schedule, the first compilation and a second start. Figures are medians, with the least in
brackets; CPU time unless wall time is said.

    python checks/benchmarks/kernel.py [--seconds 10] [--rounds 9]
"""

import argparse
from collections.abc import Callable, Mapping
import ctypes
import functools
import os
from pathlib import Path
import subprocess
import sys
import tempfile
import time

import numpy as np

from checks.benchmarks import measure
from checks.reference.tripod import TABLE_5
from ros2_ident.kernel import rows
from ros2_ident.lanes import WIDTH
from ros2_ident.models import load_machine
from ros2_ident.models.drives.model import Compiled
from ros2_ident.models.tripod.model import Tripod
from ros2_ident.recording import Dataset
from ros2_ident.search import GeneticSearch, GeneticSettings, minimise, ThreadedEvaluator
from ros2_ident.simulate.motions import draw_motion

ROOT = Path(__file__).resolve().parents[2]
# Rows of the C kernel's blocks, as its enumerations have them.
MACHINE = ('rail_radius', 'rod_length', 'tool_mass', 'gravity')
DRIVE = (
    'gear_stiffness',
    'gear_damping',
    'motor_mass',
    'rail_mass',
    'coulomb',
    'viscous',
    'position_gain',
    'velocity_gain',
    'integral_gain',
    'torque_limit',
    'log_delay',
)
# Floating-point operations of one candidate, counted in `tripod_limit.c`: once a cycle (linkage,
# controller, cost), once a step (four stages), and a hyperbolic tangent, twelve of them a step.
CYCLE, STEP, TANGENT = 354, 402, 23
COLD = """
import sys, time
from pathlib import Path
import numpy as np
from ros2_ident.models import load_machine
from ros2_ident.models.tripod.model import Tripod
from ros2_ident.recording import Dataset
machine = load_machine(Path(sys.argv[1]))
line = np.full((3, 50), 0.1)
model = Tripod(machine, Dataset(machine.drives, 5e-4, 0, line, 0.0 * line, None, None, line))
wall, cpu = time.perf_counter(), time.process_time()
model.costs(np.array([[0.5 * (p.low + p.high) for p in model.parameters]]))
print(time.perf_counter() - wall, time.process_time() - cpu)
"""


def synthetic(seconds: float) -> Tripod:
    """Return the tripod on a log of that length, its effort simulated at Table 5's values."""
    machine = load_machine(ROOT / 'config' / 'tripod.yaml')
    motion = draw_motion('pick_and_place', machine, seconds, 7)

    def model(effort: np.ndarray) -> Tripod:
        course = motion.position, motion.velocity
        return Tripod(
            machine, Dataset(machine.drives, motion.cycle, 0, *course, None, None, effort)
        )

    plain = model(np.zeros(motion.position.shape))
    effort = plain.simulate(at(plain, TABLE_5)[None])[0]
    effort += machine.effort_noise * np.random.default_rng(1).standard_normal(effort.shape)
    effort[:, 1::2] = np.nan  # a log of 1 kHz
    return model(effort)


def at(model: Tripod, values: Mapping[str, float]) -> np.ndarray:
    """Return (N,) the model's parameters at values by name."""
    return np.array([values[p.name.split('.')[-1]] for p in model.parameters])


class Limit:
    """The C kernel on a model's log."""

    def __init__(self, model: Tripod, folder: Path) -> None:
        target = folder / 'limit.so'
        flags = ['-O3', '-march=native', '-ffp-contract=fast', '-mprefer-vector-width=512']
        source = ROOT / 'checks' / 'benchmarks' / 'tripod_limit.c'
        subprocess.run(
            ['gcc', *flags, '-shared', '-fPIC', str(source), '-o', str(target)], check=True
        )
        self.library = ctypes.CDLL(str(target))
        self.library.peak.restype = ctypes.c_double
        self.model = model
        measured = model.measured
        self.samples = (~np.isnan(measured)).sum(axis=1)
        self.measured = np.concatenate([measured, np.full((3, 1), np.nan)], axis=1).ravel()

    def costs(self, theta: np.ndarray) -> np.ndarray:
        """Return (S,) costs of (S, N) candidates, as `Tripod.costs`."""
        block = self.model.rows(theta)
        steps = np.stack(
            [self.model._steps(block, fast=True), self.model._steps(block)], axis=1
        ).astype(float)
        order = np.lexsort(steps.T)
        columns = [rows.MACHINE_ROWS.index(n) for n in MACHINE]
        for first in rows.MACHINE_COUNT + rows.DRIVE_COUNT * np.arange(3):
            columns += [first + rows.DRIVE_ROWS.index(n) for n in DRIVE]
        blocks = _aligned(_lanes(block[order][:, columns]))
        out = _aligned(np.zeros((len(blocks), 3, 8)))
        model = self.model
        real = ctypes.c_double
        self.library.simulate(
            ctypes.c_int64(len(blocks)),
            _at(blocks),
            _at(_aligned(_lanes(steps[order]))),
            _at(model.log.command),
            ctypes.c_int64(model.data.cycles),
            _at(self.measured),
            _at(_grid(self.model)),
            real(model.machine.number('gear_factor')),
            real(model.machine.number('coulomb_regularisation')),
            real(model.cycle),
            real(model.machine.number('velocity_feedforward')),
            _at(out),
        )
        error = np.sqrt(out / self.samples[:, None]).mean(axis=1).ravel()[: len(theta)]
        cost = np.empty(len(theta))
        cost[order] = error
        return cost

    def peak(self) -> float:
        """Return the core's fused multiply-adds in operations a second; the best of several."""
        rounds = 2_000_000
        least = in_turn(9, lambda: self.library.peak(ctypes.c_int64(rounds))).min()
        return float(2 * 8 * 12 * rounds / least)


def _grid(model: Tripod) -> np.ndarray:
    """Return (10,) the inverse of the rail directions' differences, then the directions."""
    azimuth = model.machine.numbers('rail_azimuth')
    direction = np.stack([np.cos(azimuth), np.sin(azimuth)], axis=1)
    return np.concatenate([np.linalg.inv(direction[1:] - direction[0]), direction]).ravel()


def _lanes(values: np.ndarray) -> np.ndarray:
    groups = -(-len(values) // 8)
    whole = np.pad(values, ((0, groups * 8 - len(values)), (0, 0)), mode='edge')
    return np.ascontiguousarray(whole.reshape(groups, 8, -1).transpose(0, 2, 1))


def _aligned(values: np.ndarray) -> np.ndarray:
    raw = np.empty(values.nbytes + 64, dtype=np.uint8)
    start = -raw.ctypes.data % 64
    out = raw[start : start + values.nbytes].view(np.float64).reshape(values.shape)
    out[:] = values
    return out


def _at(values: np.ndarray) -> ctypes.c_void_p:
    return values.ctypes.data_as(ctypes.c_void_p)


def in_turn(rounds: int, *calls: Callable[[], object]) -> np.ndarray:
    """Return (rounds, calls) CPU times of this process, s; every round runs each call once."""
    times = measure.interleaved({str(n): call for n, call in enumerate(calls)}, rounds)
    return np.array([x.seconds for x in times.values()]).T


class Hooked(Tripod):
    """The tripod on the kernel with the hooks of effects, all of them off."""

    @property
    def _kernel(self) -> Compiled:
        of, room, (told, followed, mode, _, *rest) = super()._kernel
        return of, room, (told, followed, mode, self.candidates.on, *rest)


def compare(model: Tripod, limit: Limit, rounds: int) -> None:
    """Print times of one core, and what they are of the limits."""
    rng = np.random.default_rng(0)
    true = at(model, TABLE_5)
    low = np.array([p.low for p in model.parameters])
    high = np.array([p.high for p in model.parameters])
    near = true * (1.0 + 0.02 * rng.standard_normal((64, len(true))))
    box = low + (high - low) * rng.random((64, len(true)))
    hooked = Hooked(model.machine, model.data)
    cycles = model.data.cycles
    width = model.machine.number('coulomb_regularisation')
    share = np.mean(np.abs(model.data.command_velocity) < 9.2 * width)
    peak = limit.peak()
    print(f'peak {peak * 1e-9:.1f} GFLOP/s a core; tangents needed {share:.2f} of the time')
    for name, theta in (('near Table 5', near), ("Table 3's box", box)):
        ours, theirs, plain = model.costs(theta), limit.costs(theta), hooked.costs(theta)
        both = np.isfinite(ours)
        difference = np.abs(ours[both] / theirs[both] - 1.0).max()
        # Branches change which products and sums are fused, so the last digits.
        np.testing.assert_allclose(plain, ours, rtol=1e-12)
        took = in_turn(
            rounds,
            *(functools.partial(of, theta) for of in (model.costs, limit.costs, hooked.costs)),
        )
        took *= 1e3 / len(theta)
        middle, least = np.median(took, axis=0), took.min(axis=0)
        ratio = np.median(took[:, 1] / took[:, 0])
        hooks = np.median(took[:, 2] / took[:, 0])
        block = model.rows(theta)
        steps = model._steps(block, fast=True) * (1.0 - share) + model._steps(block) * share
        work = cycles * (CYCLE + steps.mean() * (STEP + 12 * TANGENT * share))
        print(
            f'{name}: {steps.mean():.2f} steps a cycle, {work * 1e-6:.1f} MFLOP, '
            f'at the peak {work / peak * 1e3:.3f} ms a candidate\n'
            f'  kernel        {middle[0]:.3f} ms ({least[0]:.3f})\n'
            f'  C by hand     {middle[1]:.3f} ms ({least[1]:.3f}); '
            f'the kernel has {ratio:.2f} of its speed; costs differ by {difference:.1e}\n'
            f'  with hooks    {middle[2]:.3f} ms ({least[2]:.3f}), all of them off: '
            f'{hooks - 1.0:+.1%}'
        )


def schedule(model: Tripod, rounds: int) -> None:
    """Print the wall time of Table 4's schedule on two threads."""
    low = np.array([p.low for p in model.parameters])
    high = np.array([p.high for p in model.parameters])
    wall, cpu = [], []
    for seed in range(rounds):
        search = GeneticSearch(len(low), GeneticSettings(), seed)
        with ThreadedEvaluator(model.costs, 2, limited=True) as evaluate:
            start, used = time.perf_counter(), time.process_time()
            found = minimise(
                evaluate,
                search,
                low=low,
                high=high,
                work=lambda x: model.work(low + x * (high - low)),
            )
            wall.append(time.perf_counter() - start)
            cpu.append(time.process_time() - used)
    print(
        f"Table 4's {found.evaluations} evaluations, {len(low)} parameters, 2 threads: "
        f'{np.median(wall):.2f} s ({min(wall):.2f}); CPU time {np.median(cpu):.2f} s '
        f'({min(cpu):.2f}), over 2 cores {np.median(cpu) / 2:.2f} s ({min(cpu) / 2:.2f})'
    )


def starts(folder: Path) -> None:
    """Print what the first and the second start take until the first costs are there."""
    environment = dict(os.environ, NUMBA_CACHE_DIR=str(folder / 'cache'))
    machine = str(ROOT / 'config' / 'tripod.yaml')
    for name in ('first start, compiling', 'second start, from the cache'):
        done = subprocess.run(
            [sys.executable, '-c', COLD, machine],
            env=environment,
            capture_output=True,
            text=True,
            check=True,
        )
        wall, cpu = (float(x) for x in done.stdout.split())
        print(f'{name}: {wall:.2f} s, CPU time {cpu:.2f} s')


def main() -> None:
    """Print all figures."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--seconds', type=float, default=10.0, help='length of the log')
    parser.add_argument('--rounds', type=int, default=9, help='repetitions')
    args = parser.parse_args()
    print(f'{measure.machine()}; {WIDTH} lanes')
    model = synthetic(args.seconds)
    with tempfile.TemporaryDirectory() as name:
        compare(model, Limit(model, Path(name)), args.rounds)
        schedule(model, max(3, args.rounds // 3))
        starts(Path(name))


if __name__ == '__main__':
    main()
