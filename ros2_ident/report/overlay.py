# SPDX-License-Identifier: Apache-2.0
"""Measured and simulated effort side by side: streams, and a bag that any tool opens."""

from collections.abc import Callable, Sequence
import glob
from pathlib import Path
import time

import numpy as np

from ros2_ident.arrays import Array
from ros2_ident.errors import ErrorCode
from ros2_ident.identify.data import Data
from ros2_ident.identify.problem import Problem
from ros2_ident.identify.settings import IdentifyProgress
from ros2_ident.recording import Dataset, Recording, Stream, Topics, write_bag
from ros2_ident.recording.grid import find_ticks
from ros2_ident.recording.streams import FloatArray, IntArray
from ros2_ident.recording.write import remove_bag, require_room, Topic
from ros2_ident.report.scene import MARKERS, scene_messages, scene_of

# Where the node `identifier` publishes the same, so that one layout shows both.
SIMULATED, RESIDUAL = '/identifier/simulated', '/identifier/residual'
SCENE = '/identifier/scene'
# Name of the bag in a result directory, and its mark in the metadata.
OVERLAY = 'overlay'
# Simulating a preview holds the search up; it may for this share of the time.
SHARE = 0.05
# Samples of a segment in a preview: enough for the eye, and a few milliseconds to publish.
SAMPLES = 500

Series = list[Stream]


def overlay_streams(problem: Problem, theta: Array) -> list[dict[str, Stream]]:
    """Simulate every segment at the stamps of its measured efforts.

    Args:
        theta: (N,) parameters, physical units.

    Returns:
        For each segment `simulated` and `residual` (measured less simulated), with the drives
        compared as names, their stamps, and efforts in the unit of the log.
    """
    streams = []
    scale = problem.machine.effort_scales
    per_drive = np.array([[scale[drive]] for drive in problem.drives])
    for number, (model, dataset, recording) in enumerate(
        zip(problem.models, problem.data.datasets, problem.data.recordings, strict=True)
    ):
        simulated = model.simulate(problem.own(number, theta))[0, : len(problem.drives)]
        simulated = simulated / per_drive
        stamp, cycle, measured = _measured(recording, dataset, problem.drives)
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

    A tripod, a delta or an arm moves in them as markers for RViz and Foxglove, too.

    Args:
        path: Directory of the bag; further segments get `_2`, `_3` behind it. Overlays there are
            replaced, anything else is left alone.
        theta: (N,) parameters, physical units.
        topics: Names of the original streams' topics.

    Returns:
        The bags' directories; none where the data hold no recordings.

    Raises:
        IdentError: INVALID_GOAL as `require_place`.
    """
    if len(problem.data.recordings) != len(problem.data.datasets) or not np.isfinite(theta).all():
        return ()
    if problem.models[0].outputs[0].quantity != 'effort':
        return ()  # there is no effort to lay the simulated one over
    names = topics or Topics()
    path = Path(path)
    written = []
    for number, extra in enumerate(overlay_streams(problem, theta), 1):
        recording = problem.data.recordings[number - 1]
        streams = {getattr(names, role): stream for role, stream in recording.streams.items()}
        streams |= {SIMULATED: extra['simulated'], RESIDUAL: extra['residual']}
        scene = scene_of(problem, theta, extra['residual'], number - 1)
        others = []
        if scene is not None:
            others.append(Topic(SCENE, MARKERS, scene.stamp, scene_messages(scene)))
        written.append(write_bag(_place(path, number), streams, mark=OVERLAY, others=others))
    return tuple(written)


def require_place(path: str | Path, data: Data, inputs: Sequence[str | Path | None] = ()) -> None:
    """Refuse, before any work is done, a place whose bags are not ours to replace.

    Args:
        path: As for `write_overlay`.
        data: What the overlay will be of.
        inputs: The bags that were read; an overlay among them is not replaced either.

    Raises:
        IdentError: INVALID_GOAL with the remedy.
    """
    read = {Path(x).resolve() for x in inputs if x}
    for number in range(1, len(data.recordings) + 1):
        place = _place(Path(path), number)
        if any(x.is_relative_to(place.resolve()) for x in read):
            raise ErrorCode.INVALID_GOAL.error(
                f'{place}: is what is read and will not be replaced; give another directory for '
                'the results'
            )
        require_room(place, OVERLAY)


def withdraw_overlay(path: str | Path) -> None:
    """Remove the overlays of an earlier run: what is new shall not lie beside them."""
    first = Path(path)
    for place in (first, *first.parent.glob(f'{glob.escape(first.name)}_[0-9]*')):
        remove_bag(place, OVERLAY)


def _place(path: Path, number: int) -> Path:
    """Return the directory of a segment's bag; they count from 1."""
    return path if number == 1 else path.with_name(f'{path.name}_{number}')


def _measured(
    recording: Recording, dataset: Dataset, drives: tuple[str, ...]
) -> tuple[IntArray, IntArray, FloatArray]:
    """Return stamps (T,), cycles (T,) and efforts (T, D) of the samples on the data set's grid."""
    stamps, cycles, columns = [], [], []
    for drive in drives:
        streams = [x for role in ('effort', 'state') if (x := recording.streams.get(role))]
        pairs = ((x, x.column('effort', drive)) for x in streams)
        stream, values = next((x, found) for x, found in pairs if found is not None)
        there = ~np.isnan(values)
        cycle = find_ticks(stream.stamp, dataset.start, dataset.cycle).tick
        inside = there & (cycle >= 0) & (cycle < dataset.cycles)
        stamps.append(stream.stamp[inside])
        cycles.append(cycle[inside])
        columns.append(values[inside])
    stamp, first = np.unique(np.concatenate(stamps), return_index=True)
    out = np.full((stamp.size, len(drives)), np.nan)
    for column, (own, values) in enumerate(zip(stamps, columns, strict=True)):
        out[np.searchsorted(stamp, own), column] = values
    return stamp, np.concatenate(cycles)[first], out


def preview(
    problem: Problem, show: Callable[[Series, Series], None], period: float
) -> Callable[[IdentifyProgress], None]:
    """Return what simulates and shows the best candidate so far, if it is due and a better one.

    Args:
        show: Gets the simulated and the residual effort, one stream a segment, thinned out.
        period: Least time from one to the next, s.
    """
    due, shown = -np.inf, np.inf

    def look(progress: IdentifyProgress) -> None:
        nonlocal due, shown
        begin = time.monotonic()
        if begin < due or not progress.best_cost < shown:
            return
        shown = progress.best_cost
        pairs = overlay_streams(problem, progress.best_theta)
        streams = ([pair[name] for pair in pairs] for name in ('simulated', 'residual'))
        show(*([x.taken(slice(None, None, -(-x.stamp.size // SAMPLES))) for x in own]
               for own in streams))  # fmt: skip
        due = begin + max(period, (time.monotonic() - begin) / SHARE)

    return look
