# SPDX-License-Identifier: Apache-2.0
"""From recordings to segments on the controller's grid, checked before anything is searched."""

from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.gates.examine import late_set_point
from ros2_ident.identify.result import Quality
from ros2_ident.machine.units import STATED_FOR
from ros2_ident.models import Machine
from ros2_ident.models.registry import compared_of, follows, kind_of, knows_gains, travel_of
from ros2_ident.recording import (
    align,
    choose_windows,
    Dataset,
    read_bags,
    Recording,
    SAMPLES,
    Topics,
)

# A shorter stretch holds hardly a motion, s. By hand.
SHORTEST = 0.5
# A model starts at rest; a log that starts in motion needs so long, s, to be forgotten. By hand.
SETTLING = 0.3
# Points of the grid from one sample to the next where no controller is simulated. By hand.
POINTS = 16


@dataclass(frozen=True, eq=False)
class Data:
    """Data of recordings to identify from.

    Attributes:
        datasets: Its segments on the grid of controller cycles.
        recordings: The recording each segment came from, in the same order; empty where unknown.
        labels: The bag each segment came from, by a short name; empty where there is one only.
        source: Path of the bag, or the name of the live buffer; of several with ` + ` between.
        sha256: Hash of the bag's files likewise, empty for live data.
        held_out: Returns parts of a long log to validate on, unusable ones left out; or None.
    """

    datasets: tuple[Dataset, ...]
    recordings: tuple[Recording, ...] = ()
    source: str = ''
    sha256: str = ''
    warnings: tuple[str, ...] = ()
    held_out: 'Callable[[], Data] | None' = None
    labels: tuple[str, ...] = ()

    def without_command(self) -> 'Data':
        """Return the same data as if no set-point had been logged."""

        def bare(dataset: Dataset) -> Dataset:
            return replace(dataset, command_position=None, command_velocity=None)

        rest = self.held_out
        held_out = rest and (lambda: rest().without_command())
        return replace(self, datasets=tuple(map(bare, self.datasets)), held_out=held_out)

    def quality(self, samples: int) -> Quality:
        """Return a summary; `samples` is the number of efforts compared."""
        came, lost = Counter[str](), Counter[str]()
        for dataset in self.datasets:
            for role, stream in dataset.streams.items():
                came[role] += stream.samples
                lost[role] += stream.missing or 0
        said = [w for d in self.datasets for w in d.warnings]
        return Quality(
            segments=len(self.datasets),
            duration=sum(d.duration for d in self.datasets),
            samples=samples,
            missing={role: lost[role] / max(1, lost[role] + came[role]) for role in came},
            warnings=tuple(dict.fromkeys([*self.warnings, *said])),
        )


def read_data(
    bags: str | Path | Sequence[str | Path],
    machine: Machine,
    drives: Sequence[str] | None = None,
    *,
    topics: Topics | None = None,
    samples: int = SAMPLES,
    quantities: Sequence[str] | None = None,
) -> Data:
    """Read bags into the data that `identify` takes.

    Args:
        bags: Path of a bag, or of several of one machine, for one fit.
        machine: The machine it was recorded on.
        drives: Drives to identify; all where None.
        samples: As for `gather`.
        quantities: As for `gather`.

    Returns:
        The segments.

    Raises:
        IdentError: As `read_bags`, `align` and `gather`.
    """
    several = [bags] if isinstance(bags, str | Path) else bags
    recordings = read_bags(several, topics, travel_of(machine), machine.drives)
    return gather(recordings, machine, drives, samples=samples, quantities=quantities)


def gather(
    recordings: Sequence[Recording],
    machine: Machine,
    drives: Sequence[str] | None = None,
    *,
    samples: int = SAMPLES,
    quantities: Sequence[str] | None = None,
) -> Data:
    """Bring recordings onto the controller's grid; unusable ones are left out with a warning.

    Args:
        recordings: From `read_bag` or a `RecordingBuilder`; of one bag or of several.
        machine: The machine they were recorded on.
        drives: Drives to identify; all where None.
        samples: Effort samples to fit on, all drives together; of a longer log the windows are
            taken that tell most (see `recording.windows`), and others are held out.
        quantities: What will be compared, so has to be in the log: of `effort`, `position` and
            `velocity`; what the kind of machine compares where None.

    Returns:
        The segments that can be used.

    Raises:
        IdentError: NO_DATA where none can be used; where there is only one, what is wrong with it;
            WRONG_UNITS where a log states its effort in another unit than the machine file.
    """
    chosen = chosen_drives(machine, drives)
    compared = quantities or compared_of(machine)
    aligned = partial(_aligned, machine=machine, chosen=chosen, quantities=compared)
    for recording in recordings if 'effort' in compared else ():
        _require_unit(recording, machine, chosen)
    if not recordings:
        raise ErrorCode.NO_DATA.error(
            'there is no recording to identify from; record a motion first'
        )
    sources = {r.source: r.sha256 for r in recordings}
    labels = _labels(recordings)
    kept: list[tuple[Dataset, Recording, str]] = []
    warnings: list[str] = []
    held_out: Callable[[], Data] | None = None
    windows = choose_windows(recordings, chosen, samples)
    if windows is not None:
        log, bags, rest = recordings, labels, windows.check

        def held_out() -> Data:
            parts = []
            for n, begin, end in rest:
                with suppress(IdentError):
                    parts.append((_forgotten(aligned(log[n].between(begin, end))), bags[n]))
            return Data(tuple(d for d, _ in parts), labels=tuple(label for _, label in parts))

        seconds = sum(end - begin for _, begin, end in windows.fit) * 1e-9
        warnings.append(
            f'the log has {windows.samples} effort samples: fitted to the {len(windows.fit)} most '
            f'informative windows, {seconds:.0f} s of '
            f'{sum(x.duration for x in recordings):.0f} s; --samples takes more of it'
        )
        recordings = [recordings[n].between(begin, end) for n, begin, end in windows.fit]
        labels = tuple(labels[n] for n, _, _ in windows.fit)
    first: IdentError | None = None
    for number, (recording, label) in enumerate(zip(recordings, labels, strict=True), 1):
        place = ', '.join(filter(None, [label, f'segment {number} of {len(recordings)}']))
        try:
            dataset = aligned(recording)
            if dataset.duration < SHORTEST:
                raise ErrorCode.NO_DATA.error(
                    f'{recording.source or "recording"}: lasts {dataset.duration:.3g} s; '
                    f'record a motion of several seconds, {SHORTEST:g} s is the least'
                )
        except IdentError as error:
            first = first or error
            warnings.append(f'{place} is left out: {error.message}')
            continue
        # What went on before a window is unknown, and no mistake of the recording's.
        if windows is not None:
            dataset = _forgotten(dataset)
        elif _starts_in_motion(dataset, machine):
            dataset = _forgotten(dataset)
            warnings.append(
                f'{place} starts in motion: its first {SETTLING:g} s are simulated and not '
                'compared; let recordings start at rest'
            )
        kept.append((dataset, recording, label))
    if not kept:
        assert first is not None
        raise first
    datasets, used, origin = zip(*kept, strict=True)
    late = next(filter(None, (late_set_point(machine, x, chosen) for x in datasets)), '')
    source, sha256 = ' + '.join(sources), ' + '.join(dict.fromkeys(sources.values()))
    said = tuple([*warnings, late] if late else warnings)
    data = Data(datasets, used, source, sha256, said, held_out, origin)
    return data.without_command() if late else data


def _require_unit(recording: Recording, machine: Machine, chosen: tuple[str, ...]) -> None:
    """Refuse an effort whose stated unit is not that of the machine file."""
    for name in chosen:
        unit = recording.units.get((name, 'effort'), machine.effort_unit)
        if unit != machine.effort_unit:
            needed = f' and {STATED_FOR[unit]}' if unit in STATED_FOR else ''
            raise ErrorCode.WRONG_UNITS.error(
                f'{recording.source}: its column map states the effort of {name} in {unit}, the '
                f'machine file in {machine.effort_unit}; write `effort_unit: {unit}`'
                f'{needed} in the machine file, or in the map a `scale` to '
                f'{machine.effort_unit} in place of the unit'
            )


def _labels(recordings: Sequence[Recording]) -> tuple[str, ...]:
    """Return a short name of each recording's bag; empty where all are of one."""
    sources = list(dict.fromkeys(r.source for r in recordings))
    if len(sources) < 2:
        return ('',) * len(recordings)
    names: dict[str, str] = {}
    for source in sources:
        stem = Path(source).stem or 'bag'
        count = sum(name.partition('#')[0] == stem for name in names.values())
        names[source] = f'{stem}#{count + 1}' if count else stem
    return tuple(names[r.source] for r in recordings)


def chosen_drives(machine: Machine, drives: Sequence[str] | None) -> tuple[str, ...]:
    """Return the drives to identify in the machine's order.

    Raises:
        IdentError: INVALID_GOAL where the list is empty, repeats a drive or names a strange one.
    """
    if drives is None:
        return machine.drives
    known = ', '.join(machine.drives)
    if isinstance(drives, str) or not drives:
        raise ErrorCode.INVALID_GOAL.error(f'no drive is chosen; name at least one of {known}')
    for name in drives:
        if name not in machine.drives:
            raise ErrorCode.INVALID_GOAL.error(
                f'drive {name!r} is not in the machine file; choose from {known}'
            )
    if len(set(drives)) != len(drives):
        raise ErrorCode.INVALID_GOAL.error(
            f'the drives {", ".join(drives)} repeat one; name each only once'
        )
    return tuple(name for name in machine.drives if name in drives)


def _aligned(
    recording: Recording, machine: Machine, chosen: tuple[str, ...], quantities: Sequence[str]
) -> Dataset:
    """Align all drives of the machine; only the chosen ones need the quantities compared."""
    dataset = align(
        recording,
        machine.drives,
        machine.number('cycle'),
        need=quantities if chosen == machine.drives else (),
        effort_scale=machine.effort_scales,
        released=kind_of(machine).released,
        follows=follows(machine) and knows_gains(machine),
    )
    where = recording.source or 'recording'
    idle = undriven(dataset) if chosen == machine.drives else ()
    for name in (x for x in chosen if x not in idle) if 'effort' in quantities else ():
        if dataset.effort is None:
            raise ErrorCode.MISSING_STREAM.error(
                f"{where}: no stream holds an effort; record the drives' effort, "
                'or name the topic or column that carries it'
            )
        row = dataset.effort[dataset.names.index(name)]
        there = row[~np.isnan(row)]
        if not there.size:
            raise ErrorCode.MISSING_STREAM.error(
                f'{where}: no effort of {name}; leave this drive out, or record its effort'
            )
        if there.max() == there.min():
            raise ErrorCode.BAD_VALUES.error(
                f'{where}: the effort of {name} is {there[0]:g} in every sample; '
                'switch its measurement on in the drive, or leave this drive out'
            )
    driving = [x for x in (dataset.command_position, dataset.position) if x is not None]
    # A model that begins where the log does goes from there to a set-point that stands.
    driving = driving[: 1 + kind_of(machine).starts_in_motion]
    if driving and all(
        np.allclose(np.nanmin(x, axis=1), np.nanmax(x, axis=1), rtol=0.0, equal_nan=True)
        for x in driving
    ):
        raise ErrorCode.NO_DATA.error(
            f'{where}: no drive moves; record a motion that accelerates every drive'
        )
    return dataset.coarse(POINTS)


def undriven(dataset: Dataset) -> tuple[str, ...]:
    """Return the drives that have no effort, or 0 in every sample, beside others that have one.

    What swings freely is so, and what was not measured.
    """
    if dataset.effort is None:
        return ()
    there = np.nan_to_num(dataset.effort).any(axis=1)
    return tuple(np.array(dataset.names)[~there].tolist()) if there.any() else ()


def _starts_in_motion(dataset: Dataset, machine: Machine) -> bool:
    """Return whether a log starts faster than a model at rest: 2 % of its top speed, by hand."""
    speed = dataset.command_velocity
    if speed is None or dataset.effort is None:
        return False
    if dataset.position is not None and kind_of(machine).starts_in_motion:
        return False
    fast = np.abs(speed).max()
    return bool(np.abs(speed[:, 0]).max() >= 0.02 * fast > 0.0)


def _forgotten(dataset: Dataset) -> Dataset:
    """Leave out the efforts that still depend on the motion before the log."""
    if dataset.effort is None:
        return dataset
    effort = dataset.effort.copy()
    effort[:, : round(SETTLING / dataset.cycle)] = np.nan
    return replace(dataset, effort=effort)
