# SPDX-License-Identifier: Apache-2.0
"""Measured and simulated effort side by side: streams, and a bag that any tool opens."""

from pathlib import Path

import numpy as np

from ros2_ident.problem import Problem
from ros2_ident.recording import Dataset, Recording, Stream, Topics, write_bag
from ros2_ident.recording.grid import find_ticks
from ros2_ident.recording.streams import FloatArray, IntArray
from ros2_ident.result import Array

# Where the node `identifier` publishes the same, so that one layout shows both.
SIMULATED, RESIDUAL = '/identifier/simulated', '/identifier/residual'


def overlay_streams(problem: Problem, theta: Array) -> list[dict[str, Stream]]:
    """Simulate every segment at the stamps of its measured efforts.

    Args:
        problem: The problem, from data that hold their recordings.
        theta: (N,) parameters, physical units.

    Returns:
        For each segment `simulated` and `residual` (measured less simulated), with the drives
        compared as names, their stamps, and efforts in the unit of the log.
    """
    streams = []
    scale = problem.machine.effort_scale
    for model, dataset, recording in zip(
        problem.models, problem.data.datasets, problem.data.recordings, strict=True
    ):
        simulated = model.simulate(theta[None, :])[0] / scale
        stamp, cycle, measured = _measured(recording, dataset, problem.drives, scale)
        values = np.where(np.isnan(measured), np.nan, simulated[:, cycle].T)
        streams.append(
            {
                'simulated': Stream(problem.drives, stamp, effort=values),
                'residual': Stream(problem.drives, stamp, effort=measured - values),
            }
        )
    return streams


def write_overlay(
    path: str | Path, problem: Problem, theta: Array, *, topics: Topics | None = None
) -> tuple[Path, ...]:
    """Write bags with the original streams, the simulated and the residual effort.

    Args:
        path: Directory of the bag; further segments get `_2`, `_3` behind it. Bags there are
            replaced.
        problem: The problem, from data that hold their recordings.
        theta: (N,) parameters, physical units.
        topics: Names of the original streams' topics.

    Returns:
        The bags' directories; none where the data hold no recordings.
    """
    if len(problem.data.recordings) != len(problem.data.datasets) or not np.isfinite(theta).all():
        return ()
    names = topics or Topics()
    path = Path(path)
    written = []
    for number, extra in enumerate(overlay_streams(problem, theta), 1):
        recording = problem.data.recordings[number - 1]
        streams = {getattr(names, role): stream for role, stream in recording.streams.items()}
        streams |= {SIMULATED: extra['simulated'], RESIDUAL: extra['residual']}
        place = path if number == 1 else path.with_name(f'{path.name}_{number}')
        written.append(write_bag(place, streams, overwrite=True))
    return tuple(written)


def _measured(
    recording: Recording, dataset: Dataset, drives: tuple[str, ...], scale: float
) -> tuple[IntArray, IntArray, FloatArray]:
    """Return stamps (T,), cycles (T,) and efforts (T, D) of the samples on the data set's grid."""
    stamps, cycles, columns = [], [], []
    for drive in drives:
        stream, values = _source(recording, drive)
        there = ~np.isnan(values)
        cycle = _cycles(stream, dataset, drive, values * scale)
        inside = there & (cycle >= 0) & (cycle < dataset.cycles)
        stamps.append(stream.stamp[inside])
        cycles.append(cycle[inside])
        columns.append(values[inside])
    stamp, first = np.unique(np.concatenate(stamps), return_index=True)
    out = np.full((stamp.size, len(drives)), np.nan)
    for column, (own, values) in enumerate(zip(stamps, columns, strict=True)):
        out[np.searchsorted(stamp, own), column] = values
    return stamp, np.concatenate(cycles)[first], out


def _source(recording: Recording, drive: str) -> tuple[Stream, FloatArray]:
    """Return the stream a drive's effort comes from, and its samples (T,)."""
    for role in ('effort', 'state'):
        stream = recording.streams.get(role)
        values = stream.column('effort', drive) if stream is not None else None
        if stream is not None and values is not None:
            return stream, values
    raise ValueError(f'the recording holds no effort of {drive}')


def _cycles(stream: Stream, dataset: Dataset, drive: str, values: FloatArray) -> IntArray:
    """Return the data set's cycle of each sample (T,).

    The grid is found again from the stamps; which of its cycles is the data set's first shows
    where the efforts agree.
    """
    tick = find_ticks(stream.stamp, int(stream.stamp[0]), dataset.cycle).tick
    about = round((int(stream.stamp[0]) - dataset.start) * 1e-9 / dataset.cycle) - int(tick[0])
    assert dataset.effort is not None
    row = dataset.effort[dataset.names.index(drive)]
    best, most = about, -1
    for shift in sorted(range(about - 5, about + 6), key=lambda s: abs(s - about)):
        cycle = tick + shift
        inside = (cycle >= 0) & (cycle < row.size)
        agree = int((row[cycle[inside]] == values[inside]).sum())
        if agree > most:
            best, most = shift, agree
    found: IntArray = tick + best
    return found
