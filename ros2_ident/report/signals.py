# SPDX-License-Identifier: Apache-2.0
"""Measured effort beside what models make of it, as a file: `signals.npz`, `diagnosis.npz`."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from ros2_ident.arrays import Array
from ros2_ident.errors import ErrorCode
from ros2_ident.files import regular, write_arrays
from ros2_ident.gap.coordinates import following_error
from ros2_ident.identify.problem import Problem
from ros2_ident.report.schema import intact

if TYPE_CHECKING:
    from ros2_ident.gap.result import Diagnosis

SCHEMA, VERSION = 'ros2_ident.signals', 2
# Fields that the file holds of a run, and of each recording.
_OF_RUN = 'unit', 'travel', 'judged', 'drives', 'models'
_OF_RECORDING = 'time', 'measured', 'simulated', 'tracking'

Short = npt.NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class Curves:
    """One recording.

    Attributes:
        time: (T,) s since its first cycle; those at which a drive has a sample.
        measured: (D, T) measured effort, NaN where a drive has no sample.
        simulated: (M, D, T) what each model says there.
        tracking: (D, T) set-point less measured position, NaN where one of them is not known.
    """

    title: str
    time: Array
    measured: Short
    simulated: Short
    tracking: Short


@dataclass(frozen=True, eq=False)
class Signals:
    """Measured and simulated effort of all recordings of a run.

    Attributes:
        travel: Unit of the drives' positions.
        judged: The model whose residual matters, and which a page shows at first; -1 for all.
    """

    unit: str
    drives: tuple[str, ...]
    models: tuple[str, ...]
    recordings: tuple[Curves, ...]
    travel: str = 'm'
    judged: int = -1


def _curves(
    title: str, cycle: float, measured: Array, simulated: Array, tracking: Array | None
) -> Curves:
    """Return a recording without the cycles (K,) at which no drive has a sample."""
    at = np.flatnonzero(np.isfinite(measured).any(axis=0))
    if tracking is None:
        tracking = np.full_like(measured, np.nan)
    rows = (x[..., at].astype(np.float32) for x in (measured, simulated, tracking))
    return Curves(title, np.asarray(at * cycle, dtype=np.float64), *rows)


def signals_of_problem(problem: Problem, theta: Array, check: Problem | None = None) -> Signals:
    """Simulate every segment with an estimate, and in the middle of the bounds, where it began.

    Only the first quantity compared of every drive is kept.

    Args:
        theta: (N,) parameters, physical units, finite.
    """
    middle = np.array([0.5 * (p.low + p.high) for p in problem.parameters])
    both = np.stack([middle, theta])
    count = len(problem.models)
    parts = [f'segment {n} of {count}' if count > 1 else '' for n in range(1, count + 1)]
    recordings = list(_simulated(problem, both, parts))
    if check is not None:
        recordings = [replace(r, title=r.title or 'fitted to') for r in recordings]
        own = np.stack([check.taken_from(problem, values) for values in both])
        recordings += _simulated(check, own, ['held out'] * len(check.models))
    models, machine = ('middle of the bounds', 'identified'), problem.models[0].machine
    travel = 'm' if machine is None else machine.travel_unit
    return Signals(problem.unit, problem.drives, models, tuple(recordings), travel, 1)


def _simulated(problem: Problem, theta: Array, titles: Sequence[str]) -> Iterator[Curves]:
    """Yield each segment with what candidates (M, N) make of it."""
    drives = len(problem.drives)
    for number, (model, title) in enumerate(zip(problem.models, titles, strict=True)):
        measured = model.measured[:drives]
        simulated = model.simulate(problem.own(number, theta))[:, :drives]
        yield _curves(title, model.cycle, measured, simulated, following_error(model))


def signals_of_diagnosis(found: 'Diagnosis') -> Signals:
    """Return what a diagnosis keeps of its recordings; the last model holds all effects found."""
    models = ('nominal', 'with effects') if len(found.steps) > 1 else ('nominal',)
    held = any(trace.held_out for trace in found.traces)
    recordings = []
    for trace in found.traces:
        motion, title = trace.motion, 'held out' if trace.held_out else 'fitted to' if held else ''
        rows = np.stack([motion.output, trace.extended])[: len(models)]
        recordings.append(_curves(title, motion.cycle, trace.measured, rows, motion.tracking))
    motion = found.traces[0].motion
    return Signals(found.unit, motion.drives, models, tuple(recordings), motion.travel or 'm')


def write_signals(path: Path, signals: Signals) -> Path:
    """Write signals as NPZ without pickle; a reader finds the old file or the new one."""
    arrays: dict[str, Any] = {name: np.array(getattr(signals, name)) for name in _OF_RUN}
    arrays |= {'schema': np.array(SCHEMA), 'version': np.array(VERSION)}
    arrays['titles'] = np.array([r.title for r in signals.recordings])
    for number, recording in enumerate(signals.recordings):
        arrays |= {f'{name}_{number}': getattr(recording, name) for name in _OF_RECORDING}
    return write_arrays(path, arrays)


def read_arrays(path: Path, remedy: str) -> dict[str, npt.NDArray[Any]]:
    """Return the arrays of an NPZ.

    Raises:
        IdentError: BAD_VALUES with what helps beside deleting it.
    """
    try:
        with regular(path) as source, np.load(source, allow_pickle=False) as file:
            return dict(file)
    except Exception as exc:  # zipfile, zlib and numpy each have their own
        raise ErrorCode.BAD_VALUES.error(
            f'{path}: is damaged ({exc}); delete it, {remedy}'
        ) from None


def load_signals(path: Path) -> Signals:
    """Read signals.

    Raises:
        IdentError: BAD_VALUES where the file is damaged, or another version's.
    """
    arrays = read_arrays(path, 'or run again')
    with intact(path):
        written = str(arrays['schema']), int(arrays['version'])
        if written == (SCHEMA, VERSION):
            recordings = (
                Curves(str(title), *(arrays[f'{name}_{number}'] for name in _OF_RECORDING))
                for number, title in enumerate(arrays['titles'])
            )
            unit, travel, judged, drives, models = (arrays[name].tolist() for name in _OF_RUN)
            return Signals(unit, tuple(drives), tuple(models), tuple(recordings), travel, judged)
    raise ErrorCode.BAD_VALUES.error(
        f'{path}: holds {written[0]} of version {written[1]} and this package reads '
        f'{SCHEMA} of version {VERSION}; delete it, or run again'
    )
