# SPDX-License-Identifier: Apache-2.0
"""Measured effort beside what models make of it, as a file: `signals.npz`, `diagnosis.npz`."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.files import write_arrays
from ros2_ident.gap.diagnosis import Diagnosis
from ros2_ident.identify.problem import Problem
from ros2_ident.identify.result import Array

SCHEMA, VERSION = 'ros2_ident.signals', 1

Short = npt.NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class Curves:
    """One recording.

    Attributes:
        title: What it is, in words.
        time: (T,) s since its first cycle; those at which a drive has a sample.
        measured: (D, T) measured effort, NaN where a drive has no sample.
        simulated: (M, D, T) what each model says there.
    """

    title: str
    time: Array
    measured: Short
    simulated: Short


@dataclass(frozen=True, eq=False)
class Signals:
    """Measured and simulated effort of all recordings of a run.

    Attributes:
        unit: Unit of the effort.
        drives: The D drives.
        models: Names of the M models.
        recordings: The recordings in order.
    """

    unit: str
    drives: tuple[str, ...]
    models: tuple[str, ...]
    recordings: tuple[Curves, ...]


def _curves(title: str, cycle: float, measured: Array, simulated: Array) -> Curves:
    """Return a recording without the cycles (K,) at which no drive has a sample."""
    at = np.flatnonzero(np.isfinite(measured).any(axis=0))
    return Curves(
        title,
        np.asarray(at * cycle, dtype=np.float64),
        measured[:, at].astype(np.float32),
        simulated[..., at].astype(np.float32),
    )


def signals_of_problem(problem: Problem, theta: Array) -> Signals:
    """Simulate every segment with an estimate; the first quantity compared of every drive.

    Args:
        problem: The problem.
        theta: (N,) parameters, physical units, finite.
    """
    count = len(problem.models)
    return Signals(
        problem.unit,
        problem.drives,
        ('identified',),
        tuple(
            _curves(
                f'segment {number} of {count}' if count > 1 else '',
                model.cycle,
                model.measured[: len(problem.drives)],
                model.simulate(problem.own(number - 1, theta))[:, : len(problem.drives)],
            )
            for number, model in enumerate(problem.models, 1)
        ),
    )


def signals_of_diagnosis(found: Diagnosis) -> Signals:
    """Return what a diagnosis keeps of its recordings; the last model holds all effects found."""
    models = ('nominal', 'with effects') if len(found.steps) > 1 else ('nominal',)
    held = any(trace.held_out for trace in found.traces)
    recordings = []
    for trace in found.traces:
        rows = np.stack([trace.motion.output, trace.extended])[: len(models)]
        title = 'held out' if trace.held_out else 'fitted to' if held else ''
        recordings.append(_curves(title, trace.motion.cycle, trace.measured, rows))
    return Signals(found.unit, found.traces[0].motion.drives, models, tuple(recordings))


def write_signals(path: Path, signals: Signals) -> Path:
    """Write signals as NPZ without pickle; a reader finds the old file or the new one.

    Returns:
        The path.
    """
    arrays: dict[str, Any] = {
        'schema': np.array(SCHEMA),
        'version': np.array(VERSION),
        'unit': np.array(signals.unit),
        'drives': np.array(signals.drives),
        'models': np.array(signals.models),
        'titles': np.array([r.title for r in signals.recordings]),
    }
    for number, recording in enumerate(signals.recordings):
        arrays[f'time_{number}'] = recording.time
        arrays[f'measured_{number}'] = recording.measured
        arrays[f'simulated_{number}'] = recording.simulated
    return write_arrays(path, arrays)


def load_signals(path: Path) -> Signals:
    """Read signals.

    Raises:
        IdentError: BAD_VALUES where the file is damaged, or another version's.
    """
    try:
        with np.load(path, allow_pickle=False) as file:
            arrays = dict(file)
        known = str(arrays['schema']) == SCHEMA and int(arrays['version']) == VERSION
        return _signals(arrays) if known else _refuse(path, arrays)
    except IdentError:
        raise
    except Exception as exc:  # zipfile, zlib and numpy each have their own
        raise IdentError(
            ErrorCode.BAD_VALUES, f'{path}: is damaged ({exc}); delete it, or run again'
        ) from None


def _refuse(path: Path, arrays: Mapping[str, Any]) -> Signals:
    raise IdentError(
        ErrorCode.BAD_VALUES,
        f'{path}: holds {arrays["schema"]} of version {arrays["version"]} and this package reads '
        f'{SCHEMA} of version {VERSION}; delete it, or run again',
    )


def _signals(arrays: Mapping[str, Any]) -> Signals:
    return Signals(
        str(arrays['unit']),
        tuple(str(x) for x in arrays['drives']),
        tuple(str(x) for x in arrays['models']),
        tuple(
            Curves(
                str(title),
                arrays[f'time_{number}'],
                arrays[f'measured_{number}'],
                arrays[f'simulated_{number}'],
            )
            for number, title in enumerate(arrays['titles'])
        ),
    )
