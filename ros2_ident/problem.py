# SPDX-License-Identifier: Apache-2.0
"""What is to be solved: a machine's model on all segments of a recording, as one problem."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

import numpy as np
import numpy.typing as npt

from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.models import DriveModel, EffectAt, Machine, Parameter, make_model
from ros2_ident.models.drive_model import SLOTS
from ros2_ident.models.machine import constant
from ros2_ident.recording import Dataset, Recording, Topics, align, read_bag
from ros2_ident.result import DriveResidual, Quality

Array = npt.NDArray[np.float64]
T = TypeVar('T')

# A shorter stretch holds hardly a motion.
SHORTEST = 0.5
# The models start at rest; where a stretch starts in motion, the controllers need this long to forget it.
SETTLING = 0.3


@dataclass(frozen=True, eq=False)
class Data:
    """What a recording gives to identify from.

    Attributes:
        datasets: Its segments on the grid of controller cycles.
        recordings: The recording each segment came from, in the same order; empty where unknown.
        source: Path of the bag, or the name of the live buffer.
        sha256: Hash of the bag's files, empty for live data.
        warnings: What was left out, one sentence each.
    """

    datasets: tuple[Dataset, ...]
    recordings: tuple[Recording, ...] = ()
    source: str = ''
    sha256: str = ''
    warnings: tuple[str, ...] = ()

    def quality(self, samples: int) -> Quality:
        """Return a summary; `samples` is the number of efforts compared."""
        came: dict[str, int] = {}
        lost: dict[str, int] = {}
        for dataset in self.datasets:
            for stream in dataset.quality.streams:
                came[stream.role] = came.get(stream.role, 0) + stream.samples
                lost[stream.role] = lost.get(stream.role, 0) + stream.missing
        said = [w for d in self.datasets for w in d.quality.warnings]
        return Quality(
            segments=len(self.datasets),
            duration=sum(d.duration for d in self.datasets),
            samples=samples,
            missing={role: lost[role] / max(1, lost[role] + came[role]) for role in came},
            warnings=tuple(dict.fromkeys([*self.warnings, *said])),
        )


def read_problem(
    bag: str | Path,
    machine: Machine,
    drives: Sequence[str] | None = None,
    *,
    topics: Topics | None = None,
) -> Data:
    """Read a bag into what `identify` takes.

    Args:
        bag: Path of a bag.
        machine: The machine it was recorded on.
        drives: Drives to identify; all where None.
        topics: Topic names.

    Returns:
        The segments.

    Raises:
        IdentError: As `read_bag`, `align` and `gather`.
    """
    return gather(read_bag(bag, topics), machine, drives)


def gather(
    recordings: Sequence[Recording], machine: Machine, drives: Sequence[str] | None = None
) -> Data:
    """Bring recordings onto the controller's grid; short or unusable ones are left out with a warning.

    Args:
        recordings: From `read_bag` or a `RecordingBuilder`.
        machine: The machine they were recorded on.
        drives: Drives to identify; all where None.

    Returns:
        The segments that can be used.

    Raises:
        IdentError: NO_DATA where none can be used; where there is only one, what is wrong with it.
    """
    chosen = chosen_drives(machine, drives)
    cycle = constant(machine.controller, 'cycle', 'controller')
    if not recordings:
        raise IdentError(ErrorCode.NO_DATA, 'there is no recording to identify from; record a motion first')
    kept: list[tuple[Dataset, Recording]] = []
    warnings: list[str] = []
    first: IdentError | None = None
    for number, recording in enumerate(recordings, 1):
        place = f'segment {number} of {len(recordings)}'
        try:
            dataset = _aligned(recording, machine, chosen, cycle)
            if dataset.duration < SHORTEST:
                raise IdentError(
                    ErrorCode.NO_DATA,
                    f'{recording.source or "recording"}: lasts {dataset.duration:.3g} s; '
                    f'record a motion of several seconds, {SHORTEST:g} s is the least',
                )
        except IdentError as error:
            first = first or error
            warnings.append(f'{place} is left out: {error.message}')
            continue
        kept.append((_settled(dataset, place, warnings), recording))
    if not kept:
        assert first is not None
        raise first
    one = recordings[0]
    datasets, used = zip(*kept, strict=True)
    return Data(datasets, used, one.source, one.sha256, tuple(warnings))


def chosen_drives(machine: Machine, drives: Sequence[str] | None) -> tuple[str, ...]:
    """Return the drives to identify in the machine's order.

    Raises:
        IdentError: INVALID_GOAL where the list is empty, repeats a drive or names a strange one.
    """
    if drives is None:
        return machine.drives
    known = ', '.join(machine.drives)
    if isinstance(drives, str) or not drives:
        raise IdentError(ErrorCode.INVALID_GOAL, f'no drive is chosen; name at least one of {known}')
    for name in drives:
        if name not in machine.drives:
            raise IdentError(
                ErrorCode.INVALID_GOAL, f'drive {name!r} is not in the machine file; choose from {known}'
            )
    if len(set(drives)) != len(drives):
        raise IdentError(
            ErrorCode.INVALID_GOAL, f'the drives {", ".join(drives)} repeat one; name each only once'
        )
    return tuple(name for name in machine.drives if name in drives)


def _aligned(recording: Recording, machine: Machine, chosen: tuple[str, ...], cycle: float) -> Dataset:
    """Align all drives of the machine; only the chosen ones need an effort."""
    everyone = chosen == machine.drives
    need = ('effort',) if everyone else ()
    dataset = align(recording, machine.drives, cycle, need=need, effort_scale=machine.effort_scale)
    if not everyone:
        _check_efforts(recording, dataset, chosen)
    _check_motion(recording, dataset, chosen)
    return dataset


def _check_efforts(recording: Recording, dataset: Dataset, chosen: tuple[str, ...]) -> None:
    where = recording.source or 'recording'
    if dataset.effort is None:
        raise IdentError(
            ErrorCode.MISSING_STREAM,
            f"{where}: no stream holds an effort; record the drives' effort, or name the topic that carries it",
        )
    for name in chosen:
        if np.isnan(dataset.effort[dataset.names.index(name)]).all():
            raise IdentError(
                ErrorCode.MISSING_STREAM, f'{where}: no effort of {name}; leave this drive out, or record its effort'
            )


def _check_motion(recording: Recording, dataset: Dataset, chosen: tuple[str, ...]) -> None:
    """Refuse what would cost minutes and tell nothing."""
    where = recording.source or 'recording'
    assert dataset.effort is not None
    for name in chosen:
        row = dataset.effort[dataset.names.index(name)]
        there = row[~np.isnan(row)]
        if there.size and float(there.max()) == float(there.min()):
            raise IdentError(
                ErrorCode.BAD_VALUES,
                f'{where}: the effort of {name} is {there[0]:g} in every sample; '
                'switch its measurement on in the drive, or leave this drive out',
            )
    driving = dataset.command_position if dataset.command_position is not None else dataset.position
    if driving is not None and float(np.nanmax(np.nanmax(driving, axis=1) - np.nanmin(driving, axis=1))) == 0.0:
        raise IdentError(
            ErrorCode.NO_DATA, f'{where}: no drive moves; record a motion that accelerates every drive'
        )


def _settled(dataset: Dataset, place: str, warnings: list[str]) -> Dataset:
    """Leave out the efforts at the start of a stretch that begins in motion."""
    speed = dataset.command_velocity
    if speed is None or dataset.effort is None:
        return dataset
    fast = np.abs(speed).max()
    if fast == 0.0 or np.abs(speed[:, 0]).max() < 0.02 * fast:
        return dataset
    effort = dataset.effort.copy()
    effort[:, : round(SETTLING / dataset.cycle)] = np.nan
    warnings.append(
        f'{place} starts in motion: its first {SETTLING:g} s are simulated and not compared; '
        'let recordings start at rest'
    )
    return replace(dataset, effort=effort)


class Problem:
    """A model on every segment, with its box.

    The cost of a candidate is the mean of the segments' costs (eq. 2), weighted by their samples; the
    residuals of the segments follow one another.

    Args:
        machine: The machine.
        data: The segments.
        drives: Drives whose effort is compared; all where None.
        fixed: Parameters held at a value: by full name, or `gear_stiffness` for that of every drive.
        bounds: (low, high) instead of the machine file's, by the same names.
        effects: Effects beside the nominal physics.
        cutoff: Low-pass of recorded motion where it drives the model [Hz].

    Raises:
        IdentError: INVALID_GOAL, UNKNOWN_PARAMETER, NO_DATA, or as `make_model`.
    """

    def __init__(
        self,
        machine: Machine,
        data: Data,
        *,
        drives: Sequence[str] | None = None,
        fixed: Mapping[str, float] | None = None,
        bounds: Mapping[str, tuple[float, float]] | None = None,
        effects: Sequence[EffectAt] = (),
        cutoff: float = 100.0,
    ) -> None:
        self.machine = machine
        self.data = data
        self.drives = chosen_drives(machine, drives)
        _check_names(machine, data)
        free = make_model(machine, data.datasets[0], drives=self.drives, effects=effects, cutoff=cutoff)
        self.fixed = _expanded(machine, free.parameters, dict(fixed or {}), 'fixed')
        changed = _expanded(machine, free.parameters, dict(bounds or {}), 'bounded')
        _check_overrides(self.fixed, changed)
        self.models: tuple[DriveModel, ...] = tuple(
            make_model(machine, d, drives=self.drives, effects=effects, fixed=self.fixed, cutoff=cutoff)
            for d in data.datasets
        )
        self.parameters: tuple[Parameter, ...] = tuple(
            replace(p, low=float(changed[p.name][0]), high=float(changed[p.name][1])) if p.name in changed else p
            for p in self.models[0].parameters
        )
        if not self.parameters:
            raise IdentError(
                ErrorCode.INVALID_GOAL, 'every parameter is fixed; leave at least one to be identified'
            )
        self.low: Array = np.array([p.low for p in self.parameters])
        self.high: Array = np.array([p.high for p in self.parameters])
        self.unit = self.models[0].output_unit
        counts = [(~np.isnan(m.measured)).sum(axis=1) for m in self.models]
        #: Lengths of the time series that make up the residual: drive after drive, segment after segment.
        self.series: tuple[int, ...] = tuple(int(n) for c in counts for n in c)
        self.samples = sum(self.series)
        if self.samples <= len(self.parameters):
            raise IdentError(
                ErrorCode.NO_DATA,
                f'{self.samples} effort samples cannot determine {len(self.parameters)} parameters; '
                'record a longer motion',
            )
        self._weights = [c.sum() / self.samples for c in counts]

    def costs(self, theta: Array) -> Array:
        """Return (S,) costs of (S, N) candidates, `unit`; inf where one diverged."""
        total = np.zeros(len(theta))
        for weight, model in zip(self._weights, self.models, strict=True):
            total += weight * model.costs(theta)
        return total

    def residuals(self, theta: Array) -> Array:
        """Return (S, R) measured less simulated effort of (S, N) candidates, `unit`; inf where one diverged."""
        if len(self.models) == 1:
            return self.models[0].residuals(theta)
        return np.concatenate([m.residuals(theta) for m in self.models], axis=1)

    def cost_of(self, residual: Array) -> float:
        """Return the cost that belongs to one residual vector (R,), `unit`."""
        total, start, series = 0.0, 0, iter(self.series)
        for weight in self._weights:
            parts = []
            for _ in self.drives:
                length = next(series)
                if length:
                    parts.append(float(np.sqrt(np.mean(residual[start : start + length] ** 2))))
                start += length
            total += float(weight) * (sum(parts) / len(parts) if parts else 0.0)
        return total if np.isfinite(total) else float('inf')

    def left(self, residual: Array) -> tuple[DriveResidual, ...]:
        """Return what a residual vector (R,) leaves of each drive's effort."""
        measured = [m.measured for m in self.models]
        square = np.zeros(len(self.drives))
        whole = np.zeros(len(self.drives))
        count = np.zeros(len(self.drives), dtype=int)
        start = 0
        for rows in measured:
            for d, row in enumerate(rows):
                there = row[~np.isnan(row)]
                square[d] += float(np.sum(residual[start : start + there.size] ** 2))
                whole[d] += float(np.sum(there**2))
                count[d] += there.size
                start += there.size
        return tuple(
            DriveResidual(
                name,
                float(np.sqrt(square[d] / max(1, count[d]))),
                float(np.sqrt(square[d] / whole[d])) if whole[d] > 0.0 else float('nan'),
                int(count[d]),
            )
            for d, name in enumerate(self.drives)
        )


def _check_names(machine: Machine, data: Data) -> None:
    if not data.datasets:
        raise IdentError(ErrorCode.NO_DATA, 'there is no segment to identify from; record a motion first')
    for dataset in data.datasets:
        missing = [name for name in machine.drives if name not in dataset.names]
        if missing:
            raise IdentError(
                ErrorCode.MISSING_STREAM,
                f'the data hold {", ".join(dataset.names)} and not {", ".join(missing)}; '
                "align them with the machine's drives",
            )
        if dataset.effort is None:
            raise IdentError(
                ErrorCode.MISSING_STREAM, 'the data hold no effort; record it, or name the topic that carries it'
            )


def _expanded(
    machine: Machine, parameters: Sequence[Parameter], given: Mapping[str, T], what: str
) -> dict[str, T]:
    """Return the entries by full name; a full name goes before the one for every drive."""
    known = [p.name for p in parameters]
    out: dict[str, T] = {}
    for name, value in sorted(given.items(), key=lambda item: '.' in item[0]):
        slot = SLOTS.get(name)
        if name in known:
            out[name] = value
        elif name in machine.bounds and slot is not None and not slot.shared:
            out.update({f'{drive}.{name}': value for drive in machine.drives if f'{drive}.{name}' in known})
        else:
            raise IdentError(
                ErrorCode.UNKNOWN_PARAMETER,
                f'{name!r} cannot be {what}: no such parameter; choose from {", ".join(known)}',
            )
    return out


def _check_overrides(fixed: Mapping[str, float], bounds: Mapping[str, tuple[float, float]]) -> None:
    for name, value in fixed.items():
        if not np.isfinite(value):
            raise IdentError(
                ErrorCode.INVALID_GOAL, f'{name} cannot be fixed at {value}; give a finite number'
            )
        if name in bounds:
            raise IdentError(
                ErrorCode.INVALID_GOAL, f'{name} is both fixed and bounded; give one of the two'
            )
    for name, (low, high) in bounds.items():
        if not (np.isfinite(low) and np.isfinite(high) and low < high):
            raise IdentError(
                ErrorCode.INVALID_GOAL,
                f'{name} has the bounds {low:g} to {high:g}; give a finite lower bound below a finite upper one',
            )
