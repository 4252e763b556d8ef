# SPDX-License-Identifier: Apache-2.0
"""What is to be solved: a machine's model on all segments of a recording, as one problem."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
import math
from typing import TypeVar

import numpy as np
import numpy.typing as npt

from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.identify.data import chosen_drives, Data
from ros2_ident.identify.result import DriveResidual
from ros2_ident.kernel.hooks import sources_digest
from ros2_ident.models import DriveModel, EffectAt, Machine, make_model, Parameter
from ros2_ident.models.drives.candidates import SLOTS

Array = npt.NDArray[np.float64]
T = TypeVar('T')


class Problem:
    """A model on every segment, with its box.

    The cost of a candidate is the mean of the segments' costs (eq. 2), weighted by their samples;
    the residuals of the segments follow one another.

    Args:
        machine: The machine.
        data: The segments.
        drives: Drives whose effort is compared; all where None.
        fixed: Parameters held at a value: by full name, or `gear_stiffness` for every drive's.
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
        self._how = (drives, fixed, bounds, effects, cutoff)
        self.drives = chosen_drives(machine, drives)
        _check_names(machine, data)
        free = make_model(
            machine, data.datasets[0], drives=self.drives, effects=effects, cutoff=cutoff
        )
        known = [p.name for p in free.parameters]
        # Drives that only follow have no free parameters; their gears may be known all the same.
        followers = [
            f'{drive}.{name}'
            for drive in machine.drives
            for name in machine.bounds
            if drive not in self.drives and not SLOTS[name].shared
        ]
        self.fixed = _expanded([*known, *followers], machine, dict(fixed or {}), 'fixed')
        changed = _expanded(known, machine, dict(bounds or {}), 'bounded')
        _check_overrides(self.fixed, changed)
        self.models: tuple[DriveModel, ...] = tuple(
            make_model(
                machine, d, drives=self.drives, effects=effects, fixed=self.fixed, cutoff=cutoff
            )
            for d in data.datasets
        )
        self.parameters: tuple[Parameter, ...] = tuple(
            replace(p, low=float(changed[p.name][0]), high=float(changed[p.name][1]))
            if p.name in changed
            else p
            for p in self.models[0].parameters
        )
        if not self.parameters:
            raise IdentError(
                ErrorCode.INVALID_GOAL,
                'every parameter is fixed; leave at least one to be identified',
            )
        self.low: Array = np.array([p.low for p in self.parameters])
        self.high: Array = np.array([p.high for p in self.parameters])
        self.unit = self.models[0].output_unit
        counts = [(~np.isnan(m.measured)).sum(axis=1) for m in self.models]
        #: Lengths of the residual's time series: drive after drive, segment after segment.
        self.series: tuple[int, ...] = tuple(int(n) for c in counts for n in c)
        self.samples = sum(self.series)
        if self.samples <= len(self.parameters):
            raise IdentError(
                ErrorCode.NO_DATA,
                f'{self.samples} effort samples cannot determine {len(self.parameters)} '
                'parameters; record a longer motion',
            )
        self._weights = [c.sum() / self.samples for c in counts]

    def __reduce__(self) -> tuple[Callable[..., 'Problem'], tuple[object, ...]]:
        """Pickle what the problem is made from; the models are made anew where it arrives."""
        # Only the overlay and the validation need the rest, and both are made here.
        data = replace(self.data, recordings=(), held_out=None)
        return _made_anew, (sources_digest(), self.machine, data, *self._how)

    def prepare(self) -> None:
        """Compile the simulation, or read it from the cache."""
        self.costs(0.5 * (self.low + self.high)[None, :])

    def work(self, points: Array) -> npt.NDArray[np.int64]:
        """Return (S,) how much work candidates (S, N) in the unit cube are."""
        return self.models[0].work(self.low + points * (self.high - self.low))

    def costs(
        self, theta: Array, limit: float = math.inf, stop: Callable[[], bool] | None = None
    ) -> Array:
        """Return the costs of candidates.

        Args:
            theta: (S, N) candidates.
            limit: Cost above which a candidate need not be simulated to the end.
            stop: Asked now and then; where it says True, nobody needs the result any more.

        Returns:
            (S,) costs, `unit`; inf where a candidate diverged. Where one is above `limit` it is a
            lower bound of the cost.
        """
        total = np.zeros(len(theta))
        below = np.arange(len(theta))
        for weight, model in zip(self._weights, self.models, strict=True):
            # A bit more than is left, so that the sum is above the limit in spite of rounding.
            left = (limit * (1.0 + 1e-12) - total[below]) / weight
            total[below] += weight * model.costs(theta[below], left, stop)
            below = below[(total[below] <= limit) & (total[below] < math.inf)]
            if not below.size:
                break
        return total

    def residuals(self, theta: Array) -> Array:
        """Return (S, R) measured less simulated effort of (S, N) candidates, `unit`.

        Rows of diverged candidates are inf.
        """
        if len(self.models) == 1:
            return self.models[0].residuals(theta)
        return np.concatenate([m.residuals(theta) for m in self.models], axis=1)

    def validate(self, theta: Array) -> tuple[DriveResidual, ...]:
        """Return what candidate (N,) leaves of each drive's effort in the parts held out.

        Empty where none are; they are simulated one at a time.
        """
        drives, fixed, _, effects, cutoff = self._how
        parts: list[tuple[DriveResidual, ...]] = []
        for dataset in self.data.held_out or ():
            part = Problem(
                self.machine,
                Data((dataset,)),
                drives=drives,
                fixed=fixed,
                effects=effects,
                cutoff=cutoff,
            )
            parts.append(part.left(part.residuals(theta[None, :])[0]))
        return tuple(_together(of_drive) for of_drive in zip(*parts, strict=True))

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


def _together(parts: Sequence[DriveResidual]) -> DriveResidual:
    """Return what is left of one drive's effort over several parts."""
    samples = sum(p.samples for p in parts)
    square = sum(p.samples * p.rms**2 for p in parts)
    # A share is the residual's RMS over the effort's, whose square it gives back.
    whole = sum(p.samples * (p.rms / p.share) ** 2 for p in parts if p.share > 0.0)
    return DriveResidual(
        parts[0].drive,
        float(np.sqrt(square / max(1, samples))),
        float(np.sqrt(square / whole)) if whole > 0.0 else float('nan'),
        samples,
    )


def require_sources(digest: str) -> None:
    """Refuse to work for a process whose sources differ: it would get other numbers.

    Args:
        digest: What `sources_digest` returns there.

    Raises:
        IdentError: INVALID_GOAL with the remedy.
    """
    if digest != sources_digest():
        raise IdentError(
            ErrorCode.INVALID_GOAL,
            'a worker has other sources of ros2_ident than this process; install the same version '
            'on all of them',
        )


def _made_anew(
    digest: str,
    machine: Machine,
    data: Data,
    drives: Sequence[str] | None,
    fixed: Mapping[str, float] | None,
    bounds: Mapping[str, tuple[float, float]] | None,
    effects: Sequence[EffectAt],
    cutoff: float,
) -> Problem:
    """Return a pickled problem, or refuse to where it would give other numbers."""
    require_sources(digest)
    return Problem(
        machine,
        data,
        drives=drives,
        fixed=fixed,
        bounds=bounds,
        effects=effects,
        cutoff=cutoff,
    )


def _check_names(machine: Machine, data: Data) -> None:
    if not data.datasets:
        raise IdentError(
            ErrorCode.NO_DATA, 'there is no segment to identify from; record a motion first'
        )
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
                ErrorCode.MISSING_STREAM,
                'the data hold no effort; record it, or name the topic that carries it',
            )


def _expanded(
    known: Sequence[str], machine: Machine, given: Mapping[str, T], what: str
) -> dict[str, T]:
    """Return the entries by full name; a full name goes before the one for every drive."""
    out: dict[str, T] = {}
    for name, value in sorted(given.items(), key=lambda item: '.' in item[0]):
        of_drives = [f'{drive}.{name}' for drive in machine.drives if f'{drive}.{name}' in known]
        if name in known:
            out[name] = value
        elif of_drives:
            out.update(dict.fromkeys(of_drives, value))
        else:
            raise IdentError(
                ErrorCode.UNKNOWN_PARAMETER,
                f'{name!r} cannot be {what}: no such parameter; choose from {", ".join(known)}',
            )
    return out


def _check_overrides(
    fixed: Mapping[str, float], bounds: Mapping[str, tuple[float, float]]
) -> None:
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
                f'{name} has the bounds {low:g} to {high:g}; '
                'give a finite lower bound below a finite upper one',
            )
